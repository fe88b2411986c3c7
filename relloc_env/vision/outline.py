"""The image of a sphere: an ellipse whose centre is not where the sphere's centre is projected.

A sphere of radius R around (X, Y, Z) is seen along rays u with (u c)² >= (|c|² - R²) |u|². With p = (X, Y)/Z, the image
of the centre, and q = (R/Z)², the ellipse has its centre at p/(1 - q), and an area of
pi q sqrt(1 + |p|² - q)/(1 - q)^(3/2), in normalised image coordinates: from both follow p and q.
"""

import math

import numpy as np

from relloc_env.samples import Float


def from_ellipse(centre: Float, area: float) -> tuple[Float, float]:
    """Return p (2,), where the sphere's centre is projected, and q = (R/Z)².

    Args:
        centre: [-] (2,) centre of the ellipse.
        area: [-] its area.
    """
    q, square = 0.0, float(centre @ centre)
    for _ in range(20):
        q = area * (1.0 - q) ** 1.5 / (math.pi * math.sqrt(1.0 + square * (1.0 - q) ** 2 - q))
        q = min(q, 0.9)
    return centre * (1.0 - q), q


def moments(p: Float, q: float) -> Float:
    """Return (2, 2) second central moments of the ellipse over its area: a quarter of its squared semi-axes."""
    square = float(p @ p)
    across = q / (1.0 - q)  # squared semi-axis across the direction to p
    along = across * (1.0 + square - q) / (1.0 - q)
    unit = p / math.sqrt(square) if square > 0.0 else np.array([1.0, 0.0])
    return 0.25 * (across * np.eye(2) + (along - across) * np.outer(unit, unit))
