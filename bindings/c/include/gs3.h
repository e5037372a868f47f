/*
 * gs3: frames of 3D Gaussian Splatting scenes, and a reconstructor for the frames of other renderers.
 *
 * Made by cbindgen from the crate gs3-c; docs/c.md tells how to use it.
 *
 * - Structures begin with their size, and what is 0 in them means the default:
 *   gs3_renderer_desc desc = {.struct_size = sizeof desc};
 * - Calls that return a gs3_status may fail; gs3_last_error says why.
 * - Memory that is passed is used during the call alone.
 */

#ifndef GS3_H
#define GS3_H

#include <stdint.h>

// The version that this header describes: major * 10000 + minor * 100 + patch.
#define GS3_VERSION 100

// What gs3_memory.device_bytes says of a GPU with a driver that does not tell.
#define GS3_UNKNOWN_BYTES UINT64_MAX

// Most frames between two.
#define GS3_MAX_IN_BETWEEN 3

// Bytes of gs3_renderer_info.adapter, the zero at its end included.
#define GS3_NAME_BYTES 128

// How much a message matters.
typedef enum gs3_log_level {
    // A call failed: the text of gs3_last_error.
    GS3_LOG_ERROR = 0,
    // What people should be told: the CPU took over from a GPU, a file says something that is not used, Gaussians were
    // invalid.
    GS3_LOG_WARNING = 1,
    // What was opened, and what renders.
    GS3_LOG_INFO = 2,
} gs3_log_level;

// What a call tells. Values stay what they are in all versions; new ones may be added.
typedef enum gs3_status {
    // The call did what it says.
    GS3_OK = 0,
    // A fault of the library. The handle that was passed is of no more use but to be destroyed.
    GS3_ERROR_INTERNAL = -1,
    // A pointer is null, a number out of its range, or two arguments do not go together.
    GS3_ERROR_ARGUMENT = -2,
    // A descriptor's struct_size is too small, or the descriptor is larger than this version knows and its tail is not
    // zero.
    GS3_ERROR_DESCRIPTOR = -3,
    // Memory of the caller is too small for the image that is said to lie there, or its strides do not fit.
    GS3_ERROR_LAYOUT = -4,
    // A scene file cannot be read, or has no scene.
    GS3_ERROR_FILE = -5,
    // Arrays make no scene.
    GS3_ERROR_SCENE = -6,
    // This version of the library, or this handle, does not offer that.
    GS3_ERROR_UNSUPPORTED = -7,
    // A GPU cannot be opened, has no room, fails or is lost.
    GS3_ERROR_DEVICE = -8,
    // A call with the same handle runs, in another thread.
    GS3_ERROR_BUSY = -9,
} gs3_status;

// What an adapter is.
typedef enum gs3_adapter_kind {
    // A graphics card with its own memory.
    GS3_ADAPTER_KIND_DISCRETE = 0,
    // A graphics unit that shares the processor's memory.
    GS3_ADAPTER_KIND_INTEGRATED = 1,
    // A share of a graphics card in a virtual machine.
    GS3_ADAPTER_KIND_VIRTUAL = 2,
    // The driver does not say.
    GS3_ADAPTER_KIND_UNKNOWN = 3,
    // The processor: slower than the library's own path on it.
    GS3_ADAPTER_KIND_SOFTWARE = 4,
} gs3_adapter_kind;

// What renders.
typedef enum gs3_backend {
    // A GPU where there is one, and the CPU where there is none, where it is emulated, or once it fails.
    GS3_BACKEND_AUTO = 0,
    // The CPU.
    GS3_BACKEND_CPU = 1,
    // A GPU, an emulated one too. Where it fails, calls do.
    GS3_BACKEND_GPU = 2,
} gs3_backend;

// What the numbers of a depth buffer mean.
typedef enum gs3_depth_encoding {
    // Distance along the view axis, world units; 0 where nothing was hit.
    GS3_DEPTH_ENCODING_DISTANCE = 0,
    // Projective: 0 at the near plane, 1 at the far plane, where nothing was hit.
    GS3_DEPTH_ENCODING_PROJECTIVE = 1,
    // Projective reversed: 1 at the near plane, 0 at the far plane, where nothing was hit.
    GS3_DEPTH_ENCODING_REVERSED = 2,
    // Linear: 0 at the near plane, 1 at the far plane, where nothing was hit.
    GS3_DEPTH_ENCODING_LINEAR = 3,
} gs3_depth_encoding;

