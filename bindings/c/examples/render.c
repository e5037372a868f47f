/* Renders an orbit about a scene into FOLDER/frame_000.ppm and so on: render SCENE FOLDER [FRAMES]. */

#include <stdio.h>
#include <stdlib.h>

#include <gs3.h>

enum { WIDTH = 320, HEIGHT = 180 };

static void must(gs3_status status) {
    if (status != GS3_OK) {
        fprintf(stderr, "%s\n", gs3_last_error());
        exit(1);
    }
}

int main(int count, char **arguments) {
    if (count < 3) {
        fprintf(stderr, "usage: render SCENE FOLDER [FRAMES]\n");
        return 2;
    }
    const unsigned frames = count > 3 ? (unsigned)atoi(arguments[3]) : 60;
    gs3_scene *scene = NULL;
    must(gs3_scene_open(arguments[1], NULL, &scene));
    gs3_renderer *renderer = NULL;
    must(gs3_renderer_create(scene, &(gs3_renderer_desc){.struct_size = sizeof(gs3_renderer_desc)},
                             &renderer));
    static unsigned char pixels[WIDTH * HEIGHT * 3];
    const gs3_output output = {
        .struct_size = sizeof output, .format = GS3_FORMAT_RGB8, .data = pixels, .size = sizeof pixels};
    for (unsigned frame = 0; frame < frames; frame++) {
        gs3_camera camera = {.struct_size = sizeof camera};
        must(gs3_camera_orbit(scene, frame, frames, WIDTH, HEIGHT, &camera));
        const gs3_render_desc desc = {.struct_size = sizeof desc, .camera = &camera, .output = &output};
        must(gs3_renderer_render(renderer, &desc, NULL));
        char path[1024];
        snprintf(path, sizeof path, "%s/frame_%03u.ppm", arguments[2], frame);
        FILE *file = fopen(path, "wb");
        if (!file || fprintf(file, "P6 %d %d 255\n", WIDTH, HEIGHT) < 0 ||
            fwrite(pixels, sizeof pixels, 1, file) != 1 || fclose(file) != 0) {
            perror(path);
            return 1;
        }
    }
    gs3_renderer_destroy(renderer);
    gs3_scene_destroy(scene);
    return 0;
}
