"""Frames as PNG files."""

from __future__ import annotations

import os
from typing import Any, Union

import numpy as np

from . import _gs3
from ._arrays import array, from_any
from ._errors import InputError


def save_png(path: Union[str, "os.PathLike[str]"], frame: Any) -> None:
    """Writes ``frame``, u8 [H, W, 3], display-encoded RGB, as the PNG file that ``gs3 render`` would write, byte for byte.

    The file appears whole or not at all.
    """
    found = from_any(frame, "frame")
    if found.dtype != np.uint8:
        raise InputError(f"frame: expected type uint8 (render with dtype=numpy.uint8), found {found.dtype}")
    _gs3.save_png(os.fspath(path), array(found, "frame", ("H", "W", 3), np.uint8))
