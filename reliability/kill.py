"""Kills gs3 at random moments, and looks at what is left: whole files only, and the same command goes on to the end.

    python reliability/kill.py --gs3 target/release/gs3 --times 200

Each round runs one command, kills it (SIGKILL) after a random share of the time that the command takes, checks every file under
its final name, runs the command again, and compares the result with the result of a run that nobody killed. Weights are not
compared: they must be whole.
"""

import argparse
import hashlib
import json
import pathlib
import random
import shutil
import signal
import struct
import subprocess
import tempfile
import time
import zlib


def digest(file):
    return hashlib.sha256(file.read_bytes()).hexdigest()


def is_png(file):
    """Whether the file has all chunks up to IEND, each with its checksum."""
    data = file.read_bytes()
    at = 8
    while data[:8] == b"\x89PNG\r\n\x1a\n" and at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if data[at + 8 + length : at + 12 + length] != struct.pack(">I", zlib.crc32(kind + body)):
            return False
        if kind == b"IEND":
            return at + 12 + length == len(data)
        at += 12 + length
    return False


class Job:
    """A command, its result, and how a file of its result is checked."""

    def __init__(self, name, command, result, is_whole, compares=True):
        self.name, self.command, self.result, self.is_whole, self.compares = name, command, result, is_whole, compares

    def run(self, gs3, folder):
        return subprocess.Popen([gs3, *self.command.split()], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    def files(self, folder):
        return {file.name: file for file in sorted(folder.glob(self.result))}


def jobs(gs3, base):
    def opens(file):
        return subprocess.run([gs3, "info", file], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0

    def plays(file):
        probe = ["ffprobe", "-v", "error", "-count_frames", "-show_entries", "stream=nb_read_frames", "-of", "json", file]
        done = subprocess.run(probe, capture_output=True, text=True)
        return done.returncode == 0 and int(json.loads(done.stdout)["streams"][0]["nb_read_frames"]) == 47

    def holds(file):
        # A safetensors file: the header names the bytes, all of them.
        data = file.read_bytes()
        (length,) = struct.unpack("<Q", data[:8])
        arrays = json.loads(data[8 : 8 + length])
        return max(a["data_offsets"][1] for name, a in arrays.items() if name != "__metadata__") + 8 + length == len(data)

    train = "train super-sample --tier fast --clips {base}/clips --checkpoint run --out net.safetensors --steps 6 --batch 1 --window 2 --crop 16"
    return [
        Job("render", f"render {base}/few.ply --size 160x90 --frames 0..24 --backend cpu --skip-existing --out out", "out/frame_*.png", is_png),
        Job("convert", f"convert {base}/demo.ply out.sog", "out.sog", opens),
        Job("join", f"join {base}/frames --frames 0..47 --out out.mp4", "out.mp4", plays),
        Job("train", train.format(base=base), "net.safetensors", holds, compares=False),
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gs3", default="gs3", help="the command")
    parser.add_argument("--times", type=int, default=200, help="kills, over all commands")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    gs3 = str(pathlib.Path(shutil.which(args.gs3) or args.gs3).resolve())
    chance = random.Random(args.seed)
    base = pathlib.Path(tempfile.mkdtemp())
    run = lambda command: subprocess.run([gs3, *command.split()], cwd=base, check=True, stderr=subprocess.DEVNULL)  # noqa: E731
    run("simplify demo --size 64x36 --frames 0..2 --keep 0.02 --out few.ply")
    run("convert demo demo.ply")
    run("render few.ply --size 160x90 --frames 0..24 --backend cpu --out frames")
    run("train clips demo --network super-sample --count 3 --held-out 0.34 --frames 2 --size 64x64 --out clips")
    kills, late, parts = {}, {}, {}
    for job in (all_jobs := jobs(gs3, base)):
        whole = base / f"whole_{job.name}"
        whole.mkdir()
        begun = time.monotonic()
        assert job.run(gs3, whole).wait() == 0, job.name
        job.seconds = time.monotonic() - begun
        job.wanted = {name: digest(file) for name, file in job.files(whole).items()}
        assert job.wanted, job.name
    for k in range(args.times):
        job = all_jobs[k % len(all_jobs)]
        folder = base / "round"
        folder.mkdir()
        process = job.run(gs3, folder)
        time.sleep(chance.random() * job.seconds)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        was_killed = process.returncode == -signal.SIGKILL
        (kills if was_killed else late)[job.name] = (kills if was_killed else late).get(job.name, 0) + 1
        there = job.files(folder)
        parts[job.name] = parts.get(job.name, 0) + bool(was_killed and there and len(there) < len(job.wanted))
        for name, file in there.items():
            assert job.is_whole(file), f"round {k}: {job.name} left a part of {name} in {folder}"
            assert not job.compares or digest(file) == job.wanted[name], f"round {k}: {name} differs"
        again = job.run(gs3, folder)
        said = again.communicate()[1].decode()
        assert again.returncode == 0, f"round {k}: {job.name} does not go on: {said}"
        found = {name: digest(file) for name, file in job.files(folder).items()}
        assert found.keys() == job.wanted.keys(), f"round {k}: {job.name}"
        assert not job.compares or found == job.wanted, f"round {k}: {job.name} ends otherwise"
        assert all(job.is_whole(file) for file in job.files(folder).values())
        shutil.rmtree(folder)
    shutil.rmtree(base)
    for job in all_jobs:
        killed, ended = kills.get(job.name, 0), late.get(job.name, 0)
        print(f"{job.name}: {killed} killed, {parts[job.name]} of them with some files; {ended} had ended; all went on to the end")


if __name__ == "__main__":
    main()
