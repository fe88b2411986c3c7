"""Covariance of the depth observer's error, against finite differences and many noisy runs."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.kernels import depth_covariance, motion
from tests.kernels.observers import BASE_COVARIANCE, COVARIANCE, ESTIMATE, POINT, SETTINGS, Observers

Float = NDArray[np.float64]
QUIET = SETTINGS._replace(z_min=1e-3, z_max=1e3, image_sd=0.0, v_sd=0.0, w_sd=0.0)


def matrix(p: Any) -> Any:
    return np.array([[p[0], p[1], p[2]], [p[1], p[3], p[4]], [p[2], p[4], p[5]]])


def test_covariances_stay_positive_over_random_samples() -> None:
    """240 points, 400 samples (96,000 point samples), 40 % of them unseen; two kinds of gains."""
    rng = np.random.default_rng(5)
    for settings, alpha_lambda in ((SETTINGS, 120.0), (SETTINGS._replace(critical=True), 1e4)):
        observers = Observers(120, settings, alpha_lambda=alpha_lambda, depth=rng.uniform(0.3, 8, 120))
        for _ in range(400):
            images, seen = rng.uniform(-0.6, 0.6, (120, 2)), rng.random(120) < 0.6
            observers.sample(rng.uniform(-0.5, 0.5, (120, 3)), 0.05, images, seen)
        numbers = observers.numbers
        assert np.isfinite(numbers).all()
        for row in numbers:
            for place in (COVARIANCE, BASE_COVARIANCE):
                p = matrix(row[place])
                sd = np.sqrt(np.diag(p))
                assert np.linalg.eigvalsh(p / np.outer(sd, sd)).min() > -1e-12


def test_covariance_is_carried_by_the_derivative_of_the_step() -> None:
    """100 random steps without noise, against central differences of the estimate after the step."""
    rng, cases = np.random.default_rng(6), []
    for _ in range(100):
        s, chi, time, velocity = (
            rng.uniform([-1, -1], 1),
            *rng.uniform([0.1, 0.02], [0.6, 0.1]),
            rng.uniform(-0.4, 0.4, 3),
        )
        gains, after = rng.uniform([1, 10], [20, 1000]), s + rng.uniform(-0.02, 0.02, 2)
        s_hat, half = s + rng.uniform(-0.005, 0.005, 2), rng.normal(size=(3, 3)) * [[0.01], [0.01], [0.05]]
        cases.append((s, after, np.array([*s_hat, chi]), velocity, time, *gains, half @ half.T))
    s0, s1, start, u, dt, h, alpha_lambda, p = (np.array(column) for column in zip(*cases, strict=True))

    def step(x: Float) -> Observers:
        observers = Observers(100, QUIET, h=h, alpha_lambda=alpha_lambda)
        observers.sample([0, 0, 0], 0.0, s0)
        for k, name in enumerate(("x_hat", "y_hat", "chi_hat")):
            observers.put(name, x[:, k])
        observers.put("base_covariance", p[:, *np.triu_indices(3)])
        observers.sample(u, dt, s1)
        return observers

    columns = [
        (step(start + d).numbers[:, ESTIMATE] - step(start - d).numbers[:, ESTIMATE]) / 2e-6 for d in 1e-6 * np.eye(3)
    ]
    jacobian = np.stack(columns, axis=-1)
    expected = jacobian @ p @ jacobian.mT
    for row, of_differences in zip(step(start).numbers, expected, strict=True):
        scale = np.sqrt(np.outer(np.diag(of_differences), np.diag(of_differences)))
        assert matrix(row[BASE_COVARIANCE]) / scale == pytest.approx(of_differences / scale, abs=5e-3)


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
    # point, velocity, settings, samples per frame, gap
    "straight": ((5.0, 1.5, 0.5), (0.1, 0.0, 0.0), SETTINGS, 1, (0.0, 0.0)),
    "turning, fast gains": ((4.0, 2.5, 1.0), (0.25, 0.0, 0.03), SETTINGS, 1, (0.0, 0.0)),
    "critical": ((4.0, 2.5, 1.0), (0.25, 0.0, 0.03), SETTINGS._replace(critical=True), 1, (0.0, 0.0)),
    "lateral": ((5.0, 1.5, 0.5), (0.05, 0.1, 0.03), SETTINGS._replace(lateral_sd=0.01), 1, (0.0, 0.0)),
    "slow camera": ((5.0, 1.5, 0.5), (0.1, 0.0, 0.03), SETTINGS, 4, (0.0, 0.0)),
    "gap at the end": ((5.0, 1.5, 0.5), (0.1, 0.0, 0.1), SETTINGS, 1, (2.52, 6.0)),
}


@pytest.mark.parametrize("name", NOISY)
def test_covariance_is_that_of_many_noisy_runs(name: str) -> None:
    """2,000 runs of 5 s at 20 Hz; 1.6 % is one standard deviation of such a ratio."""
    point, velocity, settings, every, gap = NOISY[name]
    rng, runs, dt = np.random.default_rng(8), 2000, 0.05
    depth = point[0] + rng.normal(0, 0.1, runs)
    observers = Observers(runs, settings, alpha_lambda=480.0 if "fast" in name else 120.0, depth=depth, depth_sd=0.1)
    noise = np.array([settings.v_sd, settings.lateral_sd, settings.w_sd])
    for k in range(101):
        moved = motion.arc(*velocity, k * dt)
        q = np.array([*motion.move_point(*point[:2], *moved), point[2]])
        images = np.array([-q[1], -q[2]]) / q[0] + rng.normal(0, settings.image_sd, (runs, 2))
        odometry = velocity + noise * rng.normal(size=(runs, 3))
        observers.sample(odometry, dt if k else 0.0, images, k % every == 0 and not gap[0] < k * dt < gap[1])
    rows = observers.numbers
    measured = np.cov((rows[:, POINT] - q).T)
    stated = matrix(rows[:, COVARIANCE].mean(axis=0))
    assert np.sqrt(np.diag(measured) / np.diag(stated)) == pytest.approx(1, abs=0.08)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    assert measured / scale == pytest.approx(stated / scale, abs=0.15)
    of_chi = observers.image_covariance_now(0.1)[::50, 5].mean()
    chi = 1 / rows[:, POINT[0]]
    assert np.std(chi) / math.sqrt(of_chi) == pytest.approx(1, abs=0.15)
