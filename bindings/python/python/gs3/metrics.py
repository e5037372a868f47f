"""Quality metrics of frames [H, W, 3]: f32 from 0 to 1, clamped to that, or u8.

``reference`` is the ground truth, ``test`` what is judged.
"""

from __future__ import annotations

from typing import Any, Sequence

import numpy as np

from . import _gs3
from ._arrays import picture
from ._errors import InputError

__all__ = ["flicker", "flip", "flip_map", "psnr", "ssim", "tpsnr"]


def psnr(reference: Any, test: Any, *, eight_bit: bool = False) -> float:
    """Peak signal-to-noise ratio, dB; infinite for equal frames. ``eight_bit`` rounds to steps of 1/255 first."""
    return _gs3.psnr(picture(reference, "reference"), picture(test, "test"), eight_bit)


def ssim(reference: Any, test: Any, *, zero_pad: bool = False) -> float:
    """Structural similarity, 1 for equal frames: Gaussian window of 11×11, σ 1.5 (Wang et al. 2004).

    Without ``zero_pad`` windows stay within the frame, as in scikit-image; with it as in the code of Kerbl et al. 2023.
    """
    return _gs3.ssim(picture(reference, "reference"), picture(test, "test"), zero_pad)


def flip(reference: Any, test: Any, *, pixels_per_degree: float = 67.0) -> float:
    """Mean ꟻLIP error (Andersson et al. 2020), 0 for equal frames, at most 1."""
    return _gs3.flip(picture(reference, "reference"), picture(test, "test"), pixels_per_degree)


def flip_map(reference: Any, test: Any, *, pixels_per_degree: float = 67.0) -> np.ndarray:
    """ꟻLIP error of each pixel, f32 [H, W], 0 to 1."""
    return _gs3.flip_map(picture(reference, "reference"), picture(test, "test"), pixels_per_degree)


def tpsnr(reference: Sequence[Any], test: Sequence[Any], *, eight_bit: bool = False) -> float:
    """PSNR of the difference between two frames, dB: errors that come and go count, those that stay do not."""
    return _gs3.tpsnr(_pictures(reference, "reference", 2), _pictures(test, "test", 2), eight_bit)


def flicker(reference: Sequence[Any], test: Sequence[Any], *, eight_bit: bool = False) -> float:
    """Root mean square of the error's part that alternates over three frames, 0 to 1."""
    return _gs3.flicker(_pictures(reference, "reference", 3), _pictures(test, "test", 3), eight_bit)


def _pictures(frames: Sequence[Any], name: str, count: int) -> Any:
    if len(frames) != count:
        raise InputError(f"{name}: expected {count} frames, found {len(frames)}")
    return [picture(frame, name) for frame in frames]