// How much small Gaussians are widened.
typedef enum gs3_dilation {
    // By 0.3 px^2 of the image shown: low-resolution samples are exact samples of it.
    GS3_DILATION_MATCHED = 0,
    // By 0.3 px^2 of the grid that is rasterized.
    GS3_DILATION_KERBL = 1,
    // By dilation_value, px^2 of the grid that is rasterized.
    GS3_DILATION_VALUE = 2,
} gs3_dilation;

// What the pixels of an output are. Colours are display-encoded red, green and blue. The function that writes the output
// says what the fourth channel is.
typedef enum gs3_format {
    // Four 32-bit floats, nominally 0 to 1, not clamped. Their address needs no alignment.
    GS3_FORMAT_RGBA_FLOAT32 = 0,
    // Three 32-bit floats.
    GS3_FORMAT_RGB_FLOAT32 = 1,
    // Four bytes, 0 to 255, clamped and rounded to nearest.
    GS3_FORMAT_RGBA8 = 2,
    // Three bytes.
    GS3_FORMAT_RGB8 = 3,
} gs3_format;

// Which pixels are predicted from up to eight samples around them (gradient-enhanced kriging) instead of the mean of
// first-order predictions: sharper in motion, and slower.
typedef enum gs3_kriging {
    // None.
    GS3_KRIGING_OFF = 0,
    // Where that mean errs most.
    GS3_KRIGING_COARSE = 1,
    // Where it errs by about a step of 8 bits.
    GS3_KRIGING_ON = 2,
    // Wherever it makes a difference.
    GS3_KRIGING_FINE = 3,
} gs3_kriging;

// How frames come about.
typedef enum gs3_mode {
    // Low-resolution frames super-sampled over time.
    GS3_MODE_SUPER_SAMPLE = 0,
    // The same, and frames interpolated before each.
    GS3_MODE_FULL = 1,
    // Every pixel rasterized.
    GS3_MODE_NATIVE = 2,
    // Low-resolution frames enlarged: the baseline.
    GS3_MODE_BICUBIC = 3,
} gs3_mode;

// The networks that refine frames. Of scale 2 there is BALANCED, of scale 4 all, of other scales none.
typedef enum gs3_networks {
    // None.
    GS3_NETWORKS_NONE = 0,
    // The fastest.
    GS3_NETWORKS_FAST = 1,
    // Those between.
    GS3_NETWORKS_BALANCED = 2,
    // The best.
    GS3_NETWORKS_HIGH = 3,
} gs3_networks;

// What a number of an input is.
typedef enum gs3_number {
    // 32-bit float of the machine's byte order.
    GS3_NUMBER_FLOAT32 = 0,
} gs3_number;

// How opacities react to the widening of small Gaussians: a scene is rendered as it was trained.
typedef enum gs3_opacity_mode {
    // As stored (3D Gaussian Splatting).
    GS3_OPACITY_MODE_DEFAULT = 0,
    // Scaled as the Gaussian's area grows (Mip-Splatting; antialiased in gsplat).
    GS3_OPACITY_MODE_ANTIALIASED = 1,
} gs3_opacity_mode;

// What GS3_REFINE_AUTO may spend. Above 1920 * 1080 pixels no more pixels are exact than there.
typedef enum gs3_quality {
    // 17.5 % of the pixels, errors of 5.75 steps of 8 bits.
    GS3_QUALITY_BALANCED = 0,
    // 8 % of the pixels, errors of twelve steps.
    GS3_QUALITY_FAST = 1,
    // 30 % of the pixels, errors of three steps.
    GS3_QUALITY_HIGH = 2,
} gs3_quality;

// Which pixels are rasterized exactly besides the low-resolution grid: the blocks of 4 x 4 with the largest expected error.
typedef enum gs3_refine {
    // Those with an expected error that would be seen, within the budget of the quality.
    GS3_REFINE_AUTO = 0,
    // None.
    GS3_REFINE_OFF = 1,
    // A share of all, refine_value, 0 to 1.
    GS3_REFINE_SHARE = 2,
    // As many as fit into refine_value milliseconds a frame.
    GS3_REFINE_FRAME_TIME = 3,
} gs3_refine;

