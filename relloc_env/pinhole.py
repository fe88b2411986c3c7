"""Where points of the world are in the images of ideal cameras: for pictures and scores, whole arrays at once."""

import numpy as np
from numpy.typing import ArrayLike

from relloc_env.samples import Float


def project(poses: Float, mounts: ArrayLike, points: Float) -> Float:
    """Return normalised image x and y [-] and depths [m] (..., M, 3); x and y hold for depths > 0.

    Args:
        poses: [m, m, rad] (..., 3) of the robots, whose cameras look along the heading, level.
        mounts: [m] (...) heights of the cameras.
        points: [m] (..., M, 3) in the world; leading axes are broadcast.
    """
    d, heading = points[..., :2] - poses[..., None, :2], poses[..., None, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    depth, right = cos * d[..., 0] + sin * d[..., 1], sin * d[..., 0] - cos * d[..., 1]
    down = np.asarray(mounts)[..., None] - points[..., 2]
    divisor = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
    return np.stack([right / divisor, down / divisor, depth], axis=-1)
