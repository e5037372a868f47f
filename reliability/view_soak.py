"""Plays a hand in the viewer's window and watches the memory: scenes are opened and closed, the camera moves, methods are compared.

    python reliability/view_soak.py --gs3 target/release/gs3 --rounds 300 --minutes 30 garden.ply lod-meta.json

One process shows the scenes and the built-in one in turn, on an X server without a screen (Xvfb). Ten times a second its memory is
read from /proc: little is left between scenes for less than a second. The first tenth of the time does not count.
"""

import argparse
import contextlib
import json
import pathlib
import subprocess
import tempfile
import time

from soak import resident

# Loops of the viewer a second.
FPS = 30
# Parts of the time that counts, in which the least memory is found. What rounds show repeats after thirty (3 scenes, 5 comparisons,
# 6 views): of three hundred rounds each part has thirty.
PARTS = 9
# Parts whose means are compared: longer ones, as means also depend on how long each scene takes to load.
MEAN_PARTS = 3


def steps_of(scenes, rounds, minutes):
    """What the hand does: as many loops in each round, so that all rounds take the time asked for."""
    loops = int(minutes * 60 * FPS / rounds)
    steps = []
    for k in range(rounds):
        hand = [
            {"do": "drop", "file": scenes[k % len(scenes)]},
            {"do": "expect", "message": ""},
            {"do": "drag", "button": "left", "from": [0.5, 0.5], "to": [0.6, 0.45], "frames": loops // 4},
            {"do": "hold", "key": "W", "frames": loops // 8},
            {"do": "key", "key": "C"},
            {"do": "key", "key": "V"},
            {"do": "wait", "frames": loops // 4},
            {"do": "wheel", "lines": 2, "at": [0.5, 0.5]},
            {"do": "wait", "frames": loops // 4},
            {"do": "drop", "file": "no-scene.ply"},
            {"do": "key", "key": "Escape"},
            {"do": "wait", "frames": loops // 8},
        ]
        steps += hand
    return [*steps, {"do": "wait_idle"}, {"do": "figures", "file": "figures.json"}, {"do": "end"}]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gs3", type=pathlib.Path, required=True)
    parser.add_argument("--rounds", type=int, default=300)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--backend", default="cpu")
    parser.add_argument("scenes", nargs="*", type=pathlib.Path)
    args = parser.parse_args()
    scenes = [*(str(scene.resolve()) for scene in args.scenes), "demo"]
    with tempfile.TemporaryDirectory() as folder:
        script = pathlib.Path(folder, "script.json")
        script.write_text(json.dumps({"steps": steps_of(scenes, args.rounds, args.minutes)}))
        command = [args.gs3.resolve(), "view", "demo", "--size", args.size, "--backend", args.backend, "--script", script]
        command = ["xvfb-run", "-a", *command]
        begun, found, viewer = time.monotonic(), [], None
        process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True)
        while process.poll() is None:
            time.sleep(0.1)
            viewer = viewer or child_of(process.pid, args.gs3.name)
            # A process that is ending has no memory to read.
            with contextlib.suppress(OSError, StopIteration):
                if viewer:
                    found.append((time.monotonic() - begun, resident(viewer)))
        assert process.returncode == 0, process.stderr.read()
        assert found, f"expected a process {args.gs3.name} below xvfb-run, found none"
        figures = json.loads(pathlib.Path(folder, "figures.json").read_text())
    passed = found[-1][0]
    # In its last second the process may be ending, which gives memory back.
    counted = [memory for at, memory in found if passed / 10 <= at <= passed - 1]
    means = [sum(part) / len(part) for part in divided(counted, MEAN_PARTS)]
    # What is left between scenes.
    least = [min(part) for part in divided(counted, PARTS)]
    print(
        f"{passed / 60:.1f} minutes, {args.rounds} scenes opened, {figures['rendered']} frames rendered; "
        f"memory {min(counted):.0f} to {max(counted):.0f} MiB, by ninths least {listed(least)} MiB, by thirds mean {listed(means)} MiB"
    )
    # Each part against each other one, so also the last against the first.
    for memories in (least, means):
        assert max(memories) <= 1.05 * min(memories), "memory is not flat"


def divided(memories, count):
    """`count` parts of `memories`, one after the other."""
    ends = [len(memories) * k // count for k in range(count + 1)]
    return [memories[begin:end] for begin, end in zip(ends, ends[1:])]


def listed(memories):
    return ", ".join(f"{memory:.0f}" for memory in memories)


def child_of(pid, name):
    """The process called `name` below `pid`, if it runs."""
    for status in pathlib.Path("/proc").glob("[0-9]*/status"):
        try:
            fields = dict(line.split(":\t", 1) for line in status.read_text().splitlines() if ":\t" in line)
        except OSError:
            continue
        # Linux keeps 15 characters of a name.
        if fields.get("Name") == name[:15] and fields.get("PPid") == str(pid):
            return int(fields["Pid"])
    return None


if __name__ == "__main__":
    main()
