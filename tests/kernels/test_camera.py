"""Projection, image flow and lines of sight, against rotation matrices, SciPy's integrator and brute force."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from relloc_env.kernels import camera, motion

CASES = 60
BODY_TO_CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Camera: x right (body -y), y down (body -z), z forward (body x)."""


def points_in_view(seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0.3, 10, CASES), rng.uniform(-5, 5, CASES), rng.uniform(-2, 2, CASES)])


def test_projection_is_that_of_a_pinhole() -> None:
    for q in points_in_view(1):
        p = BODY_TO_CAMERA @ q
        x, y, chi = camera.project(*q)
        assert (x, y, chi) == pytest.approx((p[0] / p[2], p[1] / p[2], 1 / p[2]), rel=1e-14)
        assert camera.back_project(x, y, chi) == pytest.approx(q, rel=1e-14)


def test_flow_is_the_derivative_of_the_projected_motion() -> None:
    """Central differences of the exact arc."""
    rng = np.random.default_rng(2)
    for q in points_in_view(2):
        v, lateral, w = rng.uniform(-1, 1, 3)
        sides = []
        for dt in (1e-5, -1e-5):
            moved = motion.move_point(q[0], q[1], *motion.arc(v, lateral, w, dt))
            sides.append(np.array(camera.project(moved[0], moved[1], q[2])))
        difference = (sides[0] - sides[1]) / 2e-5
        assert camera.image_flow(*np.hstack([camera.project(*q), v, lateral, w])) == pytest.approx(
            difference, rel=1e-6, abs=1e-8
        )


def test_flow_integrates_to_the_projected_arc() -> None:
    rng = np.random.default_rng(3)
    for q in points_in_view(3):
        v, lateral, w = rng.uniform(-0.5, 0.5, 3)
        dt = 0.5 * min(q[0], 1.0)
        moved = motion.move_point(q[0], q[1], *motion.arc(v, lateral, w, dt))
        if moved[0] < 0.1:
            continue

        def rate(_: float, s: NDArray[np.float64], u: tuple[float, float, float] = (v, lateral, w)) -> Any:
            return camera.image_flow(*np.hstack([s, u]))

        end = solve_ivp(rate, (0, dt), camera.project(*q), method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        assert camera.project(moved[0], moved[1], q[2]) == pytest.approx(end, rel=1e-8, abs=1e-10)


def test_polar_coordinates_are_bearing_elevation_and_inverse_range() -> None:
    for q in points_in_view(4):
        distance = math.hypot(q[0], q[1])
        expected = math.atan2(q[1], q[0]), q[2] / distance, 1 / distance
        assert camera.to_polar(*camera.project(*q)) == pytest.approx(expected, rel=1e-13)


FRACTIONS = np.linspace(0, 1, 20_001)


def check_crossing(found: float, inside: NDArray[np.bool_], nearly: NDArray[np.bool_]) -> str:
    """Compare a crossing with 20,001 samples of the segment; what only touches may count either way."""
    if inside.any():
        assert found == pytest.approx(FRACTIONS[inside.argmax()], abs=1.01 / 20_000)
        assert found >= 0
        return "hit"
    if nearly.any():
        return "touch"
    assert found == -1.0
    return "miss"


def test_crossing_of_a_disc_against_sampling() -> None:
    rng = np.random.default_rng(5)
    outcomes = []
    for _ in range(400):
        a, b, c = rng.uniform(-2, 2, (3, 2))
        radius = rng.uniform(0.05, 1.5)
        distance = np.hypot(*(a + FRACTIONS[:, None] * (b - a) - c).T)
        found = camera.crosses_disc(*np.hstack([a, b, c, radius]))
        outcomes.append(check_crossing(found, distance <= radius, distance <= radius + 1e-3))
    assert outcomes.count("hit") > 100
    assert outcomes.count("miss") > 100


def test_crossing_of_a_box_against_sampling() -> None:
    rng = np.random.default_rng(6)
    outcomes = []
    for case in range(400):
        a, b, c = rng.uniform(-2, 2, (3, 2))
        half = rng.uniform(0.1, 1.5, 2)
        angle = rng.uniform(-4, 4)
        if case % 10 == 0:  # along an axis of the box
            angle, b[1] = 0.0, a[1]
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        local = np.abs((a + FRACTIONS[:, None] * (b - a) - c) @ turn.T)
        found = camera.crosses_box(*np.hstack([a, b, c, half, math.cos(angle), math.sin(angle)]))
        inside, nearly = (local <= half).all(axis=1), (local <= half + 1e-3).all(axis=1)
        outcomes.append(check_crossing(found, inside, nearly))
    assert outcomes.count("hit") > 100
    assert outcomes.count("miss") > 100


def test_crossing_of_what_the_segment_starts_in_or_of_no_length() -> None:
    assert camera.crosses_disc(0.1, 0.0, 3.0, 0.0, 0.0, 0.0, 0.5) == 0.0
    assert camera.crosses_box(0.1, 0.0, 3.0, 0.0, 0.0, 0.0, 0.5, 0.5, math.cos(0.7), math.sin(0.7)) == 0.0
    assert camera.crosses_disc(1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.5) == -1.0
    assert camera.crosses_box(1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 1.0, 0.0) == -1.0


def test_view_is_the_projection_along_the_axes_of_the_camera() -> None:
    """100 random cameras and points, in front and behind: p - c = depth (forward + x right + y down)."""
    rng = np.random.default_rng(7)
    for _ in range(100):
        (x, y, p_x, p_y, p_z), height, theta = rng.uniform(-4, 4, 5), rng.uniform(0, 1), rng.uniform(-4, 4)
        cos, sin = math.cos(theta), math.sin(theta)
        depth, image_x, image_y = camera.view(x, y, cos, sin, height, p_x, p_y, p_z)
        forward, right, down = np.array([[cos, sin, 0], [sin, -cos, 0], [0, 0, -1]])
        expected = np.array([p_x - x, p_y - y, p_z - height])
        assert depth == pytest.approx(forward @ expected, abs=1e-14)
        assert depth * (forward + image_x * right + image_y * down) == pytest.approx(expected, abs=1e-13)
