"""`gs3.Reconstructor` with frames of `Scene.rasterization`, a renderer like any other."""

import numpy as np
import pytest

import gs3

SIZE, SCALE = (160, 88), 4


@pytest.fixture(scope="module")
def scene():
    return gs3.demo()


@pytest.fixture(scope="module")
def path():
    return gs3.demo_path().resized(*SIZE)


def render(scene, reconstructor, view, K, jitter):
    """A low-resolution frame: colour, its derivatives, and depth."""
    lr_K = reconstructor.lr_K(K, jitter)
    made = scene.rasterization(view[None], lr_K[None], *reconstructor.lr_size, eps2d=0.3 / SCALE**2, near_plane=scene.near)
    color, _, meta = made
    return color[0], meta["color_dx"][0], meta["color_dy"][0], meta["median_depth"][0, ..., 0]


def run(scene, path, count, encode=lambda depth: depth, gradients=True, camera=lambda k: k, **options):
    reconstructor, shown = gs3.Reconstructor(*SIZE, scale=SCALE), []
    for k in range(count):
        view, K = path.viewmats[camera(k)], path.Ks[camera(k)]
        jitter = reconstructor.next_jitter(view, K)
        color, dx, dy, depth = render(scene, reconstructor, view, K, jitter)
        exact = {"color_dx": dx, "color_dy": dy} if gradients else {}
        shown.append(reconstructor.reconstruct(view, K, color, encode(depth), jitter=jitter, **exact, **options))
    return shown, reconstructor


def native(scene, path, k):
    return scene.rasterization(path.viewmats[k : k + 1], path.Ks[k : k + 1], *SIZE, near_plane=scene.near, gbuffer=False)[0][0]


def test_frames_approach_the_native_image(scene, path):
    shown, reconstructor = run(scene, path, 17, camera=lambda k: 0)
    assert [len(frames) for frames in shown] == [1] + [2] * 16
    target = native(scene, path, 0)
    first, last = (gs3.metrics.psnr(target, frames[-1]) for frames in (shown[0], shown[-1]))
    assert first < 45 < 60 < last, (first, last)
    assert reconstructor.last_reset is None


def test_exact_gradients_are_worth_having(scene, path):
    target = native(scene, path, 3)
    exact, differenced = (run(scene, path, 4, gradients=g)[0][-1][-1] for g in (True, False))
    assert gs3.metrics.psnr(target, exact) > gs3.metrics.psnr(target, differenced) + 0.3


@pytest.mark.parametrize("encoding", ["projective", "reversed", "linear"])
def test_depth_buffers_are_read_as_they_are(scene, path, encoding):
    near, far = 0.1, 200.0

    def encode(depth):
        z = np.where(depth > 0, depth.astype(np.float64), far)
        projective = far / (far - near) * (1 - near / z)
        encoded = {"projective": projective, "reversed": 1 - projective, "linear": (z - near) / (far - near)}[encoding]
        return encoded.astype(np.float32)

    plain = run(scene, path, 3)[0][-1]
    encoded = run(scene, path, 3, encode=encode, depth_encoding=encoding, near=near, far=far)[0][-1]
    for a, b in zip(plain, encoded):
        assert gs3.metrics.psnr(a, b) > 45


def test_bytes_alpha_and_a_reset(scene, path):
    shown, reconstructor = run(scene, path, 2, dtype=np.uint8)
    assert shown[1][0].dtype == np.uint8 and len(shown[1]) == 2
    view, K = path.viewmats[2], path.Ks[2]
    reconstructor.reset()
    ahead = reconstructor.next(view, K)
    assert ahead.reset == "camera_cut" and ahead.margin == (0, 0, 0, 0)
    color, _, _, depth = render(scene, reconstructor, view, K, ahead.jitter)
    rgba = np.concatenate([color, np.ones_like(color[..., :1])], -1)
    assert len(reconstructor.reconstruct(view, K, rgba, depth, jitter=ahead.jitter)) == 1
    assert reconstructor.last_reset == "camera_cut"


def test_motion_vectors_follow_what_moves():
    """A pattern that flies past a camera at rest, 5 pixels a frame."""
    fx, speed, z = 140.0, 5.0, 3.0
    K = np.array([[fx, 0, SIZE[0] / 2], [0, fx, SIZE[1] / 2], [0, 0, 1.0]])

    def pattern(x, y, k):
        u, v = (x - speed * k) * 0.9, y * 0.7
        return np.stack([np.sin(u) * 0.3 + 0.5, np.sin(u + v) * 0.3 + 0.5, np.cos(v) * 0.3 + 0.5], -1).astype(np.float32)

    def last(with_motion):
        reconstructor = gs3.Reconstructor(*SIZE, scale=SCALE)
        columns, rows = reconstructor.lr_size
        for k in range(10):
            jitter = reconstructor.next_jitter(np.eye(4), K)
            x, y = np.meshgrid(np.arange(columns) + 0.5 + jitter[0], np.arange(rows) + 0.5 + jitter[1])
            back = np.zeros((rows, columns, 2), np.float32)
            back[..., 0] = -speed / SCALE
            motion = {"motion": back} if with_motion and k > 0 else {}
            color = pattern(x * SCALE, y * SCALE, k)
            depth = np.full((rows, columns), z, np.float32)
            frames = reconstructor.reconstruct(np.eye(4), K, color, depth, jitter=jitter, **motion)
        x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
        # Where the pattern has been in view all the time.
        return gs3.metrics.psnr(pattern(x, y, 9)[:, 50:], frames[-1][:, 50:])

    moved, still = last(True), last(False)
    print(f"{moved:.1f} dB with motion vectors, {still:.1f} dB without")
    assert moved > still + 6


def test_errors_say_what_was_expected_and_found(path):
    reconstructor = gs3.Reconstructor(*SIZE)
    view, K = path.viewmats[0], path.Ks[0]
    color, depth = np.zeros((22, 40, 3), np.float32), np.ones((22, 40), np.float32)
    for change, kind, message in [
        ({"color": color[:-1]}, gs3.InputError, r"color: expected shape \[22, 40, 3\], found \[21, 40, 3\]"),
        ({"depth": depth[None]}, gs3.InputError, r"depth: expected shape \[22, 40\], found \[1, 22, 40\]"),
        ({"jitter": (2, 0)}, gs3.InputError, "jitter: expected finite offsets"),
        ({"depth_encoding": "z"}, gs3.InputError, "depth_encoding: expected distance"),
        ({"depth_encoding": "linear"}, gs3.InputError, "clip planes: expected 0 < near < far"),
        ({"color_dx": color}, gs3.InputError, "color_dx and color_dy: expected both or none"),
        ({"color": np.full_like(color, np.nan)}, gs3.InputError, "expected finite numbers"),
        ({"motion": np.zeros((22, 40, 3))}, gs3.InputError, r"motion: expected shape \[22, 40, 2\], found"),
        ({"motion": np.full((22, 40, 2), np.inf)}, gs3.InputError, "G-buffer motion"),
        ({"dtype": np.float64}, gs3.InputError, "dtype: expected float32 or uint8, found float64"),
    ]:
        with pytest.raises(kind, match=message):
            reconstructor.reconstruct(view, K, **{"color": color, "depth": depth, "jitter": (0, 0), **change})
    with pytest.raises(gs3.InputError, match="scale: expected 1 to 8, found 9"):
        gs3.Reconstructor(*SIZE, scale=9)
