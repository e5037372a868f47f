/*
 * The reconstructor alone, fed by a renderer of a wall: at rest it reaches the image that the renderer makes
 * of every pixel, however the numbers lie in memory and whatever depths mean.
 */

#include <math.h>

#include "check.h"

enum {
    WIDTH = 64,
    HEIGHT = 48,
    SCALE = 4,
    LR_WIDTH = WIDTH / SCALE,
    LR_HEIGHT = HEIGHT / SCALE,
    LR = LR_WIDTH * LR_HEIGHT
};

static const double FOCAL = 60.0, WALL = 5.0;
static const float NEAR_PLANE = 0.5f, FAR_PLANE = 40.0f;

/* Colour of the wall and its derivatives along x and y, per world unit. */
static void wall(double x, double y, float color[3], float dx[3], float dy[3]) {
    color[0] = (float)(0.5 + 0.4 * sin(2.0 * x));
    color[1] = (float)(0.5 + 0.4 * cos(1.5 * y));
    color[2] = (float)(0.5 + 0.3 * sin(x + 2.0 * y));
    dx[0] = (float)(0.8 * cos(2.0 * x));
    dx[1] = 0.0f;
    dx[2] = (float)(0.3 * cos(x + 2.0 * y));
    dy[0] = 0.0f;
    dy[1] = (float)(-0.6 * sin(1.5 * y));
    dy[2] = (float)(0.6 * cos(x + 2.0 * y));
}

/* The camera at (x, 0, 0) that looks along z. */
static gs3_camera camera_at(double x) {
    return (gs3_camera){
        .struct_size = sizeof(gs3_camera),
        .width = WIDTH,
        .height = HEIGHT,
        .view_from_world = {1, 0, 0, -x, 0, 1, 0, 0, 0, 0, 1, 0},
        .fx = FOCAL,
        .fy = FOCAL,
        .cx = WIDTH / 2.0,
        .cy = HEIGHT / 2.0,
    };
}

/* What the renderer has: RGBA pixel by pixel, planes of the same, derivatives, depth. */
typedef struct {
    float rgba[LR][4];
    float planes[3][LR];
    float dx[LR][3];
    float dy[LR][3];
    float depth[LR];
} lr_frame;

static float encoded_depth(uint32_t encoding) {
    double z = WALL, near = NEAR_PLANE, far = FAR_PLANE, projective = far / (far - near) * (1.0 - near / z);
    switch (encoding) {
    case GS3_DEPTH_ENCODING_PROJECTIVE:
        return (float)projective;
    case GS3_DEPTH_ENCODING_REVERSED:
        return (float)(1.0 - projective);
    case GS3_DEPTH_ENCODING_LINEAR:
        return (float)((z - near) / (far - near));
    default:
        return (float)z;
    }
}

static void render(lr_frame *frame, double x, const float jitter[2], uint32_t encoding) {
    const double unit = WALL / FOCAL * SCALE;
    for (int k = 0; k < LR; k++) {
        double column = k % LR_WIDTH + 0.5 + jitter[0], row = k / LR_WIDTH + 0.5 + jitter[1];
        float *color = frame->rgba[k];
        wall(x + (column - LR_WIDTH / 2.0) * unit, (row - LR_HEIGHT / 2.0) * unit, color, frame->dx[k],
             frame->dy[k]);
        color[3] = 1.0f;
        for (int c = 0; c < 3; c++) {
            frame->planes[c][k] = color[c];
            frame->dx[k][c] *= (float)unit;
            frame->dy[k][c] *= (float)unit;
        }
        frame->depth[k] = encoded_depth(encoding);
    }
}

/* The largest difference of an image from the wall seen from (x, 0, 0), and the mean. */
typedef struct {
    float largest, mean;
} error;

