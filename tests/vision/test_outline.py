"""The image of a sphere against brute force: cones of rays that meet it, counted one by one."""

import math

import numpy as np
import pytest

from relloc_env.vision.outline import agreement, area_of, from_ellipse, from_rim, moments

SPHERES = [((0.0, 0.0, 1.0), 0.1), ((0.6, -0.4, 1.0), 0.1), ((0.9, -0.4, 1.3), 0.3), ((-2.0, 1.0, 5.0), 0.5)]


def grid(centre, radius):
    """Area, centroid and second moments of the rays that meet a sphere."""
    x, y, z = centre
    reach = 2.0 * radius / (z - radius)
    xs, ys = (np.linspace(c / z - reach, c / z + reach, 2001) for c in (x, y))
    u, v = np.meshgrid(xs, ys)
    dot, k = u * x + v * y + z, x * x + y * y + z * z - radius**2
    inside = dot * dot >= (u * u + v * v + 1.0) * k
    cell = (xs[1] - xs[0]) * (ys[1] - ys[0])
    points = np.column_stack([u[inside], v[inside]])
    return inside.sum() * cell, points.mean(axis=0), np.cov(points.T)


@pytest.mark.parametrize(("centre", "radius"), SPHERES)
def test_centre_and_size_follow_from_the_ellipse(centre, radius) -> None:
    area, mean, spread = grid(centre, radius)
    p, q = np.array(centre[:2]) / centre[2], (radius / centre[2]) ** 2
    assert area_of(p, q) == pytest.approx(area, rel=2e-3)
    assert np.allclose(moments(p, q), spread, rtol=5e-3, atol=2e-3 * spread.max())
    found, size = from_ellipse(mean, area)
    assert np.allclose(found, p, atol=2e-4)
    assert size == pytest.approx(q, rel=4e-3)


def test_without_the_correction_the_centre_is_three_pixels_off() -> None:
    """A radius of 10 cm at 1 m, near the corner of the picture, 532 pixels of focal length."""
    _, mean, _ = grid((0.6, -0.4, 1.0), 0.1)
    assert 3.0 < 532.0 * np.linalg.norm(mean - [0.6, -0.4]) < 4.5


def rim(centre, radius, angles, noise, rng, pixel=1.0 / 532.0):
    """Points near the outline, at angles [rad] around it, and how deep inside they are [px]."""
    c = np.array(centre)
    length = np.linalg.norm(c)
    side = np.linalg.svd(c[None])[2][1:]
    cos = radius / length
    circle = np.cos(angles)[:, None] * side[0] + np.sin(angles)[:, None] * side[1]
    edge = c * (1.0 - cos**2) + radius * math.sqrt(1.0 - cos**2) * circle
    points = edge[:, :2] / edge[:, 2:]
    out = points - c[:2] / c[2]
    out /= np.linalg.norm(out, axis=1)[:, None]
    depth = rng.uniform(-0.4, 0.4, len(angles))
    return points - out * (depth + noise * rng.standard_normal(len(angles)))[:, None] * pixel, depth


@pytest.mark.parametrize("shown", [0.4, 0.6, 1.0])
def test_part_of_an_outline_is_enough(shown) -> None:
    """60 spheres, among whose points a fifth are on a straight edge."""
    rng = np.random.default_rng(3)
    worst = []
    for _ in range(20):
        z = rng.uniform(1.5, 5.0)
        centre, start = (rng.uniform(-0.5, 0.5) * z, rng.uniform(-0.3, 0.3) * z, z), rng.uniform(0.0, 2.0 * math.pi)
        angles = start + np.linspace(0.0, 2.0 * math.pi * shown, 60)
        points, depth = rim(centre, 0.1, angles, 0.05, rng)
        chord = np.linspace(points[0], points[-1], 14)[1:-1]
        points, depth = np.vstack([points, chord]), np.append(depth, rng.uniform(-0.4, 0.4, 12))
        fit = from_rim(points, depth, 1.0 / 532.0)
        assert fit is not None
        worst.append(532.0 * np.linalg.norm(fit[0] - np.array(centre[:2]) / z))
    assert np.median(worst) < 0.15
    assert max(worst) < 0.6


def test_too_little_of_an_outline_is_not_taken() -> None:
    rng = np.random.default_rng(4)
    points, depth = rim((0.3, 0.1, 2.0), 0.1, np.linspace(0.0, 0.9, 40), 0.05, rng)
    assert from_rim(points, depth, 1.0 / 532.0) is None
    assert from_rim(points[:4], depth[:4], 1.0 / 532.0) is None


def test_a_square_is_no_outline() -> None:
    side = np.linspace(-1.0, 1.0, 30)
    square = np.vstack([np.column_stack(pair) for pair in ((side, 0 * side + 1), (side, 0 * side - 1))])
    square = 12.0 / 532.0 * np.vstack([square, square[:, ::-1]])
    p, q = from_ellipse(np.zeros(2), (24.0 / 532.0) ** 2)
    assert agreement(square, np.zeros(120), 1.0 / 532.0, p, q) < 0.5
    points, depth = rim((0.0, 0.0, 2.0), 0.1, np.linspace(0.0, 2.0 * math.pi, 60), 0.0, np.random.default_rng(0))
    assert agreement(points, depth, 1.0 / 532.0, np.zeros(2), 0.05**2) == 1.0
