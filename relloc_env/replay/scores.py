"""Scores of a replay: what the estimator believed, held against the truth. Pure functions of arrays."""

from typing import Any, NamedTuple

import numpy as np

from relloc_env.logs.source import Log, Truth
from relloc_env.metrics import TrajectoryBound, chi2_quantile, convergence_time, nees, nees_band
from relloc_env.samples import Bool, Float

NEES_BAND = nees_band(3)
"""Interval that holds 95 % of a consistent filter's NEES of a pose: quantiles of chi squared with 3 degrees."""
RATIO_BAND = (float(np.sqrt(NEES_BAND[0] / 3.0)), float(np.sqrt(NEES_BAND[1] / 3.0)))
"""Interval that holds 95 % of the whitened errors of an estimator at the bound."""
NEES_MEDIAN = chi2_quantile(0.5, 3)
"""Median of chi squared with 3 degrees of freedom."""
SETTLED = 0.1
"""Part of the first depth error below which a track counts as converged."""
CERTAIN = (1.5, 0.5)
"""[m, rad] an estimate of the pose exists where the filter claims at most these standard deviations."""
SURE = 0.2
"""[m] an estimator is sure of a depth where it claims at most this standard deviation."""


class Trace(NamedTuple):
    """What an estimator believed after each of the T samples of a log."""

    points: Float
    """[rad, -, 1/m] (T, R, M, 3) polar points."""
    points_covariance: Float
    """(T, R, M, 3, 3)."""
    known: Bool
    """(T, R, M)."""
    pose: Float
    """[m, m, rad] (T, P, 3)."""
    pose_covariance: Float
    """(T, P, 3, 3)."""


class DepthErrors(NamedTuple):
    """Errors of the depth along the optical axis, where a point is seen; NaN elsewhere."""

    error: Float
    """[m] (T, R, M) estimate minus truth."""
    sd: Float
    """[m] (T, R, M) claimed standard deviation."""
    against_sensor: Float
    """[m] (T, R, M) estimate minus the depth by another sensor."""
    bound_sd: Float
    """[m] (T, R, M) least standard deviation by the information bound; NaN where there is none."""


