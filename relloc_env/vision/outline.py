"""The image of a sphere: an ellipse whose centre is not where the sphere's centre is projected.

A sphere of radius R around (X, Y, Z) is seen along rays u with (u c)² >= (|c|² - R²) |u|². With p = (X, Y)/Z, the image
of the centre, and q = (R/Z)², the ellipse has its centre at p/(1 - q), and an area of
pi q sqrt(1 + |p|² - q)/(1 - q)^(3/2), in normalised image coordinates: from both follow p and q.
"""

import math

import numpy as np

from relloc_env.samples import Bool, Float

TRIPLES = 60
"""Circles through three points of a rim that are tried."""
CLOSE = 0.6
"""[px] how far from an outline a point of its rim may be."""
LEAST_ARC = 1.0 / 3.0
"""Share of an outline that must show."""
SECTORS = 36


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


def area_of(p: Float, q: float) -> float:
    """Area of the ellipse."""
    return math.pi * q * math.sqrt(1.0 + float(p @ p) - q) / (1.0 - q) ** 1.5


def moments(p: Float, q: float) -> Float:
    """Return (2, 2) second central moments of the ellipse over its area: a quarter of its squared semi-axes."""
    square = float(p @ p)
    across = q / (1.0 - q)  # squared semi-axis across the direction to p
    along = across * (1.0 + square - q) / (1.0 - q)
    unit = p / math.sqrt(square) if square > 0.0 else np.array([1.0, 0.0])
    return 0.25 * (across * np.eye(2) + (along - across) * np.outer(unit, unit))


def from_rim(rays: Float, depth: Float, pixel: float) -> tuple[Float, float, Bool] | None:
    """The sphere's image of which only a part of the rim shows; other edges may be among the points.

    A circle that agrees with as many points as possible is found first, then the sphere's outline is fitted to them.

    Args:
        rays: [-] (E, 2) points within a pixel of an edge.
        depth: [px] (E,) how far inside the edge each of them is.
        pixel: [-] size of a pixel.

    Returns:
        p (2,) and q = (R/Z)², and which of the points are on the outline (E,); None where too little of it shows.
    """
    start = _circle(rays, depth * pixel, CLOSE * pixel)
    if start is None:
        return None
    centre, radius = start
    p, q = from_ellipse(centre, math.pi * radius * radius)
    on = np.ones(len(rays), np.bool_)
    for k in range(8):
        value, slope = _inside(rays, p, q)
        miss = value / pixel - depth
        on = np.abs(miss) < CLOSE * (2.0 if k < 3 else 1.0)
        if on.sum() < 6:
            return None
        step = np.linalg.lstsq(slope[on] / pixel, -miss[on], rcond=None)[0]
        p, q = p + step[:2], float(np.clip(q + step[2], 1e-8, 0.9))
    d = rays[on] - p
    sectors = np.unique(((np.arctan2(d[:, 1], d[:, 0]) / (2.0 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS)
    return (p, q, on) if sectors.size >= LEAST_ARC * SECTORS else None


def agreement(rays: Float, depth: Float, pixel: float, p: Float, q: float) -> float:
    """Share of the points of an edge that are on an outline; arguments as of `from_rim`."""
    return float(np.mean(np.abs(_inside(rays, p, q)[0] / pixel - depth) < CLOSE)) if len(rays) else 0.0


def _inside(rays: Float, p: Float, q: float) -> tuple[Float, Float]:
    """How far inside the outline points (E, 2) are [-] (E,), and the derivative by p and q (E, 3)."""
    dot = rays @ p + 1.0
    square, k = np.sum(rays * rays, axis=1) + 1.0, float(p @ p) + 1.0 - q
    value = dot * dot - square * k
    gradient = 2.0 * (dot[:, None] * p - k * rays)
    size = np.linalg.norm(gradient, axis=1)
    slope = np.column_stack([2.0 * (dot[:, None] * rays - square[:, None] * p), square])
    return value / size, slope / size[:, None]


def _circle(points: Float, depth: Float, close: float) -> tuple[Float, float] | None:
    """Centre and radius of the circle that most of the points (E, 2) are as deep inside of as they should be."""
    if len(points) < 6:
        return None
    triples = np.random.default_rng(0).integers(0, len(points), (TRIPLES, 3))
    a, b, c = (points[triples[:, i]] for i in range(3))
    b, c = b - a, c - a
    twice = 2.0 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    bb, cc = np.sum(b * b, axis=1), np.sum(c * c, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        centre = np.column_stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb]) / twice[:, None]
    regular = np.abs(twice) > 0.0
    centre, a = centre[regular], a[regular]
    radius = np.hypot(centre[:, 0], centre[:, 1])
    away = np.linalg.norm(points - (centre + a)[:, None], axis=-1)
    votes = np.sum(np.abs(radius[:, None] - away - depth) < close, axis=1)
    best = int(np.argmax(votes)) if votes.size else 0
    return (centre[best] + a[best], float(radius[best])) if votes.size and votes[best] >= 6 else None
