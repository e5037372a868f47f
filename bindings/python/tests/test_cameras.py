"""Camera paths: files in, arrays out."""

import json

import numpy as np
import pytest

import gs3
import scenes


def test_a_file_of_cameras_becomes_arrays(tmp_path):
    c2w = np.eye(4)
    c2w[:3, 3] = 1, 2, 3
    frames = [{"file_path": f"{k}.png", "transform_matrix": c2w.tolist()} for k in range(3)]
    shared = {"w": 640, "h": 480, "fl_x": 500.0, "fl_y": 510.0, "cx": 320.0, "cy": 240.0}
    (tmp_path / "transforms.json").write_text(json.dumps({**shared, "frames": frames}))
    path = gs3.load_cameras(tmp_path / "transforms.json")
    assert len(path) == 3 and path.names[2].endswith("2.png")
    assert path.viewmats.shape == (3, 4, 4) and path.Ks.shape == (3, 3, 3)
    assert path.sizes.tolist() == [[640, 480]] * 3
    np.testing.assert_array_equal(path.Ks[0], [[500, 0, 320], [0, 510, 240], [0, 0, 1]])
    # OpenGL's axes in the file, OpenCV's in memory: the camera is at (1, 2, 3) and looks along −z, with y down.
    center = -path.viewmats[0, :3, :3].T @ path.viewmats[0, :3, 3]
    np.testing.assert_allclose(center, [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(path.viewmats[0, 1, :3], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(path.viewmats[0, 2, :3], [0, 0, -1], atol=1e-12)


def test_arrays_become_a_path_and_come_back():
    pairs = [scenes.camera(64, 48, tilt=0.1 * k) for k in range(4)]
    views, Ks = np.stack([v for v, _ in pairs]), np.stack([k for _, k in pairs])
    path = gs3.CameraPath.from_arrays(views, Ks, 64, 48, frames_per_second=25)
    np.testing.assert_allclose(path.viewmats, views, atol=1e-12)
    np.testing.assert_allclose(path.Ks, Ks, atol=1e-12)
    assert path.frames_per_second == 25 and not path.is_cycle and len(path[1:3]) == 2
    np.testing.assert_array_equal(path[1:3].viewmats, path.viewmats[1:3])
    halved = path.resized(32, 24)
    np.testing.assert_allclose(halved.Ks[0], [[28.8, 0, 16], [0, 31.68, 12], [0, 0, 1]], atol=1e-9)
    assert len(path.smoothed(11)) == 11


def test_errors_say_what_was_expected_and_found(tmp_path):
    with pytest.raises(gs3.FileError, match="nothing.json"):
        gs3.load_cameras(tmp_path / "nothing.json")
    (tmp_path / "bad.json").write_text("[]")
    with pytest.raises(gs3.InputError, match="bad.json"):
        gs3.load_cameras(tmp_path / "bad.json")
    with pytest.raises(gs3.InputError, match="cameras: expected at least 1, found 0"):
        gs3.CameraPath.from_arrays(np.zeros((0, 4, 4)), np.zeros((0, 3, 3)), 64, 48)
    with pytest.raises(IndexError, match="step: expected 1, found 2"):
        gs3.demo_path()[::2]
