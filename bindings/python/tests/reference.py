"""gsplat's rasterization, written down naively in f64: every Gaussian at every pixel, front to back.

Sources: Kerbl et al. 2023; Ye et al. 2024, "gsplat: An Open-Source Library for Gaussian Splatting", with an appendix that has the
projection and the blending. Thresholds are gsplat's: α from 1/255 on and at most 0.999, blending until transmittance would
fall to 1e-4.
"""

import numpy as np

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def rotations(quats):
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def sh_bases(directions, degree):
    x, y, z = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
    bases = [np.full_like(x, C0)]
    if degree > 0:
        bases += [-C1 * y, C1 * z, -C1 * x]
    if degree > 1:
        bases += [
            C2[0] * x * y,
            C2[1] * y * z,
            C2[2] * (2 * z * z - x * x - y * y),
            C2[3] * x * z,
            C2[4] * (x * x - y * y),
        ]
    if degree > 2:
        bases += [
            C3[0] * y * (3 * x * x - y * y),
            C3[1] * x * y * z,
            C3[2] * y * (4 * z * z - x * x - y * y),
            C3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y),
            C3[4] * x * (4 * z * z - x * x - y * y),
            C3[5] * z * (x * x - y * y),
            C3[6] * x * (x * x - 3 * y * y),
        ]
    return np.stack(bases, 1)


def rasterize(gaussians, view, K, width, height, *, eps2d=0.3, near=0.01, far=1e10, antialiased=False, background=None):
    """Colour [H, W, 3], alpha [H, W], accumulated depth [H, W], and where rounding decides [H, W]."""
    means, quats, scales, opacities, colors = (np.asarray(a, np.float64) for a in gaussians.arrays())
    rotation, translation = view[:3, :3], view[:3, 3]
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]

    centers = means @ rotation.T + translation
    depths = centers[:, 2]
    shown = (depths > near) & (depths < far)
    x, y = centers[:, 0] / depths, centers[:, 1] / depths
    # The Jacobian's slopes end 15 % of the picture beyond its edges; positions do not.
    limit = lambda slope, side, center, f: np.clip(slope, -(center + 0.15 * side) / f, (1.15 * side - center) / f)
    zeros = np.zeros_like(x)
    jacobian = np.stack(
        [
            np.stack([fx / depths, zeros, -fx * limit(x, width, cx, fx) / depths], 1),
            np.stack([zeros, fy / depths, -fy * limit(y, height, cy, fy) / depths], 1),
        ],
        1,
    )
    axes = jacobian @ rotation @ rotations(quats) * scales[:, None, :]
    covariance = axes @ np.moveaxis(axes, 1, 2)
    before = np.linalg.det(covariance)
    covariance = covariance + eps2d * np.eye(2)
    after = np.linalg.det(covariance)
    conics = np.linalg.inv(covariance)
    if antialiased:
        opacities = opacities * np.sqrt(np.clip(before / after, 0, None))
    if gaussians.sh_degree is not None:
        center = -rotation.T @ translation
        bases = sh_bases(means - center, gaussians.sh_degree)
        used = colors[:, : bases.shape[1]]
        colors = np.clip(np.einsum("nk,nkc->nc", bases, used) + 0.5, 0, None)

    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    color, depth = np.zeros((height, width, 3)), np.zeros((height, width))
    transmittance, is_open = np.ones((height, width)), np.ones((height, width), bool)
    unsure = np.zeros((height, width), bool)
    for i in np.argsort(depths, kind="stable"):
        if not shown[i]:
            continue
        dx, dy = columns - (fx * x[i] + cx), rows - (fy * y[i] + cy)
        (a, b), (_, c) = conics[i]
        raw = opacities[i] * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy)
        alpha = np.minimum(raw, 0.999)
        hit = is_open & (alpha >= 1 / 255)
        left = transmittance * (1 - alpha)
        ends = hit & (left <= 1e-4)
        unsure |= is_open & (np.abs(raw * 255 - 1) < 1e-3) | hit & (np.abs(left * 1e4 - 1) < 1e-2)
        is_open &= ~ends
        weight = np.where(hit & ~ends, alpha * transmittance, 0)
        color += weight[..., None] * colors[i]
        depth += weight * depths[i]
        transmittance = np.where(hit & ~ends, left, transmittance)
    if background is not None:
        color += transmittance[..., None] * background
    return color, 1 - transmittance, depth, unsure
