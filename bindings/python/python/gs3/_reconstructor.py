"""Frames of other renderers."""

from __future__ import annotations

from typing import Any, List, NamedTuple, Optional, Tuple

import numpy as np

from . import _gs3
from ._arrays import array, from_any, is_bytes, matrix, size
from ._errors import InputError


class NextFrame(NamedTuple):
    """How a frame is to be rendered."""

    jitter: Tuple[float, float]
    """Where samples lie, from the centres of the low-resolution pixels, in those; x right, y down."""
    margin: Tuple[int, int, int, int]
    """Low-resolution pixels worth rendering beyond the left, top, right and bottom edge."""
    reset: Optional[str]
    """Why the frame has no history, if it has none."""


class Reconstructor:
    """Low-resolution frames of any renderer to high-resolution ones, and frames between them.

    For each frame of a high-resolution camera: ask ``next_jitter``, render the low-resolution frame sampled there
    (``lr_K`` is the camera for it), and give it to ``reconstruct``. Surfaces are followed by depths and
    cameras, and by ``motion`` where they move by themselves.

    Args:
        width, height: Size of the high-resolution frames, pixels.
        scale: High over low resolution, 1 to 8.
        frames_between: Frames interpolated before each rendered one, 0 for none.
        kriging: Sharper in motion: ``off``, ``coarse``, ``on``, ``fine``.
        widest_margin: Pixels that the renderer can render beyond each edge.
        jittered: Whether frames are sampled at other places from one to the next.
    """

    def __init__(
        self,
        width: int,
        height: int,
        *,
        scale: int = 4,
        frames_between: int = 1,
        kriging: str = "off",
        widest_margin: int = 0,
        jittered: bool = True,
    ) -> None:
        self._size = size(width, height)
        self._scale = scale
        self._native = _gs3.Reconstructor(scale, frames_between, kriging, widest_margin, jittered)

    @property
    def lr_size(self) -> Tuple[int, int]:
        """Width and height of low-resolution frames, pixels, without margins."""
        width, height = self._size
        return -(-width // self._scale), -(-height // self._scale)

    def lr_K(self, K: Any, jitter: Tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Intrinsics, f64 [3, 3], with which a renderer that samples at pixel centres samples where ``jitter`` says, in
        low-resolution pixels."""
        lr = array(K, "K", (3, 3), np.float64).copy()
        lr[:2] /= self._scale
        lr[:2, 2] -= jitter
        return lr

    def next(self, viewmat: Any, K: Any) -> NextFrame:
        """How the frame of the high-resolution camera is to be rendered. Asking changes nothing."""
        jitter, margin, reset = self._native.next(*matrix(viewmat, K), *self._size)
        left, top, right, bottom = margin
        return NextFrame((jitter[0], jitter[1]), (left, top, right, bottom), reset)

    def next_jitter(self, viewmat: Any, K: Any) -> Tuple[float, float]:
        """Where the next frame is to be sampled: an offset from the centres of the low-resolution pixels, in those."""
        return self.next(viewmat, K).jitter

    def reset(self) -> None:
        """Forgets the frames before: the next one starts anew."""
        self._native.reset()

    def reconstruct(
        self,
        viewmat: Any,
        K: Any,
        color: Any,
        depth: Any,
        *,
        color_dx: Any = None,
        color_dy: Any = None,
        motion: Any = None,
        jitter: Tuple[float, float],
        depth_encoding: str = "distance",
        near: float = 0.1,
        far: float = float("inf"),
        margin: Tuple[int, int, int, int] = (0, 0, 0, 0),
        dtype: Any = np.float32,
    ) -> List[np.ndarray]:
        """The frames to show: those between the last camera and this one, and its own.

        Args:
            viewmat, K: The high-resolution camera, [4, 4] and [3, 3].
            color: Display-encoded RGB, [h, w, 3 or 4]. Three channels are read.
            depth: Of the visible surface, [h, w], as ``depth_encoding`` says.
            color_dx, color_dy: Derivatives of the colour per low-resolution pixel, [h, w, 3]; differenced where there are
                none, which costs sharpness.
            motion: From where a pixel's surface is to where it was in the frame before, [h, w, 2], low-resolution pixels, x right
                and y down, without jitter, the camera's motion included (as FSR and DLSS take it). Without, what is shown
                stands still.
            jitter: Where the frame is sampled, as ``next_jitter`` said.
            depth_encoding: ``distance`` along the view axis, 0 where there is nothing; ``projective``, 0 at ``near`` and 1
                at ``far``; ``reversed``, 1 at ``near`` and 0 at ``far``; ``linear``.
            near, far: Distances of the clip planes, world units; ``distance`` does not read them.
            margin: Pixels of the planes beyond the left, top, right and bottom edge.
            dtype: ``float32`` or ``uint8``.

        Returns:
            Frames [H, W, 3]. Before the first frame and after a reset there are none between.
        """
        if (color_dx is None) != (color_dy is None):
            raise InputError("color_dx and color_dy: expected both or none, found one")
        width, height = self.lr_size
        left, top, right, bottom = margin
        columns, rows = width + left + right, height + top + bottom
        pixels = from_any(color, "color")
        channels = 4 if pixels.ndim == 3 and pixels.shape[2] == 4 else 3
        gradients = None
        if color_dx is not None:
            gradients = [
                array(color_dx, "color_dx", (rows, columns, 3)),
                array(color_dy, "color_dy", (rows, columns, 3)),
            ]
        frames, self._reset = self._native.reconstruct(
            *matrix(viewmat, K),
            *self._size,
            array(pixels, "color", (rows, columns, channels)),
            array(depth, "depth", (rows, columns)),
            gradients,
            None if motion is None else array(motion, "motion", (rows, columns, 2)),
            [float(jitter[0]), float(jitter[1])],
            list(margin),
            depth_encoding,
            near,
            far,
            is_bytes(dtype),
        )
        return frames

    _reset: Optional[str] = None

    @property
    def last_reset(self) -> Optional[str]:
        """Why the last frame had no history, if it had none."""
        return self._reset
