"""farm/openjd.yaml, run by the reference implementation of Open Job Description."""

import shutil
import subprocess
import sys
import pathlib

import pytest
from conftest import CHUNK, FARM, FRAMES, OPTIONS, digests


def test_openjd_renders_and_joins(gs3, job):
    openjd = shutil.which("openjd") or shutil.which("openjd", path=pathlib.Path(sys.executable).parent)
    if openjd is None:
        pytest.skip("skipped: openjd (PyPI's openjd-cli) is not installed")
    parameters = {
        "Scene": job / "few.ply",
        "Frames": f"1-{FRAMES - 1}",
        "ChunkLength": CHUNK,
        "Out": job / "openjd",
        "Options": OPTIONS.replace("path.json", str(job / "path.json")),
        "Gs3": gs3,
    }
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}={value}")]
    template = FARM / "openjd.yaml"
    subprocess.run([openjd, "check", template, "--extensions", "TASK_CHUNKING"], check=True)
    run = [openjd, "run", template, "--extensions", "TASK_CHUNKING", *given]
    done = subprocess.run(run, cwd=job, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert digests(job / "openjd") == digests(job / "whole")
    assert (job / "openjd.mp4").stat().st_size > 1000
