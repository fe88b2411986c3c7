"""Worlds as believed: where the belief is the truth they are the real ones, and they hold no more than the belief."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from relloc_env.envs.belief import BeliefModel, believed_places
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.samples import Estimate

OPTIONS: dict[str, Any] = {"estimator": "cascade", "arena": None, "max_cycles": 20}


def true_estimate(envs: RellocVectorEnv) -> Estimate:
    """The truth, told as an estimate."""
    world, config = envs.core.simulation.world, envs.config
    n, robots = world.pose.shape[:2]
    m = world.points.shape[1]
    polar = np.zeros((n, robots, m, 3))
    for r in range(robots):
        to = world.points[:, :, :2] - world.pose[:, r, None, :2]
        distance = np.hypot(to[..., 0], to[..., 1])
        polar[:, r, :, 0] = np.arctan2(to[..., 1], to[..., 0]) - world.pose[:, r, None, 2]
        polar[:, r, :, 1] = (world.points[:, :, 2] - config.camera_of(r).mount_height) / distance
        polar[:, r, :, 2] = 1.0 / distance
    pose = np.zeros((n, 2, 3))
    for p, (a, b) in enumerate(((0, 1), (1, 0))):
        d = world.pose[:, b, :2] - world.pose[:, a, :2]
        cos, sin = np.cos(world.pose[:, a, 2]), np.sin(world.pose[:, a, 2])
        pose[:, p, 0], pose[:, p, 1] = cos * d[:, 0] + sin * d[:, 1], cos * d[:, 1] - sin * d[:, 0]
        pose[:, p, 2] = world.pose[:, b, 2] - world.pose[:, a, 2]
    rng = np.random.default_rng(0)
    root = 0.1 * rng.normal(size=(n, 2, 3, 3))
    cov = root @ np.swapaxes(root, -1, -2) + 0.01 * np.eye(3)
    small = np.broadcast_to(np.diag([1e-4, 1e-4, 1e-3]), (n, robots, m, 3, 3)).copy()
    return Estimate(polar, small, np.ones((n, robots, m), np.bool_), pose, cov)


@pytest.mark.parametrize("copies", [1, 3])
def test_a_true_belief_gains_what_the_real_robots_gain(copies: int) -> None:
    """Started where the real ones are, and moved alike, the believed worlds reach the bound of the real ones."""
    envs = RellocVectorEnv(4, **OPTIONS)
    envs.reset(seed=3)
    core = envs.core
    model = BeliefModel(envs.config, 4, copies, 1)
    model.start(core.simulation.world.pose, core.simulation.world.points, np.arange(4))
    assert_allclose(model.information, np.repeat(core.score.pose_information[:, None], copies, 1), rtol=1e-9)
    rng = np.random.default_rng(1)
    for _ in range(10):
        actions = rng.uniform(-1.0, 1.0, (4, 2, 2))
        envs.step(actions.reshape(4, -1).astype(np.float32))
        model.step(np.repeat(actions.astype(np.float32).astype(np.float64)[:, None], copies, 1))
        real = np.repeat(core.score.pose_information[:, None], copies, 1)
        assert_allclose(model.information, real, rtol=1e-9)
    assert_allclose(model.poses[:, -1], core.simulation.world.pose, atol=1e-12)


def test_a_past_that_is_believed_rightly_in_the_end_counts_as_it_was() -> None:
    """A model that had it all wrong, told of the real past, has the bound of the real robots; others keep theirs."""
    envs = RellocVectorEnv(3, **OPTIONS)
    envs.reset(seed=5)
    world = envs.core.simulation.world
    model = BeliefModel(envs.config, 3, 2, 1)
    model.start(np.zeros((3, 2, 3)), world.points + 2.0, np.arange(3))
    wrong = model.information
    rng, poses, actions = np.random.default_rng(2), [world.pose.copy()], []
    for _ in range(8):
        actions.append(rng.uniform(-1.0, 1.0, (3, 2, 2)).astype(np.float32).astype(np.float64))
        envs.step(actions[-1].reshape(3, -1).astype(np.float32))
        poses.append(world.pose.copy())
    model.retrace(np.array(poses), np.array(actions), world.points, np.array([0, 2]))
    real = np.repeat(envs.core.score.pose_information[:, None], 2, 1)
    assert_allclose(model.information[[0, 2]], real[[0, 2]], rtol=1e-9)
    assert_allclose(model.information[1], wrong[1])
    assert_allclose(model.poses[[0, 2], 1], world.pose[[0, 2]], atol=1e-12)


def test_an_estimate_is_put_where_it_says_and_known_as_well_as_it_claims() -> None:
    envs = RellocVectorEnv(5, **OPTIONS)
    envs.reset(seed=8)
    world = envs.core.simulation.world
    estimate = true_estimate(envs)
    model = envs.from_belief(estimate, 2)
    # J of the pair is -log det(P)/6 whatever the axes: that of the claimed covariance.
    expected = -np.linalg.slogdet(estimate.pose_covariance[:, 0])[1] / 6.0
    factor, variances = model.core.score.bound_factor[::2], model.core.score.bound_variances[::2]
    bound = (factor * variances[:, None]) @ np.swapaxes(factor, 1, 2)
    assert_allclose(-np.linalg.slogdet(bound[:, :3, :3])[1] / 6.0, expected, rtol=1e-9)
    assert_allclose(model.information, np.repeat(expected[:, None], 2, axis=1), rtol=1e-9)
    # Distances between robots and points are what they are, though the axes are A's.
    for r in range(2):
        real = np.linalg.norm(world.points[..., :2] - world.pose[:, r, None, :2], axis=-1)
        made = model.core.simulation.world
        assert_allclose(np.linalg.norm(made.points[::2, :, :2] - made.pose[::2, r, None, :2], axis=-1), real, rtol=1e-9)
    assert_allclose(model.core.simulation.world.points[::2, :, 2], world.points[..., 2], rtol=1e-9)


def test_what_nobody_knows_is_out_of_sight_and_teaches_nothing() -> None:
    envs = RellocVectorEnv(2, **OPTIONS)
    envs.reset(seed=1)
    world = envs.core.simulation.world
    points = world.points.copy()
    points[0] = np.nan
    model = BeliefModel(envs.config, 2, 1, 1)
    model.start(world.pose, points, np.arange(2))
    before = model.information
    model.step(np.full((2, 1, 2, 2), 0.5))
    assert model.information[0, 0] <= before[0, 0]
    assert model.information[1, 0] > before[1, 0]


def test_branches_start_from_the_other_model_and_part() -> None:
    envs = RellocVectorEnv(2, **OPTIONS)
    envs.reset(seed=2)
    world = envs.core.simulation.world
    now = BeliefModel(envs.config, 2, 1, 1)
    now.start(world.pose, world.points, np.arange(2))
    now.step(np.full((2, 1, 2, 2), 0.4))
    tried = BeliefModel(envs.config, 2, 3, 1)
    tried.branch(now)
    assert_allclose(tried.information, np.repeat(now.information, 3, 1))
    actions = np.full((2, 3, 2, 2), 0.4)
    actions[:, 1] = -1.0
    tried.step(actions)
    now.step(actions[:, :1])
    assert_allclose(tried.information[:, [0, 2]], np.repeat(now.information, 2, 1), rtol=1e-12)
    assert np.all(tried.information[:, 1] != tried.information[:, 0])


def test_bad_input() -> None:
    envs = RellocVectorEnv(2, **OPTIONS)
    envs.reset(seed=2)
    estimate = true_estimate(envs)
    with pytest.raises(ValueError, match="`copies` must be an integer"):
        envs.from_belief(estimate, 0)
    with pytest.raises(ValueError, match=r"`estimate\.points` must be finite, of"):
        envs.from_belief(Estimate._make(part[:1] for part in estimate), 2)
    assert believed_places(estimate, np.array([0.3, 0.3]))[1].shape == (2, 2, 3)
