"""Scenes."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Tuple, Union

import numpy as np

from . import _gs3
from ._arrays import array, from_any, matrices, size
from ._errors import InputError

if TYPE_CHECKING:
    from ._cameras import CameraPath

Progress = Callable[[float], Optional[bool]]
Path = Union[str, "os.PathLike[str]"]


class Scene:
    """Gaussians that were checked, ready to be rendered. A scene does not change.

    Values are activated: scales are lengths, opacities are 0 to 1. Axes are right-down-front, as in COLMAP and OpenCV.
    """

    def __init__(self, native: "_gs3.Scene") -> None:
        self._native = native

    @classmethod
    def open(
        cls,
        path: Path,
        *,
        level: Optional[int] = None,
        environment: bool = True,
        budget: Optional[int] = None,
        cameras: Optional[CameraPath] = None,
        axes: Optional[str] = None,
        progress: Optional[Progress] = None,
    ) -> "Scene":
        """Opens a scene file of any format: PLY, compressed PLY, .splat, .ksplat, SPZ, SOG, glTF, .rad, LCC2.

        ``level`` is the level of detail of a streamed scene, 0 the finest; ``environment`` says whether its sky is loaded.
        Instead of ``level``, ``budget`` is the most Gaussians of a streamed SOG scene: each part has the level that leaves the
        least error in the images of ``cameras``, or by its size without them. The environment comes on top.
        ``axes`` states which way the axes of the file point, as three letters such as ``"rub"`` (right, up, back), where that
        is not what the file states or its format says.
        ``progress`` is called some twenty times a second with the share that is done, 0 to 1; where it returns ``False``
        loading stops.

        Raises ``FileError`` if the file cannot be read, ``InputError`` if it is no scene, ``Cancelled`` if ``progress`` said
        no.
        """
        if cameras is not None and budget is None:
            raise InputError("cameras: expected a budget with them, found none")
        seen = None if cameras is None else cameras._native
        return cls(_gs3.Scene.open(os.fspath(path), level, environment, budget, seen, axes, progress))

    @classmethod
    def from_arrays(
        cls,
        means: Any,
        quats: Any,
        scales: Any,
        opacities: Any,
        *,
        sh: Any = None,
        colors: Any = None,
        sh_degree: Optional[int] = None,
        antialiased: bool = False,
    ) -> "Scene":
        """A scene of N Gaussians from arrays, of NumPy or anything with DLPack. Each is copied once.

        Args:
            means: Centres, [N, 3], world units.
            quats: Rotations from the principal axes to the world as w, x, y, z, [N, 4], of any length but 0.
            scales: Standard deviations along the principal axes, [N, 3], world units (after ``exp``).
            opacities: [N], 0 to 1 (after ``sigmoid``).
            sh: Spherical-harmonics coefficients, [N, K, 3], K at least (``sh_degree`` + 1)², in the order and the signs of
                Kerbl et al. 2023 and gsplat.
            colors: Instead of ``sh``, RGB that look alike from everywhere, [N, 3], at least 0.
            sh_degree: How many bands of ``sh`` are used, 0 to 4; all unless stated.
            antialiased: Whether the scene was trained with opacities that make up for the dilation of splats
                (Mip-Splatting, gsplat's ``rasterize_mode="antialiased"``).

        Invalid Gaussians are dropped: ``dropped`` counts them.
        """
        positions = array(means, "means", ("N", 3))
        count = positions.shape[0]
        coefficients, rgb, degree = _colors(count, sh, colors, sh_degree)
        return cls(
            _gs3.Scene.from_arrays(
                positions,
                array(quats, "quats", (count, 4)),
                array(scales, "scales", (count, 3)),
                array(opacities, "opacities", (count,)),
                coefficients,
                degree,
                rgb,
                antialiased,
            )
        )

    def save(self, path: Path) -> List[str]:
        """Saves the scene; the end of the name says the format: .ply, .compressed.ply, .spz, .sog, .glb, .splat or lod-meta.json.

        The file appears whole or not at all. Gives what the format does not keep: sentences, none if it keeps all.
        """
        self._native.save(os.fspath(path))
        return self._native.losses(os.fspath(path))

    def __len__(self) -> int:
        return len(self._native)

    def __repr__(self) -> str:
        return f"gs3.Scene({len(self):,} Gaussians, SH degree {self.sh_degree})"

    @property
    def means(self) -> np.ndarray:
        """Centres, f32 [N, 3], world units. A new array each time, as the others."""
        return self._native.means()

    @property
    def quats(self) -> np.ndarray:
        """Rotations as unit quaternions w, x, y, z, f32 [N, 4]."""
        return self._native.quats()

    @property
    def scales(self) -> np.ndarray:
        """Standard deviations along the principal axes, f32 [N, 3], world units."""
        return self._native.scales()

    @property
    def opacities(self) -> np.ndarray:
        """f32 [N], 0 to 1."""
        return self._native.opacities()

    @property
    def sh(self) -> np.ndarray:
        """Spherical-harmonics coefficients, f32 [N, (sh_degree + 1)², 3]."""
        return self._native.sh()

    @property
    def sh_degree(self) -> int:
        """0 to 4."""
        return self._native.sh_degree

    @property
    def origin(self) -> Tuple[float, float, float]:
        """What the file's positions have more than ``means``: not 0 where they are larger than an f32 keeps exactly, as in
        geodetic coordinates. ``load_cameras`` takes it off cameras with ``scene=``."""
        return tuple(self._native.origin)  # type: ignore[return-value]

    @property
    def antialiased(self) -> bool:
        """Whether opacities make up for the dilation of splats."""
        return self._native.antialiased

    @property
    def near(self) -> float:
        """``Renderer`` shows no Gaussian nearer than this, view-space z in world units."""
        return self._native.near

    @property
    def dropped(self) -> int:
        """How many Gaussians of the source were invalid and are not part of the scene."""
        return self._native.dropped

    @property
    def notes(self) -> List[str]:
        """What the reader of the file found and did not use, or assumed."""
        return self._native.notes

    def rasterization(
        self,
        viewmats: Any,
        Ks: Any,
        width: int,
        height: int,
        *,
        near_plane: float = 0.01,
        far_plane: float = 1e10,
        eps2d: float = 0.3,
        backgrounds: Any = None,
        render_mode: str = "RGB",
        gbuffer: bool = True,
    ) -> Tuple[np.ndarray, np.ndarray, Dict[str, Any]]:
        """As ``gs3.rasterization``, of this scene: nothing is copied or checked again from call to call."""
        views, intrinsics = matrices(viewmats, Ks)
        columns, rows = size(width, height)
        background = None
        if backgrounds is not None:
            background = array(backgrounds, "backgrounds", (views.shape[0], 3))
        made = self._native.rasterize(
            views,
            intrinsics,
            columns,
            rows,
            near_plane,
            far_plane,
            eps2d,
            background,
            render_mode,
            gbuffer,
        )
        render, alphas = made.pop("render"), made.pop("alphas")
        meta = {"width": columns, "height": rows, "n_cameras": views.shape[0], **made}
        return render, alphas, meta


def _colors(
    count: int, sh: Any, colors: Any, sh_degree: Optional[int]
) -> Tuple[Optional[np.ndarray], Optional[np.ndarray], int]:
    """Coefficients or colours, and the degree."""
    if (sh is None) == (colors is None):
        found = "neither" if sh is None else "both"
        raise InputError(f"sh and colors: expected one of them, found {found}")
    if sh is None:
        if sh_degree not in (None, 0):
            raise InputError(f"sh_degree: expected none or 0 with colors, found {sh_degree}")
        return None, array(colors, "colors", (count, 3)), 0
    found_sh = from_any(sh, "sh")
    coefficients = array(found_sh, "sh", (count, "K", 3))
    stored = coefficients.shape[1]
    highest = int(np.sqrt(stored)) - 1
    if sh_degree is None:
        if (highest + 1) ** 2 != stored:
            raise InputError(f"sh: expected 1, 4, 9, 16 or 25 coefficients, found {stored}")
        sh_degree = highest
    if not 0 <= sh_degree <= 4:
        raise InputError(f"sh_degree: expected 0 to 4, found {sh_degree}")
    if sh_degree > highest:
        raise InputError(
            f"sh: expected at least {(sh_degree + 1) ** 2} coefficients for sh_degree {sh_degree}, found {stored}"
        )
    return coefficients, None, int(sh_degree)


def demo() -> Scene:
    """The scene that comes with gs3: a stone court with a gilded knot, 530,000 Gaussians, z up, in metres."""
    return Scene(_gs3.Scene.demo())
