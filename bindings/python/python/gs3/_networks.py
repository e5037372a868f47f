"""The networks that come with gs3."""

from __future__ import annotations

import os
from typing import Any, Dict

import numpy as np

from . import _gs3
from ._scene import Path


def weights(network: str = "super_sample", *, tier: str = "balanced", scale: int = 4) -> Dict[str, np.ndarray]:
    """The numbers that a network has learned: f32 arrays by the names of its layers, convolutions [out, in, kh, kw].

    ``network`` is ``super_sample`` or ``interpolate``, ``tier`` ``fast``, ``balanced`` or ``high``.
    """
    return _gs3.weights(network, tier, scale)


def weights_info(network: str = "super_sample", *, tier: str = "balanced", scale: int = 4) -> Dict[str, Any]:
    """What a network was trained on, its version and its licence."""
    return _gs3.weights_info(network, tier, scale)


def export_onnx(path: Path, network: str = "super_sample", *, tier: str = "balanced", scale: int = 4) -> None:
    """Writes a network with its weights as an ONNX file, for ONNX Runtime, TensorRT and others."""
    _gs3.export_onnx(os.fspath(path), network, tier, scale)
