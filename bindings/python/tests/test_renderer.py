"""`gs3.Renderer` against the command and against native rendering."""

import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

import gs3
import png

SIZE = (160, 88)


@pytest.fixture(scope="module")
def scene():
    return gs3.demo()


@pytest.fixture(scope="module")
def path():
    return gs3.demo_path().resized(*SIZE)


def all_frames(renderer, path, **options):
    return [frame for frames in renderer.follow(path, **options) for frame in frames]


@pytest.mark.parametrize(
    "settings, options",
    [
        ({}, []),
        ({"frames_between": 3, "quality": "fast", "kriging": "on"}, ["--in-between", "3", "--quality", "fast", "--kriging"]),
        ({"mode": "super-sample", "tier": "fast", "refine": "off"}, ["--mode", "super-sample", "--tier", "fast", "--refine", "off"]),
        ({"mode": "native", "background": (1, 0.5, 0)}, ["--mode", "native", "--background", "1,0.5,0"]),
    ],
)
def test_frames_are_those_of_the_command(tmp_path, scene, settings, options):
    """Needs the command: its path in the environment's GS3."""
    command = os.environ.get("GS3")
    if not command or not Path(command).is_file():
        pytest.skip("skipped: no command in the environment's GS3")
    common = ["--backend", "cpu", "--size", f"{SIZE[0]}x{SIZE[1]}", "--frames", "0..4"]
    cameras = tmp_path / "cameras.json"
    cameras.write_text(inria(gs3.demo_path().resized(*SIZE)[:4]))
    subprocess.run(
        [command, "render", "demo", "--path", cameras, *common, *options, "--out", tmp_path / "out"],
        check=True, capture_output=True,
    )
    renderer = gs3.Renderer(scene, *SIZE, backend="cpu", **settings)
    frames = all_frames(renderer, gs3.load_cameras(cameras), dtype=np.uint8)
    files = sorted((tmp_path / "out").glob("*.png"))
    assert len(files) == len(frames) > 3
    for file, frame in zip(files, frames):
        assert (png.read(file) == frame).all(), file


def inria(path):
    """The path as a `cameras.json`."""
    import json

    cameras = []
    for k, (view, K) in enumerate(zip(path.viewmats, path.Ks)):
        center = -view[:3, :3].T @ view[:3, 3]
        cameras.append({
            "id": k, "img_name": f"{k:03}", "width": SIZE[0], "height": SIZE[1], "position": center.tolist(),
            "rotation": view[:3, :3].T.tolist(), "fx": K[0, 0], "fy": K[1, 1],
        })
    return json.dumps(cameras)


def test_a_resting_camera_reaches_the_native_image(scene, path):
    renderer = gs3.Renderer(scene, *SIZE, mode="super-sample", refine="off", backend="cpu")
    view, K = path.viewmats[0], path.Ks[0]
    native = renderer.native(view, K)
    first = renderer.render(view, K)[-1]
    for _ in range(16):
        last = renderer.render(view, K)[-1]
    assert gs3.metrics.psnr(native, first) < 45 < 70 < gs3.metrics.psnr(native, last)
    assert (native == all_frames(gs3.Renderer(scene, *SIZE, mode="native", backend="cpu"), path[:1])[0]).all()
    # The rasterizer's own image, but for gsplat's cap of α.
    rasterized, _, _ = scene.rasterization(view[None], K[None], *SIZE, near_plane=scene.near, gbuffer=False)
    assert gs3.metrics.psnr(native, rasterized[0]) > 50


def test_a_path_has_frames_between(scene, path):
    renderer = gs3.Renderer(scene, *SIZE, frames_between=2, backend="cpu")
    frames = list(renderer.follow(path[:3]))
    assert [len(shown) for shown in frames] == [1, 3, 3]
    assert all(f.shape == (SIZE[1], SIZE[0], 3) and f.dtype == np.float32 for shown in frames for f in shown)
    # Cameras one by one give the same frames of their own; those between follow the straight way, not the curve.
    renderer.reset()
    again = list(renderer.follow(list(zip(path.viewmats[:3], path.Ks[:3]))))
    for shown, other in zip(frames, again):
        assert (shown[-1] == other[-1]).all()
    stats = renderer.stats
    assert stats["reset"] is None and stats["backend"] == "cpu" and 0 < stats["refined_share"] <= 0.21
    assert set(stats["stage_ms"]) == {"rasterize", "super_sample", "refine", "interpolate"}
    assert all(time > 0 for time in stats["stage_ms"].values()) and stats["visible"] > 1000
    renderer.reset()
    assert len(renderer.render(path.viewmats[1], path.Ks[1])) == 3, "the frame before is held"
    assert renderer.stats["reset"] == "camera_cut"


