"""Frames of a moving camera."""

from __future__ import annotations

from typing import Any, Callable, Dict, Iterable, Iterator, List, Optional, Sequence, Tuple, Union

import numpy as np

from . import _gs3
from ._arrays import array, is_bytes, matrix, size
from ._cameras import CameraPath
from ._errors import Cancelled, InputError
from ._scene import Progress, Scene

Cameras = Union[CameraPath, Iterable[Tuple[Any, Any]]]


class Renderer:
    """Renders a scene along a moving camera: few pixels rasterized, the rest reconstructed from the frames before.

    Frames are those of the command ``gs3 render`` with the same settings, bit for bit. Each follows from the ones before,
    so cameras come in the order of the film. One renderer may be called from several threads, one after the other.

    Args:
        scene: What is shown.
        width, height: Size of the frames, pixels.
        quality: How large an error may be left: ``fast``, ``balanced`` or ``high``.
        refine: Which pixels are rasterized exactly besides: ``auto`` (what ``quality`` says), ``off``, a share of all, 0 to 1,
            or the time of a frame, ``"33ms"``. Not on a GPU with a super-sampling network.
        scale: High over low resolution, 1 to 8; ``auto`` is 4 up to 2560×1440 pixels and with a network, 6 above.
        frames_between: Frames interpolated before each rendered one in mode ``full``, 1 to 3.
        mode: ``full``, ``super-sample`` (none between), ``native`` (every pixel rasterized), ``bicubic`` (the baseline).
        backend: ``auto`` (a GPU where there is one), ``cpu`` or ``gpu``.
        tier: The network that refines frames: none, ``fast``, ``balanced`` or ``high``. Frames take a few times as long.
        learned_interpolation: Whether the tier's network refines in-between frames as well.
        kriging: Sharper in motion without a network: ``off``, ``coarse``, ``on``, ``fine``.
        overscan: Whether frames are rasterized beyond the edges that the camera turns to.
        keyframes: Frames from one keyframe to the next, 0 for none, so that parts of a path can be rendered apart (``follow``).
            The history begins anew at a keyframe if frames have exact pixels; else only the sub-pixel offsets do.
        background: RGB, 0 to 1.
    """

    def __init__(
        self,
        scene: Scene,
        width: int,
        height: int,
        *,
        quality: str = "balanced",
        refine: Union[str, float] = "auto",
        scale: Union[str, int] = "auto",
        frames_between: int = 2,
        mode: str = "full",
        backend: str = "auto",
        tier: Optional[str] = None,
        learned_interpolation: bool = False,
        kriging: str = "off",
        overscan: bool = False,
        keyframes: int = 32,
        background: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        self._size = size(width, height)
        rgb = array(background, "background", (3,)).tolist()
        self._native = _gs3.Renderer(
            scene._native,
            mode,
            str(scale),
            quality,
            str(refine),
            frames_between,
            tier,
            learned_interpolation,
            kriging,
            overscan,
            keyframes,
            backend,
            rgb,
        )

    @property
    def width(self) -> int:
        """Pixels."""
        return self._size[0]

    @property
    def height(self) -> int:
        """Pixels."""
        return self._size[1]

    def render(self, viewmat: Any, K: Any, *, dtype: Any = np.float32) -> List[np.ndarray]:
        """What the camera gives to show, in order: the frames between the last camera and this one, and its own frame.

        The first call gives one frame. After a cut of the camera nothing lies between: the frame before is held.

        Args:
            viewmat: World to camera, [4, 4]; x right, y down, z forward.
            K: Intrinsics of frames of this size, [3, 3], pixels.
            dtype: ``float32``, not clamped, or ``uint8``.

        Returns:
            Frames [H, W, 3], display-encoded RGB.
        """
        return self._native.render(*matrix(viewmat, K), *self._size, is_bytes(dtype))

    def follow(
        self,
        path: Cameras,
        *,
        frames: Optional[range] = None,
        dtype: Any = np.float32,
        progress: Optional[Progress] = None,
    ) -> Iterator[List[np.ndarray]]:
        """The frames of each camera of ``path`` in turn, as ``render`` gives them; begins anew.

        Of a ``CameraPath``, which is brought to this size, in-between frames are those of its smooth curve, as in
        ``gs3 render``. Other paths are pairs of a ``viewmat`` and a ``K``.

        ``frames`` are consecutive frames of a ``CameraPath``, all of them unless stated. The frames before them that their bits
        take are rendered and not given, so parts of a path that are rendered apart are those of one run.

        ``progress`` is called before each camera with the share that is done, 0 to 1 (0 where the length is not known); where it
        returns ``False``, ``Cancelled`` is raised.
        """
        as_bytes = is_bytes(dtype)
        if isinstance(path, CameraPath):
            resized = path
            if (path.sizes != self._size).any():
                resized = path.resized(*self._size)
            wanted = _part(frames, len(resized))
            first = self._native.begin_for(wanted.start)
            for k in range(first, wanted.stop):
                _ask(progress, (k - first) / (wanted.stop - first))
                shown = self._native.render_of_path(resized._native, k, as_bytes)
                if k in wanted:
                    yield shown
        elif frames is not None:
            raise InputError("frames: expected a path of gs3.load_cameras with them, found another one")
        else:
            self._native.begin_for(0)
            count = len(path) if hasattr(path, "__len__") else None  # type: ignore[arg-type]
            for k, (viewmat, K) in enumerate(path):
                _ask(progress, k / count if count else 0.0)
                yield self.render(viewmat, K, dtype=dtype)
        _ask(progress, 1.0)

    def native(self, viewmat: Any, K: Any, *, dtype: Any = np.float32) -> np.ndarray:
        """The same camera with every pixel rasterized, [H, W, 3]: what frames are judged by. The history stays."""
        return self._native.native(*matrix(viewmat, K), *self._size, is_bytes(dtype))

    def reset(self) -> None:
        """Forgets the frames before: the next one starts anew."""
        self._native.reset()

    def set_refine(self, refine: Union[str, float]) -> None:
        """Which pixels are rasterized exactly from the next frame on; the history stays."""
        self._native.set_refine(str(refine))

    @property
    def stats(self) -> Dict[str, Any]:
        """Figures of the last frame.

        - ``stage_ms``: milliseconds of ``rasterize``, ``super_sample``, ``refine``, ``interpolate``, as far as they ran;
        - ``refined_share``: share of the pixels that were rasterized exactly besides, 0 to 1;
        - ``reset``: why it has no history (``first_frame``, ``camera_cut``, …), or ``None``;
        - ``visible``: number of Gaussians shown, ``None`` where a GPU keeps the count;
        - ``backend``, ``adapter``: what renders, and the GPU's name;
        - ``notices``: what happened since this was asked last, as that the CPU took over from a GPU.
        """
        return self._native.stats()


def _part(frames: Optional[range], count: int) -> range:
    """``frames``, if a path of ``count`` has them in this order without gaps."""
    if frames is None:
        return range(count)
    if not isinstance(frames, range) or frames.step != 1 or not 0 <= frames.start < frames.stop <= count:
        raise InputError(f"frames: expected a range of consecutive frames within 0..{count}, found {frames!r}")
    return frames


def _ask(progress: Optional[Progress], share: float) -> None:
    if progress is not None and progress(share) is False:
        raise Cancelled("path: stopped, as the callback returned False")


def render_fn(scene: Scene, **settings: Any) -> Callable[[Any, Any], np.ndarray]:
    """What ``nerfview.Viewer`` calls: ``nerfview.Viewer(server, gs3.render_fn(scene), mode="rendering")``.

    ``settings`` are those of ``Renderer``; frames are those of mode ``super-sample`` within 100 ms unless stated. Images are
    u8 [H, W, 3]. The function takes nerfview's ``(camera_state, render_tab_state)`` and the older ``(camera_state, img_wh)``.
    """
    settings = {"mode": "super-sample", "refine": "100ms", **settings}
    if settings["mode"] == "full":
        raise InputError("mode: expected one without in-between frames, as a viewer shows the last alone, found 'full'")
    renderers: Dict[Tuple[int, int], Renderer] = {}

    def render(camera_state: Any, render_tab_state: Any) -> np.ndarray:
        if hasattr(render_tab_state, "viewer_width"):
            of = "render" if render_tab_state.preview_render else "viewer"
            wanted = (getattr(render_tab_state, f"{of}_width"), getattr(render_tab_state, f"{of}_height"))
        else:
            wanted = (int(render_tab_state[0]), int(render_tab_state[1]))
        if wanted not in renderers:
            # Another size begins without history anyway.
            renderers.clear()
            renderers[wanted] = Renderer(scene, *wanted, **settings)
        viewmat = np.linalg.inv(np.asarray(camera_state.c2w, dtype=np.float64))
        viewmat[3] = (0.0, 0.0, 0.0, 1.0)
        return renderers[wanted].render(viewmat, camera_state.get_K(wanted), dtype=np.uint8)[-1]

    return render
