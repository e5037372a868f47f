/*
 * Whole frames of a scene, by all that the header says of them. Arguments: a scene file, a file of arrays,
 * and a folder to write frames into, which the caller compares with the library's own.
 */

#include "logged.h"
#include "orbit.h"

enum { FRAMES = 5 };

static void write_file(const char *folder, const char *name, const void *data, size_t size) {
    char path[1024];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, "wb");
    CHECK(file != NULL);
    CHECK(fwrite(data, 1, size, file) == size);
    CHECK(fclose(file) == 0);
}

static void queries(void) {
    CHECK(gs3_query_version() == GS3_VERSION);
    uint32_t width = 0, height = 0, count = 0;
    CHECK(gs3_query_render_size(1921, 1080, 4, &width, &height) == GS3_OK);
    CHECK(width == 481 && height == 270);
    CHECK(gs3_query_render_size(1920, 1080, 0, &width, &height) == GS3_OK);
    CHECK(width == 480 && height == 270);
    CHECK_FAILS(gs3_query_render_size(1920, 1080, 9, &width, &height), GS3_ERROR_ARGUMENT,
                "scale: expected 1 to 8");
    CHECK_FAILS(gs3_query_render_size(0, 1080, 4, &width, &height), GS3_ERROR_ARGUMENT,
                "width: expected 1 to 8192, found 0");
    CHECK_FAILS(gs3_query_render_size(8, 8, 4, NULL, &height), GS3_ERROR_ARGUMENT,
                "render_width: expected a pointer, found null");
    CHECK(gs3_query_jitter_count(4, &count) == GS3_OK && count == 16);
    int seen[4][4] = {{0}};
    for (uint32_t frame = 3; frame < 19; frame++) {
        float jitter[2];
        CHECK(gs3_query_jitter(4, frame, jitter) == GS3_OK);
        int column = (int)((jitter[0] + 0.5f) * 4.0f), row = (int)((jitter[1] + 0.5f) * 4.0f);
        CHECK(column >= 0 && column < 4 && row >= 0 && row < 4);
        CHECK(++seen[row][column] == 1);
    }
    gs3_memory memory = {.struct_size = sizeof memory};
    CHECK(gs3_query_memory(&memory) == GS3_OK && memory.device_bytes == 0);
}