// Why a frame has no history. Such a frame is less sharp than those to come.
typedef enum gs3_reset_reason {
    // The frame has one.
    GS3_RESET_NONE = 0,
    // It is the first.
    GS3_RESET_FIRST_FRAME = 1,
    // The camera jumped, or the caller asked for it.
    GS3_RESET_CUT = 2,
    // The size or the settings changed.
    GS3_RESET_SIZE = 3,
    // The scene changed.
    GS3_RESET_SCENE = 4,
    // Another machine renders.
    GS3_RESET_BACKEND = 5,
    // The frame before failed.
    GS3_RESET_FAILURE = 6,
    // A reason that this version of the header does not name.
    GS3_RESET_OTHER = 7,
    // The frame is a keyframe, where all begins anew. In-between frames lead to it.
    GS3_RESET_KEYFRAME = 8,
} gs3_reset_reason;

// Where within their pixels low-resolution frames are sampled.
typedef enum gs3_sampling {
    // Where the frames before did not sample: after scale^2 frames a resting camera has seen every pixel.
    GS3_SAMPLING_JITTERED = 0,
    // Always at pixel centres.
    GS3_SAMPLING_CENTERED = 1,
} gs3_sampling;

// Which way the axes of view space point.
typedef enum gs3_view_axes {
    // x right, y down, z forward: COLMAP, OpenCV.
    GS3_VIEW_AXES_RIGHT_DOWN_FRONT = 0,
    // x right, y up, z backward: OpenGL and most engines.
    GS3_VIEW_AXES_RIGHT_UP_BACK = 1,
} gs3_view_axes;

// Reconstructs the frames of one renderer, one after the other, on threads of its own. One call at a time may use it, from
// any thread.
typedef struct gs3_reconstructor gs3_reconstructor;

// Renders one scene along a sequence of cameras, on threads of its own. One call at a time may use it, from any thread.
typedef struct gs3_renderer gs3_renderer;

// A scene of 3D Gaussians, which does not change. Any number of threads and handles may use it at once; it may be
// destroyed while renderers show it.
typedef struct gs3_scene gs3_scene;

// Takes a message: UTF-8 text of one line, which is valid during the call, and the user pointer that was set. Nothing may
// be thrown out of it.
typedef void (*gs3_log_callback)(enum gs3_log_level level, const char *message, void *user);

// A GPU as one programming interface shows it.
typedef struct gs3_adapter_info {
    // sizeof(gs3_adapter_info).
    uint32_t struct_size;
    // A gs3_adapter_kind.
    uint32_t kind;
    // 1 if it has all that the library needs.
    uint32_t is_usable;
    // 0.
    uint32_t reserved;
    // Its name and the interface.
    char name[GS3_NAME_BYTES];
} gs3_adapter_info;

// Memory that is allocated and not freed, bytes.
typedef struct gs3_memory {
    // sizeof(gs3_memory).
    uint32_t struct_size;
    // 0.
    uint32_t reserved;
    // Of the processor, without the stacks of threads.
    uint64_t host_bytes;
    // Of a GPU's buffers: 0 without a GPU, GS3_UNKNOWN_BYTES where its driver does not tell.
    uint64_t device_bytes;
} gs3_memory;

// A pinhole camera. Pixel (i, j) covers columns i to i + 1 and rows j to j + 1, its centre is at (i + 0.5, j + 0.5), and (0, 0)
// is the upper left corner. All fields are needed.
typedef struct gs3_camera {
    // sizeof(gs3_camera).
    uint32_t struct_size;
    // A gs3_view_axes.
    uint32_t axes;
    // Width of the image that is shown, pixels, 1 to 8192.
    uint32_t width;
    // Height of the image that is shown, pixels, 1 to 8192.
    uint32_t height;
    // The rigid transform from world to view space: three rows of four, the fourth column the translation, world units. Its
    // rotation is orthonormal within 2e-3.
    double view_from_world[12];
    // Horizontal focal length, pixels, positive.
    double fx;
    // Vertical focal length, pixels, positive.
    double fy;
    // Principal point x, pixels: half the width where it is the centre.
    double cx;
    // Principal point y, pixels.
    double cy;
} gs3_camera;

// What to open of a scene file; all 0 for all of it at its finest.
typedef struct gs3_scene_options {
    // sizeof(gs3_scene_options).
    uint32_t struct_size;
    // Of a streamed scene: 1 for its finest level of detail, 2 for the next, and so on; 0 for the finest that each part has.
    uint32_t level_of_detail;
    // 1 to leave out the environment (sky, far background) of a streamed scene.
    uint32_t without_environment;
    // Pointers in budget_cameras.
    uint32_t budget_camera_count;
    // Which way the axes of the file point, as three letters (RDF: right, down, front), where that is not what the file
    // states or its format says; else NULL.
    const char *axes;
    // Most Gaussians of a streamed SOG scene; each part has the level of detail that leaves the least error. Not together with
    // level_of_detail. 0 for no budget.
    uint64_t budget;
    // budget_camera_count cameras that show the scene: error counts where they see it. NULL if it may be seen from anywhere.
    const struct gs3_camera *const *budget_cameras;
} gs3_scene_options;

