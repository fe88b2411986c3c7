"""The tracker against exact projections of a turning camera, and SciPy's assignment."""

import math

import numpy as np
from scipy.optimize import linear_sum_assignment

from relloc_env.samples import Float
from relloc_env.vision.tracking import LOST, assign, empty_tracks, predict


def test_a_turn_is_predicted_exactly() -> None:
    """50 points, from a camera that turns on the spot."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(2.0, 6.0, 50), rng.uniform(-1.0, 1.0, 50), rng.uniform(-1.0, 1.0, 50)])

    def project(theta):
        ahead = math.cos(theta) * points[:, 0] + math.sin(theta) * points[:, 1]
        left = math.cos(theta) * points[:, 1] - math.sin(theta) * points[:, 0]
        return np.column_stack([-left / ahead, -points[:, 2] / ahead])

    rays, age = project(0.0), np.zeros(50, np.int64)
    for theta in (0.03, 0.08, 0.05):
        predict(rays, age, theta - {0.03: 0.0, 0.08: 0.03, 0.05: 0.08}[theta])
    assert np.allclose(rays, project(0.05), atol=1e-12)
    assert np.array_equal(age, np.full(50, 3))


def test_a_short_loss_is_bridged_and_a_long_one_forgotten() -> None:
    tracks = empty_tracks(1, 1, 1)
    rays, age = tracks.rays[0, 0], tracks.age[0, 0]
    one, score = np.ones((1, 1), np.bool_), np.ones(1)
    assert assign(rays, age, np.array([[0.1, 0.0]]), one, score).tolist() == [0]
    rays[0], age[0] = (0.1, 0.0), 0
    for _ in range(5):
        predict(rays, age, 0.0)
    far, near = np.array([[0.5, 0.3]]), np.array([[0.12, 0.01]])
    assert assign(rays, age, far, one, score).tolist() == [-1]  # something else
    assert assign(rays, age, near, one, score).tolist() == [0]
    for _ in range(LOST):
        predict(rays, age, 0.0)
    assert age[0] == -1
    assert assign(rays, age, far, one, score).tolist() == [0]  # searched for anew


def test_the_nearest_are_paired_as_scipy_pairs_them() -> None:
    """200 pictures of 4 targets of one colour, less apart than they jump."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        grid = rng.permutation(16)[:4]
        rays = 0.08 * np.column_stack([grid % 4, grid // 4]) - 0.1
        found: Float = (rays + rng.uniform(-0.012, 0.012, rays.shape))[rng.permutation(4)]
        chosen = assign(
            np.asarray(rays, np.float64), np.zeros(4, np.int64), found, np.ones((4, 4), np.bool_), np.ones(4)
        )
        cost = np.linalg.norm(found[:, None] - rays, axis=-1)
        detections, targets = linear_sum_assignment(cost)
        assert chosen[targets].tolist() == detections.tolist()


def test_targets_of_one_colour_keep_their_numbers_when_they_pass_each_other() -> None:
    """Two targets at two depths, seen by a camera that slides past: their images cross, at different heights."""
    rays, age = np.zeros((2, 2)), np.full(2, -1, np.int64)
    both, score = np.ones((2, 2), np.bool_), np.ones(2)
    for k in range(100):
        truth = np.array([[-0.2 + 0.004 * k, 0.03], [0.1 - 0.002 * k, -0.03]])
        predict(rays, age, 0.0)
        order = [1, 0] if k % 2 else [0, 1]
        chosen = assign(rays, age, truth[order], both, score)
        assert [order[d] for d in chosen] == [0, 1], k
        rays[:], age[:] = truth, 0


def test_at_first_targets_of_one_colour_are_numbered_from_left_to_right() -> None:
    found, score = np.array([[0.3, 0.0], [-0.2, 0.1], [0.0, -0.1]]), np.array([5.0, 3.0, 1.0])
    fits, age = np.ones((3, 2), np.bool_), np.full(2, -1, np.int64)
    assert assign(np.zeros((2, 2)), age, found, fits, score).tolist() == [1, 0]  # the best two, by column


def test_of_two_things_of_a_colour_the_better_one_is_taken() -> None:
    found, score = np.array([[0.3, 0.0], [-0.2, 0.1]]), np.array([2.0, 9.0])
    fits = np.array([[True, False], [True, False]])
    assert assign(np.zeros((2, 2)), np.full(2, -1, np.int64), found, fits, score).tolist() == [1, -1]