static void scenes(const char *path, const gs3_scene *scene) {
    gs3_scene_info info = {.struct_size = sizeof info};
    CHECK(gs3_scene_query_info(scene, &info) == GS3_OK);
    CHECK(info.count == 300 && info.sh_degree == 1 && info.dropped == 0);
    CHECK(info.radius > 0.1 && info.near_plane > 0.0f);
    CHECK(info.opacity_mode == GS3_OPACITY_MODE_DEFAULT);
    /* An older program knows less of it. */
    gs3_scene_info older;
    memset(&older, 0x55, sizeof older);
    older.struct_size = 16;
    CHECK(gs3_scene_query_info(scene, &older) == GS3_OK);
    CHECK(older.count == 300 && older.dropped == 0x5555555555555555);

    gs3_memory memory = {.struct_size = sizeof memory};
    CHECK(gs3_scene_query_memory(scene, &memory) == GS3_OK);
    /* 11 numbers of geometry and 12 of colour. */
    CHECK(memory.host_bytes >= 300 * 23 * 4 && memory.host_bytes < 300 * 23 * 4 + 4096);
    CHECK(memory.device_bytes == 0);

    gs3_scene *none = NULL;
    CHECK_FAILS(gs3_scene_open("no such scene.ply", NULL, &none), GS3_ERROR_FILE, "no such scene.ply");
    CHECK_FAILS(gs3_scene_open(NULL, NULL, &none), GS3_ERROR_ARGUMENT,
                "path: expected a pointer, found null");
    CHECK_FAILS(gs3_scene_open(path, NULL, NULL), GS3_ERROR_ARGUMENT,
                "scene: expected a pointer, found null");
    CHECK_FAILS(gs3_scene_open("\xff", NULL, &none), GS3_ERROR_ARGUMENT, "path: expected UTF-8");
    gs3_scene_options options = {.struct_size = sizeof options, .level_of_detail = 3};
    CHECK_FAILS(gs3_scene_open(path, &options, &none), GS3_ERROR_FILE, "level of detail");
    options = (gs3_scene_options){.struct_size = sizeof options, .without_environment = 2};
    CHECK_FAILS(gs3_scene_open(path, &options, &none), GS3_ERROR_ARGUMENT,
                "without_environment: expected 0 or 1, found 2");
    options = (gs3_scene_options){.struct_size = sizeof options, .axes = "XYZ"};
    CHECK_FAILS(gs3_scene_open(path, &options, &none), GS3_ERROR_ARGUMENT, "axes: ");
    /* 300 Gaussians without coarser levels do not fit 299. */
    options = (gs3_scene_options){.struct_size = sizeof options, .budget = 299};
    CHECK_FAILS(gs3_scene_open(path, &options, &none), GS3_ERROR_FILE, "Gaussians: expected at most 299");
    const gs3_camera *camera = NULL;
    options = (gs3_scene_options){
        .struct_size = sizeof options, .budget = 300, .budget_cameras = &camera, .budget_camera_count = 1};
    CHECK_FAILS(gs3_scene_open(path, &options, &none), GS3_ERROR_ARGUMENT,
                "options: budget_cameras[0]: expected a pointer, found null");
    options.budget_camera_count = 0;
    CHECK(gs3_scene_open(path, &options, &none) == GS3_OK);
    gs3_scene_destroy(none);
    none = NULL;
    options.struct_size = 2;
    CHECK_FAILS(gs3_scene_open(path, &options, &none), GS3_ERROR_DESCRIPTOR,
                "options: struct_size: expected");
    CHECK(none == NULL);
    /* Twelve bytes of options leave out the axes. */
    options = (gs3_scene_options){.struct_size = 12, .axes = "XYZ"};
    CHECK(gs3_scene_open(path, &options, &none) == GS3_OK);
    gs3_scene_destroy(none);
    gs3_scene_destroy(NULL);
}

/* Arrays of a file: 300 Gaussians of degree 1. */
static gs3_scene *arrays_scene(const char *path) {
    enum { COUNT = 300 };
    static float numbers[COUNT * 23];
    FILE *file = fopen(path, "rb");
    CHECK(file != NULL);
    CHECK(fread(numbers, sizeof(float), COUNT * 23, file) == COUNT * 23);
    fclose(file);
    gs3_scene_arrays arrays = {
        .struct_size = sizeof arrays,
        .sh_degree = 1,
        .count = COUNT,
        .means = numbers,
        .scales = numbers + COUNT * 3,
        .rotations = numbers + COUNT * 6,
        .opacities = numbers + COUNT * 10,
        .sh = numbers + COUNT * 11,
    };
    gs3_scene *scene = NULL;
    CHECK(gs3_scene_from_arrays(&arrays, &scene) == GS3_OK);

    gs3_scene *none = NULL;
    gs3_scene_arrays wrong = arrays;
    wrong.sh = NULL;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_ARGUMENT,
                "arrays: sh: expected a pointer, found null");
    wrong = arrays;
    wrong.sh_degree = 5;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_ARGUMENT,
                "arrays: sh_degree: expected 0 to 4, found 5");
    wrong = arrays;
    wrong.count = 0;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_SCENE, "count: expected 1 or more");
    wrong.count = UINT64_MAX / 2;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_LAYOUT, "expected at most");
    wrong = arrays;
    wrong.means = (const float *)((const char *)numbers + 1);
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_LAYOUT,
                "means: expected an address divisible by 4");
    wrong = arrays;
    wrong.near_plane = -1.0f;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_ARGUMENT, "near_plane");
    wrong = arrays;
    wrong.opacity_mode = 2;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_ARGUMENT,
                "opacity_mode: expected 0 to 1 (gs3_opacity_mode)");
    wrong = arrays;
    wrong.struct_size = 48;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_DESCRIPTOR, "arrays: struct_size: expected");
    /* Scales of NaN leave nothing. */
    static float nans[COUNT * 3];
    memset(nans, 0xff, sizeof nans);
    wrong = arrays;
    wrong.scales = nans;
    CHECK_FAILS(gs3_scene_from_arrays(&wrong, &none), GS3_ERROR_SCENE, "no valid Gaussian");
    CHECK(none == NULL);
    return scene;
}