// Gaussians in the caller's memory, which is read during the call alone. Values are activated: scales are lengths, opacities
// shares. The world's axes may point anywhere; cameras have the same.
typedef struct gs3_scene_arrays {
    // sizeof(gs3_scene_arrays).
    uint32_t struct_size;
    // Degree of the spherical harmonics, 0 to 4.
    uint32_t sh_degree;
    // Number of Gaussians N, 1 or more.
    uint64_t count;
    // Centres, world units, N x 3.
    const float *means;
    // Standard deviations along the principal axes, world units, N x 3.
    const float *scales;
    // Rotations from principal axes to world, quaternions w, x, y, z of any length but 0, N x 4.
    const float *rotations;
    // Opacities, 0 to 1, N.
    const float *opacities;
    // Coefficients of the spherical harmonics, N x (sh_degree + 1)^2 x 3, RGB innermost, in the order and with the signs of
    // Kerbl et al. 2023: a colour that looks alike from everywhere has the first coefficient (colour - 0.5) / 0.28209479.
    const float *sh;
    // A gs3_opacity_mode.
    uint32_t opacity_mode;
    // Gaussians nearer to the camera than this, view-space z in world units, are not shown; 0 for a distance that suits the
    // scene.
    float near_plane;
} gs3_scene_arrays;

// What a scene is.
typedef struct gs3_scene_info {
    // sizeof(gs3_scene_info).
    uint32_t struct_size;
    // Degree of the spherical harmonics.
    uint32_t sh_degree;
    // Number of Gaussians.
    uint64_t count;
    // Number of invalid Gaussians that were left out.
    uint64_t dropped;
    // Where the scene's origin lies in the file's frame of reference, right-down-front.
    double origin[3];
    // The likely centre of the scene, world units.
    double center[3];
    // The likely upward direction, of length 1.
    double up[3];
    // The distance from the centre within which nearly all of the scene lies, world units.
    double radius;
    // Gaussians nearer to the camera than this, view-space z in world units, are not shown.
    float near_plane;
    // A gs3_opacity_mode.
    uint32_t opacity_mode;
} gs3_scene_info;

// How a renderer renders. All 0 is a good choice.
typedef struct gs3_renderer_desc {
    // sizeof(gs3_renderer_desc).
    uint32_t struct_size;
    // A gs3_mode.
    uint32_t mode;
    // Width and height of what is shown over those of what is rasterized, 1 to 8; 0 for 4 up to 2560 * 1440 pixels and with
    // networks, and 6 above. Native frames do not read it.
    uint32_t scale;
    // A gs3_backend. gs3_renderer_configure does not read it.
    uint32_t backend;
    // The GPU: 0 for the fastest, n for number n - 1 of gs3_query_adapter. gs3_renderer_configure does not read it.
    uint32_t adapter;
    // Threads of the renderer, at most 1024; 0 for as many as the machine runs at once. gs3_renderer_configure does not read
    // it.
    uint32_t threads;
    // A gs3_networks.
    uint32_t networks;
    // 1 for in-between frames that a network refines too; gains little.
    uint32_t networks_between;
    // A gs3_refine.
    uint32_t refine;
    // What the gs3_refine says.
    float refine_value;
    // A gs3_quality.
    uint32_t quality;
    // A gs3_kriging. Networks have theirs.
    uint32_t kriging;
    // 1 to rasterize what lies beyond the edges that the camera turns to. Networks do anyway.
    uint32_t overscan;
    // In-between frames of GS3_MODE_FULL, 1 to GS3_MAX_IN_BETWEEN; 0 for 2.
    uint32_t in_between_count;
    // A gs3_sampling.
    uint32_t sampling;
    // A gs3_dilation.
    uint32_t dilation;
    // What the gs3_dilation says.
    float dilation_value;
    // Display-encoded red, green and blue behind everything.
    float background[3];
} gs3_renderer_desc;

