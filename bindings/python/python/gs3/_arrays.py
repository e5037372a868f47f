"""Arrays of any library to NumPy's, checked."""

from __future__ import annotations

from typing import Any, Tuple, Union

import numpy as np

from ._errors import InputError

Shape = Tuple[Union[int, str], ...]


def from_any(value: Any, name: str) -> np.ndarray:
    """``value`` as an array of NumPy: as it is, through DLPack, or as ``numpy.asarray`` makes it."""
    if isinstance(value, np.ndarray):
        return value
    # Tensors of PyTorch that gradients flow through are not exported as they are.
    if getattr(value, "requires_grad", False):
        value = value.detach()
    if hasattr(value, "__dlpack__"):
        try:
            return np.from_dlpack(value)
        except (BufferError, RuntimeError, TypeError, ValueError) as error:
            device = getattr(value, "device", "unknown")
            raise InputError(
                f"{name}: expected an array in the processor's memory of a type that NumPy has, found "
                f"{type(value).__name__} of type {getattr(value, 'dtype', 'unknown')} on device {device} ({error})"
            ) from error
    return np.asarray(value)


def array(value: Any, name: str, shape: Shape, dtype: Any = np.float32) -> np.ndarray:
    """``value`` as a C-contiguous array of ``dtype``, without a copy where it is one.

    ``shape`` has numbers, and names for lengths that may be any.
    """
    found = from_any(value, name)
    if found.dtype.kind not in "fiub":
        raise InputError(f"{name}: expected real numbers, found type {found.dtype}")
    fits = len(found.shape) == len(shape) and all(
        isinstance(wanted, str) or wanted == actual for wanted, actual in zip(shape, found.shape)
    )
    if not fits:
        wanted = ", ".join(str(side) for side in shape)
        raise InputError(f"{name}: expected shape [{wanted}], found {list(found.shape)}")
    return np.ascontiguousarray(found, dtype=dtype)


def matrices(viewmats: Any, Ks: Any) -> Tuple[np.ndarray, np.ndarray]:
    """World-to-camera and intrinsic matrices of C cameras, [C, 4, 4] and [C, 3, 3]."""
    views = array(viewmats, "viewmats", ("C", 4, 4), np.float64)
    return views, array(Ks, "Ks", (views.shape[0], 3, 3), np.float64)


def matrix(viewmat: Any, K: Any) -> Tuple[np.ndarray, np.ndarray]:
    """World-to-camera and intrinsic matrix of one camera, [4, 4] and [3, 3]."""
    return array(viewmat, "viewmat", (4, 4), np.float64), array(K, "K", (3, 3), np.float64)


def picture(value: Any, name: str) -> np.ndarray:
    """[H, W, 3] as f32; bytes become 0 to 1."""
    found = from_any(value, name)
    if found.dtype == np.uint8:
        found = array(found, name, ("H", "W", 3), np.uint8).astype(np.float32) / np.float32(255)
    return array(found, name, ("H", "W", 3))


def is_bytes(dtype: Any) -> bool:
    """Whether frames are to be bytes, and not f32."""
    found = np.dtype(dtype)
    if found not in (np.dtype(np.float32), np.dtype(np.uint8)):
        raise InputError(f"dtype: expected float32 or uint8, found {found}")
    return found == np.dtype(np.uint8)


def size(width: Any, height: Any) -> Tuple[int, int]:
    """Width and height in pixels, as numbers that fit."""
    for name, side in (("width", width), ("height", height)):
        if not 1 <= int(side) <= 65535 or int(side) != side:
            raise InputError(f"{name}: expected a whole number from 1 to 65535 (pixels), found {side}")
    return int(width), int(height)
