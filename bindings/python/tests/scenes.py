"""Random Gaussians before cameras, and a camera."""

from dataclasses import dataclass
from typing import Optional

import numpy as np


@dataclass
class Gaussians:
    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    sh_degree: Optional[int] = None

    def arrays(self):
        return self.means, self.quats, self.scales, self.opacities, self.colors


def camera(width, height, tilt=0.0, cx=0.0, focal=0.9):
    """World to camera, turned by `tilt` about an oblique axis, and intrinsics with a centre that is off by `cx` pixels."""
    axis = np.array([0.48, 0.6, 0.64])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    view = np.eye(4)
    view[:3, :3] += np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross
    view[:3, 3] = 0.1, -0.05, 0.3
    K = np.array([[focal * width, 0, width / 2 + cx], [0, 1.1 * focal * width, height / 2], [0, 0, 1.0]])
    return view, K


def random(seed, view, K, width, height, count=150, sh_degree=None, size=(1.0, 12.0)):
    """`count` Gaussians of `size` pixels (standard deviations, least and most) in and around the picture, f32."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(1.0, 6.0, count)
    x = (rng.uniform(-0.2, 1.2, count) * width - K[0, 2]) / K[0, 0] * z
    y = (rng.uniform(-0.2, 1.2, count) * height - K[1, 2]) / K[1, 1] * z
    means = (np.stack([x, y, z], 1) - view[:3, 3]) @ view[:3, :3]
    pixels = np.exp(rng.uniform(np.log(size[0]), np.log(size[1]), (count, 3)))
    colors = rng.uniform(0, 1, (count, 3))
    if sh_degree is not None:
        colors = 0.4 * rng.standard_normal((count, (sh_degree + 1) ** 2, 3))
    arrays = means, rng.standard_normal((count, 4)), pixels * (z / K[0, 0])[:, None], rng.uniform(0.05, 1, count), colors
    return Gaussians(*(array.astype(np.float32) for array in arrays), sh_degree)