// An image that a call writes: the pixel in column x of row y lies at data + y * row_stride + x * pixel_stride. Row 0 is the
// topmost. Bytes between pixels and rows stay as they are.
typedef struct gs3_output {
    // sizeof(gs3_output).
    uint32_t struct_size;
    // A gs3_format.
    uint32_t format;
    // The first pixel. It may lie at any address.
    void *data;
    // Bytes that may be written from data on.
    uint64_t size;
    // Bytes from row to row: 0 for rows without gaps, or at least the bytes of a row.
    uint64_t row_stride;
    // Bytes from pixel to pixel of a row: 0 for pixels without gaps, or at least the bytes of a pixel.
    uint64_t pixel_stride;
    // 1 for a fourth channel of 1 (or 255) instead of the frame's own.
    uint32_t opaque;
    // 0.
    uint32_t reserved;
} gs3_output;

// A frame to render.
typedef struct gs3_render_desc {
    // sizeof(gs3_render_desc).
    uint32_t struct_size;
    // 1 to forget the frames before, as at a cut. Cuts of the camera are found without.
    uint32_t reset;
    // The camera.
    const struct gs3_camera *camera;
    // Where the frame goes. Its fourth channel is opacity in native frames, else 1.
    const struct gs3_output *output;
    // Where the in-between frames go that lie before this one, in order; NULL for nowhere.
    const struct gs3_output *const *in_between_outputs;
    // The true cameras of the in-between frames, in order; NULL for cameras between the previous one and this one.
    const struct gs3_camera *const *in_between_cameras;
    // Number of both: what the renderer was created for, or 0.
    uint32_t in_between_count;
    // 0.
    uint32_t reserved;
} gs3_render_desc;

// What is told of a frame.
typedef struct gs3_frame_info {
    // sizeof(gs3_frame_info).
    uint32_t struct_size;
    // A gs3_reset_reason.
    uint32_t reset_reason;
    // In-between frames that were made and written: all or, after a reset, none. Then the frame before stays on for their
    // moments.
    uint32_t in_between_count;
    // Share of the pixels that were rasterized exactly besides the low-resolution grid, 0 to 1.
    float refined_share;
    // Time of each stage, milliseconds, 0 of one that did not run. Of a reconstructor they are 0.
    float rasterize_ms;
    // See rasterize_ms.
    float super_sample_ms;
    // See rasterize_ms.
    float refine_ms;
    // See rasterize_ms.
    float interpolate_ms;
} gs3_frame_info;

// What a renderer is.
typedef struct gs3_renderer_info {
    // sizeof(gs3_renderer_info).
    uint32_t struct_size;
    // What renders now: GS3_BACKEND_CPU or GS3_BACKEND_GPU.
    uint32_t backend;
    // In-between frames that come before each frame.
    uint32_t in_between_count;
    // Frames after which a resting camera has been sampled everywhere, for frames of the size of the last one.
    uint32_t jitter_count;
    // Threads of the renderer.
    uint32_t threads;
    // 0.
    uint32_t reserved;
    // Name and interface of the GPU, empty of the CPU.
    char adapter[GS3_NAME_BYTES];
} gs3_renderer_info;

// How a reconstructor reconstructs.
typedef struct gs3_reconstructor_desc {
    // sizeof(gs3_reconstructor_desc).
    uint32_t struct_size;
    // Width and height of what is shown over those of what is rendered, 1 to 8; 0 for 4.
    uint32_t scale;
    // In-between frames that come before each frame, 0 to GS3_MAX_IN_BETWEEN.
    uint32_t in_between_count;
    // A gs3_sampling.
    uint32_t sampling;
    // A gs3_kriging.
    uint32_t kriging;
    // Most pixels that the renderer can render beyond each edge, 0 to 32.
    uint32_t widest_margin;
    // Threads of the reconstructor, at most 1024; 0 for as many as the machine runs at once.
    uint32_t threads;
    // 0.
    uint32_t reserved;
} gs3_reconstructor_desc;

// Pixels beyond the edges of a frame, of the grid that is rendered.
typedef struct gs3_margin {
    // Columns before the first.
    uint32_t left;
    // Rows above the first.
    uint32_t top;
    // Columns after the last.
    uint32_t right;
    // Rows below the last.
    uint32_t bottom;
} gs3_margin;

// How a frame is to be rendered.
typedef struct gs3_frame_start {
    // sizeof(gs3_frame_start).
    uint32_t struct_size;
    // Why it will have no history, a gs3_reset_reason.
    uint32_t reset_reason;
    // Where to sample: an offset from pixel centres, in pixels of the grid that is rendered, x right and y down.
    float jitter[2];
    // Width of what is rendered, without the margin.
    uint32_t render_width;
    // Height of what is rendered, without the margin.
    uint32_t render_height;
    // What is worth rendering beyond the edges, at most widest_margin.
    struct gs3_margin margin;
} gs3_frame_start;

