"""What the tests of all engines share: the command, a small scene, and the frames of one run over the whole path."""

import hashlib
import json
import math
import os
import pathlib
import shutil
import subprocess

import pytest

FARM = pathlib.Path(__file__).resolve().parent.parent
# Eight chunks of twelve frames, keyframes at their length.
FRAMES, CHUNK = 96, 12
OPTIONS = f"--path path.json --backend cpu --threads 1 --keyframes {CHUNK}"


@pytest.fixture(scope="session")
def gs3():
    """The command: what GS3 names, else the one on PATH."""
    found = shutil.which(os.environ.get("GS3", "gs3"))
    if found is None:
        pytest.skip("skipped: GS3 names no command, and there is none on PATH")
    return str(pathlib.Path(found).resolve())


def camera(k):
    """Frame `k` of an orbit, as nerfstudio's camera_path.json has it."""
    s, c = math.sin(0.02 * k), math.cos(0.02 * k)
    pose = [c, 0, s, 7 * s, 0, 1, 0, -1, -s, 0, c, 7 * c, 0, 0, 0, 1]
    return {"camera_to_world": pose, "fov": 50, "aspect": 16 / 9}


@pytest.fixture(scope="session")
def job(gs3, tmp_path_factory):
    """A folder with few.ply, path.json, and in `whole` the frames of one run."""
    folder = tmp_path_factory.mktemp("job")
    path = {"fps": 30, "render_height": 54, "render_width": 96, "camera_path": [camera(k) for k in range(FRAMES)]}
    (folder / "path.json").write_text(json.dumps(path))
    run = lambda command: subprocess.run([gs3, *command.split()], cwd=folder, check=True)  # noqa: E731
    run("simplify demo --size 64x36 --frames 0..2 --keep 0.02 --out few.ply")
    run(f"render few.ply {OPTIONS} --out whole")
    assert len(digests(folder / "whole")) == 3 * FRAMES - 2
    return folder


def digests(folder):
    """Name and digest of every frame in `folder`."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.glob("frame_*.png"))}


@pytest.fixture
def environment(gs3, job):
    """What farm/chunk.sh reads."""
    job_only = {"GS3": gs3, "SCENE": "few.ply", "FRAMES": str(FRAMES), "CHUNK": str(CHUNK), "OPTIONS": OPTIONS}
    return os.environ | job_only | {"FARM": str(FARM)}
