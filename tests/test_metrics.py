"""Metrics on cases whose answers are known by hand, or from SciPy."""

import math

import numpy as np
import pytest
from scipy import stats

from relloc_env import metrics
from relloc_env.samples import Estimate, Float

TIMES = np.arange(5) * 0.5


def test_wrap() -> None:
    angles = [-3.5 * math.pi, -math.pi, 0.0, math.pi, 7.0]
    np.testing.assert_allclose(metrics.wrap(angles), [0.5 * math.pi, -math.pi, 0.0, -math.pi, 7.0 - 2.0 * math.pi])


@pytest.mark.parametrize(
    ("errors", "first", "stays"),
    [
        ([1.0, -0.05, 0.2, 0.05, -0.01], 0.5, 1.5),
        ([0.0, 0.0, 0.0, 0.0, 0.0], 0.0, 0.0),
        ([0.0, 0.0, 0.0, 0.0, -1.0], 0.0, math.inf),
        ([1.0, 1.0, 1.0, 1.0, 0.0], 2.0, 2.0),
        ([0.1, 0.1, 0.1, 0.1, 0.1], math.inf, math.inf),
        ([math.nan, 0.0, math.nan, 0.0, 0.0], 0.5, 1.5),
    ],
)
def test_times_of_convergence(errors: list[float], first: float, stays: float) -> None:
    assert metrics.first_crossing(TIMES, errors, 0.1) == first
    assert metrics.convergence_time(TIMES, errors, 0.1) == stays


def test_times_of_convergence_of_many() -> None:
    errors = np.array([[[1.0, 0.0, 1.0, 0.0, 0.0]], [[1.0, 1.0, 1.0, 1.0, 1.0]]])
    np.testing.assert_array_equal(metrics.first_crossing(TIMES, errors, 0.1), [[0.5], [math.inf]])
    np.testing.assert_array_equal(metrics.convergence_time(TIMES, errors, 0.1), [[1.5], [math.inf]])


def test_times_of_convergence_refuse_bad_input() -> None:
    with pytest.raises(ValueError, match=r"`times` must be a list of increasing times"):
        metrics.first_crossing([0.0, 0.0], [1.0, 1.0], 0.1)
    with pytest.raises(ValueError, match=r"`errors` must have shape \(..., 5\), but has \(4,\)"):
        metrics.convergence_time(TIMES, [1.0] * 4, 0.1)
    with pytest.raises(ValueError, match=r"`threshold` must be positive, but is 0.0"):
        metrics.convergence_time(TIMES, [1.0] * 5, 0.0)


def test_rmse() -> None:
    errors = [[3.0, 0.0], [4.0, 0.0]]
    assert metrics.rmse(errors) == 2.5
    np.testing.assert_allclose(metrics.rmse(errors, axis=0), [math.sqrt(12.5), 0.0])


def test_nees_and_whitened_error() -> None:
    covariance = np.array([[[4.0, 0.0], [0.0, 1.0]], [[2.0, 1.0], [1.0, 2.0]]])
    errors = np.array([[2.0, 3.0], [1.0, -1.0]])
    np.testing.assert_allclose(metrics.nees(errors, covariance), [10.0, 2.0])
    assert metrics.whitened_error(errors, covariance) == pytest.approx(math.sqrt(3.0))
    np.testing.assert_allclose(
        metrics.whitened_error(errors[:, None], covariance[:, None], axis=1), [math.sqrt(5.0), 1.0]
    )
    with pytest.raises(ValueError, match=r"`covariance` must have shape \(..., 2, 2\), but has \(3, 3\)"):
        metrics.nees(errors, np.eye(3))