// Numbers of a frame that a call reads: channel c of the pixel in column x of row y lies at
// data + y * row_stride + x * pixel_stride + c * channel_stride. Row 0 is the topmost.
typedef struct gs3_input {
    // sizeof(gs3_input).
    uint32_t struct_size;
    // A gs3_number.
    uint32_t number;
    // The first number, at an address divisible by 4.
    const void *data;
    // Bytes that may be read from data on.
    uint64_t size;
    // Bytes from row to row, 0 for rows without gaps. Strides are divisible by 4.
    uint64_t row_stride;
    // Bytes from pixel to pixel of a row, 0 for pixels without gaps (of as many channels as are read).
    uint64_t pixel_stride;
    // Bytes from channel to channel of a pixel, 0 for 4. Of planes one after the other it is a plane's size.
    uint64_t channel_stride;
} gs3_input;

// A frame to reconstruct. All inputs are of render_width x render_height pixels, point samples at pixel centres moved by the
// jitter, of the visible surface. They are read during the call alone.
typedef struct gs3_reconstruct_desc {
    // sizeof(gs3_reconstruct_desc).
    uint32_t struct_size;
    // 1 to forget the frames before, as at a cut. Cuts of the camera are found without.
    uint32_t reset;
    // The camera of the image shown.
    const struct gs3_camera *camera;
    // Width of the inputs, the margin included: the camera's divided by the scale, rounded up, and the margin.
    uint32_t render_width;
    // Height of the inputs, likewise.
    uint32_t render_height;
    // Where the inputs were sampled: an offset from pixel centres, in pixels of the inputs, x right and y down, within -1 and 1.
    float jitter[2];
    // Display-encoded red, green and blue, finite.
    const struct gs3_input *color;
    // Depth, one channel.
    const struct gs3_input *depth;
    // Where the frame goes. Its fourth channel is the uncertainty, 0 to 1: 0 where a pixel was sampled itself.
    const struct gs3_output *output;
    // A gs3_depth_encoding.
    uint32_t depth_encoding;
    // Number of in_between_outputs and in_between_cameras: what the reconstructor was created for, or 0.
    uint32_t in_between_count;
    // Distance of the near plane, world units. Distances have none.
    float near_plane;
    // Distance of the far plane, world units; INFINITY where there is none. Distances have none.
    float far_plane;
    // Derivatives of colour to the right, per pixel of the inputs; NULL to difference colours. Both or none are given.
    const struct gs3_input *color_dx;
    // Derivatives of colour downwards.
    const struct gs3_input *color_dy;
    // Where each surface was in the frame before, less where it is, two channels, x right and y down, without the jitter of
    // either frame; finite. NULL where nothing but the camera moves.
    const struct gs3_input *motion;
    // Pixels of the inputs that 1 of motion stands for, in x and y; 0 for 1.
    float motion_scale[2];
    // How much of the inputs lies beyond the edges of the picture.
    struct gs3_margin margin;
    // Where the in-between frames go that lie before this one, in order; NULL for nowhere.
    const struct gs3_output *const *in_between_outputs;
    // The true cameras of the in-between frames, in order; NULL for cameras between the previous one and this one.
    const struct gs3_camera *const *in_between_cameras;
} gs3_reconstruct_desc;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The text of this thread's last call that failed, in UTF-8: function, field, what was expected and what was found. Empty
// before the first. The memory is the library's, and stays until the next call of this thread fails.
const char *gs3_last_error(void);

// Sets what takes the library's messages from now on, all handles' and threads'; NULL for nobody, as at the start.
//
// Messages come from the thread of the call that they are about, before that call returns. The callback may call the library. A call
// that runs in another thread may still use the callback that was set before.
//
// What is passed:
// `callback` may be called by any thread that calls the library, with `user`, until another one is set.
void gs3_set_log_callback(gs3_log_callback callback,
                          void *user);

// The version of the library. GS3_VERSION is the version of the header. Programs run with later libraries of the same major
// number.
uint32_t gs3_query_version(void);

// Tells how large the low-resolution frames of an image of width x height pixels are: both divided by the
// scale (0 for 4), rounded up.
//
// What is passed:
// render_width and render_height point to numbers.
enum gs3_status gs3_query_render_size(uint32_t width,
                                      uint32_t height,
                                      uint32_t scale,
                                      uint32_t *render_width,
                                      uint32_t *render_height);