/* Frames and in-between frames, with gaps between pixels and rows, into tight files. */
static void full_frames(const gs3_scene *scene, const char *folder) {
    gs3_renderer_desc desc = {
        .struct_size = sizeof desc,
        .mode = GS3_MODE_FULL,
        .scale = 2,
        .backend = GS3_BACKEND_CPU,
        .threads = 2,
        .in_between_count = 2,
        .background = {0.1f, 0.2f, 0.3f},
    };
    gs3_renderer *renderer = NULL;
    CHECK(gs3_renderer_create(scene, &desc, &renderer) == GS3_OK);
    gs3_renderer_info info = {.struct_size = sizeof info};
    CHECK(gs3_renderer_query_info(renderer, &info) == GS3_OK);
    CHECK(info.backend == GS3_BACKEND_CPU && info.in_between_count == 2 && info.jitter_count == 4);
    CHECK(info.threads == 2 && info.adapter[0] == '\0');

    enum { PIXEL = 20, ROW = WIDTH * PIXEL + 12 };
    static unsigned char memory[HEIGHT * ROW];
    static float between[2][HEIGHT * WIDTH * 3];
    static float tight[HEIGHT * WIDTH * 4];
    const gs3_output output = {
        .struct_size = sizeof output,
        .format = GS3_FORMAT_RGBA_FLOAT32,
        .data = memory,
        .size = sizeof memory,
        .row_stride = ROW,
        .pixel_stride = PIXEL,
    };
    gs3_output outputs[2];
    for (int k = 0; k < 2; k++) {
        outputs[k] = (gs3_output){
            .struct_size = sizeof outputs[k],
            .format = GS3_FORMAT_RGB_FLOAT32,
            .data = between[k],
            .size = sizeof between[k],
        };
    }
    const gs3_output *const pointers[2] = {&outputs[0], &outputs[1]};
    for (uint32_t frame = 0; frame < FRAMES; frame++) {
        memset(memory, 0xab, sizeof memory);
        memset(between, 0xab, sizeof between);
        const gs3_camera camera = orbit_camera(scene, frame);
        const gs3_render_desc call = {
            .struct_size = sizeof call,
            .camera = &camera,
            .output = &output,
            .in_between_outputs = pointers,
            .in_between_count = 2,
        };
        gs3_frame_info made = {.struct_size = sizeof made};
        CHECK(gs3_renderer_render(renderer, &call, &made) == GS3_OK);
        CHECK(made.reset_reason == (frame == 0 ? GS3_RESET_FIRST_FRAME : GS3_RESET_NONE));
        CHECK(made.in_between_count == (frame == 0 ? 0u : 2u));
        CHECK(made.rasterize_ms > 0.0f && made.super_sample_ms > 0.0f);
        CHECK((made.interpolate_ms > 0.0f) == (frame > 0));
        int untouched = 1;
        for (size_t y = 0; y < HEIGHT; y++) {
            for (size_t x = 0; x < WIDTH; x++) {
                memcpy(tight + (y * WIDTH + x) * 4, memory + y * ROW + x * PIXEL, 16);
                for (size_t k = 16; k < PIXEL; k++) {
                    untouched &= memory[y * ROW + x * PIXEL + k] == 0xab;
                }
                CHECK(tight[(y * WIDTH + x) * 4 + 3] == 1.0f);
            }
            for (size_t k = WIDTH * PIXEL; k < ROW; k++) {
                untouched &= memory[y * ROW + k] == 0xab;
            }
        }
        CHECK(untouched);
        char name[64];
        snprintf(name, sizeof name, "full_%u.rgba", frame);
        write_file(folder, name, tight, sizeof tight);
        for (int k = 0; k < 2 && frame > 0; k++) {
            snprintf(name, sizeof name, "between_%u_%d.rgb", frame, k);
            write_file(folder, name, between[k], sizeof between[k]);
        }
        CHECK(frame > 0 || *(const unsigned char *)between == 0xab);
    }
    gs3_renderer_destroy(renderer);
}