static error error_of(const float *image, double x) {
    error found = {0.0f, 0.0f};
    const double unit = WALL / FOCAL;
    for (int k = 0; k < WIDTH * HEIGHT; k++) {
        float color[3], dx[3], dy[3];
        wall(x + (k % WIDTH + 0.5 - WIDTH / 2.0) * unit, (k / WIDTH + 0.5 - HEIGHT / 2.0) * unit, color, dx,
             dy);
        for (int c = 0; c < 3; c++) {
            float difference = fabsf(image[4 * k + c] - color[c]);
            found.largest = fmaxf(found.largest, difference);
            found.mean += difference / (3 * WIDTH * HEIGHT);
        }
    }
    return found;
}

static gs3_input input_of(const float *data, size_t size) {
    return (gs3_input){.struct_size = sizeof(gs3_input), .data = data, .size = size};
}

/* All of a call but its camera, jitter and output. */
typedef struct {
    lr_frame frame;
    gs3_input color, depth, dx, dy;
    gs3_reconstruct_desc desc;
} call;

static void prepare(call *c, uint32_t encoding, int planar, int gradients) {
    memset(c, 0, sizeof *c);
    if (planar) {
        c->color = input_of(c->frame.planes[0], sizeof c->frame.planes);
        c->color.row_stride = LR_WIDTH * 4;
        c->color.pixel_stride = 4;
        c->color.channel_stride = LR * 4;
    } else {
        c->color = input_of(c->frame.rgba[0], sizeof c->frame.rgba);
        c->color.pixel_stride = 16;
    }
    c->depth = input_of(c->frame.depth, sizeof c->frame.depth);
    c->dx = input_of(c->frame.dx[0], sizeof c->frame.dx);
    c->dy = input_of(c->frame.dy[0], sizeof c->frame.dy);
    c->desc = (gs3_reconstruct_desc){
        .struct_size = sizeof c->desc,
        .render_width = LR_WIDTH,
        .render_height = LR_HEIGHT,
        .color = &c->color,
        .depth = &c->depth,
        .color_dx = gradients ? &c->dx : NULL,
        .color_dy = gradients ? &c->dy : NULL,
        .depth_encoding = encoding,
        .near_plane = NEAR_PLANE,
        .far_plane = FAR_PLANE,
    };
}

/* Reconstructs the frame of the camera at (x, 0, 0) into image. */
static gs3_frame_info step(gs3_reconstructor *reconstructor, call *c, double x, float *image) {
    const gs3_camera camera = camera_at(x);
    gs3_frame_start start = {.struct_size = sizeof start};
    CHECK(gs3_reconstructor_query_next(reconstructor, &camera, &start) == GS3_OK);
    CHECK(start.render_width == LR_WIDTH && start.render_height == LR_HEIGHT);
    render(&c->frame, x, start.jitter, c->desc.depth_encoding);
    const gs3_output output = {.struct_size = sizeof output, .data = image, .size = WIDTH * HEIGHT * 16};
    c->desc.camera = &camera;
    c->desc.output = &output;
    memcpy(c->desc.jitter, start.jitter, sizeof start.jitter);
    gs3_frame_info info = {.struct_size = sizeof info};
    CHECK(gs3_reconstructor_reconstruct(reconstructor, &c->desc, &info) == GS3_OK);
    CHECK(info.reset_reason == start.reset_reason);
    return info;
}

static gs3_reconstructor *create(uint32_t between) {
    const gs3_reconstructor_desc desc = {
        .struct_size = sizeof desc, .scale = SCALE, .threads = 1, .in_between_count = between};
    gs3_reconstructor *reconstructor = NULL;
    CHECK(gs3_reconstructor_create(&desc, &reconstructor) == GS3_OK);
    return reconstructor;
}

static float image[WIDTH * HEIGHT * 4], other[WIDTH * HEIGHT * 4];

