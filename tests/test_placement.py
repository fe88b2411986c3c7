"""Starts of episodes: the conditions, computed here from the poses and targets alone; what is fixed; what is told."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from relloc_env.config import ConfigError, load_config
from relloc_env.metrics import relative_poses, wrap
from relloc_env.simulation import Simulation

ROW = np.zeros(1, np.int64)


def starts(count: int, **options: Any) -> tuple[Simulation, NDArray[np.float64], NDArray[np.float64]]:
    """A simulation of `count` environments after their first reset, their poses and targets."""
    simulation = Simulation(load_config({"estimator": None, **options}), count)
    rows = np.arange(count)
    simulation.seed(rows, list(range(count)))
    simulation.reset(rows)
    return simulation, simulation.world.pose.copy(), simulation.world.points.copy()


def distances(poses: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, R, M) in the plane."""
    return np.linalg.norm(points[:, None, :, :2] - poses[:, :, None, :2], axis=-1)


@pytest.mark.parametrize(("robots", "targets"), [(2, 2), (1, 2), (2, 4)])
def test_drawn_starts_meet_the_conditions(robots: int, targets: int) -> None:
    """1000 starts of the default task: distances, separations, heights, headings, view, walls."""
    _, poses, points = starts(1000, robots=robots, targets=targets)
    reach = distances(poses, points)
    assert reach.min() >= 2.0
    assert reach.max() <= 7.0
    apart = np.linalg.norm(points[:, :, None, :2] - points[:, None, :, :2], axis=-1)[:, *np.triu_indices(targets, 1)]
    assert apart.min() >= 0.8
    assert apart.max() <= 4.0
    height = points[..., 2] - 0.3
    assert -0.3 <= height.min() < -0.25
    assert 0.75 < height.max() <= 0.8
    assert np.abs(points[..., :2]).max() <= 4.5
    assert np.abs(poses[..., :2]).max() <= 4.5
    if robots == 2:
        assert np.linalg.norm(poses[:, 0, :2] - poses[:, 1, :2], axis=-1).min() >= 1.0
    to = points[:, None, :, :2].mean(axis=2) - poses[..., :2]
    error = wrap(poses[..., 2] - np.arctan2(to[..., 1], to[..., 0]))
    assert np.abs(error).max() <= math.radians(8.0)
    assert np.abs(error).max() > math.radians(7.5)
    d = points[:, None, :, :] - np.append(poses[..., :2], np.full((*poses.shape[:2], 1), 0.3), axis=-1)[:, :, None]
    cos, sin = np.cos(poses[..., 2])[..., None], np.sin(poses[..., 2])[..., None]
    depth, left = cos * d[..., 0] + sin * d[..., 1], cos * d[..., 1] - sin * d[..., 0]
    half = math.radians(62.2) / 2
    assert (depth > 0.1).all()
    assert (np.abs(left / depth) <= math.tan(half)).all()
    assert (np.abs(d[..., 2] / depth) <= math.tan(half) * 480 / 640).all()
    if robots == 2:  # neither robot stands before the other's camera
        for a, b in ((0, 1), (1, 0)):
            ray = points[:, :, :2] - poses[:, a, None, :2]
            share = np.clip(((poses[:, b, None, :2] - poses[:, a, None, :2]) * ray).sum(-1) / (ray**2).sum(-1), 0, 1)
            nearest = poses[:, a, None, :2] + share[..., None] * ray
            near = np.linalg.norm(nearest - poses[:, b, None, :2], axis=-1) < 0.18
            above = 0.3 + share * (points[..., 2] - 0.3)
            assert not (near & (above < 0.39)).any()


def test_all_targets_are_seen_at_the_start_but_for_misses() -> None:
    simulation, _, _ = starts(300)
    assert simulation.first.seen.all()
    assert simulation.world.visible.all()


def test_other_conditions_are_met_too() -> None:
    """300 starts with obstacles, a small arena and wide headings."""
    obstacles = [
        {"shape": "disc", "position": (0.5, 0.5), "radius": 0.5},
        {"shape": "box", "position": (-1.0, -1.0), "size": (1.0, 0.4), "angle": 0.7, "height": 0.5},
    ]
    start = {
        "target_distance": (1.0, 3.0), "target_separation": (0.3, 2.0), "target_height": (0.1, 0.2),
        "heading_error": 90.0, "robot_distance": 0.5, "margin": 0.3, "in_view": False,
    }  # fmt: skip
    simulation, poses, points = starts(300, arena=(5.0, 4.0), obstacles=obstacles, start=start)
    reach = distances(poses, points)
    assert reach.min() >= 1.0
    assert reach.max() <= 3.0
    assert np.linalg.norm(poses[:, 0, :2] - poses[:, 1, :2], axis=-1).min() >= 0.5
    for places in (poses.reshape(-1, 3), points.reshape(-1, 3)):
        assert np.abs(places[:, 0]).max() <= 2.2
        assert np.abs(places[:, 1]).max() <= 1.7
        assert np.hypot(places[:, 0] - 0.5, places[:, 1] - 0.5).min() > 0.5
        turned = ((places[:, 0] + 1.0) + 1j * (places[:, 1] + 1.0)) * np.exp(-0.7j)
        assert not ((np.abs(turned.real) < 0.5) & (np.abs(turned.imag) < 0.2)).any()
    assert np.hypot(poses[..., 0] - 0.5, poses[..., 1] - 0.5).min() >= 0.5 + 0.3
    assert not simulation.world.visible.all()


