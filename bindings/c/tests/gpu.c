/* Adapters, and frames of one that is usable. Arguments: a scene file. */

#include <math.h>

#include "check.h"

enum { WIDTH = 64, HEIGHT = 48 };

static float image[2][HEIGHT * WIDTH * 4];

/* Renders a frame without history on a machine. */
static void render(const gs3_scene *scene, gs3_backend backend, uint32_t adapter, float *to) {
    const gs3_renderer_desc desc = {.struct_size = sizeof desc,
                                    .backend = backend,
                                    .adapter = adapter,
                                    .threads = 1,
                                    .scale = 2,
                                    .refine = GS3_REFINE_OFF};
    gs3_renderer *renderer = NULL;
    CHECK(gs3_renderer_create(scene, &desc, &renderer) == GS3_OK);
    gs3_camera camera = {.struct_size = sizeof camera};
    CHECK(gs3_camera_orbit(scene, 0, 100, WIDTH, HEIGHT, &camera) == GS3_OK);
    const gs3_output output = {.struct_size = sizeof output, .data = to, .size = sizeof image[0]};
    const gs3_render_desc call = {.struct_size = sizeof call, .camera = &camera, .output = &output};
    CHECK(gs3_renderer_render(renderer, &call, NULL) == GS3_OK);
    gs3_renderer_info info = {.struct_size = sizeof info};
    CHECK(gs3_renderer_query_info(renderer, &info) == GS3_OK);
    CHECK(info.backend == (uint32_t)backend);
    CHECK((info.adapter[0] != '\0') == (backend == GS3_BACKEND_GPU));
    gs3_memory memory = {.struct_size = sizeof memory};
    CHECK(gs3_renderer_query_memory(renderer, &memory) == GS3_OK);
    CHECK((memory.device_bytes > sizeof image) == (backend == GS3_BACKEND_GPU));
    gs3_renderer_destroy(renderer);
}

int main(int count, char **arguments) {
    CHECK(count == 2);
    gs3_scene *scene = NULL;
    CHECK(gs3_scene_open(arguments[1], NULL, &scene) == GS3_OK);
    uint32_t adapters = 0, usable = 0;
    CHECK(gs3_query_adapter_count(&adapters) == GS3_OK);
    gs3_adapter_info info = {.struct_size = sizeof info};
    CHECK_FAILS(gs3_query_adapter(adapters, &info), GS3_ERROR_ARGUMENT, "index: expected a number below");
    for (uint32_t index = 0; index < adapters; index++) {
        CHECK(gs3_query_adapter(index, &info) == GS3_OK);
        CHECK(info.name[0] != '\0' && info.kind <= GS3_ADAPTER_KIND_SOFTWARE);
        if (info.is_usable && usable == 0) {
            usable = index + 1;
        }
    }
    gs3_renderer *renderer = NULL;
    const gs3_renderer_desc none = {
        .struct_size = sizeof none, .backend = GS3_BACKEND_GPU, .adapter = adapters + 1};
    CHECK(gs3_renderer_create(scene, &none, &renderer) == GS3_ERROR_DEVICE && renderer == NULL);
    if (usable > 0) {
        render(scene, GS3_BACKEND_CPU, 0, image[0]);
        render(scene, GS3_BACKEND_GPU, usable, image[1]);
        float worst = 0.0f;
        for (int k = 0; k < HEIGHT * WIDTH * 4; k++) {
            worst = fmaxf(worst, fabsf(image[0][k] - image[1][k]));
        }
        /* A GPU keeps colours in half precision: half a step of 8 bits and more. */
        CHECK(worst < 0.02f);
    } else {
        puts("skipped: no usable adapter (Mesa's lavapipe is one)");
    }
    gs3_scene_destroy(scene);
    return checks_end();
}
