from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from relloc_env.logs import Log
from relloc_env.replay import scores

MakeLog = Callable[..., Log]


def exact_trace(log: Log) -> scores.Trace:
    """Believe the truth, with unit covariances."""
    truth = log.truth
    assert truth is not None
    count, robots, points = len(log), len(log.robots), len(log.points)
    side = truth.points[None, None, :, :2] - truth.poses[:, :, None, :2]
    reach = np.hypot(side[..., 0], side[..., 1])
    beta = np.arctan2(side[..., 1], side[..., 0]) - truth.poses[:, :, None, 2]
    polar = np.stack([beta, truth.points[:, 2] / reach, 1.0 / reach], axis=-1)
    covariance = np.broadcast_to(np.diag([1e-4, 1e-4, 1e-6]), (count, robots, points, 3, 3)).copy()
    known = np.ones((count, robots, points), dtype=np.bool_)
    return scores.Trace(polar, covariance, known, truth.relative.copy(), np.tile(np.eye(3) * 0.01, (count, 2, 1, 1)))


def test_the_band_is_that_of_chi_squared() -> None:
    assert chi2.ppf([0.025, 0.975], 3) == pytest.approx(scores.NEES_BAND, abs=1e-3)
    assert chi2.median(3) == pytest.approx(scores.NEES_MEDIAN, abs=1e-3)


def test_the_truth_scores_no_error(make_log: MakeLog) -> None:
    log = make_log(5.0)
    trace = exact_trace(log)
    errors = scores.depth_errors(log, trace)
    np.testing.assert_allclose(errors.error, 0.0, atol=1e-12)
    pose = scores.pose_errors(log, trace, 0, 0, 1)
    np.testing.assert_allclose(pose.error, 0.0, atol=1e-12)
    assert pose.exists.all()
    summary = scores.summarise_pose(scores.per_second(log.time, pose))
    assert summary["median_position_error_m"] == pytest.approx(0.0, abs=1e-12)
    assert summary["seconds_with_estimate"] == summary["seconds_with_two_common_points"] == 6


def test_depth_errors_and_their_spread_by_sampling(make_log: MakeLog) -> None:
    log = make_log(1.0)
    trace = exact_trace(log)
    assert log.truth is not None
    rng = np.random.default_rng(1)
    mean, covariance = trace.points[0, 0, 0], trace.points_covariance[0, 0, 0]
    drawn = rng.multivariate_normal(mean, covariance, 200_000)
    spread = np.std(np.cos(drawn[:, 0]) / drawn[:, 2])
    assert scores.depth_errors(log, trace).sd[0, 0, 0] == pytest.approx(spread, rel=0.01)
    trace.points[..., 2] /= 1.1
    np.testing.assert_allclose(scores.depth_errors(log, trace).error, 0.1 * log.truth.depth, rtol=1e-9)


def test_nothing_is_scored_out_of_sight_or_unknown(make_log: MakeLog) -> None:
    log = make_log(2.0)
    log.samples.seen[0, 3, 1, 2] = False
    trace = exact_trace(log)
    trace.known[5, 0, 1] = False
    missing = np.isnan(scores.depth_errors(log, trace).error)
    assert missing[3, 1, 2]
    assert missing[5, 0, 1]
    assert missing.sum() == 2


def test_tracks_by_hand(make_log: MakeLog) -> None:
    log = make_log(4.0)
    trace = exact_trace(log)
    errors = scores.depth_errors(log, trace)
    errors.error[:, 0, 0] = 1.0 - 0.05 * np.arange(21)
    errors.error[:4, 0, 0] = np.nan
    tracks = scores.score_tracks(log, errors)
    assert len(tracks) == 6
    track = next(t for t in tracks if t["robot"] == "robot_a" and t["point"] == "p1")
    assert track["from_s"] == pytest.approx(0.8)
    assert track["initial_error_m"] == pytest.approx(0.8)
    assert track["final_error_m"] == pytest.approx(0.0, abs=1e-12)
    assert track["time_to_10_percent_s"] == pytest.approx((19 - 4) * 0.2)
    assert scores.summarise_tracks(tracks)["tracks"] == 6


def test_pose_errors_wrap_and_count_in_units_of_the_covariance(make_log: MakeLog) -> None:
    log = make_log(1.0)
    trace = exact_trace(log)
    trace.pose[:, 1, 2] += 2.0 * np.pi + 0.1
    trace.pose[:, 1, 0] += 0.2
    errors = scores.pose_errors(log, trace, 1, 1, 0)
    np.testing.assert_allclose(errors.error[:, 2], 0.1)
    np.testing.assert_allclose(errors.nees, (0.2**2 + 0.1**2) / 0.01)


def test_nees_of_a_full_covariance_is_that_of_numpy(make_log: MakeLog) -> None:
    log = make_log(4.0)
    trace = exact_trace(log)
    rng = np.random.default_rng(6)
    for t in range(len(log)):
        root = rng.standard_normal((3, 3)) * np.array([[1e-3], [1.0], [10.0]])
        trace.pose_covariance[t, 0] = root @ root.T
    trace.pose[:, 0] += rng.standard_normal((len(log), 3)) * [1e-3, 0.1, 0.1]
    errors = scores.pose_errors(log, trace, 0, 0, 1)
    wanted = [e @ np.linalg.inv(c) @ e for e, c in zip(errors.error, errors.covariance, strict=True)]
    np.testing.assert_allclose(errors.nees, wanted, rtol=1e-5)


def test_an_estimate_exists_where_it_is_certain_enough_and_two_points_are_shared(make_log: MakeLog) -> None:
    log = make_log(4.0)
    trace = exact_trace(log)
    trace.known[:5, 1, 1:] = False
    trace.pose_covariance[5, 0, 2, 2] = 0.6**2
    trace.pose_covariance[6, 0, 0, 0] = 1.6**2
    trace.pose[7, 0] = np.inf
    errors = scores.pose_errors(log, trace, 0, 0, 1)
    assert np.flatnonzero(~errors.exists).tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert np.flatnonzero(~errors.shared).tolist() == [0, 1, 2, 3, 4]


def test_one_value_a_second() -> None:
    time = np.array([0.2, 0.9, 1.1, 3.5, 3.6])
    assert scores.by_second(time).tolist() == [1, 2, 4]