def test_starts_differ_between_seeds_and_episodes() -> None:
    """100 seeds, two episodes each: all different; the same seed gives the same start."""
    simulation, first, _ = starts(100)
    simulation.reset(np.arange(100))
    every = np.concatenate([first, simulation.world.pose]).reshape(200, -1)
    assert len(np.unique(every, axis=0)) == 200
    simulation.seed(np.arange(100), list(range(100)))
    simulation.reset(np.arange(100))
    np.testing.assert_array_equal(simulation.world.pose, first)


POSES = [(-2.0, -0.5, 0.1), (-2.0, 1.5, -0.2)]
POINTS = [(2.0, 0.0, 0.4), (2.5, 1.5, 0.5)]


def test_fixed_starts_are_honoured_and_survive() -> None:
    """Poses and points given at a reset hold for the episodes after it, until other options come; {} clears them."""
    simulation, drawn, _ = starts(3)
    rows = np.arange(3)
    simulation.reset(rows[:2], {"poses": POSES, "points": POINTS})
    for _ in range(3):
        np.testing.assert_array_equal(simulation.world.pose[:2], [POSES, POSES])
        np.testing.assert_array_equal(simulation.world.points[:2], [POINTS, POINTS])
        simulation.reset(rows)
    assert not np.array_equal(simulation.world.pose[2], drawn[2])
    simulation.reset(rows[:1], {})
    assert not np.array_equal(simulation.world.pose[0], POSES)
    assert not np.array_equal(simulation.world.points[0], POINTS)
    np.testing.assert_array_equal(simulation.world.pose[1], POSES)
    simulation.reset(rows[:1], {"points": POINTS})
    np.testing.assert_array_equal(simulation.world.points[0], POINTS)
    assert not np.array_equal(simulation.world.pose[0], POSES)


def test_configured_starts_come_back_when_options_are_cleared() -> None:
    simulation, poses, points = starts(1, poses=POSES, points=POINTS)
    np.testing.assert_array_equal(poses[0], POSES)
    simulation.reset(ROW, {"poses": POSES[::-1]})
    np.testing.assert_array_equal(simulation.world.pose[0], POSES[::-1])
    simulation.reset(ROW, {})
    np.testing.assert_array_equal(simulation.world.pose[0], POSES)
    np.testing.assert_array_equal(simulation.world.points, points)


def test_what_is_drawn_around_what_is_fixed_meets_the_conditions() -> None:
    """200 starts with fixed robots and drawn targets, and 200 the other way round: all in view and in reach."""
    for options in ({"poses": POSES}, {"points": POINTS}):
        simulation, poses, points = starts(200, **options)
        reach = distances(poses, points)
        assert reach.min() >= 2.0
        assert reach.max() <= 7.0
        assert simulation.world.visible.all()


@pytest.mark.parametrize(
    "options",
    [
        {"arena": (2.0, 2.0)},
        {"start": {"target_distance": (50.0, 60.0)}},
        {"start": {"margin": 4.5}},
        {"targets": 8, "start": {"target_separation": (3.9, 4.0)}},
        {"camera": {"far": 0.5}},
        {"poses": [(4.0, 0.0, 0.0), (4.0, 1.5, 0.0)]},
    ],
    ids=str,
)
def test_impossible_start_is_an_error(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="No start was found that meets the conditions of `start`"):
        starts(1, **options)


def test_fixed_guesses_have_their_size() -> None:
    """500 starts: errors of 1 m, 1.5 m and 60° with either sign, each as often."""
    simulation, poses, points = starts(500)
    depth, pose = guess_errors(simulation, poses, points)
    nearest = points_depth(poses, points) > 1.3 + 1e-9
    np.testing.assert_allclose(np.abs(depth[nearest]), 1.0, atol=1e-9)
    for column, size in enumerate((1.5, 1.5, math.radians(60.0))):
        errors = pose[..., column].ravel()
        np.testing.assert_allclose(np.abs(errors), size, atol=1e-9)
        assert stats.binomtest(int((errors > 0).sum()), errors.size).pvalue > 1e-4
    assert stats.binomtest(int((depth > 0).sum()), depth.size).pvalue > 1e-4


def test_positive_and_gaussian_guesses() -> None:
    """500 starts each; the Gaussian ones by a Kolmogorov-Smirnov test."""
    sizes = {"depth": 0.2, "position": 0.7, "heading": 20.0}
    depth, pose = guess_errors(*starts(500, guess={"kind": "positive", **sizes}))
    np.testing.assert_allclose(depth, 0.2, atol=1e-9)
    np.testing.assert_allclose(pose, np.broadcast_to([0.7, 0.7, math.radians(20.0)], pose.shape), atol=1e-9)
    depth, pose = guess_errors(*starts(500, guess={"kind": "gaussian", **sizes}))
    for errors, size in ((depth, 0.2), (pose[..., 0], 0.7), (pose[..., 1], 0.7), (pose[..., 2], math.radians(20.0))):
        assert stats.kstest(errors.ravel() / size, "norm").pvalue > 1e-4


def points_depth(poses: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """[m] (N, R, M) along the heading."""
    d = points[:, None, :, :2] - poses[:, :, None, :2]
    return np.cos(poses[..., 2])[..., None] * d[..., 0] + np.sin(poses[..., 2])[..., None] * d[..., 1]


def guess_errors(
    simulation: Simulation, poses: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of depth (N, R, M) and of pose (N, P, 3)."""
    pose = simulation.world.guess_pose - relative_poses(poses)
    pose[..., 2] = wrap(pose[..., 2])
    return simulation.world.guess_depth - points_depth(poses, points), pose
