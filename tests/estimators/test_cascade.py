"""The cascade: what it finds, its state, its rows, its errors."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.estimators import CascadeConfig, make
from relloc_env.estimators.cascade import Cascade
from relloc_env.kernels import camera, motion
from relloc_env.samples import Prior, Samples
from tests.estimators.driving import NOW, POINTS, late, prior, run, simulate, take
from tests.kernels.observers import POINT

relative: Any = motion.relative


def test_finds_the_pose_and_claims_what_it_finds_with_true_depths():
    samples, truth = simulate(600, noise=0.0, seen=1.0)
    estimator = make(CascadeConfig(), 1, 2, len(POINTS))
    rows = np.array([0])
    depth = np.array([[[relative(*truth[0, 0, i], *p[:2], 0.0)[0] for p in POINTS] for i in range(2)]])
    estimator.reset(prior(1)._replace(depth=depth), rows)
    estimator.update(samples, rows)
    for p, (a, b) in enumerate(((0, 1), (1, 0))):
        expected = relative(*truth[0, -1, a], *truth[0, -1, b])
        np.testing.assert_allclose(estimator.estimate.pose[0, p], expected, atol=2e-3)


def test_blocks_rows_and_batches_do_not_change_a_bit():
    samples, _ = simulate(90, envs=9)
    whole, singles = run(late(samples, 8, 4), window=8, block=91), run(late(samples, 8, 4), window=8, block=1)
    for name, field in whole.estimate._asdict().items():
        np.testing.assert_array_equal(field, getattr(singles.estimate, name))
    for n in range(9):
        fields: Any = [np.ascontiguousarray(field[n : n + 1]) for field in late(samples, 8, 4)]
        alone = run(Samples(*fields), window=8, block=7)
        for name, field in alone.estimate._asdict().items():
            np.testing.assert_array_equal(field[0], getattr(whole.estimate, name)[n])


@pytest.mark.parametrize("window", [1, 8])
def test_only_the_given_rows_change_and_as_in_a_batch_of_their_own(window):
    """19 environments, so that one block is whole and rows lie in each of three; rows in any order."""
    samples, _ = simulate(40, envs=19)
    samples = late(samples, window, 5)
    estimator, rows = run(take(samples, 0, 20), window=window), np.array([17, 3, 8, 0, 9])
    before, state = [field.copy() for field in estimator.estimate], estimator.get_state(np.arange(19))
    estimator.update(take(samples, 20, 40), rows)
    others = np.delete(np.arange(19), rows)
    everyone = run(take(samples, 0, 40), window=window).estimate
    for old, new, all_new in zip(before, estimator.estimate, everyone, strict=True):
        np.testing.assert_array_equal(old[others], new[others])
        np.testing.assert_array_equal(new[rows], all_new[rows])
    for name, array in estimator.get_state(others).items():
        np.testing.assert_array_equal(array, state[name][others], err_msg=name)
    estimator.reset(prior(19), rows)
    for old, new in zip(before, estimator.estimate, strict=True):
        np.testing.assert_array_equal(old[others], new[others])
    np.testing.assert_array_equal(estimator.estimate.pose[rows], prior(19).pose[rows])
    assert not estimator.estimate.known[rows].any()


@pytest.mark.parametrize("window", [1, 8])
def test_state_goes_on_bit_for_bit_in_any_row(window):
    samples, _ = simulate(80, envs=11)
    samples = late(samples, window, 6)
    first, rows = run(take(samples, 0, 41), window=window), np.arange(11)
    order = np.random.default_rng(7).permutation(11)
    state = first.get_state(order)
    assert all(len(array) == 11 for array in state.values())
    second = make("cascade-critical", 11, 2, len(POINTS), message_window=window)
    second.set_state(state, rows)
    for old, new in zip(first.estimate, second.estimate, strict=True):
        np.testing.assert_array_equal(old[order], new)
    rest = take(samples, 41, 81)
    first.update(rest, rows)
    fields: Any = [field[order] for field in rest]
    second.update(Samples(*fields), rows)
    for name, array in first.get_state(order).items():
        np.testing.assert_array_equal(array, second.get_state(rows)[name], err_msg=name)
    for old, new in zip(first.estimate, second.estimate, strict=True):
        np.testing.assert_array_equal(old[order], new)


def test_points_are_those_of_the_depth_observers_in_polar_form():
    samples, _ = simulate(50, envs=2)
    estimator = run(samples)
    numbers = estimator.get_state(np.arange(2))["point"].reshape(2, 2, len(POINTS), -1)
    q = np.moveaxis(numbers[..., POINT], -1, 0)
    distance = np.hypot(q[0], q[1])
    expected = np.stack([np.arctan2(q[1], q[0]), q[2] / distance, 1.0 / distance], axis=-1)
    np.testing.assert_allclose(estimator.estimate.points, expected, rtol=1e-12)
    chi = 1.0 / q[0]
    for index in np.ndindex(chi.shape):
        polar = camera.to_polar(-q[1][index] * chi[index], -q[2][index] * chi[index], chi[index])
        np.testing.assert_allclose(estimator.estimate.points[index], polar, rtol=1e-12)
    assert np.linalg.eigvalsh(estimator.estimate.points_covariance).min() > 0
    np.testing.assert_array_equal(
        estimator.estimate.points_covariance, np.swapaxes(estimator.estimate.points_covariance, -1, -2)
    )


def test_points_never_seen_read_as_unknown():
    samples, _ = simulate(10)
    seen = samples.seen.copy()
    seen[:, :, 0, 1] = False
    estimator = run(samples._replace(seen=seen))
    assert not estimator.estimate.known[0, 0, 1]
    assert estimator.estimate.known.sum() == 5
    np.testing.assert_array_equal(estimator.estimate.points[0, 0, 1], 0.0)
    np.testing.assert_array_equal(estimator.estimate.points_covariance[0, 0, 1], 0.0)


def test_remembered_points_take_part_where_asked():
    samples, _ = simulate(60, seen=1.0)
    seen = samples.seen.copy()
    seen[:, 30:, 0] = False
    samples = samples._replace(seen=seen)
    without = run(samples, CascadeConfig())
    with_unseen = run(samples, CascadeConfig(use_unseen=True))
    assert np.linalg.det(with_unseen.estimate.pose_covariance[0, 0]) < 0.5 * np.linalg.det(
        without.estimate.pose_covariance[0, 0]
    )
    blind = run(take(samples, 0, 31)).estimate
    assert not np.array_equal(blind.pose, without.estimate.pose)


def test_one_robot_has_points_and_no_pairs():
    samples, _ = simulate(20)
    one = Samples(
        samples.period,
        np.ascontiguousarray(samples.odometry[:, :, :1]),
        np.ascontiguousarray(samples.image[:, :, :1]),
        np.ascontiguousarray(samples.seen[:, :, :1]),
        np.zeros((1, 21, 0), dtype=np.uint64),
    )
    estimator = make("cascade", 1, 1, len(POINTS))
    rows = np.array([0])
    estimator.reset(Prior(prior(1).depth[:, :1].copy(), np.zeros((1, 0, 3)), 1.0, np.ones(3)), rows)
    estimator.update(one, rows)
    both = run(samples, "cascade")
    np.testing.assert_array_equal(estimator.estimate.points[:, 0], both.estimate.points[:, 0])
    assert estimator.estimate.pose.shape == (1, 0, 3)


def test_gains_are_per_environment_robot_and_point():
    samples, _ = simulate(60, envs=2)
    estimator = make("cascade", 2, 2, len(POINTS))
    assert isinstance(estimator, Cascade)
    np.testing.assert_array_equal(estimator.gains, np.broadcast_to([2.5, 120.0], (2, 2, len(POINTS), 2)))
    rows = np.arange(2)
    estimator.reset(prior(2), rows)
    estimator.gains[1, 0] = 5.0, 30.0
    estimator.update(samples, rows)
    usual = run(samples, "cascade", block=61).estimate.points
    tuned = run(samples, CascadeConfig(h=(5.0, 2.5), alpha_lambda=(30.0, 120.0)), block=61).estimate.points
    np.testing.assert_array_equal(estimator.estimate.points[0], usual[0])
    np.testing.assert_array_equal(estimator.estimate.points[1], tuned[1])
    assert not np.array_equal(tuned[1, 0], usual[1, 0])
    estimator.reset(prior(2), rows)
    estimator.gains[:, :, 1:] = 2.5, 120.0
    estimator.update(samples, rows)
    mixed = np.where(np.arange(len(POINTS))[:, None] == 0, tuned[1], usual[1])
    np.testing.assert_array_equal(estimator.estimate.points[1], mixed)


BAD_SAMPLES: list[tuple[str, Any]] = [
    ("period", lambda a: a.astype(np.float32)),
    ("odometry", lambda a: a.astype(np.float64)),
    ("image", lambda a: a[:, :, :, :2]),
    ("seen", lambda a: a.astype(np.int8)),
    ("arrived", lambda a: a.astype(np.int64)),
    ("arrived", lambda a: a[:, ::-1]),
]


@pytest.mark.parametrize(("field", "change"), BAD_SAMPLES)
def test_wrong_samples_are_refused(field, change):
    samples, _ = simulate(5)
    estimator = make("cascade", 1, 2, len(POINTS))
    estimator.reset(prior(1), np.array([0]))
    broken = samples._replace(**{field: change(getattr(samples, field))})
    with pytest.raises(ValueError, match=rf"Argument `samples\.{field}` must be a C-contiguous array"):
        estimator.update(broken, np.array([0]))


@pytest.mark.parametrize("row", [-1, 1])
def test_rows_out_of_range_are_refused_and_nothing_changes(row):
    samples, _ = simulate(5)
    estimator = run(samples)
    before = estimator.get_state(np.array([0]))
    for call in (
        lambda rows: estimator.update(samples, rows),
        lambda rows: estimator.reset(prior(1), rows),
    ):
        with pytest.raises(IndexError, match=r"Argument `rows` must lie in \[0, 1\)"):
            call(np.array([0, row]))
    for name, array in estimator.get_state(np.array([0])).items():
        np.testing.assert_array_equal(array, before[name])


def test_an_update_before_the_first_reset_is_refused():
    samples, _ = simulate(5, envs=2)
    estimator = make("cascade", 2, 2, len(POINTS))
    estimator.reset(prior(2), np.array([1]))
    with pytest.raises(RuntimeError, match="must be reset before"):
        estimator.update(samples, np.arange(2))
    estimator.update(samples, np.array([1]))


def test_messages_older_than_the_window_are_refused():
    samples, _ = simulate(5)
    arrived: NDArray[np.uint64] = samples.arrived.copy()
    arrived[0, 4, 1] = NOW << np.uint64(2)
    run(samples._replace(arrived=arrived), window=3)
    with pytest.raises(ValueError, match="ages below the message window, 2 samples"):
        run(samples._replace(arrived=arrived), window=2)


def test_a_state_of_another_estimator_is_refused():
    samples, _ = simulate(5)
    estimator = run(samples)
    state = estimator.get_state(np.array([0]))
    with pytest.raises(ValueError, match="must have the keys"):
        estimator.set_state({"point": state["point"]}, np.array([0]))
    with pytest.raises(ValueError, match="must have the keys"):
        make("cascade", 1, 2, len(POINTS), message_window=2).set_state(state, np.array([0]))
    with pytest.raises(ValueError, match=r"state\['gains'\].* shape \(1, 2, 4, 2\), but is .*\(1, 2, 3, 2\)"):
        make("cascade", 1, 2, len(POINTS) + 1).set_state(state, np.array([0]))