// Tells after how many frames a resting camera has been sampled everywhere at a scale (0 for 4): its square.
//
// What is passed:
// count points to a number.
enum gs3_status gs3_query_jitter_count(uint32_t scale, uint32_t *count);

// Tells an offset of the sampling grid of a scale (0 for 4), in low-resolution pixels from the pixel centre, x right and y
// down: that of number frame in the order that suits a resting camera, which repeats itself. gs3_reconstructor_query_next
// chooses among the same by what the frames before sampled, which is better in motion.
//
// What is passed:
// jitter points to two numbers.
enum gs3_status gs3_query_jitter(uint32_t scale,
                                 uint64_t frame,
                                 float *jitter);

// Tells how many adapters there are, 0 on a machine without a driver.
//
// What is passed:
// count points to a number.
enum gs3_status gs3_query_adapter_count(uint32_t *count);

// Tells what the adapter of number index is, counted from 0.
//
// What is passed:
// info points to a gs3_adapter_info with struct_size set.
enum gs3_status gs3_query_adapter(uint32_t index, struct gs3_adapter_info *info);

// What the whole library has allocated on the processor: all handles, and what belongs to none. device_bytes is 0:
// memory of GPUs is told by handle.
//
// What is passed:
// `memory` points to a gs3_memory with struct_size set.
enum gs3_status gs3_query_memory(struct gs3_memory *memory);

// The camera at eye that looks at target, world units, where up points up in its image as far as possible. fov_y is the
// vertical field of view in radians, between 0 and pi. Pixels are square, and the principal point is the centre.
//
// What is passed:
// eye, target and up point to three doubles each, and camera to a gs3_camera with struct_size set.
enum gs3_status gs3_camera_look_at(const double *eye,
                                   const double *target,
                                   const double *up,
                                   double fov_y,
                                   uint32_t width,
                                   uint32_t height,
                                   struct gs3_camera *camera);

// Opens the scene file, or the folder of a streamed scene, at path (UTF-8): PLY, compressed PLY, .splat, .ksplat, SPZ, SOG,
// glTF with KHR_gaussian_splatting, .rad, LCC2. options may be NULL. The handle is written to scene.
//
// GS3_ERROR_FILE, with a text that names file and field, if there is no such scene.
//
// What is passed:
// path and options->axes end with a zero; options->budget_cameras is null or points to that many pointers to cameras; scene
// points to a pointer.
enum gs3_status gs3_scene_open(const char *path,
                               const struct gs3_scene_options *options,
                               struct gs3_scene **scene);

// Makes a scene of arrays. Gaussians with invalid values are left out; gs3_scene_query_info says how many. The handle is
// written to scene.
//
// GS3_ERROR_SCENE if no Gaussian is valid.
//
// What is passed:
// arrays is as its structure describes; scene points to a pointer.
enum gs3_status gs3_scene_from_arrays(const struct gs3_scene_arrays *arrays,
                                      struct gs3_scene **scene);

// Tells what a scene is.
//
// What is passed:
// scene is a scene, and info points to a gs3_scene_info with struct_size set.
enum gs3_status gs3_scene_query_info(const struct gs3_scene *scene, struct gs3_scene_info *info);

// Tells how much memory a scene has. It is the scene's own, however many renderers show it.
//
// What is passed:
// scene is a scene, and memory points to a gs3_memory with struct_size set.
enum gs3_status gs3_scene_query_memory(const struct gs3_scene *scene, struct gs3_memory *memory);

// Destroys a scene; NULL is none. Renderers that show it keep what they show.
//
// What is passed:
// scene is NULL, or a scene that nobody uses any more.
void gs3_scene_destroy(struct gs3_scene *scene);

// A camera of a closed orbit of frames cameras (1 or more) that keeps the scene in view: that of number frame, counted from
// 0. For programs that know nothing of the scene yet.
//
// What is passed:
// scene is a scene, and camera points to a gs3_camera with struct_size set.
enum gs3_status gs3_camera_orbit(const struct gs3_scene *scene,
                                 uint32_t frame,
                                 uint32_t frames,
                                 uint32_t width,
                                 uint32_t height,
                                 struct gs3_camera *camera);

// Makes a renderer of a scene. desc may be NULL for all defaults. The handle is written to renderer.
//
// GS3_ERROR_DEVICE if a GPU that was asked for cannot be opened or has no room for the scene.
//
// What is passed:
// scene is a scene, desc NULL or as its structure describes, and renderer points to a pointer.
enum gs3_status gs3_renderer_create(const struct gs3_scene *scene,
                                    const struct gs3_renderer_desc *desc,
                                    struct gs3_renderer **renderer);