/* At rest every pixel has been sampled after SCALE^2 frames, whatever was before. */
static void rest(uint32_t encoding, int planar, int gradients) {
    static call c;
    gs3_reconstructor *reconstructor = create(0);
    prepare(&c, encoding, planar, gradients);
    CHECK(step(reconstructor, &c, 0.0, image).reset_reason == GS3_RESET_FIRST_FRAME);
    float uncertain = 0.0f;
    CHECK(error_of(image, 0.0).largest > 2e-3f);
    for (int frame = 1; frame < SCALE * SCALE; frame++) {
        CHECK(step(reconstructor, &c, 0.0, image).reset_reason == GS3_RESET_NONE);
    }
    /* What is left is rounding: positions and weights are in single precision. */
    CHECK(error_of(image, 0.0).largest < 2e-4f);
    for (int k = 0; k < WIDTH * HEIGHT; k++) {
        uncertain = fmaxf(uncertain, image[4 * k + 3]);
    }
    CHECK(uncertain == 0.0f);
    gs3_reconstructor_destroy(reconstructor);
}

/* In-between frames, in bytes, and what a cut does. */
static void motion(void) {
    static call c;
    static unsigned char between[2][WIDTH * HEIGHT * 4];
    gs3_reconstructor *reconstructor = create(2);
    prepare(&c, GS3_DEPTH_ENCODING_DISTANCE, 0, 1);
    gs3_output outputs[2];
    for (int k = 0; k < 2; k++) {
        outputs[k] = (gs3_output){.struct_size = sizeof outputs[k],
                                  .format = GS3_FORMAT_RGBA8,
                                  .data = between[k],
                                  .size = sizeof between[k],
                                  .opaque = 1};
    }
    const gs3_output *const pointers[2] = {&outputs[0], &outputs[1]};
    c.desc.in_between_outputs = pointers;
    c.desc.in_between_count = 2;
    for (int frame = 0; frame < 6; frame++) {
        double x = 0.03 * frame;
        const gs3_frame_info info = step(reconstructor, &c, x, image);
        CHECK(info.in_between_count == (frame == 0 ? 0u : 2u));
        for (int k = 0; k < 2 && frame > 0; k++) {
            for (int i = 0; i < WIDTH * HEIGHT; i++) {
                for (int n = 0; n < 3; n++) {
                    other[4 * i + n] = between[k][4 * i + n] / 255.0f;
                }
                CHECK(between[k][4 * i + 3] == 255);
            }
            const double there = x - 0.03 * (2 - k) / 3.0;
            /* It is that of its own moment, not of one a third of a step away. */
            const float mean = error_of(other, there).mean;
            CHECK(mean < 0.004f);
            CHECK(mean < error_of(other, there - 0.01).mean && mean < error_of(other, there + 0.01).mean);
        }
    }
    /* True cameras of the in-between frames: here those that are assumed anyway. */
    const gs3_camera cameras[2] = {camera_at(0.16), camera_at(0.17)};
    const gs3_camera *const poses[2] = {&cameras[0], &cameras[1]};
    c.desc.in_between_cameras = poses;
    CHECK(step(reconstructor, &c, 0.18, image).in_between_count == 2);
    c.desc.in_between_cameras = NULL;

    c.desc.reset = 1;
    static call fresh;
    prepare(&fresh, GS3_DEPTH_ENCODING_DISTANCE, 0, 1);
    const gs3_camera camera = camera_at(0.2);
    gs3_frame_start start = {.struct_size = sizeof start};
    CHECK(gs3_reconstructor_reset(reconstructor) == GS3_OK);
    CHECK(gs3_reconstructor_query_next(reconstructor, &camera, &start) == GS3_OK);
    CHECK(start.reset_reason == GS3_RESET_CUT);
    CHECK(step(reconstructor, &c, 0.2, image).reset_reason == GS3_RESET_CUT);
    /* As the first frame of another. */
    gs3_reconstructor *second = create(0);
    step(second, &fresh, 0.2, other);
    CHECK(memcmp(image, other, sizeof image) == 0);
    gs3_reconstructor_destroy(second);
    gs3_reconstructor_destroy(reconstructor);
}

