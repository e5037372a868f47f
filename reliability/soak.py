"""Renders for hours and watches the memory: frames are rendered, written and removed; the resident memory must stay flat.

    python reliability/soak.py --gs3 target/release/gs3 --hours 4 -- demo --size 640x360 --backend cpu

One process renders one long path. Every minute its memory is read from /proc. The first tenth of the time does not count.
"""

import argparse
import json
import math
import pathlib
import shutil
import subprocess
import tempfile
import time


def camera(k):
    """Frame `k` of an orbit, as nerfstudio's camera_path.json has it."""
    s, c = math.sin(0.01 * k), math.cos(0.01 * k)
    s, c = round(s, 6), round(c, 6)
    return {"camera_to_world": [c, 0, s, 7 * s, 0, 1, 0, -1, -s, 0, c, 7 * c, 0, 0, 0, 1], "fov": 50, "aspect": 16 / 9}


def resident(pid):
    """Resident memory in MiB."""
    lines = pathlib.Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gs3", default="gs3")
    parser.add_argument("--hours", type=float, default=4.0)
    parser.add_argument("--frames", type=int, default=400_000, help="of the path; more than the hours need")
    parser.add_argument("--log", type=pathlib.Path, help="a line a minute")
    parser.add_argument("render", nargs="+", help="the scene and options of gs3 render")
    args = parser.parse_args()
    gs3 = str(pathlib.Path(shutil.which(args.gs3) or args.gs3).resolve())
    folder = pathlib.Path(tempfile.mkdtemp())
    path = {"fps": 30, "render_height": 360, "render_width": 640, "camera_path": [camera(k) for k in range(args.frames)]}
    (folder / "path.json").write_text(json.dumps(path))
    command = [gs3, "render", *args.render, "--path", "path.json", "--out", "out"]
    process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE)
    begun, found, removed = time.monotonic(), [], 0
    try:
        while (passed := time.monotonic() - begun) < args.hours * 3600:
            time.sleep(min(60, args.hours * 360))
            assert process.poll() is None, process.communicate()[1].decode()
            for frame in list((folder / "out").glob("frame_*.png")):
                frame.unlink()
                removed += 1
            found.append((passed / 3600, resident(process.pid)))
            if args.log:
                with args.log.open("a") as log:
                    log.write(f"{found[-1][0]:.3f} h, {found[-1][1]:.1f} MiB, {removed} frames\n")
    finally:
        process.kill()
        process.wait()
        shutil.rmtree(folder)
    counted = [memory for hour, memory in found if hour >= args.hours / 10]
    first, last = sum(counted[:5]) / len(counted[:5]), sum(counted[-5:]) / len(counted[-5:])
    change = last / first - 1
    print(f"{args.hours} h, {removed} frames; memory {min(counted):.0f} to {max(counted):.0f} MiB, {change:+.1%} from begin to end")
    assert abs(change) <= 0.05, "memory is not flat"


if __name__ == "__main__":
    main()
