"""Messages in order, late, out of order and lost: a message is used at the time it was made for."""

from typing import Any

import numpy as np
import pytest

from relloc_env.estimators import CascadeConfig, make
from relloc_env.kernels import motion, relative_pose
from tests.estimators.driving import NOW, PERIOD, POINTS, late, prior, run, simulate, take

arc: Any = motion.arc
rp: Any = relative_pose


@pytest.mark.parametrize("name", ["cascade", "cascade-critical"])
@pytest.mark.parametrize("window", [2, 8, 64])
def test_messages_out_of_order_give_exactly_the_result_of_messages_in_order(name, window):
    samples, _ = simulate(150, envs=4)
    in_order, out_of_order = run(samples, name), run(late(samples, window, 1), name, window)
    np.testing.assert_array_equal(out_of_order.estimate.pose, in_order.estimate.pose)
    np.testing.assert_array_equal(out_of_order.estimate.pose_covariance, in_order.estimate.pose_covariance)


def test_late_messages_are_used_with_losses_too():
    samples, _ = simulate(150, envs=4)
    lossy = late(samples, 1, seed=2, loss=0.5)
    delayed = np.zeros_like(lossy.arrived)
    rng = np.random.default_rng(3)
    for n, made, p in np.argwhere(lossy.arrived):
        at = min(made + int(rng.integers(8)), 150)
        delayed[n, at, p] |= NOW << np.uint64(at - made)
    on_time, later = run(lossy), run(lossy._replace(arrived=delayed), window=8)
    last = lossy.arrived[:, -1] != 0  # otherwise the last samples are predictions in both, from the same anchor
    assert last.any()
    np.testing.assert_array_equal(later.estimate.pose, on_time.estimate.pose)
    np.testing.assert_array_equal(later.estimate.pose_covariance, on_time.estimate.pose_covariance)


def test_a_message_is_used_at_the_time_it_was_made_for():
    samples, _ = simulate(100, noise=0.0)
    delay = 6
    arrived = np.zeros_like(samples.arrived)
    arrived[:, delay:] = NOW << np.uint64(delay)
    estimator = run(samples._replace(arrived=arrived), window=delay + 1)
    then = run(take(samples, 0, 101 - delay)).estimate.pose[0]
    for p, (a, b) in enumerate(((0, 1), (1, 0))):
        pose = then[p]
        held = samples.odometry[0, 100 - delay, b].astype(float)
        for k in range(101 - delay, 101):
            pose = np.array(
                rp.predict(*pose, *arc(*samples.odometry[0, k, a].astype(float), PERIOD), *arc(*held, PERIOD))[:3]
            )
        np.testing.assert_allclose(estimator.estimate.pose[0, p], pose, atol=1e-12)


def test_a_gap_is_spanned_exactly_by_dead_reckoning():
    samples, _ = simulate(60)
    samples = samples._replace(seen=np.zeros_like(samples.seen))
    config = CascadeConfig(process="odometry")
    lost = samples.arrived.copy()
    lost[:, 10:60] = 0
    each, gap = run(samples, config), run(samples._replace(arrived=lost), config)
    np.testing.assert_allclose(gap.estimate.pose, each.estimate.pose, atol=1e-12)
    np.testing.assert_allclose(gap.estimate.pose_covariance, each.estimate.pose_covariance, atol=1e-12)


def test_fixed_process_noise_counts_the_samples_of_a_gap():
    samples, _ = simulate(60)
    lost = samples.arrived.copy()
    lost[:, 1:60] = 0
    samples = samples._replace(seen=np.zeros_like(samples.seen), arrived=lost)
    some, more = (run(samples, CascadeConfig(process_sd=sd)).estimate for sd in (1e-3, 2e-3))
    np.testing.assert_array_equal(some.pose, more.pose)
    np.testing.assert_allclose((more.pose_covariance - some.pose_covariance)[0, 0], 60 * 3e-6 * np.eye(3), atol=1e-12)


def test_without_messages_the_filter_only_predicts_and_grows_less_certain():
    samples, _ = simulate(100)
    silent = samples.arrived.copy()
    silent[:, 50:] = 0
    samples = samples._replace(arrived=silent)
    estimator = run(take(samples, 0, 51))
    rows = np.array([0])
    before = np.linalg.det(estimator.estimate.pose_covariance[0, 0])
    for k in range(51, 101):
        estimator.update(take(samples, k, k + 1), rows)
        after = np.linalg.det(estimator.estimate.pose_covariance[0, 0])
        assert after > before
        before = after
        assert np.linalg.eigvalsh(estimator.estimate.pose_covariance[0, 0])[0] > 0


def test_prediction_of_a_held_velocity_covers_what_was_not_heard():
    """Monte Carlo, 20,000 draws: B's velocity differs from the last one heard by the stated deviation."""
    rng = np.random.default_rng(5)
    draws, sd, hold_sd = 20_000, 0.0005, (0.002, 0.003)
    u = np.array([[0.15, 0.0, 0.05], [0.1, 0.0, -0.08]])
    samples, _ = simulate(40, noise=0.0)
    arrived = np.zeros_like(samples.arrived)
    arrived[:, 0] = NOW
    odometry = np.broadcast_to(u.astype(np.float32), samples.odometry.shape).copy()
    samples = samples._replace(odometry=odometry, seen=np.zeros_like(samples.seen), arrived=arrived)
    config = CascadeConfig(process="odometry", unheard_sd=hold_sd, odometry_noise=(sd, sd))
    estimator = make(config, 1, 2, len(POINTS))
    estimator.reset(prior(1)._replace(pose_sd=np.full(3, 1e-9)), np.array([0]))
    estimator.update(take(samples, 0, 1), np.array([0]))
    estimator.update(take(samples, 1, 41), np.array([0]))
    a = np.zeros((3, draws))
    b = np.repeat(prior(1).pose[0, 0][:, None], draws, axis=1)
    hold = rng.normal(0.0, hold_sd, (draws, 2)).T
    for _ in range(40):
        for pose, mean, error in ((a, u[0], 0.0), (b, u[1], hold)):
            speed, turn = mean[[0, 2], None] + rng.normal(0.0, sd, (2, draws)) + error
            middle = pose[2] + 0.5 * PERIOD * turn
            pose[:] += PERIOD * np.stack([speed * np.cos(middle), speed * np.sin(middle), turn])
    d = b - a
    ends = np.stack([np.cos(a[2]) * d[0] + np.sin(a[2]) * d[1], np.cos(a[2]) * d[1] - np.sin(a[2]) * d[0], d[2]])
    # both say the same about every direction
    ratio = np.linalg.eigvals(np.linalg.solve(estimator.estimate.pose_covariance[0, 0], np.cov(ends))).real
    assert ratio.min() > 0.9
    assert ratio.max() < 1.1