/* The bytes of a native frame of a scene, three or four a pixel. */
static void native_frame(const gs3_scene *scene, const char *folder, const char *name, gs3_format format) {
    gs3_renderer_desc desc = {
        .struct_size = sizeof desc, .mode = GS3_MODE_NATIVE, .backend = GS3_BACKEND_CPU, .threads = 1};
    gs3_renderer *renderer = NULL;
    CHECK(gs3_renderer_create(scene, &desc, &renderer) == GS3_OK);
    static unsigned char bytes[HEIGHT * WIDTH * 4 + 1];
    size_t size = HEIGHT * WIDTH * (format == GS3_FORMAT_RGBA8 ? 4 : 3);
    memset(bytes, 0xab, sizeof bytes);
    const gs3_camera camera = orbit_camera(scene, 7);
    /* At an odd address. */
    const gs3_output output = {
        .struct_size = sizeof output, .format = format, .data = bytes + 1, .size = size};
    const gs3_render_desc call = {.struct_size = sizeof call, .camera = &camera, .output = &output};
    CHECK(gs3_renderer_render(renderer, &call, NULL) == GS3_OK);
    CHECK(bytes[0] == 0xab && (format == GS3_FORMAT_RGBA8 || bytes[1 + size] == 0xab));
    write_file(folder, name, bytes + 1, size);
    gs3_renderer_destroy(renderer);
}

/* Settings that are none of the defaults; the caller renders the same. */
static void settings(const gs3_scene *scene, const char *folder) {
    const gs3_renderer_desc descs[] = {
        {.networks = GS3_NETWORKS_FAST, .refine = GS3_REFINE_OFF},
        {.scale = 2, .kriging = GS3_KRIGING_ON, .quality = GS3_QUALITY_HIGH, .overscan = 1},
        {.scale = 2, .refine = GS3_REFINE_SHARE, .refine_value = 0.2f, .sampling = GS3_SAMPLING_CENTERED},
        {.scale = 2, .mode = GS3_MODE_BICUBIC, .dilation = GS3_DILATION_KERBL},
        {.scale = 3, .dilation = GS3_DILATION_VALUE, .dilation_value = 0.05f, .kriging = GS3_KRIGING_FINE},
    };
    for (size_t k = 0; k < sizeof descs / sizeof descs[0]; k++) {
        gs3_renderer_desc desc = descs[k];
        desc.struct_size = sizeof desc;
        desc.backend = GS3_BACKEND_CPU;
        desc.threads = 1;
        gs3_renderer *renderer = NULL;
        CHECK(gs3_renderer_create(scene, &desc, &renderer) == GS3_OK);
        static unsigned char bytes[HEIGHT * WIDTH * 3];
        const gs3_output output = {
            .struct_size = sizeof output, .format = GS3_FORMAT_RGB8, .data = bytes, .size = sizeof bytes};
        for (uint32_t frame = 0; frame < 3; frame++) {
            gs3_camera camera = orbit_camera(scene, frame);
            /* The same view in axes of OpenGL: y up and z backward. */
            camera.axes = GS3_VIEW_AXES_RIGHT_UP_BACK;
            for (int i = 4; i < 12; i++) {
                camera.view_from_world[i] = -camera.view_from_world[i];
            }
            const gs3_render_desc call = {.struct_size = sizeof call, .camera = &camera, .output = &output};
            CHECK(gs3_renderer_render(renderer, &call, NULL) == GS3_OK);
        }
        char name[64];
        snprintf(name, sizeof name, "settings_%zu.rgb8", k);
        write_file(folder, name, bytes, sizeof bytes);
        gs3_renderer_destroy(renderer);
    }
}