/* Inputs that are larger than the picture, on each side by another number of pixels. */
static void margins(void) {
    enum { LEFT = 4, TOP = 1, RIGHT = 3, BOTTOM = 2 };
    enum { ACROSS = LEFT + LR_WIDTH + RIGHT, DOWN = TOP + LR_HEIGHT + BOTTOM };
    static float color[DOWN][ACROSS][3], dx[DOWN][ACROSS][3], dy[DOWN][ACROSS][3], depth[DOWN][ACROSS];
    const gs3_reconstructor_desc desc = {
        .struct_size = sizeof desc, .scale = SCALE, .threads = 1, .widest_margin = 8};
    gs3_reconstructor *reconstructor = NULL;
    CHECK(gs3_reconstructor_create(&desc, &reconstructor) == GS3_OK);
    const double unit = WALL / FOCAL * SCALE;
    uint32_t widest = 0;
    for (int frame = 0; frame < 4; frame++) {
        const double x = 0.1 * frame;
        const gs3_camera camera = camera_at(x);
        gs3_frame_start start = {.struct_size = sizeof start};
        CHECK(gs3_reconstructor_query_next(reconstructor, &camera, &start) == GS3_OK);
        widest = start.margin.right > widest ? start.margin.right : widest;
        for (int row = 0; row < DOWN; row++) {
            for (int column = 0; column < ACROSS; column++) {
                double u = column - LEFT + 0.5 + start.jitter[0] - LR_WIDTH / 2.0;
                double v = row - TOP + 0.5 + start.jitter[1] - LR_HEIGHT / 2.0;
                wall(x + u * unit, v * unit, color[row][column], dx[row][column], dy[row][column]);
                for (int c = 0; c < 3; c++) {
                    dx[row][column][c] *= (float)unit;
                    dy[row][column][c] *= (float)unit;
                }
                depth[row][column] = (float)WALL;
            }
        }
        const gs3_input colors = input_of(color[0][0], sizeof color),
                        depths = input_of(depth[0], sizeof depth);
        const gs3_input dxs = input_of(dx[0][0], sizeof dx), dys = input_of(dy[0][0], sizeof dy);
        const gs3_output output = {.struct_size = sizeof output, .data = image, .size = sizeof image};
        const gs3_reconstruct_desc call = {
            .struct_size = sizeof call,
            .camera = &camera,
            .render_width = ACROSS,
            .render_height = DOWN,
            .jitter = {start.jitter[0], start.jitter[1]},
            .color = &colors,
            .depth = &depths,
            .color_dx = &dxs,
            .color_dy = &dys,
            .margin = {.left = LEFT, .top = TOP, .right = RIGHT, .bottom = BOTTOM},
            .output = &output,
        };
        CHECK(gs3_reconstructor_reconstruct(reconstructor, &call, NULL) == GS3_OK);
        /* A picture that begins a pixel off has twenty times as much. */
        CHECK(error_of(image, x).mean < 0.004f);
    }
    /* The camera moves to the right. */
    CHECK(widest > 0 && widest <= 8);
    gs3_reconstructor_destroy(reconstructor);
}

/* A wall that slides by under a resting camera, with motion vectors or without: the mean error after some
 * frames. */
