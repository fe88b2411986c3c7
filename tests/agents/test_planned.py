"""The planner: it sees what is observed, improves its plan, and gains more than a script."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from agents.laws import Laws
from agents.planned import OpenLoop, Planner, believed, reckoned
from agents.playing import play
from agents.policy import Task
from agents.registry import agent
from relloc_env.config import load_config
from relloc_env.envs.belief import believed_places
from relloc_env.envs.vector import RellocVectorEnv


@pytest.mark.parametrize("robots", [1, 2])
def test_what_is_observed_is_what_is_believed(robots: int) -> None:
    """From an observation after some motion: the estimate itself, in the axes of robot A's dead reckoning."""
    envs = RellocVectorEnv(6, robots=robots, estimator="cascade")
    task, core = Task.of(envs), envs.core
    observations, _ = envs.reset(seed=4)
    for _ in range(8):
        observations = envs.step(np.tile(np.array([0.7, 0.3] * robots, np.float32), (6, 1)))[0]
    poses, points = believed(task, task.rows(observations))
    heights = np.full(robots, envs.config.camera_of(0).mount_height)
    expected_poses, expected_points = believed_places(core.onboard.estimate, heights)
    own = core.onboard.memory.dead_reckoning[:, 0]
    cos, sin = np.cos(own[:, 2])[:, None], np.sin(own[:, 2])[:, None]
    for got, expected in ((poses, expected_poses), (points, expected_points)):
        x = own[:, None, 0] + cos * expected[..., 0] - sin * expected[..., 1]
        y = own[:, None, 1] + sin * expected[..., 0] + cos * expected[..., 1]
        near = np.hypot(expected[..., 0], expected[..., 1]) < 15.0  # further ones are drawn in
        assert_allclose(got[..., 0][near], x[near], atol=1e-4)
        assert_allclose(got[..., 1][near], y[near], atol=1e-4)
    assert_allclose(np.cos(poses[..., 2] - own[:, None, 2]), np.cos(expected_poses[..., 2]), atol=1e-5)


def test_a_plan_is_never_worse_than_the_one_before_it() -> None:
    """The best plan found has at least the value of any that the planner starts from."""
    envs = RellocVectorEnv(3, estimator="cascade")
    task = Task.of(envs)
    planner = Planner(task, horizon=2.0, knots=3, samples=12, iterations=2)
    planner.reset(3, 0)
    observations, _ = envs.reset(seed=1)
    planner.act(task.rows(observations))
    search = planner._search
    still = np.zeros((3, 12, 3, 2, 2))
    start = np.zeros((3, search.steps, 2, 2))
    start[..., 0] = 0.8
    assert np.all(search.value(search.plan, still)[:, 0] >= search.value(start, still)[:, 0])


def test_where_dead_reckoning_had_the_robots_is_told_as_it_is_believed_now() -> None:
    """Of a true belief: in the model the robots went their real ways, and know what they really would."""
    envs = RellocVectorEnv(3, estimator="cascade", arena=None, robot={"odometry_noise": (0.0, 0.0)})
    task, world = Task.of(envs), envs.core.simulation.world
    planner = Planner(task, horizon=1.0, knots=3, samples=8, iterations=1)
    planner.reset(3, 0)
    observations, _ = envs.reset(seed=7)
    for _ in range(9):
        observations = envs.step(planner.act(task.rows(observations)).reshape(3, -1))[0]
    planner._reckoned.append(reckoned(task, task.rows(observations)))
    planner._retrace(world.pose.copy(), world.points.copy())
    real = envs.core.score.pose_information
    assert_allclose(planner._search.now.information[:, 0], real, rtol=0.02)


def test_laws_keep_the_outermost_point_at_an_angle() -> None:
    """Rolled here by the motion of a unicycle: after 4 s two points in a line are within the angles of the laws."""
    config = load_config(None, robots=1)
    laws = Laws(config, (2, 30), 1000, np.random.default_rng(3))
    speed, rate = config.robot_of(0).max_speed, config.robot_of(0).max_yaw_rate
    poses, points = np.zeros((2, 30, 1, 3)), np.tile([[6.0, 0.4, 0.3], [6.1, 0.4, 0.3]], (2, 30, 1, 1))
    ways = []
    for k in range(80):
        actions = laws.actions(k, poses, points)
        assert np.all(np.abs(actions) <= 1.0)
        poses[..., 0] += 0.05 * speed * actions[..., 0] * np.cos(poses[..., 2])
        poses[..., 1] += 0.05 * speed * actions[..., 0] * np.sin(poses[..., 2])
        poses[..., 2] += 0.05 * rate * actions[..., 1]
        ways.append(actions[..., 0, 0])
    offset = points[..., :2] - poses[..., :2]
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - poses[..., 2]
    lawful = np.array(ways)[-40:].std(axis=0) == 0.0  # no reversal lately
    share = np.abs(bearing[lawful]) / config.camera_of(0).half_view
    assert len(share) > 40
    assert np.all((share > 0.47) & (share < 0.98))


def test_plans_beat_driving_straight() -> None:
    """Paired, J at the end of six whole episodes of one robot."""
    config = load_config(None, robots=1, estimator="cascade")
    seeds = range(1_000_000, 1_000_006)
    straight, _ = play(config, agent("straight"), seeds, threads=1)
    planned, _ = play(config, lambda task: Planner(task, horizon=4.0, knots=4, samples=16), seeds, threads=1)
    assert np.mean(planned["information_end"] - straight["information_end"]) > 0.3


def test_the_same_seed_gives_the_same_plans() -> None:
    config = load_config(None, estimator="cascade", max_cycles=6, camera={"miss_probability": 0.3})
    found = [
        play(config, lambda task: Planner(task, horizon=1.0, knots=3, samples=8), [3, 4], threads=1)[1]["ways"]
        for _ in range(2)
    ]
    assert np.array_equal(found[0], found[1])


def test_the_open_loop_optimum_ends_where_its_search_says() -> None:
    """What was found in the model comes about in the environment; a longer search finds no less."""
    config, seeds, found = load_config(None, robots=1, estimator="cascade", max_cycles=24), [5, 6, 7], []
    for rounds in (0, 8):
        policies: list[OpenLoop] = []

        def build(task: Task, rounds: int = rounds, policies: list[OpenLoop] = policies) -> OpenLoop:
            policies.append(OpenLoop(task, rounds=rounds, knots=7, horizon=2.0, samples=8))
            return policies[-1]

        found.append(play(config, build, seeds, threads=1)[0]["information_end"])
        assert_allclose(found[-1], policies[0].value, rtol=1e-6)
    assert np.all(found[1] >= found[0] - 1e-9)
    assert np.any(found[1] > found[0] + 1e-3)