def depth_errors(log: Log, trace: Trace, bound: TrajectoryBound | None = None) -> DepthErrors:
    """Depth errors at the sights of each point: Z = cos(beta)/rho."""
    truth = _truth(log)
    beta, rho = trace.points[..., 0], trace.points[..., 2]
    valid = log.samples.seen[0] & trace.known & (rho > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(valid, np.cos(beta) / rho, np.nan)
        by_beta, by_rho = -np.sin(beta) / rho, -np.cos(beta) / rho**2
        c = trace.points_covariance
        variance = by_beta**2 * c[..., 0, 0] + 2 * by_beta * by_rho * c[..., 0, 2] + by_rho**2 * c[..., 2, 2]
        sd = np.where(valid, np.sqrt(np.maximum(variance, 0.0)), np.nan)
    sensed = np.full_like(depth, np.nan) if truth.sensed_depth is None else truth.sensed_depth
    least = np.full_like(depth, np.nan) if bound is None else np.sqrt(bound.points[..., 0, 0])
    return DepthErrors(depth - truth.depth, sd, depth - sensed, least)


def score_tracks(log: Log, errors: DepthErrors) -> list[dict[str, Any]]:
    """Scores of each (robot, point) with a known depth, in the order of first sight."""
    time, tracks = log.time, []
    for r, robot in enumerate(log.robots):
        for m, point in enumerate(log.points):
            at = np.flatnonzero(np.isfinite(errors.error[:, r, m]))
            if at.size < 2:
                continue
            error = errors.error[at, r, m]
            goal = max(SETTLED * abs(float(error[0])), 1e-9)
            since = time[at] - time[at[0]]
            last = np.append(np.diff(since) > 0.0, True)  # of those with one time stamp
            settled = float(convergence_time(since[last], error[last], goal))
            sensed = errors.against_sensor[at, r, m]
            tracks.append(
                {
                    "robot": robot,
                    "point": point,
                    "from_s": float(time[at[0]]),
                    "to_s": float(time[at[-1]]),
                    "sights": int(at.size),
                    "initial_error_m": float(error[0]),
                    "final_error_m": float(error[-1]),
                    "time_to_10_percent_s": settled if np.isfinite(settled) else None,
                    "final_error_against_sensor_m": _or_none(sensed[-1]),
                    "final_sd_m": float(errors.sd[at[-1], r, m]),
                    "final_bound_sd_m": _or_none(errors.bound_sd[at[-1], r, m]),
                }
            )
    return sorted(tracks, key=lambda track: (track["from_s"], track["robot"], track["point"]))


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def summarise_tracks(tracks: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over tracks."""
    if not tracks:
        return {"tracks": 0}
    first, last = (np.abs([track[key] for track in tracks]) for key in ("initial_error_m", "final_error_m"))
    settled = [t["time_to_10_percent_s"] for t in tracks if t["time_to_10_percent_s"] is not None]
    sensed = [abs(t["final_error_against_sensor_m"]) for t in tracks if t["final_error_against_sensor_m"] is not None]
    ratio = [t["final_error_m"] / t["final_bound_sd_m"] for t in tracks if t["final_bound_sd_m"] is not None]
    sure = [abs(t["final_error_m"]) for t in tracks if t["final_sd_m"] <= SURE]
    return {
        "tracks": len(tracks),
        "median_initial_error_m": float(np.median(first)),
        "median_final_error_m": float(np.median(last)),
        "median_final_error_against_sensor_m": float(np.median(sensed)) if sensed else None,
        "sure_tracks": len(sure),
        "median_final_error_where_sure_m": float(np.median(sure)) if sure else None,
        "whitened_final_error": float(np.sqrt(np.mean(np.square(ratio)))) if ratio else None,
        "settled_tracks": len(settled),
        "median_time_to_10_percent_s": float(np.median(settled)) if settled else None,
    }


class PoseErrors(NamedTuple):
    """Errors of the relative pose of one ordered pair."""

    error: Float
    """[m, m, rad] (T, 3) estimate minus truth, angle wrapped; NaN where the truth is not known."""
    covariance: Float
    """(T, 3, 3) claimed."""
    nees: Float
    """(T,) error in units of the claimed covariance, squared."""
    shared: Bool
    """(T,) whether both maps hold two common points: the least from which the pose follows. Of an estimator without
    maps: whether both robots have seen two."""
    exists: Bool
    """(T,) whether an estimate exists: shared, and the claimed standard deviations are within `CERTAIN`."""
    bound: Float | None = None
    """(T, 3, 3) information bound of the covariance; None where there is none."""
    ratio: Float | None = None
    """(T,) whitened error: the root of eᵀ C⁻¹ e / 3 with C the bound; root mean square 1 at the bound."""


def pose_errors(
    log: Log, trace: Trace, pair: int, observer: int, observed: int, bound: TrajectoryBound | None = None
) -> PoseErrors:
    """Errors over time of one ordered pair."""
    finite = np.isfinite(trace.pose[:, pair].sum(axis=1))
    error = np.where(finite[:, None], trace.pose[:, pair], np.nan) - _truth(log).relative[:, pair]
    error[:, 2] = np.mod(error[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    covariance = trace.pose_covariance[:, pair]
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    usable = finite & np.isfinite(covariance).all(axis=(1, 2)) & (variance > 0.0).all(axis=1)
    honest = np.full(len(error), np.nan)
    # Divided by the standard deviations first, so that a tiny covariance is still told from a singular one.
    sd = np.sqrt(variance[usable])
    whitened = error[usable] / sd
    correlation = covariance[usable] / (sd[:, :, None] * sd[:, None, :]) + 1e-12 * np.eye(3)
    honest[usable] = np.einsum("ti,ti->t", whitened, np.linalg.solve(correlation, whitened[..., None])[..., 0])
    # An estimator that keeps no map is judged from when both robots have seen two common points.
    held = trace.known if trace.known.any() else np.logical_or.accumulate(log.samples.seen[0], axis=0)
    shared = (held[:, observer] & held[:, observed]).sum(axis=1) >= 2
    spread = np.sqrt(np.maximum(variance[:, 0] + variance[:, 1], 0.0))
    certain = usable & (spread <= CERTAIN[0]) & (np.sqrt(np.maximum(variance[:, 2], 0.0)) <= CERTAIN[1])
    if bound is None:
        return PoseErrors(error, covariance, honest, shared, shared & certain)
    least = bound.pose[:, pair]
    return PoseErrors(error, covariance, honest, shared, shared & certain, least, np.sqrt(nees(error, least) / 3.0))


def by_second(time: Float) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Index of the last sample in each second."""
    second = np.floor(time)
    return np.flatnonzero(np.append(np.diff(second) > 0, True))


class PoseSeries(NamedTuple):
    """Sizes of the errors once a second, where an estimate exists and the truth is known."""

    position: Float
    """[m]."""
    heading: Float
    """[rad] size."""
    nees: Float
    ratio: Float
    """Whitened errors; NaN where there is no bound."""
    seconds_shared: int
    """Seconds in which that was so, see `PoseErrors.shared`, and the truth is known."""


def per_second(time: Float, errors: PoseErrors) -> PoseSeries:
    """Take one value a second."""
    at = by_second(time)
    at = at[np.isfinite(errors.error[at]).all(axis=1)]
    kept = at[errors.exists[at]]
    return PoseSeries(
        np.hypot(errors.error[kept, 0], errors.error[kept, 1]),
        np.abs(errors.error[kept, 2]),
        errors.nees[kept],
        np.full(len(kept), np.nan) if errors.ratio is None else errors.ratio[kept],
        int(errors.shared[at].sum()),
    )


def join(parts: list[PoseSeries]) -> PoseSeries:
    """All seconds of several pairs."""
    return PoseSeries(
        np.concatenate([p.position for p in parts]),
        np.concatenate([p.heading for p in parts]),
        np.concatenate([p.nees for p in parts]),
        np.concatenate([p.ratio for p in parts]),
        sum(p.seconds_shared for p in parts),
    )


def summarise_pose(series: PoseSeries) -> dict[str, Any]:
    """Medians, root mean squares, consistency and whitened error over the seconds in which an estimate existed."""
    seconds = len(series.position)
    summary: dict[str, Any] = {
        "seconds_with_two_common_points": series.seconds_shared,
        "seconds_with_estimate": seconds,
    }
    if not seconds:
        return summary
    heading = np.degrees(series.heading)
    honest = series.nees[np.isfinite(series.nees)]
    low, high = NEES_BAND
    summary |= {
        "median_position_error_m": float(np.median(series.position)),
        "rmse_position_m": float(np.sqrt(np.mean(series.position**2))),
        "q90_position_error_m": float(np.quantile(series.position, 0.9)),
        "median_heading_error_deg": float(np.median(heading)),
        "rmse_heading_deg": float(np.sqrt(np.mean(heading**2))),
        "q90_heading_error_deg": float(np.quantile(heading, 0.9)),
        "median_nees": float(np.median(honest)) if honest.size else None,
        "nees_in_band": float(np.mean((honest >= low) & (honest <= high))) if honest.size else None,
        "whitened_error": float(np.sqrt(np.mean(series.ratio**2))) if np.isfinite(series.ratio).all() else None,
    }
    return summary


def bound_by_second(time: Float, errors: PoseErrors) -> dict[str, Any] | None:
    """The bound of one ordered pair as plain data, once a second; None where there is none."""
    if errors.bound is None:
        return None
    at = by_second(time)
    sd = np.sqrt(np.diagonal(errors.bound[at], axis1=1, axis2=2))
    return {
        "time_s": time[at].round(6).tolist(),
        "sd_x_m": [_or_none(value) for value in sd[:, 0]],
        "sd_y_m": [_or_none(value) for value in sd[:, 1]],
        "sd_heading_deg": [_or_none(value) for value in np.degrees(sd[:, 2])],
    }


def _truth(log: Log) -> Truth:
    if log.truth is None:
        raise ValueError("Argument `log` must hold the truth to be scored, but does not")
    return log.truth