def test_bytes_are_the_rounded_numbers(scene, path):
    float_frames, byte_frames = (
        all_frames(gs3.Renderer(scene, *SIZE, backend="cpu"), path[:2], dtype=dtype) for dtype in (np.float32, np.uint8)
    )
    for numbers, as_bytes in zip(float_frames, byte_frames):
        assert as_bytes.dtype == np.uint8
        assert (np.floor(numbers.clip(0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8) == as_bytes).all()


def test_paths_are_brought_to_the_size_of_the_renderer(scene, path):
    frames = all_frames(gs3.Renderer(scene, *SIZE, backend="cpu"), gs3.demo_path()[:2])
    assert all((a == b).all() for a, b in zip(frames, all_frames(gs3.Renderer(scene, *SIZE, backend="cpu"), path[:2])))


def test_a_part_of_a_path_is_that_of_the_whole(scene, path):
    film = path[:12]
    render = lambda **part: list(gs3.Renderer(scene, *SIZE, keyframes=4, backend="cpu").follow(film, dtype=np.uint8, **part))  # noqa: E731
    whole, part = render(), render(frames=range(6, 10))
    assert len(whole) == 12 and [len(frames) for frames in part] == [3] * 4
    assert all((a == b).all() for k, frames in enumerate(part) for a, b in zip(whole[6 + k], frames))
    for wrong in [range(6, 13), range(6, 6), range(0, 12, 2), [6, 7]]:
        with pytest.raises(gs3.InputError, match=r"frames: expected a range of consecutive frames within 0..12, found"):
            render(frames=wrong)


def test_frames_are_saved_as_they_are(tmp_path):
    frame = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    gs3.save_png(tmp_path / "a.png", frame)
    assert (png.read(tmp_path / "a.png") == frame).all()
    for wrong, message in [(frame / 255, "frame: expected type uint8"), (frame[0], r"frame: expected shape \[H, W, 3\]")]:
        with pytest.raises(gs3.InputError, match=message):
            gs3.save_png(tmp_path / "b.png", wrong)
    with pytest.raises(gs3.FileError, match="cannot be written"):
        gs3.save_png(tmp_path / "none" / "b.png", frame)
    assert not (tmp_path / "b.png").exists()


def test_a_path_is_stopped_by_its_callback(scene, path):
    renderer, shares = gs3.Renderer(scene, *SIZE, backend="cpu"), []

    def progress(share):
        shares.append(share)
        return len(shares) < 3

    with pytest.raises(gs3.Cancelled, match="path: stopped"):
        all_frames(renderer, path[:4], progress=progress)
    assert shares == [0.0, 0.25, 0.5]


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="skipped: the system has no timers that send signals")
def test_an_interrupt_ends_a_path_between_frames(scene, path):
    renderer, done = gs3.Renderer(scene, *SIZE, backend="cpu"), 0
    # As Ctrl-C does, and without a thread, which a busy machine may let wait.
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            for _ in renderer.follow(path):
                done += 1
                if done == 2:
                    signal.setitimer(signal.ITIMER_REAL, 0.01)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert 2 <= done < 240


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"mode": "fast"}, "mode: expected one of native, bicubic, super-sample, full, found 'fast'|found \"fast\""),
        ({"scale": 9}, "scale: expected auto or 1 to 8, found 9"),
        ({"refine": 1.5}, "refine: expected off, auto, a share"),
        ({"frames_between": 4}, "in-between frames: expected 1 to 3"),
        ({"tier": "best"}, "tier: expected one of fast, balanced, high"),
        ({"tier": "high", "scale": 3}, "3"),
        ({"backend": "cuda"}, "backend: expected auto, cpu or gpu"),
        ({"background": (1, 2)}, r"background: expected shape \[3\], found \[2\]"),
    ],
)
def test_errors_say_what_was_expected_and_found(scene, settings, message):
    with pytest.raises(gs3.InputError, match=message):
        gs3.Renderer(scene, *SIZE, **settings)


def test_viewers_call_render_fn(scene):
    class CameraState:
        c2w = np.linalg.inv(gs3.demo_path().viewmats[0])

        def get_K(self, img_wh):
            return np.array([[80.0, 0, img_wh[0] / 2], [0, 80, img_wh[1] / 2], [0, 0, 1]])

    class RenderTabState:
        preview_render, viewer_width, viewer_height, render_width, render_height = False, 96, 56, 64, 40

    render = gs3.render_fn(scene, backend="cpu")
    image = render(CameraState(), RenderTabState())
    assert image.shape == (56, 96, 3) and image.dtype == np.uint8 and image.max() > 100
    assert render(CameraState(), (64, 40)).shape == (40, 64, 3)
    RenderTabState.preview_render = True
    assert render(CameraState(), RenderTabState()).shape == (40, 64, 3)
    with pytest.raises(gs3.InputError, match="mode: expected one without in-between frames"):
        gs3.render_fn(scene, mode="full")
