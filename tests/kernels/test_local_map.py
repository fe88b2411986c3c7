"""The joint map of a robot: its geometry, its Jacobians by finite differences, its Kalman steps by dense matrices."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from relloc_env.kernels import local_map
from relloc_env.kernels.camera import to_polar
from relloc_env.kernels.motion import arc, move_point

Float = NDArray[np.float64]


def jacobian(function: Callable[[Float], Float], at: Float, step: float = 1e-6) -> Float:
    columns = [(function(at + step * e) - function(at - step * e)) / (2.0 * step) for e in np.eye(len(at))]
    return np.stack(columns, axis=1)


def random_map(rng: np.random.Generator, points: int, calibrated: bool) -> tuple[Float, Float]:
    size = 3 * points + (local_map.CALIBRATION if calibrated else 0)
    state = np.empty(size)
    state[: 3 * points] = rng.uniform([-1.2, -0.5, 0.1], [1.2, 0.5, 1.0], (points, 3)).ravel()
    if calibrated:
        state[3 * points :] = rng.uniform([0.8, 0.8, -0.1, -0.1, -0.2], [1.2, 1.2, 0.1, 0.1, 0.2])
    root = 0.05 * rng.normal(size=(size, size))
    return state, root @ root.T + 1e-4 * np.eye(size)


def test_transfer_agrees_with_the_geometry_of_points_200_cases() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        q = rng.uniform(-6.0, 6.0, 2)
        height, camera = rng.uniform(-1.0, 1.0, 2)
        r, theta = rng.uniform(-2.0, 2.0, 2), rng.uniform(-3.0, 3.0)
        reach = math.hypot(*q)
        seen = local_map.transfer(math.atan2(q[1], q[0]), height / reach, 1.0 / reach, r[0], r[1], theta, camera)
        p_x, p_y = move_point(q[0], q[1], r[0], r[1], theta)
        there = math.hypot(p_x, p_y)
        assert_allclose([math.cos(seen[0]), math.sin(seen[0])], [p_x / there, p_y / there], atol=1e-12)
        assert_allclose(seen[1:3], [(height - camera) / there, 1.0 / there], rtol=1e-11)


def test_transfer_jacobian_by_finite_differences_100_cases() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        at = rng.uniform([-1.5, -1, 0.1, -1, -1, -2, -0.5], [1.5, 1, 0.6, 1, 1, 2, 0.5])
        values = local_map.transfer(*at)
        inv = values[3]
        expected = np.zeros((3, 7))
        for column, start in ((0, 4), (2, 7), (3, 10), (4, 13)):
            expected[:, column] = values[start : start + 3]
        expected[1, 1], expected[0, 5], expected[1, 6] = inv, -1.0, -at[2] * inv
        assert_allclose(jacobian(lambda a: np.array(local_map.transfer(*a)[:3]), at), expected, atol=2e-8)


@pytest.mark.parametrize("w", [0.0, 1e-5, 2e-3, 0.7, -1.5])
def test_arc_jacobian_by_finite_differences(w: float) -> None:
    at = np.array([0.3, -0.1, w])
    numeric = jacobian(lambda u: np.array(arc(u[0], u[1], u[2], 0.2))[:2], at, 1e-5)
    analytic: Float = np.array(local_map.arc_jacobian(*at, 0.2)).reshape(3, 2).T
    assert_allclose(analytic, numeric, atol=1e-10)


def test_image_noise_by_finite_differences_50_cases() -> None:
    rng = np.random.default_rng(3)
    for x, y in rng.uniform(-2.0, 2.0, (50, 2)):
        t = jacobian(lambda s: np.array(to_polar(s[0], s[1], 1.0)[:2]), np.array([x, y]))
        expected = 0.01 * t @ t.T
        assert_allclose(local_map.image_noise(x, y, 0.01), [expected[0, 0], expected[0, 1], expected[1, 1]], atol=1e-9)


@pytest.mark.parametrize("calibrated", [False, True])
def test_prediction_is_that_of_dense_matrices_20_cases(calibrated: bool) -> None:
    rng = np.random.default_rng(4)
    points, dt, variances = 4, 0.3, np.array([0.04, 0.01, 0.09])
    for _ in range(20):
        state, covariance = random_map(rng, points, calibrated)
        known = np.array([True, True, False, True])
        used = np.repeat(known, 3)
        unused = np.flatnonzero(~used)
        state[unused] = 0.0
        covariance[unused] = 0.0
        covariance[:, unused] = 0.0
        u = rng.uniform(-0.5, 0.5, 3)

        def move(values: Float, u: Float, known: NDArray[np.bool_] = known) -> Float:
            k_v, k_w, loss = values[-5:-2] if calibrated else (1.0, 1.0, 0.0)
            c_x, c_y, delta = arc(k_v * u[0] - loss * abs(u[2]), k_v * u[1], k_w * u[2], dt)
            out = values.copy()
            for i in np.flatnonzero(known):
                beta, eta, rho = values[3 * i : 3 * i + 3]
                q = move_point(math.cos(beta) / rho, math.sin(beta) / rho, c_x, c_y, delta)
                reach = math.hypot(*q)
                out[3 * i : 3 * i + 3] = math.atan2(q[1], q[0]), eta / rho / reach, 1.0 / reach
            return out

        def velocity_moves(du: Float, state: Float = state, u: Float = u) -> Float:
            # The noise adds to the true velocity, which the calibrated one stands for.
            if not calibrated:
                return move(state, u + du)
            k_v, k_w, loss = state[-5:-2]
            true = np.array([k_v * u[0] - loss * abs(u[2]), k_v * u[1], k_w * u[2]])
            return np.append(move(np.append(state[:-5], [1.0, 1.0, 0.0, 0.0, 0.0]), true + du)[:-5], state[-5:])

        def state_moves(values: Float, u: Float = u) -> Float:
            return move(values, u)

        f, g = jacobian(state_moves, state), jacobian(velocity_moves, np.zeros(3))
        for i in unused:
            f[i] = 0.0
        expected_state, expected = move(state, u), f @ covariance @ f.T + g @ np.diag(variances) @ g.T
        local_map.map_predict(state, covariance, known, *u, dt, *variances, np.empty((len(state), 3)))
        assert_allclose(state, expected_state, atol=1e-12)
        assert_allclose(covariance, expected, atol=1e-7)


@pytest.mark.parametrize("calibrated", [False, True])
@pytest.mark.parametrize("level", [False, True])
def test_correction_is_the_textbook_kalman_step_20_cases(calibrated: bool, level: bool) -> None:
    rng = np.random.default_rng(5)
    points, i, variance, w = 3, 1, 0.003**2, 0.4
    for _ in range(20):
        state, covariance = random_map(rng, points, calibrated)
        size = len(state)
        h = np.zeros((1 if level else 2, size))
        h[0, 3 * i] = 1.0
        if calibrated:
            h[0, -2:] = -1.0, w
        if not level:
            h[1, 3 * i + 1] = 1.0
        z = h @ state + 0.02 * rng.normal(size=len(h))
        x = -math.tan(z[0])
        y = math.nan if level else -z[1] * math.sqrt(1.0 + x * x)
        r_bb, r_be, r_ee = local_map.image_noise(x, 0.0 if level else y, variance)
        r = np.array([[r_bb]]) if level else np.array([[r_bb, r_be], [r_be, r_ee]])
        s = h @ covariance @ h.T + r
        gain = covariance @ h.T @ np.linalg.inv(s)
        innovation = z - h @ state
        expected_state = state + gain @ innovation
        joseph = np.eye(size) - gain @ h
        expected = joseph @ covariance @ joseph.T + gain @ r @ gain.T
        accepted, squared = local_map.map_correct(
            state, covariance, points, i, x, y, w, variance, 1e9, 1e9, np.empty((size, 3))
        )
        assert accepted
        assert_allclose(squared, innovation @ np.linalg.solve(s, innovation), rtol=1e-9)
        assert_allclose(state, expected_state, atol=1e-12)
        assert_allclose(covariance, expected, atol=1e-12)
        assert np.array_equal(covariance, covariance.T)


def test_a_gated_measurement_changes_nothing() -> None:
    state, covariance = random_map(np.random.default_rng(6), 2, False)
    before: tuple[Any, Any] = state.copy(), covariance.copy()
    accepted, squared = local_map.map_correct(
        state, covariance, 2, 0, 5.0, 5.0, 0.0, 1e-6, 13.8, 10.8, np.empty((6, 3))
    )
    assert not accepted
    assert squared > 13.8
    assert np.array_equal(state, before[0])
    assert np.array_equal(covariance, before[1])


def test_entering_has_the_covariance_of_its_formula() -> None:
    """Beta = beta_seen + psi - w tau, so its ties to psi and tau are linear; the rest of the map stays untied."""
    state, covariance = random_map(np.random.default_rng(7), 3, True)
    before, known = covariance.copy(), np.array([True, False, True])
    x, y, w, variance = 0.3, -0.2, 0.6, 1e-5
    psi, tau = state[-2], state[-1]
    local_map.map_enter(state, covariance, known, 1, x, y, w, variance, 0.25, 0.04)
    beta, eta, _ = to_polar(x, y, 1.0)
    r_bb, r_be, r_ee = local_map.image_noise(x, y, variance)
    row = before[-2] - w * before[-1]
    row[3:6] = 0.0
    tied = row[-2] - w * row[-1]
    assert_allclose(state[3:6], [beta + psi - w * tau, eta, 0.25], atol=1e-15)
    others = [0, 1, 2, 6, 7, 8, 9, 10, 11, 12, 13]
    assert_allclose(covariance[3, others], row[others], atol=1e-15)
    assert_allclose(covariance[3:6, 3:6], [[tied + r_bb, r_be, 0], [r_be, r_ee, 0], [0, 0, 0.04]], atol=1e-15)
    assert not covariance[4:6, others].any()
    assert known.all()
    assert np.array_equal(covariance, covariance.T)


def test_the_depth_prior_is_that_of_the_depth() -> None:
    rho, variance = local_map.depth_prior(0.4, 4.0, 0.5)
    cos = 1.0 / math.hypot(1.0, 0.4)
    assert_allclose(rho, cos / 4.0)
    slope = (cos / (4.0 + 1e-6) - cos / (4.0 - 1e-6)) / 2e-6
    assert_allclose(variance, (slope * 0.5) ** 2, rtol=1e-8)


def test_a_static_point_is_followed_to_the_depth_by_motion_alone() -> None:
    """Noise-free images of a point at 5 m, guessed at 6 m: after a sideways path the map has its true place."""
    state, covariance, known = np.zeros(3), np.zeros((3, 3)), np.zeros(1, dtype=np.bool_)
    q, height, work = np.array([5.0, 0.8]), 0.4, np.empty((3, 3))
    rho, variance = local_map.depth_prior(-q[1] / q[0], 6.0, 1.0)
    local_map.map_enter(state, covariance, known, 0, -q[1] / q[0], -height / q[0], 0.0, 1e-8, rho, variance)
    for _ in range(200):
        u = (0.2, 0.0, 0.05)
        q = np.array(move_point(*q, *arc(*u, 0.05)))
        local_map.map_predict(state, covariance, known, *u, 0.05, 1e-10, 0.0, 1e-10, work)
        local_map.map_correct(state, covariance, 1, 0, -q[1] / q[0], -height / q[0], 0.05, 1e-8, 1e9, 1e9, work)
    reach = math.hypot(*q)
    assert_allclose(state, [math.atan2(q[1], q[0]), height / reach, 1.0 / reach], atol=2e-4)
    assert math.sqrt(covariance[2, 2]) < 1e-3
