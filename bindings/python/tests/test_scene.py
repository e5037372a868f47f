"""Scenes: arrays and files in and out."""

import json
import threading
import time

import numpy as np
import pytest

import gs3
import scenes


def some(count=500, sh_degree=3):
    view, K = scenes.camera(64, 48)
    return scenes.random(1, view, K, 64, 48, count=count, sh_degree=sh_degree)


def test_arrays_come_back_as_they_went_in():
    g = some()
    scene = gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors)
    assert (len(scene), scene.sh_degree, scene.dropped, scene.antialiased) == (500, 3, 0, False)
    assert (scene.means == g.means).all() and (scene.scales == g.scales).all()
    assert (scene.opacities == g.opacities).all() and (scene.sh == g.colors).all()
    np.testing.assert_allclose(scene.quats, g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True), atol=1e-6)
    assert scene.sh.dtype == np.float32 and scene.sh.shape == (500, 16, 3)
    assert "500 Gaussians" in repr(scene)
    part = gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors, sh_degree=1)
    assert (part.sh == g.colors[:, :4]).all()
    flat = gs3.Scene.from_arrays(*g.arrays()[:4], colors=g.colors[:, 0].clip(0))
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * flat.sh[:, 0], g.colors[:, 0].clip(0), atol=1e-6)


def test_invalid_gaussians_are_dropped_and_counted():
    g = some()
    g.means[3] = np.nan
    g.opacities[7] = 1.5
    scene = gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors)
    assert (len(scene), scene.dropped) == (498, 2)
    with pytest.raises(gs3.InputError, match="no valid Gaussian"):
        gs3.Scene.from_arrays(np.full((500, 3), np.inf), *g.arrays()[1:4], sh=g.colors)


def test_errors_say_what_was_expected_and_found():
    g = some()
    with pytest.raises(gs3.InputError, match="sh and colors: expected one of them, found neither"):
        gs3.Scene.from_arrays(*g.arrays()[:4])
    with pytest.raises(gs3.InputError, match="sh: expected 1, 4, 9, 16 or 25 coefficients, found 5"):
        gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors[:, :5])


@pytest.mark.parametrize("name, tolerance", [("a.ply", 1e-5), ("a.glb", 1e-5), ("a.spz", 1e-1)])
def test_files_are_written_and_read(tmp_path, name, tolerance):
    g = some()
    scene = gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors.clip(-0.9, 0.9), antialiased=name == "a.ply")
    assert scene.save(tmp_path / name) == []
    again = gs3.Scene.open(tmp_path / name)
    assert len(again) == 500 and again.antialiased == scene.antialiased
    np.testing.assert_allclose(again.means, scene.means, atol=tolerance)
    np.testing.assert_allclose(again.opacities, scene.opacities, atol=tolerance)
    np.testing.assert_allclose(again.sh, scene.sh, atol=tolerance)
    assert scene.save(tmp_path / "a.splat") != []  # what the format does not keep


def test_files_that_cannot_be_read_say_so(tmp_path):
    with pytest.raises(gs3.FileError, match="nothing.ply: cannot be read"):
        gs3.Scene.open(tmp_path / "nothing.ply")
    (tmp_path / "text.ply").write_text("no scene")
    with pytest.raises(gs3.InputError, match="text.ply: format: expected 3D Gaussians"):
        gs3.Scene.open(str(tmp_path / "text.ply"))
    with pytest.raises(gs3.InputError, match="expected .*ply"):
        gs3.Scene.from_arrays(*some().arrays()[:4], sh=some().colors).save(tmp_path / "a.xyz")
    assert issubclass(gs3.FileError, OSError) and issubclass(gs3.InputError, ValueError)


def test_a_budget_takes_coarser_levels(tmp_path):
    counts = {"fine": 400, "coarse": 100}
    for name, count in counts.items():
        g = some(count=count, sh_degree=0)
        gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors).save(tmp_path / name / "lod-meta.json")
    lods = {str(k): {"file": k, "offset": 0, "count": count} for k, count in enumerate(counts.values())}
    index = {"lodLevels": 2, "filenames": [f"{name}/0_0/meta.json" for name in counts], "tree": {"lods": lods}}
    (tmp_path / "lod-meta.json").write_text(json.dumps(index))
    for options, count in [
        ({}, 400),
        ({"level": 1}, 100),
        ({"budget": 399}, 100),
        ({"budget": 400}, 400),
        ({"budget": 399, "cameras": gs3.demo_path()}, 100),
        ({"axes": "rub"}, 400),
    ]:
        assert len(gs3.Scene.open(tmp_path, **options)) == count, options
    right, turned = gs3.Scene.open(tmp_path).means, gs3.Scene.open(tmp_path, axes="rub").means
    np.testing.assert_allclose(turned, right * [1, -1, -1], atol=1e-6)
    for options, message in [
        ({"budget": 9, "level": 1}, "a budget of 9 Gaussians and level 1"),
        ({"cameras": gs3.demo_path()}, "cameras: expected a budget with them, found none"),
        ({"axes": "xyz"}, "axes: "),
    ]:
        with pytest.raises(gs3.InputError, match=message):
            gs3.Scene.open(tmp_path, **options)


def large(folder):
    path = folder / "large.ply"
    g = some(count=200_000)
    gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors).save(path)
    return path


def test_loading_tells_how_far_it_is_and_stops(tmp_path):
    path, shares = large(tmp_path), []
    main = threading.get_ident()
    assert len(gs3.Scene.open(path, progress=lambda share: shares.append((share, threading.get_ident() == main)))) == 200_000
    assert shares[0] == (0.0, True) and shares[-1] == (1.0, True)
    assert shares == sorted(shares)
    with pytest.raises(gs3.Cancelled, match="large.ply: stopped"):
        gs3.Scene.open(path, progress=lambda share: False)

    def fails(share):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        gs3.Scene.open(path, progress=fails)


def test_other_threads_run_meanwhile():
    """A thread that counts in Python goes on while Gaussians are copied, loaded and rasterized."""
    g = some(count=400_000)
    view, K = scenes.camera(640, 480)
    counts, is_done, scene = [0], threading.Event(), None

    def count():
        while not is_done.is_set():
            counts[0] += 1
            time.sleep(0.0005)

    thread = threading.Thread(target=count)
    thread.start()
    try:
        for work in (
            lambda: gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors),
            lambda: scene.rasterization(view[None], K[None], 640, 480),
        ):
            before, started = counts[0], time.perf_counter()
            made = work()
            scene = made if isinstance(made, gs3.Scene) else scene
            elapsed = time.perf_counter() - started
            # At least one turn in 20 ms: with the lock held there would be one or two in all.
            assert counts[0] - before >= elapsed / 0.02, f"{counts[0] - before} turns in {elapsed:.3f} s"
    finally:
        is_done.set()
        thread.join()


def test_the_demo_is_there():
    scene, path = gs3.demo(), gs3.demo_path()
    assert len(scene) > 500_000 and len(path) == 240 and path.is_cycle