// Renders with other settings from the next frame on, which is a first one, on the same machine. If it fails, the old ones
// stay.
//
// What is passed:
// renderer is a renderer, and desc NULL or as its structure describes.
enum gs3_status gs3_renderer_configure(struct gs3_renderer *renderer,
                                       const struct gs3_renderer_desc *desc);

// Shows another scene from the next frame on. If it fails, the old one stays.
//
// What is passed:
// renderer is a renderer, and scene a scene.
enum gs3_status gs3_renderer_set_scene(struct gs3_renderer *renderer, const struct gs3_scene *scene);

// Renders a frame, and in GS3_MODE_FULL those between the previous one and it. info may be NULL.
//
// If it fails, nothing was written, and the next frame begins as if this one had not been asked for, or without history.
//
// What is passed:
// renderer is a renderer, desc as its structure describes, and info NULL or a gs3_frame_info with struct_size set.
enum gs3_status gs3_renderer_render(struct gs3_renderer *renderer,
                                    const struct gs3_render_desc *desc,
                                    struct gs3_frame_info *info);

// Forgets the frames before: the next one starts anew.
//
// What is passed:
// renderer is a renderer.
enum gs3_status gs3_renderer_reset(struct gs3_renderer *renderer);

// Tells what a renderer is.
//
// What is passed:
// renderer is a renderer, and info points to a gs3_renderer_info with struct_size set.
enum gs3_status gs3_renderer_query_info(struct gs3_renderer *renderer, struct gs3_renderer_info *info);

// Tells how much memory a renderer has, besides its scene.
//
// What is passed:
// renderer is a renderer, and memory points to a gs3_memory with struct_size set.
enum gs3_status gs3_renderer_query_memory(struct gs3_renderer *renderer, struct gs3_memory *memory);

// Destroys a renderer; NULL is none.
//
// What is passed:
// renderer is NULL, or a renderer that nobody uses any more.
void gs3_renderer_destroy(struct gs3_renderer *renderer);

// Makes a reconstructor. desc may be NULL for all defaults. The handle is written to reconstructor.
//
// What is passed:
// desc is NULL or as its structure describes, and reconstructor points to a pointer.
enum gs3_status gs3_reconstructor_create(const struct gs3_reconstructor_desc *desc,
                                         struct gs3_reconstructor **reconstructor);

// Reconstructs with other settings from the next frame on, which is a first one; threads are not read. If it fails, the old
// ones stay.
//
// What is passed:
// reconstructor is a reconstructor, and desc NULL or as its structure describes.
enum gs3_status gs3_reconstructor_configure(struct gs3_reconstructor *reconstructor,
                                            const struct gs3_reconstructor_desc *desc);

// Tells how the frame of a camera is to be rendered. The camera is that of the image shown: what is rendered has its
// intrinsics divided by the scale. Asking changes nothing.
//
// What is passed:
// reconstructor is a reconstructor, camera as its structure describes, and start points to a gs3_frame_start with
// struct_size set.
enum gs3_status gs3_reconstructor_query_next(struct gs3_reconstructor *reconstructor,
                                             const struct gs3_camera *camera,
                                             struct gs3_frame_start *start);

// Reconstructs a frame and, if the reconstructor was created for any, those between the previous one and it. info may be
// NULL.
//
// If it fails, nothing was written, and the history is as before, but for a reset that was asked for.
//
// What is passed:
// reconstructor is a reconstructor, desc as its structure describes, and info NULL or a gs3_frame_info with struct_size set.
enum gs3_status gs3_reconstructor_reconstruct(struct gs3_reconstructor *reconstructor,
                                              const struct gs3_reconstruct_desc *desc,
                                              struct gs3_frame_info *info);

// Forgets the frames before: the next one starts anew.
//
// What is passed:
// reconstructor is a reconstructor.
enum gs3_status gs3_reconstructor_reset(struct gs3_reconstructor *reconstructor);

// Tells how much memory a reconstructor has.
//
// What is passed:
// reconstructor is a reconstructor, and memory points to a gs3_memory with struct_size set.
enum gs3_status gs3_reconstructor_query_memory(struct gs3_reconstructor *reconstructor, struct gs3_memory *memory);

// Destroys a reconstructor; NULL is none.
//
// What is passed:
// reconstructor is NULL, or a reconstructor that nobody uses any more.
void gs3_reconstructor_destroy(struct gs3_reconstructor *reconstructor);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* GS3_H */
