"""Errors against the truth, how soon they vanish, whether an estimator's covariance is honest, and the bound.

Angles of errors are wrapped into [-pi, pi). Arrays may carry any number of leading axes where a shape says `...`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from relloc_env.kernels.bound import Bound, Noise, Prior, Scene, bound_reset, bound_step
from relloc_env.kernels.information import all_range_variances, point_covariance, pose_covariance
from relloc_env.kernels.state_layout import size_of
from relloc_env.samples import Bool, Estimate, Float, ordered_pairs


def wrap(angle: ArrayLike) -> Float:
    """Return angles [rad] wrapped into [-pi, pi)."""
    angle = np.asarray(angle, dtype=np.float64)
    return angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))


def first_crossing(times: ArrayLike, errors: ArrayLike, threshold: float) -> Float:
    """First time at which |error| is below the threshold.

    Args:
        times: [s] (T,) increasing.
        errors: (..., T); NaN counts as not below.
        threshold: positive, in the unit of the errors.

    Returns:
        [s] (...,); inf where it never is.
    """
    stamps, below = _below(times, errors, threshold)
    first = np.argmax(below, axis=-1)
    return np.where(below.any(axis=-1), stamps[first], np.inf)


def convergence_time(times: ArrayLike, errors: ArrayLike, threshold: float) -> Float:
    """First time from which |error| stays below the threshold to the end; arguments as of `first_crossing`.

    Returns:
        [s] (...,); inf where the last error is not below.
    """
    stamps, below = _below(times, errors, threshold)
    trailing = np.logical_and.accumulate(below[..., ::-1], axis=-1).sum(axis=-1)
    return np.where(trailing > 0, stamps[np.minimum(stamps.size - trailing, stamps.size - 1)], np.inf)


def _below(times: ArrayLike, errors: ArrayLike, threshold: float) -> tuple[Float, Bool]:
    stamps, values = np.asarray(times, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    if stamps.ndim != 1 or stamps.size == 0 or not np.all(np.diff(stamps) > 0.0):
        raise ValueError(f"Argument `times` must be a list of increasing times, but is {times!r}.")
    if values.shape[-1:] != stamps.shape:
        raise ValueError(f"Argument `errors` must have shape (..., {stamps.size}), but has {values.shape}.")
    if not threshold > 0.0:
        raise ValueError(f"Argument `threshold` must be positive, but is {threshold!r}.")
    return stamps, np.abs(values) < threshold


def rmse(errors: ArrayLike, axis: int | tuple[int, ...] | None = None) -> Float:
    """Root of the mean square of the errors along `axis` (None: of all)."""
    return np.asarray(np.sqrt(np.mean(np.square(np.asarray(errors, dtype=np.float64)), axis=axis)))


def nees(errors: ArrayLike, covariance: ArrayLike) -> Float:
    """Normalised estimation error squared, eᵀ P⁻¹ e: chi² with d degrees of freedom where P is right.

    Args:
        errors: (..., d).
        covariance: (..., d, d) symmetric, positive definite.

    Returns:
        (...,); mean d. Infinite where the covariance is singular, or anything is not a number.
    """
    e, p = np.asarray(errors, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    if p.shape[-2:] != 2 * e.shape[-1:]:
        size = e.shape[-1]
        raise ValueError(f"Argument `covariance` must have shape (..., {size}, {size}), but has {p.shape}.")
    regular: Bool = np.asarray(np.isfinite(e).all(axis=-1) & np.isfinite(p).all(axis=(-2, -1)))
    regular &= np.linalg.slogdet(np.where(regular[..., None, None], p, 0.0))[0] > 0.0
    solved = np.linalg.solve(np.where(regular[..., None, None], p, np.eye(e.shape[-1])), e[..., None])[..., 0]
    return np.where(regular, np.sum(e * solved, axis=-1), np.inf)


def whitened_error(errors: ArrayLike, bound: ArrayLike, axis: int | tuple[int, ...] | None = None) -> Float:
    """Errors in units of a bound C: the root of mean(eᵀ C⁻¹ e)/d along `axis`; 1 for an estimator at the bound."""
    return np.asarray(np.sqrt(np.mean(nees(errors, bound), axis=axis) / np.shape(errors)[-1]))


def nees_band(dimension: int, count: int = 1, probability: float = 0.95) -> tuple[float, float]:
    """Interval in which the mean NEES of `count` independent errors lies with the given probability.

    Args:
        dimension: d of the errors.
        count: number of errors in the mean.
        probability: of lying inside; both tails are alike.
    """
    if dimension < 1 or count < 1:
        raise ValueError(f"Arguments `dimension` and `count` must be positive, but are {dimension} and {count}.")
    tail = 0.5 * (1.0 - probability)
    freedom = dimension * count
    return chi2_quantile(tail, freedom) / count, chi2_quantile(1.0 - tail, freedom) / count


def chi2_quantile(probability: float, freedom: float) -> float:
    """Value below which a chi² variable with `freedom` degrees lies with the given probability, by bisection."""
    if not 0.0 < probability < 1.0:
        raise ValueError(f"Argument `probability` must be between 0 and 1, but is {probability!r}.")
    low, high = 0.0, freedom + 10.0
    while _chi2_below(high, freedom) < probability:
        high *= 2.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _chi2_below(middle, freedom) < probability else (low, middle)
    return 0.5 * (low + high)


def _chi2_below(value: float, freedom: float) -> float:
    """Distribution function: the regularised lower incomplete gamma function P(k/2, x/2), by its series."""
    a, x = 0.5 * freedom, 0.5 * value
    if x == 0.0:
        return 0.0
    term = total = 1.0
    n = a
    while term > 1e-17 * total:
        n += 1.0
        term *= x / n
        total += term
    return math.exp(a * math.log(x) - x - math.lgamma(a + 1.0)) * total


class PointErrors(NamedTuple):
    """Estimate minus truth, of each point for each robot; NaN where the robot has not seen the point yet."""

    depth: Float
    """[m] (N, R, M) of the depth along the optical axis, z = cos(beta)/rho."""
    range: Float
    """[m] (N, R, M) of the horizontal range, 1/rho."""
    polar: Float
    """[rad, -, 1/m] (N, R, M, 3) of (beta, eta, rho), to be held against `Estimate.points_covariance`."""


def point_errors(estimate: Estimate, poses: Float, points: Float, camera_heights: Float) -> PointErrors:
    """Errors of the estimated points.

    Args:
        estimate: of N environments.
        poses: [m, m, rad] (N, R, 3) true poses, {W}.
        points: [m] (N, M, 3) true points, {W}.
        camera_heights: [m] (R,) or (N, R) of the cameras, {W}.
    """
    to = points[:, None, :, :2] - poses[:, :, None, :2]
    distance = np.linalg.norm(to, axis=-1)
    beta = np.arctan2(to[..., 1], to[..., 0]) - poses[:, :, None, 2]
    height = points[:, None, :, 2] - np.broadcast_to(camera_heights, poses.shape[:2])[..., None]
    guess_beta, guess_eta, rho = np.moveaxis(estimate.points, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        guess_range = 1.0 / rho
        depth = np.cos(guess_beta) * guess_range - np.cos(beta) * distance
    polar = np.stack([wrap(guess_beta - beta), guess_eta - height / distance, rho - 1.0 / distance], axis=-1)
    known = estimate.known
    return PointErrors(
        depth=np.where(known, depth, np.nan),
        range=np.where(known, guess_range - distance, np.nan),
        polar=np.where(known[..., None], polar, np.nan),
    )


def relative_poses(poses: Float) -> Float:
    """Pose xi of each ordered pair's observed robot in its observer's frame, [m, m, rad] (..., P, 3).

    Args:
        poses: [m, m, rad] (..., R, 3) in {W}.
    """
    pairs = ordered_pairs(poses.shape[-2])
    observer, observed = poses[..., pairs[:, 0], :], poses[..., pairs[:, 1], :]
    d_x, d_y = observed[..., 0] - observer[..., 0], observed[..., 1] - observer[..., 1]
    cos, sin = np.cos(observer[..., 2]), np.sin(observer[..., 2])
    turn = wrap(observed[..., 2] - observer[..., 2])
    return np.stack([cos * d_x + sin * d_y, cos * d_y - sin * d_x, turn], axis=-1)


def pose_errors(estimate: Estimate, poses: Float) -> Float:
    """Estimated minus true xi of each ordered pair, [m, m, rad] (N, P, 3).

    Args:
        estimate: of N environments.
        poses: [m, m, rad] (N, R, 3) true poses, {W}.
    """
    error = estimate.pose - relative_poses(poses)
    error[..., 2] = wrap(error[..., 2])
    return error


class TrajectoryBound(NamedTuple):
    """Posterior Cramér-Rao bound after each sample of a trajectory."""

    pose: Float
    """[m, m, rad] (T, P, 3, 3) covariance of xi of each ordered pair."""
    points: Float
    """[m] (T, R, M, 3, 3) covariance of (depth, left, height above the camera) of each point in each body frame."""


def trajectory_bound(
    period: Float,
    poses: Float,
    points: Float,
    velocity: Float,
    visible: Bool,
    camera_heights: Float,
    *,
    image_sd: ArrayLike,
    speed_sd: ArrayLike,
    turn_sd: ArrayLike,
    depth_sd: ArrayLike = 1.0,
    pose_sd: ArrayLike = (1.5, 1.5, math.pi / 3.0),
    height_sd: float | None = None,
    scale_sd: tuple[float, float] | None = None,
    unseen_sd: float = 100.0,
    vertical: bool = True,
) -> TrajectoryBound:
    """Bound along a known trajectory; what it takes as known is said in `relloc_env.kernels.bound`.

    Args:
        period: [s] (T,) length of the interval before each sample; 0 for the first.
        poses: [m, m, rad] (T, R, 3) true poses at the samples, {W}.
        points: [m] (M, 3) true points, {W}.
        velocity: [m/s, m/s, rad/s] (T, R, 3) true forward, lateral and yaw rate over that interval.
        visible: (T, R, M) whether the robot has the image of the point in the sample.
        camera_heights: [m] (R,) of the cameras, {W}.
        image_sd: [-] noise of each normalised image coordinate, of each robot (R,) or of all.
        speed_sd, turn_sd: [m/s, rad/s] odometry noise of each sample, likewise.
        depth_sd: [m] guess of a depth at first sight, of each robot (R,) or of all; inf: none.
        pose_sd: [m, m, rad] (3,) prior of each other robot's pose in the frame of the first.
        height_sd: [m] prior of each difference of camera heights; None: known exactly.
        scale_sd: [-] prior of the scales of each robot's speed and yaw rate; None: known exactly.
        unseen_sd: [m] prior of each coordinate of a point before its first sight.
        vertical: whether images have their second coordinate.

    Raises:
        ValueError: images, depths or poses that are told without any error.
    """
    samples, robots, count = np.shape(visible)
    pairs, size = (
        ordered_pairs(robots),
        size_of(robots, count, heights=height_sd is not None, scales=scale_sd is not None),
    )
    noise = Noise(*(
        np.ascontiguousarray(np.broadcast_to(np.asarray(sd, dtype=np.float64), robots))
        for sd in (speed_sd, turn_sd, image_sd, depth_sd)
    ))  # fmt: skip
    prior = Prior(
        np.asarray(pose_sd, dtype=np.float64), float(unseen_sd), float(height_sd or 0.0), *(scale_sd or (0.0, 0.0))
    )
    for name, sd in (("image_sd", noise.image_sd), ("depth_sd", noise.depth_sd), ("pose_sd", prior.pose_sd)):
        if not np.all(sd > 0.0):
            raise ValueError(f"Argument `{name}` must be above 0, but is {sd.tolist()}")
    sighted = np.zeros((robots, count), dtype=np.bool_)
    bound, origin = Bound(np.zeros((size, size)), np.zeros(size), sighted, np.zeros((4, size))), poses[0, 0, :2].copy()
    bound_reset(bound, Scene(poses[0], points, camera_heights, origin), prior)
    result = TrajectoryBound(np.zeros((samples, len(pairs), 3, 3)), np.zeros((samples, robots, count, 3, 3)))
    for s in range(samples):
        scene = Scene(poses[s], points, camera_heights, origin)
        bound_step(bound, scene, noise, visible[s], velocity[s], period[s], vertical)
        for p, (a, b) in enumerate(pairs):
            pose_covariance(bound, scene, a, b, result.pose[s, p])
        for robot in range(robots):
            for i in range(count):
                point_covariance(bound, scene, robot, i, result.points[s, robot, i])
    return result


def bound_range_sd(factor: Float, variances: Float, poses: Float, points: Float, origin: Float) -> Float:
    """Standard deviation of the horizontal range of each point from each robot, by the bound, [m] (N, R, M).

    Args:
        factor, variances: (N, D, D) and (N, D), as in `relloc_env.kernels.bound`.
        poses: [m, m, rad] (N, R, 3) true poses, {W}.
        points: [m] (N, M, 3) true points, {W}.
        origin: [m] (N, 2) what the bound is about, {W}.
    """
    variance = np.zeros((*poses.shape[:2], points.shape[1]))
    all_range_variances(factor, variances, poses, points, origin, variance)
    return np.sqrt(variance)
