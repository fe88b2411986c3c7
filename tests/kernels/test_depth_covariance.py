"""Covariance of the depth observer's error, against finite differences and many noisy runs."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.kernels import depth_covariance, depth_observer, depth_state, motion

Float = NDArray[np.float64]
SETTINGS = depth_state.Settings(
    h=2.5, alpha_lambda=120.0, critical=0.0, floor=0.5, z_min=0.1, z_max=100.0, max_gap=0.3, depth_sd=0.1,
    image_sd=0.002, v_sd=0.005, lateral_sd=0.0, w_sd=0.005,
)  # fmt: skip
POINT = depth_state.Q_X, depth_state.Q_Y, depth_state.HEIGHT


def matrix(p: Any) -> Any:
    return np.array([[p[0], p[1], p[2]], [p[1], p[3], p[4]], [p[2], p[4], p[5]]])


def test_covariances_stay_positive_over_random_samples() -> None:
    """40 environments, 2 robots, 3 points, 400 samples (96,000 point samples), 40 % of them unseen."""
    rng = np.random.default_rng(5)
    settings = np.array([SETTINGS, SETTINGS._replace(critical=1.0, alpha_lambda=1e4)])
    shape = (40, 400, 2, 3)
    odometry = rng.uniform(-0.5, 0.5, shape).astype(np.float32)
    images = rng.uniform(-0.6, 0.6, (*shape, 2)).astype(np.float32)
    seen, period = rng.random(shape) < 0.6, np.full(shape[:2], 0.05)
    state = np.zeros((40, 2, 3, depth_state.SIZE))
    depth = rng.uniform(0.3, 8, (40, 2, 3))
    for k in range(400):
        depth_state.observe(state, settings, period, odometry, images, seen, depth, k, True, np.arange(40))
    assert np.isfinite(state).all()
    for row in state.reshape(-1, depth_state.SIZE):
        for first in (depth_state.COVARIANCE, depth_state.BASE_COVARIANCE):
            p = matrix(row[first : first + 6])
            sd = np.sqrt(np.diag(p))
            assert np.linalg.eigvalsh(p / np.outer(sd, sd)).min() > -1e-12


def test_covariance_is_carried_by_the_derivative_of_the_step() -> None:
    """100 random steps without noise, against central differences of `observer_step`."""
    rng = np.random.default_rng(6)
    for _ in range(100):
        s0, chi, dt = rng.uniform(-1, 1, 2), rng.uniform(0.1, 0.6), rng.uniform(0.02, 0.1)
        u = rng.uniform(-0.4, 0.4, 3)
        gains = rng.uniform(1, 20), rng.uniform(10, 1000)
        s1 = s0 + rng.uniform(-0.02, 0.02, 2)
        x = np.array([*(s0 + rng.uniform(-0.005, 0.005, 2)), chi])

        def step(x: Float, fixed: Any = (s0, s1, u, dt, gains)) -> Any:
            s0, s1, u, dt, gains = fixed
            return np.array(depth_observer.observer_step(*np.hstack([s0, s1, x, u, dt, gains, 1e-3, 1e3])))

        jacobian = np.column_stack([(step(x + d) - step(x - d)) / 2e-6 for d in 1e-6 * np.eye(3)])
        half = rng.normal(size=(3, 3)) * [[0.01], [0.01], [0.05]]
        p = half @ half.T
        means = depth_observer.interval_means(*np.hstack([s0, s1, chi, u[0], u[2], dt]))
        sigma2 = (u[0] * means[0] + u[1]) ** 2 + (u[0] * means[1]) ** 2
        mode = depth_observer.modes(gains[0], gains[1] * sigma2, dt)
        middle = (chi + step(x)[2]) / 2
        six = tuple(p[np.triu_indices(3)])
        new = depth_covariance.covariance_step(
            six, means[0], means[1], middle, u[0], u[1], u[2], dt, gains[0], gains[1], mode, 0.0, 0.0, 0.0, 0.0, 0.0
        )
        expected = jacobian @ p @ jacobian.T
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert matrix(new) / scale == pytest.approx(expected / scale, abs=5e-3)


@pytest.mark.parametrize("name", ["image_to_body", "body_to_image", "body_to_polar"])
def test_conversions_against_finite_differences(name: str) -> None:
    def to_body(s: Float) -> Float:
        return np.array([1, -s[0], -s[1]]) / s[2]

    def to_image(q: Float) -> Float:
        return np.array([-q[1], -q[2], 1]) / q[0]

    def to_polar(q: Float) -> Float:
        n = math.hypot(q[0], q[1])
        return np.array([math.atan2(q[1], q[0]), q[2] / n, 1 / n])

    function = {"image_to_body": to_body, "body_to_image": to_image, "body_to_polar": to_polar}[name]
    rng = np.random.default_rng(7)
    for _ in range(50):
        a = rng.uniform([-1, -1, 0.2], [1, 1, 2]) if name == "image_to_body" else rng.uniform([0.3, -2, -1], [4, 2, 1])
        jacobian = np.column_stack([(function(a + d) - function(a - d)) / 2e-6 for d in 1e-6 * np.eye(3)])
        half = rng.normal(size=(3, 3))
        p = half @ half.T
        found = getattr(depth_covariance, name)(*a, tuple(p[np.triu_indices(3)]))
        expected = jacobian @ p @ jacobian.T
        assert matrix(found) == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


NOISY = {
    "straight": ((5.0, 1.5, 0.5), (0.1, 0.0, 0.0), SETTINGS, 1, (0.0, 0.0)),
    "turning, fast gains": ((4.0, 2.5, 1.0), (0.25, 0.0, 0.03), SETTINGS._replace(alpha_lambda=480.0), 1, (0.0, 0.0)),
    "critical": ((4.0, 2.5, 1.0), (0.25, 0.0, 0.03), SETTINGS._replace(critical=1.0), 1, (0.0, 0.0)),
    "lateral": ((5.0, 1.5, 0.5), (0.05, 0.1, 0.03), SETTINGS._replace(lateral_sd=0.01), 1, (0.0, 0.0)),
    "slow camera": ((5.0, 1.5, 0.5), (0.1, 0.0, 0.03), SETTINGS, 4, (0.0, 0.0)),
    "gap at the end": ((5.0, 1.5, 0.5), (0.1, 0.0, 0.1), SETTINGS, 1, (2.52, 6.0)),
}


@pytest.mark.parametrize("name", NOISY)
def test_covariance_is_that_of_many_noisy_runs(name: str) -> None:
    """2,000 runs of 5 s at 20 Hz; 1.6 % is one standard deviation of such a ratio."""
    start, u, settings, every, gap = NOISY[name]
    rng, runs, dt = np.random.default_rng(8), 2000, 0.05
    point, velocity = np.array(start), np.array(u)
    state = np.zeros((runs, 1, 1, depth_state.SIZE))
    depth = point[0] + rng.normal(0, settings.depth_sd, (runs, 1, 1))
    noise = np.array([settings.v_sd, settings.lateral_sd, settings.w_sd])
    for k in range(101):
        moved = motion.arc(*np.hstack([velocity, k * dt]))
        q = np.array([*motion.move_point(*np.hstack([point[:2], moved])), point[2]])
        images = np.array([-q[1], -q[2]]) / q[0] + rng.normal(0, settings.image_sd, (runs, 1, 1, 1, 2))
        odometry = velocity + noise * rng.normal(size=(runs, 1, 1, 3))
        seen = np.full((runs, 1, 1, 1), k % every == 0 and not gap[0] < k * dt < gap[1])
        period = np.full((runs, 1), dt if k else 0.0)
        depth_state.observe(
            state, np.array([settings]), period, odometry, images, seen, depth, 0, True, np.arange(runs)
        )
    rows = state[:, 0, 0]
    measured = np.cov((rows[:, list(POINT)] - q).T)
    stated = matrix(rows[:, depth_state.COVARIANCE : depth_state.COVARIANCE + 6].mean(axis=0))
    assert np.sqrt(np.diag(measured) / np.diag(stated)) == pytest.approx(1, abs=0.08)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    assert measured / scale == pytest.approx(stated / scale, abs=0.15)
    table = state.reshape(-1, depth_state.SIZE)
    of_chi = np.mean([depth_state.image_covariance_now(table, i, 0.1)[5] for i in range(0, runs, 50)])
    chi = 1 / rows[:, depth_state.Q_X]
    assert np.std(chi) / math.sqrt(of_chi) == pytest.approx(1, abs=0.15)
