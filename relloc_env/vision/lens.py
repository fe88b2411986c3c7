"""Between pixels and the normalised image coordinates of an ideal camera, through a lens that distorts."""

import numpy as np

from relloc_env.kernels.image_targets import distort
from relloc_env.samples import Float


def to_pixels(rays: Float, intrinsics: Float, lens: Float) -> Float:
    """Return the pixels (..., 2) of normalised image coordinates (..., 2); arguments as of `View`."""
    u, v = _distort(rays[..., 0], rays[..., 1], lens)
    return np.stack([intrinsics[0] * u + intrinsics[2], intrinsics[1] * v + intrinsics[3]], axis=-1)


def from_pixels(pixels: Float, intrinsics: Float, lens: Float) -> Float:
    """Return the normalised image coordinates (..., 2) at pixels (..., 2), by fixed-point iteration."""
    seen = np.stack(
        [(pixels[..., 0] - intrinsics[2]) / intrinsics[0], (pixels[..., 1] - intrinsics[3]) / intrinsics[1]], axis=-1
    )
    if not lens.any():
        return seen
    rays = seen
    for _ in range(20):
        u, v = _distort(rays[..., 0], rays[..., 1], lens)
        rays = rays + seen - np.stack([u, v], axis=-1)
    return rays


_distort = distort.py_func  # type: ignore[attr-defined]  # the same equation, for arrays
