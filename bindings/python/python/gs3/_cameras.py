"""Camera paths."""

from __future__ import annotations

import os
from typing import Any, List, Optional, Tuple

import numpy as np

from . import _gs3
from ._arrays import matrices, size
from ._scene import Path, Scene


class CameraPath:
    """Cameras in order, one a frame, and the frame rate. A path does not change."""

    def __init__(self, native: "_gs3.CameraPath") -> None:
        self._native = native

    @classmethod
    def from_arrays(
        cls,
        viewmats: Any,
        Ks: Any,
        width: int,
        height: int,
        *,
        frames_per_second: float = 30.0,
        cycle: bool = False,
    ) -> "CameraPath":
        """A path of cameras of one size: world-to-camera [C, 4, 4], intrinsics [C, 3, 3]. In a cycle the first camera
        follows the last."""
        views, intrinsics = matrices(viewmats, Ks)
        columns, rows = size(width, height)
        return cls(_gs3.CameraPath.from_arrays(views, intrinsics, columns, rows, frames_per_second, cycle))

    def __len__(self) -> int:
        return len(self._native)

    def __repr__(self) -> str:
        return f"gs3.CameraPath({len(self)} cameras, {self.frames_per_second:g} frames per second)"

    def __getitem__(self, part: slice) -> "CameraPath":
        """Some of the cameras, one after the other: ``path[10:20]``."""
        first, end, step = part.indices(len(self))
        if step != 1:
            raise IndexError(f"step: expected 1, found {step}")
        return CameraPath(self._native.part(first, end))

    @property
    def viewmats(self) -> np.ndarray:
        """World to camera, f64 [C, 4, 4]; x right, y down, z forward."""
        return self._native.viewmats()

    @property
    def Ks(self) -> np.ndarray:
        """Intrinsics, f64 [C, 3, 3], in pixels; the centre of the first pixel is at (0.5, 0.5)."""
        return self._native.ks()

    @property
    def sizes(self) -> np.ndarray:
        """Width and height, i64 [C, 2], pixels."""
        return self._native.sizes()

    @property
    def frames_per_second(self) -> float:
        """How fast the path is meant to be shown."""
        return self._native.frames_per_second

    @property
    def is_cycle(self) -> bool:
        """Whether the first camera follows the last."""
        return self._native.is_cycle

    @property
    def names(self) -> List[str]:
        """The photos' names, empty where the file has none."""
        return self._native.names

    @property
    def notes(self) -> List[str]:
        """What the reader of the file found and did not use, or assumed."""
        return self._native.notes

    def resized(self, width: int, height: int) -> "CameraPath":
        """The same views in another size: vertical fields of view stay."""
        return CameraPath(self._native.resized(*size(width, height)))

    def smoothed(self, frames: int) -> "CameraPath":
        """``frames`` cameras along the smooth curve through these, at constant speed."""
        return CameraPath(self._native.smoothed(frames))


def load_cameras(
    path: Path,
    *,
    size: Optional[Tuple[int, int]] = None,
    fov_y: Optional[float] = None,
    dataparser: Optional[Path] = None,
    scene: Optional[Scene] = None,
) -> CameraPath:
    """Cameras of a file: a COLMAP model, ``transforms.json``, Inria's ``cameras.json``, nerfstudio's ``camera_path.json``,
    SuperSplat's settings, RealityScan's CSV, or a folder with one of them.

    ``size`` (width, height; pixels) and ``fov_y`` (radians) are what files count by that do not say them. ``dataparser`` is
    nerfstudio's ``dataparser_transforms.json``; the one beside a ``transforms.json`` is found. Cameras are brought to the
    ``origin`` of ``scene``, which matters for scenes far from 0 alone.
    """
    transforms = None if dataparser is None else os.fspath(dataparser)
    origin = (0.0, 0.0, 0.0) if scene is None else scene.origin
    return CameraPath(_gs3.CameraPath.load(os.fspath(path), size, fov_y, transforms, origin))


def demo_path() -> CameraPath:
    """The camera path of ``gs3.demo()``: 240 cameras around the knot, 4096×2160 pixels."""
    return CameraPath(_gs3.CameraPath.demo())