static float sliding(int with_vectors, float scale, float *to) {
    enum { STEPS = 12 };
    static call c;
    static float vectors[LR][2];
    const double unit = WALL / FOCAL * SCALE, slide = 0.05;
    gs3_reconstructor *reconstructor = create(0);
    prepare(&c, GS3_DEPTH_ENCODING_DISTANCE, 0, 1);
    gs3_input motion = input_of(vectors[0], sizeof vectors);
    for (int k = 0; k < LR; k++) {
        vectors[k][0] = (float)(slide / unit) / scale;
        vectors[k][1] = 0.0f;
    }
    c.desc.motion = with_vectors ? &motion : NULL;
    c.desc.motion_scale[0] = scale == 1.0f ? 0.0f : scale;
    const gs3_camera camera = camera_at(0.0);
    const gs3_output output = {.struct_size = sizeof output, .data = to, .size = WIDTH * HEIGHT * 16};
    c.desc.camera = &camera;
    c.desc.output = &output;
    for (int frame = 0; frame < STEPS; frame++) {
        gs3_frame_start start = {.struct_size = sizeof start};
        CHECK(gs3_reconstructor_query_next(reconstructor, &camera, &start) == GS3_OK);
        /* What the camera would see of a resting wall that it passes by. */
        render(&c.frame, slide * frame, start.jitter, GS3_DEPTH_ENCODING_DISTANCE);
        memcpy(c.desc.jitter, start.jitter, sizeof start.jitter);
        CHECK(gs3_reconstructor_reconstruct(reconstructor, &c.desc, NULL) == GS3_OK);
    }
    gs3_reconstructor_destroy(reconstructor);
    return error_of(to, slide * (STEPS - 1)).mean;
}

