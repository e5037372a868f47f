"""farm/ray_render.py and farm/ray_clips.py on a local cluster of two nodes with one core each."""

import os
import pathlib
import shutil
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from conftest import CHUNK, FARM, FRAMES, digests

ray = pytest.importorskip("ray", reason="skipped: ray (PyPI) is not installed")
pytest.importorskip("gs3", reason="skipped: the Python package gs3 is not installed")
sys.path.insert(0, str(FARM))
import ray_clips  # noqa: E402
import ray_render  # noqa: E402

SETTINGS = {"keyframes": CHUNK}


@pytest.fixture(scope="module")
def cluster():
    from ray.cluster_utils import Cluster

    # Workers import the scripts as the driver does.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(FARM), os.environ.get("PYTHONPATH", "")])
    # Frames go through files: the store of objects, a share of the memory otherwise, stays small. Ray's own killing of workers
    # looks at the memory of the whole machine, with all that other programs have on it.
    node = {"num_cpus": 1, "object_store_memory": 100 * 1024 * 1024}
    os.environ["RAY_memory_monitor_refresh_ms"] = "0"
    cluster = Cluster(initialize_head=True, head_node_args=node | {"include_dashboard": False})
    cluster.add_node(**node)
    ray.init(address=cluster.address, log_to_driver=False)
    assert len(ray.nodes()) == 2
    yield cluster
    ray.shutdown()
    cluster.shutdown()


def render(job, out, **more):
    settings = {"chunk": CHUNK, "workers": 2, "settings": SETTINGS} | more
    return ray_render.render(str(job / "few.ply"), job / out, path=str(job / "path.json"), **settings)


def workers():
    """Processes of actors that render, by their title."""
    found = []
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            title = (process / "cmdline").read_bytes()
        except OSError:
            continue  # ended meanwhile
        if title.startswith(b"ray::Worker"):
            found.append(int(process.name))
    return found


def killed_in_the_midst(job, out):
    """Renders the path into `out`, and kills a worker between its 30th frame and its last. A try that the workers outrun does
    not count. Gives the times of the frames that were there before, and the names that were told."""
    for _ in range(5):
        written = []
        with ThreadPoolExecutor(1) as pool:
            rendered = pool.submit(lambda: written.extend(render(job, out)))
            deadline = time.monotonic() + 240
            while not rendered.done() and len(list((job / out).glob("frame_*.png"))) < 30:
                assert time.monotonic() < deadline
                time.sleep(0.001)
            before = times(job / out)
            alive = workers()
            if alive and not rendered.done():
                os.kill(alive[0], signal.SIGKILL)
            rendered.result(240)
        if len(before) < 3 * FRAMES - 2 - 3 * CHUNK:
            return before, written
        shutil.rmtree(job / out)
    raise AssertionError("5 runs ended before a worker could be killed")


def times(folder):
    """Name and time of every frame in `folder`."""
    return {file.name: file.stat().st_mtime_ns for file in folder.glob("frame_*.png")}


def test_frames_are_those_of_one_run_though_a_worker_is_killed(job, cluster):
    before, written = killed_in_the_midst(job, "ray")
    assert digests(job / "ray") == digests(job / "whole")
    # None is lost, and none is made twice: neither those of before, nor any that is told.
    assert before.items() <= times(job / "ray").items()
    assert len(written) == len(set(written)) and len(written) > 3 * FRAMES - 2 - len(before) - 3 * CHUNK
    assert render(job, "ray") == []


@pytest.mark.skipif("GS3_TEST_SPEED" not in os.environ, reason="skipped: GS3_TEST_SPEED is not set, for an idle machine of two cores")
def test_two_workers_are_nearly_twice_as_fast_as_one(job, cluster):
    def seconds(workers, out):
        begun = time.monotonic()
        assert len(render(job, out, workers=workers, size=(1280, 720))) == 3 * FRAMES - 2
        return time.monotonic() - begun

    one, two = seconds(1, "one"), seconds(2, "two")
    print(f"one worker {one:.1f} s, two workers {two:.1f} s, {one / two:.2f} times as fast")
    assert digests(job / "one") == digests(job / "two")
    assert one / two >= 1.7


def test_clips_of_many_scenes(gs3, job, cluster):
    scenes = []
    for name in ["a", "b", "c"]:
        scene = job / f"{name}.ply"
        scene.write_bytes((job / "few.ply").read_bytes())
        scenes.append(str(scene))
    (job / "broken.ply").write_text("ply\n")
    options = "--network super-sample --size 64x64 --frames 2 --threads 1"
    make = lambda: ray_clips.make([*scenes, str(job / "broken.ply")], job / "clips", count=2, options=options, gs3=gs3)  # noqa: E731
    folders, failures = make()
    assert [pathlib.Path(folder).name for folder in folders] == ["a", "b", "c"]
    assert list(failures) == [str(job / "broken.ply")] and "broken.ply" in failures[str(job / "broken.ply")]
    clips = {file: file.stat().st_mtime_ns for file in (job / "clips").rglob("*") if file.is_file()}
    assert len(clips) >= 6
    make()
    assert clips == {file: file.stat().st_mtime_ns for file in (job / "clips").rglob("*") if file.is_file()}
