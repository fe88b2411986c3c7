"""The map-alignment estimator on simulated runs: at the bound, consistent, and indifferent to how it is fed."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from relloc_env.estimators import make
from relloc_env.estimators.config import MapAlignmentConfig
from relloc_env.estimators.map_alignment import MapAlignment
from relloc_env.kernels.motion import advance, relative
from relloc_env.samples import Prior, Samples, ordered_pairs

Float = NDArray[np.float64]

DT = 0.05
TARGETS = np.array([[7.0, 0.8, 0.4], [7.0, -1.2, 0.3]])
STARTS = np.array([[0.0, -0.8, -0.1], [0.0, 1.0, 0.25]])
INPUTS = np.array([[0.1, 0.0, 0.02], [0.1, 0.0, -0.03]])
IMAGE_NOISE, ODOMETRY_NOISE = 0.002, 0.005
CONFIG = MapAlignmentConfig(image_noise=IMAGE_NOISE, odometry_noise=(ODOMETRY_NOISE, ODOMETRY_NOISE))
POSE_SD = np.array([1.5, 1.5, np.pi / 3])


class Run(NamedTuple):
    samples: Samples
    prior: Prior
    pose: Float
    """(K, 2, 3) true relative poses, A→B and B→A."""


def simulate(
    runs: int, seconds: float, seed: int, *, missed: float = 0.0, outliers: float = 0.0, bearings: bool = False
) -> Run:
    """Noisy runs of one motion of two robots; initial errors of fixed size and random sign."""
    rng = np.random.default_rng(seed)
    steps, points = round(seconds / DT) + 1, len(TARGETS)
    image = np.empty((runs, steps, 2, points, 2))
    odometry = np.zeros((runs, steps, 2, 3))
    truth, pose, depth = STARTS.copy(), np.empty((steps, 2, 3)), np.empty((2, points))
    for k in range(steps):
        for r in range(2):
            if k:
                truth[r] = advance(*truth[r], *INPUTS[r], DT)
                odometry[:, k, r] = INPUTS[r]
                odometry[:, k, r, ::2] += ODOMETRY_NOISE * rng.normal(size=(runs, 2))
            cos, sin = np.cos(truth[r, 2]), np.sin(truth[r, 2])
            q = (TARGETS[:, :2] - truth[r, :2]) @ np.array([[cos, -sin], [sin, cos]])
            ideal = np.stack([-q[:, 1] / q[:, 0], -TARGETS[:, 2] / q[:, 0]], axis=1)
            image[:, k, r] = ideal + IMAGE_NOISE * rng.normal(size=(runs, points, 2))
            if k == 0:
                depth[r] = q[:, 0]
        for p, (a, b) in enumerate(ordered_pairs(2)):
            pose[k, p] = relative(*truth[a], *truth[b])
    wild = rng.random(image.shape[:-1]) < outliers
    image[wild] = rng.uniform(-1.0, 1.0, (int(wild.sum()), 2))
    if bearings:
        image[..., 1] = np.nan
    seen = rng.random(image.shape[:-1]) >= missed
    period = np.full((runs, steps), DT)
    period[:, 0] = 0.0
    signs = rng.choice([-1.0, 1.0], (runs, 2, 3))
    prior = Prior(depth + rng.choice([-1.0, 1.0], (runs, 2, points)), pose[0] + signs * POSE_SD, 1.0, POSE_SD)
    image = np.where(seen[..., None], image, 0.0)
    arrived = np.ones((runs, steps, 2), dtype=np.uint64)
    return Run(Samples(period, odometry.astype(np.float32), image.astype(np.float32), seen, arrived), prior, pose)


def part(samples: Samples, first: int, last: int) -> Samples:
    return Samples._make(np.ascontiguousarray(x[:, first:last]) for x in samples)


def errors(estimator: MapAlignment, run: Run, k: int) -> tuple[Float, Float]:
    """Errors (N, P, 3) after sample k, and their normalised squares (N, P)."""
    e = estimator.estimate.pose - run.pose[k]
    e[..., 2] = (e[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
    return e, np.einsum("npi,npi->np", e, np.linalg.solve(estimator.estimate.pose_covariance, e[..., None])[..., 0])


def fresh(run: Run, config: MapAlignmentConfig = CONFIG, window: int = 1) -> tuple[MapAlignment, NDArray[np.int64]]:
    n, _, robots, points = run.samples.seen.shape
    estimator, rows = MapAlignment(n, robots, points, config, message_window=window), np.arange(n)
    estimator.reset(run.prior, rows)
    return estimator, rows


def test_the_pose_is_at_the_bound_and_consistent_60_runs() -> None:
    """Bound of docs/equations.md, section 5; B's depth prior, which that one leaves out, only adds.

    Mean of 60 chi squared (3): sd 0.32. RMSE of 60: sd 9 % of itself.
    """
    run = simulate(60, 40.0, 1)
    estimator, rows = fresh(run)
    last = 0
    for seconds, bound in ((5, [0.036, 0.175, 1.5]), (10, [0.032, 0.103, 1.0]), (40, [0.008, 0.009, 0.2])):
        k = round(seconds / DT)
        estimator.update(part(run.samples, last, k + 1), rows)
        last = k + 1
        e, nees = errors(estimator, run, k)
        rmse = np.sqrt(np.mean(e[:, 0] ** 2, axis=0)) * [1.0, 1.0, np.degrees(1.0)]
        assert (rmse < 1.35 * np.array(bound)).all(), (seconds, rmse)
        assert ((nees.mean(axis=0) > 1.9) & (nees.mean(axis=0) < 4.2)).all(), (seconds, nees.mean(axis=0))
        claimed = np.sqrt(np.median(estimator.estimate.pose_covariance[:, 0, [0, 1, 2], [0, 1, 2]], axis=0))
        assert_allclose(claimed * [1.0, 1.0, np.degrees(1.0)], bound, rtol=0.15)


def test_missed_detections_and_outliers_are_borne_40_runs() -> None:
    run = simulate(40, 20.0, 2, missed=0.2, outliers=0.02)
    estimator, rows = fresh(run)
    estimator.update(run.samples, rows)
    e, nees = errors(estimator, run, -1)
    assert (np.median(nees, axis=0) < 4.0).all()
    assert (nees > 30.0).mean() <= 0.05
    assert np.median(np.hypot(e[..., 0], e[..., 1])) < 0.09


@pytest.mark.parametrize("hidden", [1, 40])
def test_a_first_sight_that_the_next_contradicts_leaves_no_trace(hidden: int) -> None:
    """Until the point is seen again, and after it: the outlier might as well not have been."""
    run = simulate(3, 4.0, 12)
    image, seen = run.samples.image.copy(), run.samples.seen.copy()
    seen[:, :hidden, :, 1] = False
    image[:, 0, :, 1] += np.float32(0.4)
    without, rows = fresh(run)
    without.update(run.samples._replace(image=image, seen=seen.copy()), rows)
    seen[:, 0, :, 1] = True
    wild, _ = fresh(run)
    wild.update(part(run.samples._replace(image=image, seen=seen), 0, hidden + 1), rows)
    assert not wild._maps.confirmed[:, 0, :, 1].any()
    wild.update(part(run.samples._replace(image=image, seen=seen), hidden + 1, 81), rows)
    for given, expected in zip(wild.estimate, without.estimate, strict=True):
        assert_array_equal(given, expected)
    assert errors(wild, run, 80)[1].max() < 25.0


def test_a_run_alone_in_a_batch_and_in_blocks_is_the_same_to_the_last_bit() -> None:
    run = simulate(3, 3.0, 3)
    whole, rows = fresh(run)
    whole.update(run.samples, rows)
    alone, _ = fresh(run)
    for first in range(0, 61, 7):
        alone.update(part(run.samples, first, min(first + 7, 61)), rows[1:2])
    for given, expected in zip(alone.estimate, whole.estimate, strict=True):
        assert_array_equal(given[1], expected[1])
    untouched, _ = fresh(run)
    assert_array_equal(alone.estimate.pose[0], untouched.estimate.pose[0])


def test_state_goes_out_and_back_in_bit_for_bit() -> None:
    run = simulate(2, 3.0, 4)
    one, rows = fresh(run, window=3)
    one.update(part(run.samples, 0, 30), rows)
    state = one.get_state(rows[:1])
    one.update(part(run.samples, 30, 61), rows)
    other, _ = fresh(run, window=3)
    other.set_state(state, rows[1:])
    swapped = Samples._make(np.ascontiguousarray(x[::-1]) for x in part(run.samples, 30, 61))
    other.update(swapped, rows[1:])
    for given, expected in zip(other.estimate, one.estimate, strict=True):
        assert_array_equal(given[1], expected[0])


def delayed(run: Run, age: int) -> Run:
    arrived = np.zeros_like(run.samples.arrived)
    arrived[:, age:] = np.uint64(1) << np.uint64(age)
    return run._replace(samples=run.samples._replace(arrived=arrived))


def test_a_message_is_used_at_the_time_it_was_made_for() -> None:
    """With messages 6 samples old, what is believed of that time is what a perfect network gave then."""
    run, age = simulate(4, 8.0, 5), 6
    perfect, rows = fresh(run)
    perfect.update(part(run.samples, 0, 161 - age), rows)
    late, _ = fresh(run, window=8)
    late.update(delayed(run, age).samples, rows)
    assert_allclose(late._pairs.anchored, perfect.estimate.pose, atol=1e-12)
    # Both robots hold their velocity, so that the pose carried to now is right too, and honest about the unheard.
    _, nees = errors(late, run, 160)
    assert nees.max() < 20.0
    # The observer's own odometry is heard at once, so not all that a message would tell is missing.
    now, _ = fresh(run)
    now.update(run.samples, rows)
    spread = np.linalg.det(late.estimate.pose_covariance) / np.linalg.det(now.estimate.pose_covariance)
    assert (spread > 1.0).all()


def test_without_messages_the_pose_is_predicted_only() -> None:
    run = simulate(4, 8.0, 6)
    silent, rows = fresh(run)
    arrived = run.samples.arrived.copy()
    arrived[:, 60:] = 0
    silent.update(part(run.samples, 0, 60), rows)
    before = np.linalg.det(silent.estimate.pose_covariance)
    turns = silent._pairs.turn.copy()
    silent.update(part(run.samples._replace(arrived=arrived), 60, 161), rows)
    assert_array_equal(silent._pairs.turn, turns)
    assert (np.linalg.det(silent.estimate.pose_covariance) > before).all()
    _, nees = errors(silent, run, 160)
    assert nees.max() < 25.0


def test_the_observed_robots_motion_is_not_known_before_its_message() -> None:
    run = simulate(2, 4.0, 7)
    estimates = []
    for changed in (False, True):
        odometry, arrived = run.samples.odometry.copy(), run.samples.arrived.copy()
        arrived[:, 40:] = 0
        if changed:
            odometry[:, 40:, 1] += 0.5
        estimator, rows = fresh(run, window=4)
        estimator.update(run.samples._replace(odometry=odometry, arrived=arrived), rows)
        estimates.append(estimator.estimate.pose[:, 0].copy())
    assert_array_equal(estimates[0], estimates[1])


def test_bearings_alone_are_enough() -> None:
    run = simulate(40, 40.0, 8, bearings=True)
    estimator, rows = fresh(run)
    estimator.update(run.samples, rows)
    e, nees = errors(estimator, run, -1)
    assert (np.mean(nees, axis=0) < 4.4).all()
    assert np.median(np.hypot(e[..., 0], e[..., 1])) < 0.05


def test_the_scale_of_the_odometry_is_found() -> None:
    """Odometry that reads 5 % too little; without the states the same runs are far from consistent."""
    run = simulate(30, 40.0, 9)
    odometry = (run.samples.odometry / np.float32(1.05)).astype(np.float32)
    config = CONFIG.model_copy(update={"scale_sd": (0.05, 0.05)})
    estimator, rows = fresh(run, config)
    estimator.update(run.samples._replace(odometry=odometry), rows)
    _, nees = errors(estimator, run, -1)
    assert (nees.mean(axis=0) < 4.5).all()
    blind, _ = fresh(run)
    blind.update(run.samples._replace(odometry=odometry), rows)
    assert errors(blind, run, -1)[1].mean() > 3.0 * nees.mean()
    assert abs(np.median(estimator.calibration[..., 1]) - 1.05) < 0.02
    assert_array_equal(estimator.calibration[..., 2:], 0.0)


def test_one_robot_alone_has_a_map_and_no_pose() -> None:
    estimator = make("map-alignment", 2, 1, 3)
    rows = np.arange(2)
    estimator.reset(Prior(np.full((2, 1, 3), 4.0), np.zeros((2, 0, 3)), 1.0, POSE_SD), rows)
    seen = np.array([True, True, False]).reshape(1, 1, 1, 3).repeat(2, axis=0)
    image = np.zeros((2, 1, 1, 3, 2), dtype=np.float32)
    image[..., 0] = [0.3, -0.3, 0.0]
    zeros = np.zeros((2, 1)), np.zeros((2, 1, 1, 3), dtype=np.float32)
    estimator.update(Samples(*zeros, image, seen, np.zeros((2, 1, 0), dtype=np.uint64)), rows)
    assert estimator.estimate.pose.shape == (2, 0, 3)
    assert_array_equal(estimator.estimate.known, seen[:, 0])
    assert_allclose(estimator.estimate.points[0, 0, :2, 0], [-np.arctan(0.3), np.arctan(0.3)], rtol=1e-6)
    assert_allclose(1.0 / estimator.estimate.points[0, 0, 0, 2] / np.hypot(1.0, 0.3), 4.0, rtol=1e-6)


def test_camera_heights_are_one_per_robot() -> None:
    with pytest.raises(ValueError, match=r"`camera_heights` must have one value per robot \(2\)"):
        MapAlignment(1, 2, 2, CONFIG.model_copy(update={"camera_heights": (0.3,)}))


def test_both_directions_are_inverse_to_each_other_where_the_heading_is_known() -> None:
    """But for their priors, which hardly count by then."""
    run = simulate(3, 12.0, 10)
    estimator, rows = fresh(run)
    estimator.update(run.samples, rows)
    pose, covariance = estimator.estimate.pose, estimator.estimate.pose_covariance
    back = np.array([relative(*p, 0.0, 0.0, 0.0) for p in pose[:, 0]])
    sd = np.sqrt(np.diagonal(covariance[:, 1], axis1=1, axis2=2))
    assert (np.abs(pose[:, 1] - back) < 0.2 * sd).all()

    def inverse(p: Float) -> Float:
        return np.array(relative(*p, 0.0, 0.0, 0.0))

    for i in range(3):
        f = np.stack([(inverse(pose[i, 0] + e) - inverse(pose[i, 0] - e)) / 2e-6 for e in 1e-6 * np.eye(3)], axis=1)
        scale = np.outer(sd[i], sd[i])
        assert_allclose(covariance[i, 1] / scale, f @ covariance[i, 0] @ f.T / scale, atol=0.02)
    # Aligned by itself, the second direction is the same.
    alone, _ = fresh(run, CONFIG.model_copy(update={"mirror": False}))
    alone.update(run.samples, rows)
    assert (np.abs(alone.estimate.pose[:, 1] - pose[:, 1]) < 0.05 * sd).all()


def test_what_does_not_fit_is_refused() -> None:
    run = simulate(2, 0.2, 11)
    estimator, rows = MapAlignment(2, 2, 2, CONFIG), np.arange(2)
    with pytest.raises(RuntimeError, match="must be reset before"):
        estimator.update(run.samples, rows)
    with pytest.raises(ValueError, match=r"`prior\.depth_sd` and `prior\.pose_sd` must be positive"):
        estimator.reset(run.prior._replace(depth_sd=0.0), rows)
    with pytest.raises(ValueError, match=r"`prior\.depth` must be .* shape \(2, 2, 2\), but is .* \(1, 2, 2\)"):
        estimator.reset(run.prior._replace(depth=run.prior.depth[:1].copy()), rows)
    estimator.reset(run.prior, rows)
    with pytest.raises(IndexError, match=r"`rows` must lie in \[0, 2\)"):
        estimator.update(run.samples, rows + 1)
    with pytest.raises(ValueError, match=r"`samples\.image` must be .* of float32"):
        estimator.update(run.samples._replace(image=run.samples.image.astype(float)), rows)
    with pytest.raises(ValueError, match=r"ages below the message window, 1 samples"):
        estimator.update(delayed(run, 2).samples, rows)
    with pytest.raises(ValueError, match=r"`state` must have the keys"):
        estimator.set_state({}, rows)


@pytest.mark.parametrize(("share", "grown"), [(1.0, True), (0.0, False)])
def test_noise_of_a_robot_that_is_told_to_stand(share: float, grown: bool) -> None:
    """With w = v = 0 measured, the heading's variance grows by odometry noise times the share that is left at rest."""
    noise, seconds = 0.02, 20.0
    run = simulate(1, 5.0, seed=3)
    config = CONFIG.model_copy(update={"odometry_noise": (noise, noise), "rest_share": share})
    estimator = MapAlignment(1, 2, 2, config)
    rows = np.zeros(1, dtype=np.int64)
    estimator.reset(run.prior, rows)
    estimator.update(run.samples, rows)
    still, steps = part(run.samples, 1, 2), round(seconds / DT)
    still.odometry[:], still.seen[:] = 0.0, False
    renewal = round((config.grid_period or 0.0) / DT) + 1  # then the grid of headings is of after the last image
    for _ in range(renewal):
        estimator.update(still, rows)
    before = estimator.estimate.pose_covariance[0, 0, 2, 2]
    for _ in range(steps):
        estimator.update(still, rows)
    added = estimator.estimate.pose_covariance[0, 0, 2, 2] - before
    # Both robots' headings: twice n (noise dt)². Maps that drift apart from each other add to the least squares alike.
    expected = 2.0 * steps * (noise * DT) ** 2 if grown else 0.0
    assert_allclose(added, expected, rtol=0.15, atol=0.02 * 2.0 * steps * (noise * DT) ** 2)
