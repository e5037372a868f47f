// The header in C++, the static library, and threads: one scene, renderers that share it, and two threads at
// one renderer. Arguments: a scene file, and a folder that is not used (all programs get one).

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "check.h"

namespace {

struct Destroy {
    void operator()(gs3_scene *scene) const { gs3_scene_destroy(scene); }
    void operator()(gs3_renderer *renderer) const { gs3_renderer_destroy(renderer); }
    void operator()(gs3_reconstructor *reconstructor) const { gs3_reconstructor_destroy(reconstructor); }
};

using Scene = std::unique_ptr<gs3_scene, Destroy>;
using Renderer = std::unique_ptr<gs3_renderer, Destroy>;
using Reconstructor = std::unique_ptr<gs3_reconstructor, Destroy>;

constexpr uint32_t width = 64;
constexpr uint32_t height = 48;

// A descriptor of defaults.
template <typename T> T sized() {
    T descriptor{};
    descriptor.struct_size = sizeof(T);
    return descriptor;
}

Renderer renderer_of(const Scene &scene) {
    auto desc = sized<gs3_renderer_desc>();
    desc.backend = GS3_BACKEND_CPU;
    desc.threads = 1;
    desc.scale = 2;
    gs3_renderer *renderer = nullptr;
    CHECK(gs3_renderer_create(scene.get(), &desc, &renderer) == GS3_OK);
    return Renderer(renderer);
}

gs3_camera look_at(double x) {
    auto camera = sized<gs3_camera>();
    const std::array<double, 3> eye{x, 0.2, -4.0}, target{0.0, 0.0, 0.0}, up{0.0, -1.0, 0.0};
    CHECK(gs3_camera_look_at(eye.data(), target.data(), up.data(), 0.7, width, height, &camera) == GS3_OK);
    return camera;
}

// Renders the frame of a camera, and gives what the call gives. Without checks: threads call it.
gs3_status render(const Renderer &renderer, const gs3_camera &camera, std::vector<float> &image) {
    image.resize(width * height * 3);
    auto output = sized<gs3_output>();
    output.format = GS3_FORMAT_RGB_FLOAT32;
    output.data = image.data();
    output.size = image.size() * sizeof(float);
    auto call = sized<gs3_render_desc>();
    call.camera = &camera;
    call.output = &output;
    return gs3_renderer_render(renderer.get(), &call, nullptr);
}

// Renderers in threads of their own give the same frames as one after the other.
void renderers_at_once(const Scene &scene) {
    constexpr int frames = 3;
    std::vector<std::vector<float>> expected(frames), found(2 * frames);
    const Renderer alone = renderer_of(scene);
    for (int k = 0; k < frames; k++) {
        CHECK(render(alone, look_at(0.01 * k), expected[k]) == GS3_OK);
    }
    std::array<Renderer, 2> renderers{renderer_of(scene), renderer_of(scene)};
    std::array<gs3_camera, frames> cameras{look_at(0.0), look_at(0.01), look_at(0.02)};
    std::atomic<int> failed{0};
    auto work = [&](int which) {
        for (int k = 0; k < frames; k++) {
            failed += render(renderers[which], cameras[k], found[which * frames + k]) != GS3_OK;
        }
    };
    std::thread first(work, 0), second(work, 1);
    first.join();
    second.join();
    CHECK(failed == 0);
    for (int k = 0; k < 2 * frames; k++) {
        CHECK(found[k] == expected[k % frames]);
    }
}

// Of two calls at once with one handle one is refused, and neither harms the other.
void one_renderer_of_two_threads(const Scene &scene) {
    const Renderer renderer = renderer_of(scene);
    const gs3_camera camera = look_at(0.0);
    std::atomic<int> done{0}, busy{0}, other{0};
    std::atomic<bool> has_text{true};
    auto work = [&] {
        std::vector<float> image;
        for (int k = 0; k < 8; k++) {
            const gs3_status status = render(renderer, camera, image);
            done += status == GS3_OK;
            busy += status == GS3_ERROR_BUSY;
            other += status != GS3_OK && status != GS3_ERROR_BUSY;
            // The text is this thread's own.
            const bool is_text =
                std::string(gs3_last_error()).find("handle: expected no call") != std::string::npos;
            has_text = has_text && (status != GS3_ERROR_BUSY || is_text);
        }
    };
    std::thread first(work), second(work);
    first.join();
    second.join();
    CHECK(done > 0);
    CHECK(done + busy == 16);
    CHECK(other == 0);
    CHECK(has_text);
    CHECK(std::string(gs3_last_error()).find("handle: expected no call") == std::string::npos);
    std::vector<float> image;
    CHECK(render(renderer, camera, image) == GS3_OK);
}

// A renderer shows its scene when the host's handle of it is gone.
void scene_goes_first(const char *path) {
    gs3_scene *opened = nullptr;
    CHECK(gs3_scene_open(path, nullptr, &opened) == GS3_OK);
    Scene scene(opened);
    const Renderer renderer = renderer_of(scene);
    scene.reset();
    std::vector<float> image;
    CHECK(render(renderer, look_at(0.0), image) == GS3_OK);
    float brightest = 0.0F;
    for (const float value : image) {
        brightest = value > brightest ? value : brightest;
    }
    CHECK(brightest > 0.1F);
}

} // namespace

int main(int count, char **arguments) {
    CHECK(count == 3);
    static_assert(sizeof(gs3_camera) == 144, "as the first version has it");
    static_assert(sizeof(gs3_renderer_desc) == 80, "as the first version has it");
    gs3_scene *opened = nullptr;
    CHECK(gs3_scene_open(arguments[1], nullptr, &opened) == GS3_OK);
    const Scene scene(opened);
    renderers_at_once(scene);
    one_renderer_of_two_threads(scene);
    scene_goes_first(arguments[1]);
    auto camera = sized<gs3_camera>();
    const std::array<double, 3> point{1.0, 2.0, 3.0};
    CHECK_FAILS(gs3_camera_look_at(point.data(), point.data(), point.data(), 0.7, width, height, &camera),
                GS3_ERROR_ARGUMENT, "camera pose");
    CHECK_FAILS(gs3_camera_look_at(point.data(), nullptr, point.data(), 0.7, width, height, &camera),
                GS3_ERROR_ARGUMENT, "target: expected a pointer, found null");
    CHECK_FAILS(gs3_camera_look_at(point.data(), point.data(), point.data(), 4.0, width, height, &camera),
                GS3_ERROR_ARGUMENT, "fov_y: expected radians between 0 and pi, found 4");
    gs3_reconstructor *made = nullptr;
    CHECK(gs3_reconstructor_create(nullptr, &made) == GS3_OK);
    const Reconstructor reconstructor(made);
    return checks_end();
}