/* The library's memory is the sum of what renderers say they have. */
static void memory(const gs3_scene *scene, uint32_t threads) {
    gs3_memory before = {.struct_size = sizeof before}, with = before, own = before;
    CHECK(gs3_query_memory(&before) == GS3_OK);
    gs3_renderer_desc desc = {
        .struct_size = sizeof desc, .backend = GS3_BACKEND_CPU, .threads = threads, .scale = 2};
    gs3_renderer *renderer = NULL;
    CHECK(gs3_renderer_create(scene, &desc, &renderer) == GS3_OK);
    static float pixels[HEIGHT * WIDTH * 4];
    const gs3_camera camera = orbit_camera(scene, 0);
    const gs3_output output = {.struct_size = sizeof output, .data = pixels, .size = sizeof pixels};
    const gs3_render_desc call = {.struct_size = sizeof call, .camera = &camera, .output = &output};
    uint64_t settled = 0;
    for (int frame = 0; frame < 12; frame++) {
        CHECK(gs3_renderer_render(renderer, &call, NULL) == GS3_OK);
        CHECK(gs3_renderer_query_memory(renderer, &own) == GS3_OK);
        if (frame == 9) {
            settled = own.host_bytes;
        }
    }
    /* A history of a resting camera is full, and needs no more. Of two threads, one needs more when it first makes a tile that
       the other made before. */
    CHECK((threads > 1 || own.host_bytes <= settled + 4096) && own.device_bytes == 0);
    /* At least this frame and the one before. */
    CHECK(own.host_bytes > 2 * sizeof pixels && own.host_bytes < 64u << 20);
    CHECK(gs3_query_memory(&with) == GS3_OK);
    uint64_t grown = with.host_bytes - before.host_bytes;
    CHECK(grown >= own.host_bytes && grown < own.host_bytes + 4096);
    gs3_renderer_destroy(renderer);
}

/* Renderers leave no more than the records of ended threads. */
static void lives(const gs3_scene *scene, uint32_t threads) {
    /* A thread that ends leaves 2304 + 2072 bytes, a record and a list of the library of its queues (crossbeam-epoch), until
       threads of later renderers collect them. So what lies there is of two renderers at most. */
    enum { LIVES = 4, LEFT_BY_THREAD = 2304 + 2072 };
    gs3_memory before = {.struct_size = sizeof before}, after = before;
    CHECK(gs3_query_memory(&before) == GS3_OK);
    for (int life = 0; life < LIVES; life++) {
        memory(scene, threads);
    }
    CHECK(gs3_query_memory(&after) == GS3_OK);
    CHECK(after.host_bytes <= before.host_bytes + 2 * threads * LEFT_BY_THREAD);
}

int main(int count, char **arguments) {
    CHECK(count == 4);
    CHECK(strcmp(gs3_last_error(), "") == 0);
    gs3_set_log_callback(on_log, last_logged);
    queries();
    gs3_scene *scene = NULL;
    CHECK(gs3_scene_open(arguments[1], NULL, &scene) == GS3_OK);
    CHECK(others_logged > 0);
    scenes(arguments[1], scene);
    gs3_scene *arrays = arrays_scene(arguments[2]);
    CHECK(errors_logged > 10);
    full_frames(scene, arguments[3]);
    native_frame(scene, arguments[3], "native.rgb8", GS3_FORMAT_RGB8);
    native_frame(scene, arguments[3], "native.rgba8", GS3_FORMAT_RGBA8);
    native_frame(arrays, arguments[3], "arrays.rgb8", GS3_FORMAT_RGB8);
    settings(scene, arguments[3]);
    lives(scene, 1);
    lives(scene, 2);
    gs3_set_log_callback(NULL, NULL);
    int logged = errors_logged;
    CHECK(gs3_query_jitter_count(99, NULL) == GS3_ERROR_ARGUMENT);
    CHECK(errors_logged == logged);
    gs3_scene_destroy(arrays);
    gs3_scene_destroy(scene);
    return checks_end();
}
