/*
 * What a renderer refuses, and that it goes on afterwards. Arguments: a scene file and a folder, which stays empty.
 */

#include "logged.h"
#include "orbit.h"

static void refusals(gs3_scene *scene) {
    gs3_renderer *renderer = NULL;
    gs3_renderer_desc desc = {
        .struct_size = sizeof desc, .backend = GS3_BACKEND_CPU, .threads = 1, .scale = 9};
    CHECK_FAILS(gs3_renderer_create(scene, &desc, &renderer), GS3_ERROR_ARGUMENT,
                "scale: expected 1 to 8, found 9");
    CHECK(strncmp(gs3_last_error(), "gs3_renderer_create: desc: ", 27) == 0);
    CHECK(strcmp(gs3_last_error(), last_logged) == 0);
    desc.scale = 4;
    desc.mode = 4;
    CHECK_FAILS(gs3_renderer_create(scene, &desc, &renderer), GS3_ERROR_ARGUMENT,
                "mode: expected 0 to 3 (gs3_mode), found 4");
    desc.mode = GS3_MODE_FULL;
    desc.in_between_count = 4;
    CHECK_FAILS(gs3_renderer_create(scene, &desc, &renderer), GS3_ERROR_ARGUMENT, "expected 1 to 3 frames");
    desc.in_between_count = 0;
    desc.networks = GS3_NETWORKS_HIGH;
    desc.scale = 3;
    CHECK_FAILS(gs3_renderer_create(scene, &desc, &renderer), GS3_ERROR_UNSUPPORTED, "networks: ");
    desc.networks = GS3_NETWORKS_NONE;
    desc.refine = GS3_REFINE_FRAME_TIME;
    CHECK_FAILS(gs3_renderer_create(scene, &desc, &renderer), GS3_ERROR_ARGUMENT,
                "refine_value: expected milliseconds above 0");
    desc.refine = GS3_REFINE_SHARE;
    desc.refine_value = 1.5f;
    CHECK_FAILS(gs3_renderer_create(scene, &desc, &renderer), GS3_ERROR_ARGUMENT, "found 1.5");
    desc.threads = 5000;
    CHECK_FAILS(gs3_renderer_create(scene, &desc, &renderer), GS3_ERROR_ARGUMENT,
                "threads: expected 0 to 1024, found 5000");
    CHECK_FAILS(gs3_renderer_create(NULL, &desc, &renderer), GS3_ERROR_ARGUMENT,
                "scene: expected a pointer, found null");
    CHECK_FAILS(gs3_renderer_create(scene, &desc, NULL), GS3_ERROR_ARGUMENT,
                "renderer: expected a pointer, found null");
    CHECK(renderer == NULL);

    desc =
        (gs3_renderer_desc){.struct_size = sizeof desc, .backend = GS3_BACKEND_CPU, .threads = 1, .scale = 2};
    CHECK(gs3_renderer_create(scene, &desc, &renderer) == GS3_OK);
    static unsigned char bytes[HEIGHT * WIDTH * 3];
    gs3_camera camera = orbit_camera(scene, 0);
    gs3_output output = {
        .struct_size = sizeof output, .format = GS3_FORMAT_RGB8, .data = bytes, .size = sizeof bytes};
    gs3_render_desc call = {.struct_size = sizeof call, .camera = &camera, .output = &output};
    CHECK_FAILS(gs3_renderer_render(NULL, &call, NULL), GS3_ERROR_ARGUMENT, "renderer: expected a pointer");
    CHECK_FAILS(gs3_renderer_render(renderer, NULL, NULL), GS3_ERROR_ARGUMENT, "desc: expected a pointer");
    gs3_frame_info made = {.struct_size = 3};
    CHECK_FAILS(gs3_renderer_render(renderer, &call, &made), GS3_ERROR_DESCRIPTOR,
                "info: struct_size: expected");
    call.struct_size = 16;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_DESCRIPTOR,
                "desc: struct_size: expected");
    call.struct_size = sizeof call;
    call.camera = NULL;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "desc: camera: expected a pointer, found null");
    call.camera = &camera;
    call.output = NULL;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "desc: output: expected a pointer, found null");
    call.output = &output;
    output.size--;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_LAYOUT,
                "output: size: expected at least 9216 bytes for 64x48 pixels, found 9215");
    output.size++;
    output.pixel_stride = 2;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_LAYOUT,
                "pixel_stride: expected 0 or at least 3 bytes, found 2");
    output.pixel_stride = 0;
    output.row_stride = 191;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_LAYOUT,
                "row_stride: expected 0 or at least 192 bytes, found 191");
    output.row_stride = UINT64_MAX / 2;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_LAYOUT, "size: expected at least");
    output.row_stride = 0;
    output.format = 4;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "format: expected 0 to 3 (gs3_format), found 4");
    output.format = GS3_FORMAT_RGB8;
    output.data = NULL;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "output: data: expected a pointer, found null");
    output.data = bytes;
    camera.fx = -1.0;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "camera: fx: expected a positive finite number, found -1");
    camera = orbit_camera(scene, 0);
    camera.width = 9000;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "image size: expected 1x1 to 8192x8192, found 9000x48");
    camera.width = WIDTH;
    camera.view_from_world[0] = 7.0;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "camera pose: expected a finite rotation");
    camera = orbit_camera(scene, 0);
    call.in_between_count = 1;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "in_between_count: expected 0 or 0");
    call.in_between_count = 1000000;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "in_between_count: expected 0 to 3");
    call.in_between_count = 0;
    call.reset = 7;
    CHECK_FAILS(gs3_renderer_render(renderer, &call, NULL), GS3_ERROR_ARGUMENT,
                "reset: expected 0 or 1, found 7");
    call.reset = 0;

    /* A program of a newer version: what this one does not know must be zero. */
    struct {
        gs3_render_desc known;
        uint64_t unknown;
    } newer = {call, 0};
    newer.known.struct_size = sizeof newer;
    CHECK(gs3_renderer_render(renderer, &newer.known, NULL) == GS3_OK);
    newer.unknown = 1;
    CHECK_FAILS(gs3_renderer_render(renderer, &newer.known, NULL), GS3_ERROR_DESCRIPTOR,
                "expected zeros after");

    /* None of all that touched the history. */
    made.struct_size = sizeof made;
    CHECK(gs3_renderer_render(renderer, &call, &made) == GS3_OK && made.reset_reason == GS3_RESET_NONE);
    call.reset = 1;
    CHECK(gs3_renderer_render(renderer, &call, &made) == GS3_OK && made.reset_reason == GS3_RESET_CUT);
    call.reset = 0;
    CHECK(gs3_renderer_reset(renderer) == GS3_OK);
    CHECK(gs3_renderer_render(renderer, &call, &made) == GS3_OK && made.reset_reason == GS3_RESET_CUT);
    CHECK(gs3_renderer_set_scene(renderer, scene) == GS3_OK);
    CHECK(gs3_renderer_render(renderer, &call, &made) == GS3_OK && made.reset_reason == GS3_RESET_SCENE);
    desc.scale = 4;
    CHECK(gs3_renderer_configure(renderer, &desc) == GS3_OK);
    CHECK(gs3_renderer_render(renderer, &call, &made) == GS3_OK &&
          made.reset_reason == GS3_RESET_FIRST_FRAME);
    desc.scale = 77;
    CHECK_FAILS(gs3_renderer_configure(renderer, &desc), GS3_ERROR_ARGUMENT,
                "scale: expected 1 to 8, found 77");
    gs3_renderer_info info = {.struct_size = sizeof info};
    CHECK(gs3_renderer_query_info(renderer, &info) == GS3_OK && info.jitter_count == 16);
    gs3_renderer_destroy(renderer);
    gs3_renderer_destroy(NULL);
}

int main(int count, char **arguments) {
    CHECK(count == 3);
    gs3_set_log_callback(on_log, last_logged);
    gs3_scene *scene = NULL;
    CHECK(gs3_scene_open(arguments[1], NULL, &scene) == GS3_OK);
    refusals(scene);
    /* Every refusal above is one error. */
    CHECK(errors_logged == 29 && others_logged > 0);
    gs3_scene_destroy(scene);
    return checks_end();
}
