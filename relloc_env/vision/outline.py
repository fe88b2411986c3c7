"""The image of a sphere: an ellipse whose centre is not where the sphere's centre is projected.

A sphere of radius R around (X, Y, Z) is seen along rays u with (u c)² >= (|c|² - R²) |u|². With p = (X, Y)/Z, the image
of the centre, and q = (R/Z)², the ellipse has its centre at p/(1 - q), and an area of
pi q sqrt(1 + |p|² - q)/(1 - q)^(3/2), in normalised image coordinates: from both follow p and q.
"""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.samples import Bool, Float

TRIPLES = 60
"""Outlines through three points of a rim that are tried."""
LEAST_POINTS = 6
"""Points that must be on an outline."""
CLOSE, CLOSEST = 0.6, 0.1
"""[px] how far from an outline a point of its rim may be, and how far at least where most are much nearer."""
SPREADS = 4.0
"""Points that are farther off than so many standard deviations of the others are not of the rim."""
STEPS = 6
"""Of a fit."""
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
    return centre * (1.0 - q), float(q)


def area_of(p: Float, q: float) -> float:
    """Area of the ellipse."""
    return float(math.pi * q * math.sqrt(1.0 + float(p @ p) - q) / (1.0 - q) ** 1.5)


def moments(p: Float, q: float) -> Float:
    """Return (2, 2) second central moments of the ellipse over its area: a quarter of its squared semi-axes."""
    square = float(p @ p)
    across = q / (1.0 - q)  # squared semi-axis across the direction to p
    along = across * (1.0 + square - q) / (1.0 - q)
    unit = p / math.sqrt(square) if square > 0.0 else np.array([1.0, 0.0])
    return 0.25 * (across * np.eye(2) + (along - across) * np.outer(unit, unit))


class Fit(NamedTuple):
    """An outline fitted to points of a rim."""

    p: Float
    """[-] (2,) where the sphere's centre is projected."""
    q: float
    """(R/Z)²"""
    on: Bool
    """(E,) which of the points are on the outline."""
    sd: float
    """[px] standard deviation of `p`, as the scatter of those points about the outline tells."""


def from_rim(rays: Float, depth: Float, pixel: float) -> Fit | None:
    """The sphere's image of which only a part of the rim shows; other edges may be among the points.

    The outline that agrees with as many points as possible is found first, then fitted to those.

    Args:
        rays: [-] (E, 2) points within a pixel of an edge.
        depth: [px] (E,) how far inside the edge each of them is.
        pixel: [-] size of a pixel.

    Returns:
        None where too little of it shows.
    """
    start = _cone(rays, depth * pixel, CLOSE * pixel)
    fit = None if start is None else refined(rays, depth, pixel, *start)
    if fit is None:
        return None
    d = rays[fit.on] - fit.p
    sectors = np.unique(((np.arctan2(d[:, 1], d[:, 0]) / (2.0 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS)
    return fit if sectors.size >= LEAST_ARC * SECTORS else None


def refined(rays: Float, depth: Float, pixel: float, p: Float, q: float) -> Fit | None:
    """Fit an outline, near to the one with `p` and `q`, to the points that agree with it; arguments as of `from_rim`.

    The points are at last those that are as near as most of them are, however near that is: an edge a few tenths of a
    pixel away, or a background that changes at the rim, moves it no more.
    """
    for k in range(STEPS):
        value, slope = _inside(rays, p, q)
        miss = value / pixel - depth
        far = np.abs(miss)
        close = 2.0 * CLOSE if k < 2 else CLOSE
        if k >= STEPS // 2:
            near = far[far < close]
            close = min(max(SPREADS * 1.4826 * float(np.median(near)), CLOSEST), CLOSE) if near.size else CLOSE
        on = far < close
        if on.sum() < LEAST_POINTS:
            return None
        slope, miss = slope[on] / pixel, miss[on]
        try:
            variance = np.linalg.inv(slope.T @ slope)
        except np.linalg.LinAlgError:
            return None
        step = variance @ (slope.T @ miss)
        p, q = p - step[:2], float(np.clip(q - step[2], 1e-8, 0.9))
    spread = float(np.sqrt(np.mean(miss**2)))
    return Fit(p, q, on, spread * math.sqrt(max(float(variance[0, 0] + variance[1, 1]), 0.0)) / pixel)


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


def _cone(rays: Float, depth: Float, close: float) -> tuple[Float, float] | None:
    """Return p and q of the sphere that most of the points (E, 2) are as deep inside of as they should be.

    Directions to the outline are as far from the direction to the centre: three of them tell a plane, normal to it.
    """
    if len(rays) < LEAST_POINTS:
        return None
    triples = np.random.default_rng(0).integers(0, len(rays), (TRIPLES, 3))
    towards = np.column_stack([rays, np.ones(len(rays))])
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    a, b, c = (towards[triples[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1) * np.sign(normal[:, 2])
    regular = size != 0.0
    normal, a = normal[regular] / size[regular, None], a[regular]
    cos = np.sum(normal * a, axis=1)
    sin = np.sqrt(np.maximum(1.0 - cos * cos, 1e-12))
    inside = (towards @ normal.T - cos) / sin
    votes = np.sum(np.abs(inside - depth[:, None]) < close, axis=0)
    best = int(np.argmax(votes)) if votes.size else 0
    if not votes.size or votes[best] < LEAST_POINTS:
        return None
    p = normal[best, :2] / normal[best, 2]
    return p, float(min(sin[best] ** 2 * (1.0 + p @ p), 0.9))
