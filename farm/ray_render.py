"""One path, rendered by all machines of a Ray cluster: frames as `gs3 render` writes them, bit for bit.

    python farm/ray_render.py garden.ply --path cameras.json --size 3840x2160 --out frames --workers 8

Each worker keeps the scene loaded and takes one chunk after the other. A chunk of a worker that dies goes to another one, which
renders only the frames that are not there. Workers share the folder OUT.
"""

import argparse
import pathlib
import time

import ray


def name(number):
    """The file of the frame with this number among all that are shown, as `gs3 render` names it."""
    return f"frame_{number:06}.png"


@ray.remote(max_restarts=-1, max_task_retries=-1)
class Worker:
    """Renders chunks of a path, with the scene in memory."""

    def __init__(self, scene, cameras, size, settings):
        import gs3

        self.gs3 = gs3
        self.scene = gs3.demo() if scene == "demo" else gs3.Scene.open(scene)
        path = gs3.demo_path() if cameras is None else gs3.load_cameras(cameras, scene=self.scene)
        self.path = path.resized(*size) if size else path
        width, height = (int(side) for side in self.path.sizes[0])
        self.renderer = gs3.Renderer(self.scene, width, height, **settings)
        self.each = settings["frames_between"] + 1 if settings.get("mode", "full") == "full" else 1

    def frames(self):
        """Number of rendered frames of the path."""
        return len(self.path)

    def render(self, out, first, end):
        """Renders the frames from `first` to `end`, the last one excluded, but for those that are there. Gives the names of
        the files written."""
        out = pathlib.Path(out)
        out.mkdir(parents=True, exist_ok=True)
        numbers = lambda k: range(max(k * self.each - self.each + 1, 0), k * self.each + 1)  # noqa: E731
        is_there = lambda k: all((out / name(number)).is_file() for number in numbers(k))  # noqa: E731
        missing = [k for k in range(first, end) if not is_there(k)]
        if not missing:
            return []
        written = []
        # One frame after the other from the first that is missing: what a killed worker left is the beginning of a chunk.
        part = range(missing[0], end)
        for k, shown in zip(part, self.renderer.follow(self.path, frames=part, dtype="uint8")):
            for number, frame in zip(numbers(k), shown):
                if not (out / name(number)).is_file():
                    self.gs3.save_png(out / name(number), frame)
                    written.append(name(number))
        return written


def chunks(frames, length):
    """Chunks that begin one frame after a keyframe, which then is all of their warm-up; the first begins with the path."""
    starts = [0, *range(length + 1, frames, length)]
    return list(zip(starts, [*starts[1:], frames]))


def render(scene, out, *, path=None, size=None, frames=None, chunk=32, workers=2, cpus=1, settings=None):
    """Renders on the Ray cluster that this process is connected to. Gives the names of the files written, in no order."""
    settings = {"backend": "cpu", "keyframes": 32, "frames_between": 2, **(settings or {})}
    # As many threads as cores, so that workers on one machine do not share them.
    environment = {"env_vars": {"RAYON_NUM_THREADS": str(cpus)}}
    options = {"num_cpus": cpus, "runtime_env": environment}
    start = lambda: Worker.options(**options).remote(scene, path, size, settings)  # noqa: E731
    started = [start() for _ in range(workers)]
    if frames is None:
        frames = ray.get(started[0].frames.remote())
    pool = ray.util.ActorPool(started)
    done = pool.map_unordered(lambda worker, part: worker.render.remote(str(out), *part), chunks(frames, chunk))
    return [file for written in done for file in written]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", help="scene file or folder, or demo")
    parser.add_argument("--path", help="cameras [default, for demo alone: its orbit]")
    parser.add_argument("--size", type=lambda text: tuple(int(side) for side in text.split("x")), metavar="WxH")
    parser.add_argument("--frames", type=int, help="rendered frames [default: all of the path]")
    parser.add_argument("--out", required=True, type=pathlib.Path, help="folder that all workers share")
    parser.add_argument("--chunk", type=int, default=32, help="rendered frames of a chunk, a multiple of 32")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cpus", type=int, default=1, help="cores of a worker")
    parser.add_argument("--address", help="of the cluster [default: a new one on this machine]")
    args = parser.parse_args()
    ray.init(address=args.address)
    begun = time.monotonic()
    scene = args.scene if args.scene == "demo" else str(pathlib.Path(args.scene).resolve())
    path = args.path and str(pathlib.Path(args.path).resolve())
    written = render(
        scene,
        args.out.resolve(),
        path=path,
        size=args.size,
        frames=args.frames,
        chunk=args.chunk,
        workers=args.workers,
        cpus=args.cpus,
    )
    print(f"{len(written)} frames written in {time.monotonic() - begun:.1f} s")


if __name__ == "__main__":
    main()