static void refusals(void) {
    static call c;
    gs3_reconstructor *reconstructor = NULL;
    gs3_reconstructor_desc desc = {.struct_size = sizeof desc, .scale = 12, .threads = 1};
    CHECK_FAILS(gs3_reconstructor_create(&desc, &reconstructor), GS3_ERROR_ARGUMENT,
                "scale: expected 1 to 8, found 12");
    desc.scale = SCALE;
    desc.in_between_count = 4;
    CHECK_FAILS(gs3_reconstructor_create(&desc, &reconstructor), GS3_ERROR_ARGUMENT,
                "in_between_count: expected 0 to 3, found 4");
    desc.in_between_count = 0;
    desc.widest_margin = 33;
    CHECK_FAILS(gs3_reconstructor_create(&desc, &reconstructor), GS3_ERROR_ARGUMENT,
                "widest_margin: expected 0 to 32, found 33");
    desc.widest_margin = 0;
    desc.kriging = 4;
    CHECK_FAILS(gs3_reconstructor_create(&desc, &reconstructor), GS3_ERROR_ARGUMENT,
                "kriging: expected 0 to 3 (gs3_kriging), found 4");
    CHECK_FAILS(gs3_reconstructor_create(&desc, NULL), GS3_ERROR_ARGUMENT,
                "reconstructor: expected a pointer, found null");
    CHECK(reconstructor == NULL);

    reconstructor = create(0);
    prepare(&c, GS3_DEPTH_ENCODING_DISTANCE, 0, 1);
    step(reconstructor, &c, 0.0, image);
    const gs3_camera camera = camera_at(0.0);
    const gs3_output output = {.struct_size = sizeof output, .data = image, .size = sizeof image};
    c.desc.camera = &camera;
    c.desc.output = &output;
    const gs3_reconstruct_desc good = c.desc;
    gs3_reconstruct_desc *bad = &c.desc;
#define REFUSED(status, words) \
    CHECK_FAILS(gs3_reconstructor_reconstruct(reconstructor, bad, NULL), status, words); \
    *bad = good
    bad->struct_size = 40;
    REFUSED(GS3_ERROR_DESCRIPTOR, "desc: struct_size: expected");
    bad->color = NULL;
    REFUSED(GS3_ERROR_ARGUMENT, "desc: color: expected a pointer, found null");
    bad->depth = NULL;
    REFUSED(GS3_ERROR_ARGUMENT, "desc: depth: expected a pointer, found null");
    bad->color_dy = NULL;
    REFUSED(GS3_ERROR_ARGUMENT, "desc: color_dy: expected a pointer, found null");
    gs3_input vectors = input_of(&c.frame.dx[0][0], sizeof c.frame.dx);
    vectors.size = LR * 2 * 4 - 4;
    bad->motion = &vectors;
    REFUSED(GS3_ERROR_LAYOUT, "desc: motion: G-buffer: expected at least 384 numbers in memory, found 383");
    bad->render_width = LR_WIDTH - 1;
    REFUSED(GS3_ERROR_ARGUMENT, "expected 16x12 pixels, found 15x12");
    bad->jitter[0] = NAN;
    REFUSED(GS3_ERROR_ARGUMENT, "jitter: expected finite offsets");
    bad->depth_encoding = 4;
    REFUSED(GS3_ERROR_ARGUMENT, "depth_encoding: expected 0 to 3 (gs3_depth_encoding), found 4");
    bad->depth_encoding = GS3_DEPTH_ENCODING_LINEAR;
    bad->far_plane = INFINITY;
    REFUSED(GS3_ERROR_ARGUMENT, "clip planes: expected 0 < near < far");
    bad->margin.left = 1;
    REFUSED(GS3_ERROR_ARGUMENT, "pixels, found");
    gs3_input input = c.color;
    bad->color = &input;
#undef REFUSED
#define REFUSED(status, words) \
    CHECK_FAILS(gs3_reconstructor_reconstruct(reconstructor, bad, NULL), status, words); \
    input = c.color
    input.size = sizeof c.frame.rgba - 8;
    REFUSED(GS3_ERROR_LAYOUT, "color: G-buffer: expected at least 767 numbers in memory, found 766");
    input.row_stride = 30;
    REFUSED(GS3_ERROR_LAYOUT, "color: row_stride: expected bytes divisible by 4, found 30");
    input.data = (const char *)c.color.data + 2;
    REFUSED(GS3_ERROR_LAYOUT, "color: data: expected an address divisible by 4");
    input.number = 1;
    REFUSED(GS3_ERROR_ARGUMENT, "color: number: expected 0");
    input.struct_size = 20;
    REFUSED(GS3_ERROR_DESCRIPTOR, "color: struct_size: expected");
#undef REFUSED
    /* Strides that are left out are those of pixels without gaps. */
    input = input_of(&c.frame.dx[0][0], sizeof c.frame.dx);
    input.struct_size = 24;
    CHECK(gs3_reconstructor_reconstruct(reconstructor, bad, NULL) == GS3_OK);
    *bad = good;
    c.frame.rgba[5][1] = NAN;
    CHECK_FAILS(gs3_reconstructor_reconstruct(reconstructor, bad, NULL), GS3_ERROR_ARGUMENT,
                "colour: expected finite numbers");
    /* The history is as it was. */
    CHECK(step(reconstructor, &c, 0.0, image).reset_reason == GS3_RESET_NONE);

    CHECK(gs3_reconstructor_configure(reconstructor, NULL) == GS3_OK);
    CHECK(step(reconstructor, &c, 0.0, image).reset_reason == GS3_RESET_FIRST_FRAME);
    gs3_memory memory = {.struct_size = sizeof memory};
    CHECK(gs3_reconstructor_query_memory(reconstructor, &memory) == GS3_OK);
    CHECK(memory.host_bytes > sizeof image && memory.device_bytes == 0);
    gs3_reconstructor_destroy(reconstructor);
    gs3_reconstructor_destroy(NULL);
}

int main(void) {
    rest(GS3_DEPTH_ENCODING_DISTANCE, 0, 1);
    memcpy(other, image, sizeof image);
    rest(GS3_DEPTH_ENCODING_DISTANCE, 1, 1);
    CHECK(memcmp(image, other, sizeof image) == 0);
    rest(GS3_DEPTH_ENCODING_PROJECTIVE, 0, 1);
    rest(GS3_DEPTH_ENCODING_REVERSED, 0, 0);
    rest(GS3_DEPTH_ENCODING_LINEAR, 1, 0);
    motion();
    margins();
    const float with = sliding(1, 1.0f, image), without = sliding(0, 1.0f, other);
    CHECK(with < 0.5f * without);
    /* In other units: a power of two, so that nothing is rounded. */
    CHECK(sliding(1, 0.25f, other) == with);
    CHECK(memcmp(image, other, sizeof image) == 0);
    refusals();
    return checks_end();
}
