"""Rasterization in gsplat's names, shapes and conventions."""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

import numpy as np

from ._arrays import from_any, matrices
from ._errors import InputError, Unsupported
from ._scene import Scene


def rasterization(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    colors: Any,
    viewmats: Any,
    Ks: Any,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: Optional[int] = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Any = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: str = "pinhole",
    segmented: bool = False,
    covars: Any = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: Any = None,
    tangential_coeffs: Any = None,
    thin_prism_coeffs: Any = None,
    ftheta_coeffs: Any = None,
    rolling_shutter: Any = None,
    viewmats_rs: Any = None,
    *,
    gbuffer: bool = True,
) -> Tuple[np.ndarray, np.ndarray, Dict[str, Any]]:
    """Rasterizes N Gaussians to C images on the CPU, as ``gsplat.rasterization`` does on CUDA, forward only.

    Arrays are NumPy's or anything with DLPack in the processor's memory. Who renders the same Gaussians again makes a
    ``Scene`` once and calls ``Scene.rasterization``, which copies and checks nothing.

    Args:
        means: Centres, [N, 3], world units.
        quats: Rotations as w, x, y, z, [N, 4], of any length but 0.
        scales: Standard deviations, [N, 3], world units (after ``exp``).
        opacities: [N], 0 to 1 (after ``sigmoid``).
        colors: RGB, [N, 3], at least 0; with ``sh_degree`` spherical-harmonics coefficients, [N, K, 3].
        viewmats: World to camera, [C, 4, 4], rigid; x right, y down, z forward.
        Ks: Intrinsics, [C, 3, 3], pixels; the centre of the first pixel is at (0.5, 0.5).
        width, height: Size of the images, pixels.
        near_plane, far_plane: View-space z between which centres are shown, world units.
        eps2d: What is added to the diagonal of projected covariances, px².
        sh_degree: How many bands of ``colors`` are used, 0 to 4; none for RGB.
        backgrounds: RGB, [C, 3]; black unless stated.
        render_mode: ``RGB``, ``D`` (accumulated depth), ``ED`` (expected depth), ``RGB+D``, ``RGB+ED``. Depths are
            view-space z of the Gaussians' centres, world units, and the last channel.
        rasterize_mode: ``classic``, or ``antialiased``: opacities make up for ``eps2d``.
        gbuffer: Whether ``meta`` has the G-buffer. Without, colours alone are made in about two thirds of the time.
        packed, tile_size, sparse_grad, absgrad, channel_chunk, segmented: Taken, and not read: they change neither the
            picture nor the shapes.

    Returns:
        The images, f32 [C, H, W, X], X as ``render_mode`` says; alpha, f32 [C, H, W, 1], 0 to 1; and a dictionary
        with ``width``, ``height``, ``n_cameras`` and, f32 [C, H, W, ·]:

        - ``color_dx``, ``color_dy`` [3]: exact derivatives of the colour by the position, per pixel;
        - ``normals`` [3]: view-space, summed with the weights of the colour, so as long as splats agree;
        - ``median_depth`` [1]: z of the surface at which transmittance falls to one half, 0 where there is none.

    Raises:
        InputError: A value or a shape is not accepted.
        Unsupported: gsplat has it, gs3 does not.
    """
    _refuse_unsupported(
        radius_clip=(radius_clip, 0.0),
        distributed=(distributed, False),
        camera_model=(camera_model, "pinhole"),
        covars=(covars, None),
        with_ut=(with_ut, False),
        with_eval3d=(with_eval3d, False),
        radial_coeffs=(radial_coeffs, None),
        tangential_coeffs=(tangential_coeffs, None),
        thin_prism_coeffs=(thin_prism_coeffs, None),
        ftheta_coeffs=(ftheta_coeffs, None),
        viewmats_rs=(viewmats_rs, None),
    )
    if rolling_shutter is not None and getattr(rolling_shutter, "name", rolling_shutter) != "GLOBAL":
        raise Unsupported(f"rolling_shutter: expected GLOBAL, which gs3 has alone, found {rolling_shutter}")
    if rasterize_mode not in ("classic", "antialiased"):
        raise InputError(f"rasterize_mode: expected classic or antialiased, found {rasterize_mode!r}")
    # Before any copy: cameras are what is most often wrong.
    views, intrinsics = matrices(viewmats, Ks)
    found = from_any(colors, "colors")
    _refuse_shape(found.shape, sh_degree)
    scene = Scene.from_arrays(
        means,
        quats,
        scales,
        opacities,
        sh=None if sh_degree is None else found,
        colors=found if sh_degree is None else None,
        sh_degree=sh_degree,
        antialiased=rasterize_mode == "antialiased",
    )
    return scene.rasterization(
        views,
        intrinsics,
        width,
        height,
        near_plane=near_plane,
        far_plane=far_plane,
        eps2d=eps2d,
        backgrounds=backgrounds,
        render_mode=render_mode,
        gbuffer=gbuffer,
    )


def _refuse_unsupported(**arguments: Tuple[Any, Any]) -> None:
    """Refuses what differs from the one value that is supported."""
    for name, (found, supported) in arguments.items():
        is_same = found is None if supported is None else found == supported
        if not is_same:
            shown = type(found).__name__ if hasattr(found, "shape") else repr(found)
            raise Unsupported(f"{name}: expected {supported!r}, which gs3 has alone, found {shown}")


def _refuse_shape(shape: Tuple[int, ...], sh_degree: Optional[int]) -> None:
    """Refuses colours of gsplat's other shapes."""
    if sh_degree is None and len(shape) == 2 and shape[1] != 3:
        raise Unsupported(f"colors: expected shape [N, 3], as gs3 has three channels, found {list(shape)}")
    most = 2 if sh_degree is None else 3
    if len(shape) > most:
        wanted = "[N, 3]" if sh_degree is None else "[N, K, 3]"
        hint = "; for spherical harmonics state sh_degree" if sh_degree is None else ""
        raise Unsupported(
            f"colors: expected shape {wanted}, alike for all cameras and without batches, found {list(shape)}{hint}"
        )
