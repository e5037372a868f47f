"""`gs3.rasterization` beside gsplat's own implementation in PyTorch: projection, spherical harmonics, and blending.

gsplat blends in PyTorch too, of pairs of pixels and Gaussians that CUDA finds. Here the pairs are all of them, kept by the rule
of that kernel: α from 1/255 on, until transmittance would fall to 1e-4.
"""

import numpy as np
import pytest

import gs3
import scenes

torch = pytest.importorskip("torch", exc_type=ImportError, reason="skipped: PyTorch is not there")
reference = pytest.importorskip("gsplat.cuda._torch_impl", exc_type=ImportError, reason="skipped: gsplat is not there")

WIDTH, HEIGHT = 72, 54


def gsplat(g, view, K, is_antialiased, background):
    """Colour, alpha, expected depth, and where rounding decides: by gsplat's functions, in f64."""
    tensors = [torch.from_numpy(a).double() for a in g.arrays()]
    means, quats, scales, opacities, colors = tensors
    viewmats, Ks = torch.from_numpy(view)[None], torch.from_numpy(K)[None]
    covars, _ = reference._quat_scale_to_covar_preci(quats, scales, True, False, triu=False)
    radii, means2d, depths, conics, compensations = reference._fully_fused_projection(
        means, covars, viewmats, Ks, WIDTH, HEIGHT, eps2d=0.3, calc_compensations=is_antialiased
    )
    if compensations is not None:
        opacities = opacities * compensations[0]
    if g.sh_degree is not None:
        directions = means - torch.linalg.inv(viewmats)[0, :3, 3]
        colors = reference._spherical_harmonics(g.sh_degree, directions, colors)
        colors = torch.clamp_min(colors + 0.5, 0.0)

    order = torch.argsort(depths[0], stable=True)
    order = order[(radii[0, order] > 0).all(-1)]
    ys, xs = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    deltas = torch.stack([xs, ys], -1)[:, :, None] - means2d[0, order]
    a, b, c = conics[0, order].unbind(-1)
    sigmas = 0.5 * (a * deltas[..., 0] ** 2 + c * deltas[..., 1] ** 2) + b * deltas[..., 0] * deltas[..., 1]
    raw = opacities[order] * torch.exp(-sigmas)
    alphas = torch.where(raw >= 1 / 255, raw.clamp_max(0.999), 0.0)
    after = torch.cumprod(1 - alphas, -1)
    is_open = after > 1e-4
    before = torch.cat([torch.ones_like(after[..., :1]), after[..., :-1]], -1)
    weights = torch.where(is_open, alphas * before, 0.0)
    left = 1 - weights.sum(-1)
    color = torch.einsum("hwn,nc->hwc", weights, colors[order]) + left[..., None] * torch.from_numpy(background)
    depth = (weights * depths[0, order]).sum(-1) / (1 - left).clamp_min(1e-10)
    unsure = ((raw * 255 - 1).abs() < 1e-3).any(-1) | ((after * 1e4 - 1).abs() < 1e-2).any(-1)
    return color.numpy(), (1 - left).numpy(), depth.numpy(), unsure.numpy()


@pytest.mark.parametrize("seed", range(100, 120))
def test_twenty_scenes_are_those_of_gsplat(seed):
    view, K = scenes.camera(WIDTH, HEIGHT, tilt=0.1 * (seed % 7), cx=seed % 3)
    sh_degree = None if seed % 4 == 3 else seed % 4 + 1
    g = scenes.random(seed, view, K, WIDTH, HEIGHT, sh_degree=sh_degree)
    is_antialiased, background = seed % 2 == 1, np.array([0.1, 0.6, 0.3])
    tensors = [torch.from_numpy(a) for a in (*g.arrays(), view[None], K[None])]
    render, alphas, _ = gs3.rasterization(
        *tensors, WIDTH, HEIGHT, sh_degree=sh_degree, backgrounds=torch.from_numpy(background)[None],
        render_mode="RGB+ED", rasterize_mode="antialiased" if is_antialiased else "classic",
    )
    color, alpha, depth, unsure = gsplat(g, view, K, is_antialiased, background)
    sure = ~unsure
    assert sure.mean() > 0.9 and (alpha > 0.5).mean() > 0.05
    assert np.abs(render[0, ..., :3] - color)[sure].max() <= 1e-4
    assert np.abs(alphas[0, ..., 0] - alpha)[sure].max() <= 1e-4
    opaque = sure & (alpha > 0.5)
    assert np.abs(render[0, ..., 3] / depth - 1)[opaque].max() <= 1e-3


def test_tensors_that_gradients_flow_through_are_taken():
    view, K = scenes.camera(WIDTH, HEIGHT)
    g = scenes.random(1, view, K, WIDTH, HEIGHT)
    tensors = [torch.from_numpy(a).requires_grad_() for a in g.arrays()]
    render, _, _ = gs3.rasterization(*tensors, torch.from_numpy(view)[None], torch.from_numpy(K)[None], WIDTH, HEIGHT)
    assert torch.from_dlpack(render).shape == (1, HEIGHT, WIDTH, 3)


def test_tensors_elsewhere_are_refused():
    with pytest.raises(gs3.InputError, match="means: expected an array in the processor's memory"):
        gs3.Scene.from_arrays(torch.zeros((2, 3), device="meta"), [[1, 0, 0, 0]] * 2, [[1] * 3] * 2, [1, 1], colors=[[1] * 3] * 2)
