"""Exact arcs and pose algebra, against SciPy's integrator and rotation matrices."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from relloc_env.kernels import motion

CASES = 60
TOLERANCE: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}


def rotation(angle: float) -> NDArray[np.float64]:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def random_velocity(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Return v, l, w, dt; every third case turns hardly, one in twenty not at all."""
    w = rng.uniform(-3, 3)
    kind = rng.integers(60)
    if kind % 3 == 0:
        w *= 1e-6
    if kind < 3:
        w = 0.0
    return rng.uniform(-1, 1), rng.uniform(-1, 1), w, rng.uniform(0.01, 2)


def test_advance_is_the_solution_of_the_kinematics() -> None:
    rng = np.random.default_rng(1)
    for _ in range(CASES):
        v, lateral, w, dt = random_velocity(rng)
        pose = rng.uniform(-3, 3, 3)

        def rate(_: float, p: NDArray[np.float64], u: tuple[float, float, float] = (v, lateral, w)) -> list[float]:
            return [*(rotation(p[2]) @ u[:2]), u[2]]

        expected = solve_ivp(rate, (0, dt), pose, **TOLERANCE).y[:, -1]
        assert motion.advance(*np.hstack([pose, v, lateral, w, dt])) == pytest.approx(expected, abs=1e-10)


def test_arc_moves_a_static_point_as_its_kinematics_say() -> None:
    """dq/dt = -w J q - [v, l] (docs/equations.md, section 2)."""
    rng = np.random.default_rng(2)
    for _ in range(CASES):
        v, lateral, w, dt = random_velocity(rng)
        q = rng.uniform(-5, 5, 2)

        def rate(_: float, q: NDArray[np.float64], u: tuple[float, float, float] = (v, lateral, w)) -> list[float]:
            return [u[2] * q[1] - u[0], -u[2] * q[0] - u[1]]

        expected = solve_ivp(rate, (0, dt), q, **TOLERANCE).y[:, -1]
        assert motion.move_point(*np.hstack([q, motion.arc(v, lateral, w, dt)])) == pytest.approx(expected, abs=1e-10)


def test_two_half_arcs_make_one() -> None:
    rng = np.random.default_rng(3)
    for _ in range(CASES):
        v, lateral, w, dt = random_velocity(rng)
        half = motion.advance(0.0, 0.0, 0.0, v, lateral, w, dt / 2)
        twice = motion.advance(*np.hstack([half, v, lateral, w, dt / 2]))
        assert motion.arc(v, lateral, w, dt) == pytest.approx(twice, abs=1e-14)


@pytest.mark.parametrize("a", [0.0, 1e-9, 9.999e-5, 1.0001e-4, 1e-3, 0.5, -0.5, 3.0, math.pi])
def test_sinc(a: float) -> None:
    assert motion.sinc(a) == pytest.approx(np.sinc(a / math.pi), abs=3e-16)


def test_wrapped_angles_lie_in_one_turn_and_mean_the_same() -> None:
    rng = np.random.default_rng(4)
    for angle in [-math.pi, math.pi, 0.0, 3 * math.pi, *rng.uniform(-100, 100, 200)]:
        wrapped = motion.wrap_angle(angle)
        assert -math.pi <= wrapped < math.pi
        assert (math.cos(wrapped), math.sin(wrapped)) == pytest.approx((math.cos(angle), math.sin(angle)), abs=1e-13)


def test_relative_is_the_rotated_difference() -> None:
    """r = R(theta_A)ᵀ (r_B - r_A), theta = theta_B - theta_A."""
    rng = np.random.default_rng(5)
    for _ in range(CASES):
        a, b = rng.uniform(-3, 3, 3), rng.uniform(-3, 3, 3)
        xi = motion.relative(*np.hstack([a, b]))
        assert xi[:2] == pytest.approx(rotation(a[2]).T @ (b[:2] - a[:2]), abs=1e-14)
        assert math.remainder(xi[2] - (b[2] - a[2]), 2 * math.pi) == pytest.approx(0, abs=1e-14)
        assert -math.pi <= xi[2] < math.pi
