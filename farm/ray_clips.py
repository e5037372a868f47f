"""Training clips of many scenes, made by all machines of a Ray cluster with `gs3 train clips`.

    python farm/ray_clips.py scenes/*.ply --out clips --count 100 --options "--network super-sample --size 256x256"

A task is one scene; its clips are in OUT/SCENE's name. All that is random follows from the scene's name and the clip's number,
so a task that is run again makes the same clips, and keeps those that are there.
"""

import argparse
import pathlib
import shlex
import subprocess
import zlib

import ray

# Of gs3: what may succeed elsewhere or later, and what Ray's retries are for.
MAY_PASS = 75


@ray.remote(max_retries=3, retry_exceptions=[OSError])
def clips(gs3, scene, out, count, options):
    """Makes `count` clips of `scene`; gives their folder."""
    folder = pathlib.Path(out) / pathlib.Path(scene).stem
    seed = zlib.crc32(pathlib.Path(scene).name.encode())
    command = [gs3, "train", "clips", scene, "--count", str(count), "--seed", str(seed), "--out", str(folder)]
    done = subprocess.run(command + shlex.split(options), capture_output=True, text=True)
    if done.returncode == MAY_PASS or done.returncode < 0:
        raise OSError(f"{scene}: {done.stderr.strip() or done.returncode}")
    if done.returncode != 0:
        raise ValueError(f"{scene}: {done.stderr.strip()}")
    return str(folder)


def make(scenes, out, *, count=100, options="", cpus=1, gs3="gs3"):
    """Makes clips of all `scenes`. Gives the folders of those that succeeded, and what was wrong with the others."""
    tasks = {clips.options(num_cpus=cpus).remote(gs3, scene, str(out), count, options): scene for scene in scenes}
    folders, failures = [], {}
    for task, scene in tasks.items():
        try:
            folders.append(ray.get(task))
        except (ray.exceptions.RayTaskError, ray.exceptions.WorkerCrashedError) as error:
            failures[scene] = str(getattr(error, "cause", error))
    return folders, failures


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="scene files or folders on a disk that all machines share")
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--count", type=int, default=100, help="clips of a scene")
    parser.add_argument("--options", default="--network super-sample", help="more options of gs3 train clips")
    parser.add_argument("--cpus", type=int, default=1, help="cores of a task")
    parser.add_argument("--gs3", default="gs3", help="the command")
    parser.add_argument("--address", help="of the cluster [default: a new one on this machine]")
    args = parser.parse_args()
    ray.init(address=args.address)
    scenes = [str(pathlib.Path(scene).resolve()) for scene in args.scenes]
    folders, failures = make(
        scenes, args.out.resolve(), count=args.count, options=args.options, cpus=args.cpus, gs3=args.gs3
    )
    for scene, reason in failures.items():
        print(f"{scene}: {reason}")
    print(f"clips of {len(folders)} scenes, {len(failures)} failed")
    raise SystemExit(2 if failures else 0)


if __name__ == "__main__":
    main()