def test_nees_of_right_covariances() -> None:
    """10^5 draws from a random covariance in 3 dimensions: chi² with 3 degrees of freedom."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    errors = rng.normal(size=(100_000, 3)) @ root.T
    values = metrics.nees(errors, root @ root.T)
    assert stats.kstest(values, stats.chi2(3).cdf).pvalue > 1e-3
    low, high = metrics.nees_band(3, len(values), 0.999)
    assert low < values.mean() < high


@pytest.mark.parametrize("freedom", [1, 2, 3, 10, 300, 30_000])
@pytest.mark.parametrize("probability", [1e-6, 0.025, 0.5, 0.95, 0.999])
def test_chi2_quantile(freedom: int, probability: float) -> None:
    assert metrics.chi2_quantile(probability, freedom) == pytest.approx(stats.chi2.ppf(probability, freedom), rel=1e-8)


def test_nees_band() -> None:
    assert metrics.nees_band(3) == pytest.approx(stats.chi2.ppf([0.025, 0.975], 3))
    assert metrics.nees_band(3, 50, 0.9) == pytest.approx(stats.chi2.ppf([0.05, 0.95], 150) / 50)
    with pytest.raises(ValueError, match="must be positive, but are 0 and 1"):
        metrics.nees_band(0)
    with pytest.raises(ValueError, match="`probability` must be between 0 and 1"):
        metrics.nees_band(3, probability=1.0)


def _estimate(points: Float, pose: Float, known: bool = True) -> Estimate:
    robots, count = points.shape[1:3]
    return Estimate(
        points=points,
        points_covariance=np.zeros((*points.shape, 3)),
        known=np.full((1, robots, count), known),
        pose=pose,
        pose_covariance=np.zeros((*pose.shape, 3)),
    )


POSES = np.array([[[1.0, 2.0, math.pi / 2.0], [1.0, 5.0, math.pi]]])
POINTS = np.array([[[-2.0, 6.0, 1.2]]])
"""In {A}: 4 m ahead and 3 m to the left; in {B}: 3 m ahead and 1 m to the right."""


def test_errors_of_points() -> None:
    beta_a, beta_b = math.atan2(3.0, 4.0), math.atan2(-1.0, 3.0)
    range_b = math.sqrt(10.0)
    points = np.array([[[[beta_a, 0.2, 1.0 / 6.0]], [[beta_b + 2.0 * math.pi, 0.7 / range_b, 1.0 / range_b]]]])
    found = metrics.point_errors(_estimate(points, np.zeros((1, 2, 3))), POSES, POINTS, np.array([0.2, 0.5]))
    np.testing.assert_allclose(found.range[0, :, 0], [1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.depth[0, :, 0], [0.8, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.polar[0, :, 0], [[0.0, 0.0, 1.0 / 6.0 - 0.2], [0.0, 0.0, 0.0]], atol=1e-12)


def test_errors_of_unknown_points_are_nan() -> None:
    estimate = _estimate(np.zeros((1, 2, 1, 3)), np.zeros((1, 2, 3)), known=False)
    found = metrics.point_errors(estimate, POSES, POINTS, np.array([0.2, 0.5]))
    assert all(np.isnan(part).all() for part in found)


def test_errors_of_poses() -> None:
    """B is 3 m ahead of A, turned by 90°; A is 3 m to the left of B, turned by -90°."""
    truth = metrics.relative_poses(POSES)
    np.testing.assert_allclose(truth, [[[3.0, 0.0, math.pi / 2.0], [0.0, 3.0, -math.pi / 2.0]]], atol=1e-12)
    pose = np.array([[[3.1, -0.2, math.pi / 2.0 - 2.0 * math.pi + 0.1], [0.0, 3.0, -math.pi / 2.0]]])
    found = metrics.pose_errors(_estimate(np.zeros((1, 2, 1, 3)), pose), POSES)
    np.testing.assert_allclose(found, [[[0.1, -0.2, 0.1], [0.0, 0.0, 0.0]]], atol=1e-12)


def _still(robots: int, height_sd: float | None = None) -> metrics.TrajectoryBound:
    """One robot or two at the origin that stand still and look at a point 5 m ahead, 101 samples."""
    samples = 101
    return metrics.trajectory_bound(
        period=np.where(np.arange(samples) > 0, 0.05, 0.0),
        poses=np.zeros((samples, robots, 3)),
        points=np.array([[5.0, 0.0, 0.5]]),
        velocity=np.zeros((samples, robots, 3)),
        visible=np.ones((samples, robots, 1), dtype=np.bool_),
        camera_heights=np.zeros(robots),
        image_sd=0.002,
        speed_sd=0.0,
        turn_sd=0.0,
        height_sd=height_sd,
    )


def test_bound_at_rest() -> None:
    """Standing still, the depth keeps its guess of 1 m; z x has the sd of the mean image, z·0.002/√samples."""
    bound = _still(robots=1)
    assert bound.pose.shape == (101, 0, 3, 3)
    for samples in (1, 101):
        covariance = bound.points[samples - 1, 0, 0]
        wide = [1e-4, (0.002 * 5.0 / math.sqrt(samples)) ** -2 + 1e-4]
        assert math.sqrt(covariance[0, 0]) == pytest.approx(1.0, rel=1e-4)
        assert math.sqrt(covariance[1, 1]) == pytest.approx(wide[1] ** -0.5, rel=1e-6)


def test_bound_of_two_that_stand_together() -> None:
    """Equal camera heights tell that both depths are the same: variance 1/2 m². Without, only the prior of r_x, 1.5 m,
    ties them: 1/(1 + 1/(1 + 1.5²)) m²."""
    exact, loose = _still(robots=2), _still(robots=2, height_sd=1e3)
    assert exact.points[-1, 0, 0, 0, 0] == pytest.approx(0.5, rel=1e-3)
    assert loose.points[-1, 0, 0, 0, 0] == pytest.approx(1.0 / (1.0 + 1.0 / 3.25), rel=1e-3)
    assert exact.pose.shape == (101, 2, 3, 3)
    np.testing.assert_allclose(exact.pose[-1, 0, 2, 2], exact.pose[-1, 1, 2, 2])
