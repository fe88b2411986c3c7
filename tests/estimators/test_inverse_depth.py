"""The per-point inverse-depth filter against a textbook Kalman filter, its consistency, and how it is fed."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from relloc_env.estimators import InverseDepthConfig, make
from relloc_env.samples import Float, Samples, ordered_pairs
from tests.estimators.driving import POINTS, late, prior, simulate, take

CONFIG = InverseDepthConfig()
ROWS = np.arange(64)


def run(samples: Samples, window: int = 1, block: int = 1, depth: float = 4.0) -> Any:
    envs, k = samples.period.shape
    estimator = make(CONFIG, envs, 2, len(POINTS), message_window=window)
    estimator.reset(prior(envs, depth), ROWS[:envs])
    for first in range(0, k, block):
        estimator.update(take(samples, first, min(first + block, k)), ROWS[:envs])
    return estimator


def wrapped(angle: Any) -> Any:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def jacobian(f: Callable[..., Float], x: Float) -> Float:
    return np.stack([(f(x + h) - f(x - h)) / 2e-6 for h in 1e-6 * np.eye(len(x))], axis=1)


def moved(u: Float, dt: float) -> Float:
    """Transform (3, 3) of a body that moves with (v, w) for dt: the exponential of its twist."""
    v, w = u
    return expm(dt * np.array([[0.0, -w, v], [w, 0.0, 0.0], [0.0, 0.0, 0.0]]))


def to_polar(q: Float) -> Float:
    distance = np.hypot(q[0], q[1])
    return np.array([np.arctan2(q[1], q[0]), q[2] / distance, 1.0 / distance])


def to_space(p: Float) -> Float:
    return np.array([np.cos(p[0]), np.sin(p[0]), p[1]]) / p[2]


def seen_from(p: Float, u: Float, dt: float) -> Float:
    """A point in polar form after the body moved."""
    q = to_space(p)
    q[:2] = (np.linalg.inv(moved(u, dt)) @ [*q[:2], 1.0])[:2]
    return to_polar(q)


def compose(xi: Float, u: Float, dt: float) -> Float:
    """Pose of B in {A} after A moved with u[:2] and B with u[2:]."""
    cos, sin = np.cos(xi[2]), np.sin(xi[2])
    pose = np.array([[cos, -sin, xi[0]], [sin, cos, xi[1]], [0.0, 0.0, 1.0]])
    after = np.linalg.inv(moved(u[:2], dt)) @ pose @ moved(u[2:], dt)
    return np.array([after[0, 2], after[1, 2], xi[2] + dt * (u[3] - u[1])])


class Textbook:
    """The same filters from their definitions alone: one environment, perfect network, numerical Jacobians."""

    def __init__(self, depth: float) -> None:
        told = prior(1, depth)
        self.depth, self.q = depth, np.diag([1e-4, 1e-4])
        self.points: dict[tuple[int, int], tuple[Float, Float]] = {}
        self.poses = [(told.pose[0, p].copy(), np.diag(told.pose_sd**2)) for p in range(2)]

    def take(self, samples: Samples, k: int) -> None:
        dt = float(samples.period[0, k])
        u = samples.odometry[0, k, :, ::2].astype(float)
        for (r, i), (x, cov) in self.points.items():
            f, g = (
                jacobian(lambda s, r=r: seen_from(s, u[r], dt), x),
                jacobian(lambda n, x=x: seen_from(x, n, dt), u[r]),
            )
            self.points[r, i] = seen_from(x, u[r], dt), f @ cov @ f.T + g @ self.q @ g.T
        for r, i in np.argwhere(samples.seen[0, k]).tolist():
            self._see(r, i, samples.image[0, k, r, i].astype(float))
        for p, (a, b) in enumerate(ordered_pairs(2)):
            xi, cov = self.poses[p]
            both = np.concatenate([u[a], u[b]])
            f = jacobian(lambda s, both=both: compose(s, both, dt), xi)
            g = jacobian(lambda n, xi=xi: compose(xi, n, dt), both)
            xi, cov = compose(xi, both, dt), f @ cov @ f.T + g @ block_diag(self.q, self.q) @ g.T
            for i in np.flatnonzero(samples.seen[0, k, a] & samples.seen[0, k, b]).tolist():
                xi, cov = self._meet(xi, cov, self.points[a, i], self.points[b, i])
            self.poses[p] = xi, cov

    def _see(self, r: int, i: int, image: Float) -> None:
        def measured(s: Float, chi: float = 1.0) -> Float:
            return to_polar(np.array([1.0, -s[0], -s[1]]) / chi)

        t = jacobian(measured, image)[:2]
        noise = CONFIG.image_noise**2 * t @ t.T
        if (r, i) not in self.points:
            first = measured(image, 1.0 / self.depth)
            sd = jacobian(lambda z: measured(image, 1.0 / z[0]), np.array([self.depth]))[2, 0]
            self.points[r, i] = first, block_diag(noise, sd**2)
            return
        x, cov = self.points[r, i]
        gain = cov[:, :2] @ np.linalg.inv(cov[:2, :2] + noise)
        innovation = measured(image)[:2] - x[:2]
        innovation[0] = wrapped(innovation[0])
        self.points[r, i] = x + gain @ innovation, cov - gain @ cov[:2]

    @staticmethod
    def _meet(xi: Float, cov: Float, own: tuple[Float, Float], other: tuple[Float, Float]) -> tuple[Float, Float]:
        def residual(s: Float, a: Float, b: Float) -> Float:
            cos, sin = np.cos(s[2]), np.sin(s[2])
            return np.array([[cos, sin], [-sin, cos]]) @ (to_space(a)[:2] - s[:2]) - to_space(b)[:2]

        (a, cov_a), (b, cov_b) = own, other
        h = jacobian(lambda s: residual(s, a, b), xi)
        g = np.hstack([jacobian(lambda s: residual(xi, s, b), a), jacobian(lambda s: residual(xi, a, s), b)])
        noise = g @ block_diag(cov_a, cov_b) @ g.T + CONFIG.measurement_sd**2 * np.eye(2)
        gain = cov @ h.T @ np.linalg.inv(h @ cov @ h.T + noise)
        return xi - gain @ residual(xi, a, b), cov - gain @ h @ cov


def test_it_is_the_textbook_filter() -> None:
    samples, _ = simulate(60, seed=1, seen=0.7)
    book, estimator = Textbook(4.5), run(samples, block=7, depth=4.5)
    for k in range(samples.period.shape[1]):
        book.take(samples, k)
    estimate = estimator.estimate
    assert estimate.known.all()
    for (r, i), (x, cov) in book.points.items():
        assert_allclose(estimate.points[0, r, i], x, rtol=1e-6, atol=1e-8)
        assert_allclose(estimate.points_covariance[0, r, i], cov, rtol=1e-4, atol=1e-10)
    for p, (xi, cov) in enumerate(book.poses):
        assert_allclose(estimate.pose[0, p, :2], xi[:2], atol=1e-6)
        assert_allclose(wrapped(estimate.pose[0, p, 2] - xi[2]), 0.0, atol=1e-6)
        assert_allclose(estimate.pose_covariance[0, p], cov, rtol=1e-4, atol=1e-10)


def test_the_depth_of_a_point_is_consistent_100_runs() -> None:
    """Gaussian errors of the depth guess, as claimed: the mean of the normalised squares is 1.

    Both robots and three points share odometry and runs: about 200 independent squares at least, sd 0.1.
    """
    envs, rng = 100, np.random.default_rng(2)
    samples, poses = simulate(400, envs=envs, seed=2)
    distance = np.linalg.norm(POINTS[:, :2] - poses[:, -1, :, None, :2], axis=-1)
    to_points = POINTS[:, :2] - poses[:, 0, :, None, :2]
    heading = poses[:, 0, :, 2, None]
    depth = np.cos(heading) * to_points[..., 0] + np.sin(heading) * to_points[..., 1]
    told = prior(envs)._replace(depth=depth + 0.3 * rng.normal(size=depth.shape), depth_sd=0.3)
    # the guess is of the first sight; so every point is seen at the start
    samples.seen[:, 0] = True
    full, _ = simulate(400, envs=envs, seed=2, seen=1.0)
    samples.image[:, 0] = full.image[:, 0]
    estimator = make(CONFIG, envs, 2, len(POINTS))
    rows = np.arange(envs)
    estimator.reset(told, rows)
    estimator.update(samples, rows)
    estimate = estimator.estimate
    nees = (estimate.points[..., 2] - 1.0 / distance) ** 2 / estimate.points_covariance[..., 2, 2]
    assert 0.7 < nees.mean() < 1.4
    assert np.sqrt(estimate.points_covariance[..., 2, 2]).mean() < 0.3 * (0.3 / depth**2).mean()


def test_a_run_alone_in_a_batch_and_in_blocks_is_the_same_to_the_last_bit() -> None:
    samples, _ = simulate(40, envs=11, seed=3)
    samples = late(samples, 4, 3, loss=0.2)
    whole = run(samples, window=4, block=41)
    for n in (0, 4, 10):
        alone = run(Samples._make(np.ascontiguousarray(x[n : n + 1]) for x in samples), window=4, block=6)
        for given, expected in zip(alone.estimate, whole.estimate, strict=True):
            assert_array_equal(given[0], expected[n])


def test_rows_that_are_not_named_stay_as_they_are() -> None:
    samples, _ = simulate(10, envs=3, seed=4)
    estimator, untouched = run(take(samples, 0, 5)), run(take(samples, 0, 5))
    estimator.update(take(samples, 5, 11), np.array([2]))
    for given, expected in zip(estimator.estimate, untouched.estimate, strict=True):
        assert_array_equal(given[:2], expected[:2])
    assert (estimator.estimate.pose[2] != untouched.estimate.pose[2]).all()


def test_state_goes_out_and_back_in_bit_for_bit() -> None:
    samples, _ = simulate(40, envs=2, seed=5)
    samples = late(samples, 4, 5)
    one, other = run(take(samples, 0, 20), window=4), run(take(samples, 0, 3), window=4)
    other.set_state(one.get_state(ROWS[:1]), ROWS[1:2])
    assert_array_equal(other.estimate.pose[1], one.estimate.pose[0])
    one.update(take(samples, 20, 41), ROWS[:2])
    other.update(Samples._make(np.ascontiguousarray(x[::-1]) for x in take(samples, 20, 41)), ROWS[:2])
    for given, expected in zip(other.estimate, one.estimate, strict=True):
        assert_array_equal(given[1], expected[0])
    with pytest.raises(ValueError, match="`state` must have the keys"):
        one.set_state({}, ROWS[:2])


def test_late_messages_end_where_prompt_ones_do() -> None:
    """Each is used at the time it was made for: once all have come, nothing is lost by their delay."""
    samples, _ = simulate(60, seed=6)
    prompt, delayed = run(samples), run(late(samples, 5, 6), window=5)
    assert_array_equal(delayed.estimate.points, prompt.estimate.points)
    assert_allclose(delayed.estimate.pose, prompt.estimate.pose, rtol=1e-12)
    assert_allclose(delayed.estimate.pose_covariance, prompt.estimate.pose_covariance, rtol=1e-12)


def test_without_messages_the_pose_is_predicted_only() -> None:
    samples, _ = simulate(40, seed=7)
    arrived: NDArray[np.uint64] = samples.arrived.copy()
    arrived[:, 20:] = 0
    before, after = run(take(samples, 0, 20)), run(samples._replace(arrived=arrived))
    spread = np.linalg.det(after.estimate.pose_covariance) / np.linalg.det(before.estimate.pose_covariance)
    assert (spread > 1.0).all()


def test_robots_that_never_look_at_once_need_what_they_remember() -> None:
    samples, _ = simulate(40, seed=10, seen=1.0)
    samples.seen[:, ::2, 0] = samples.seen[:, 1::2, 1] = False
    spread = []
    for use_unseen in (False, True):
        estimator = make(InverseDepthConfig(use_unseen=use_unseen), 1, 2, len(POINTS))
        estimator.reset(prior(1), ROWS[:1])
        estimator.update(samples, ROWS[:1])
        spread.append(np.sqrt(estimator.estimate.pose_covariance[0, :, 2, 2]))
    assert (spread[0] >= 1.0).all()
    assert (spread[1] < 0.2).all()


def test_a_bearing_alone_says_nothing_of_the_height() -> None:
    samples, _ = simulate(20, seed=8)
    samples.image[..., 1] = np.nan
    estimate = run(samples).estimate
    assert all(np.isfinite(field).all() for field in estimate)
    assert (estimate.points_covariance[..., 1, 1][estimate.known] > 0.5).all()


def test_what_does_not_fit_is_refused() -> None:
    samples, _ = simulate(3, seed=9)
    estimator = make("inverse-depth", 1, 2, len(POINTS))
    with pytest.raises(RuntimeError, match="must be reset before"):
        estimator.update(samples, ROWS[:1])
    estimator.reset(prior(1), ROWS[:1])
    with pytest.raises(IndexError, match=r"`rows` must lie in \[0, 1\)"):
        estimator.update(samples, ROWS[1:2])
    with pytest.raises(ValueError, match="ages below the message window, 1 samples"):
        estimator.update(late(samples, 3, 1), ROWS[:1])
