"""Between pixels and the normalised image coordinates of an ideal camera, through a lens that distorts."""

import numpy as np

from relloc_env.config import ConfigError
from relloc_env.kernels._compile import plain
from relloc_env.kernels.image_targets import distort
from relloc_env.samples import Bool, Float

STEPS, SETTLED = 50, 1e-12
"""Most steps of Newton's method, and [-] the error after which there are no more."""
SOLVED = 1e-6
"""[px] greatest error of a solution."""
RADII = 64
"""Places between the centre and each point of the picture's edge where a lens is looked at."""


def to_pixels(rays: Float, intrinsics: Float, lens: Float) -> Float:
    """Return the pixels (..., 2) of normalised image coordinates (..., 2); arguments as of `View`."""
    u, v = _distort(rays[..., 0], rays[..., 1], lens)
    return np.stack([intrinsics[0] * u + intrinsics[2], intrinsics[1] * v + intrinsics[3]], axis=-1)


def from_pixels(pixels: Float, intrinsics: Float, lens: Float) -> Float:
    """Return the normalised image coordinates (..., 2) at pixels (..., 2), by Newton's method.

    They are NaN where there are none: outside the picture, where a strong lens folds its image.
    """
    seen = np.stack(
        [(pixels[..., 0] - intrinsics[2]) / intrinsics[0], (pixels[..., 1] - intrinsics[3]) / intrinsics[1]], axis=-1
    )
    if not lens.any():
        return seen
    x, y = seen[..., 0], seen[..., 1]
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            u, v = _distort(x, y, lens)
            e_x, e_y = seen[..., 0] - u, seen[..., 1] - v
            error = np.maximum(np.abs(e_x), np.abs(e_y))
            if error.max(initial=0.0) < SETTLED:
                break
            a, b, c = _slopes(x, y, lens)
            scale = 1.0 / (a * c - b * b)
            x, y = x + scale * (c * e_x - b * e_y), y + scale * (a * e_y - b * e_x)
        solved = (error * max(intrinsics[0], intrinsics[1]) < SOLVED) & _upright(x, y, lens)
    return np.where(solved[..., None], np.stack([x, y], axis=-1), np.nan)


def picture_rays(width: int, height: int, intrinsics: Float, lens: Float) -> Float:
    """Return the normalised image coordinates (height, width, 2) of the middles of a picture's pixels.

    Raises:
        ConfigError: a lens that shows one place at two pixels, or at none.
    """
    rows, columns = np.mgrid[:height, :width] + 0.5
    rays = from_pixels(np.stack([columns, rows], axis=-1), intrinsics, lens)
    if lens.any():
        x, y = np.arange(width + 1.0), np.arange(height + 1.0)
        sides = [(x, 0.0 * x), (x, 0.0 * x + height), (0.0 * y, y), (0.0 * y + width, y)]
        edge = from_pixels(np.concatenate([np.column_stack(side) for side in sides]), intrinsics, lens)
        spokes = np.linspace(0.0, 1.0, RADII + 1)[:, None, None] * edge
        if not (np.isfinite(rays).all() and _upright(spokes[..., 0], spokes[..., 1], lens).all()):
            raise ConfigError(
                "Argument `camera.image.distortion` must be a lens that shows each place once from the centre of the "
                f"picture to its corners, but {tuple(lens.tolist())} folds the picture: make the coefficients smaller, "
                "add a greater k2 against a negative k1, or make `camera.field_of_view` narrower"
            )
    return rays


def _slopes(x: Float, y: Float, lens: Float) -> tuple[Float, Float, Float]:
    """The Jacobian of `distort`, which is symmetric: du/dx, du/dy = dv/dx, dv/dy."""
    square = x * x + y * y
    radial = 1.0 + square * (lens[0] + square * (lens[1] + square * lens[4]))
    slope = 2.0 * (lens[0] + square * (2.0 * lens[1] + square * 3.0 * lens[4]))
    return (
        radial + slope * x * x + 2.0 * lens[2] * y + 6.0 * lens[3] * x,
        slope * x * y + 2.0 * lens[2] * x + 2.0 * lens[3] * y,
        radial + slope * y * y + 6.0 * lens[2] * y + 2.0 * lens[3] * x,
    )


def _upright(x: Float, y: Float, lens: Float) -> Bool:
    """Where the Jacobian is positive definite: what is so all over a convex region is one to one there."""
    a, b, c = _slopes(x, y, lens)
    return (a * c - b * b > 0.0) & (a + c > 0.0)


_distort = plain(distort)
