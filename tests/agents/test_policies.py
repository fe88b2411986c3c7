from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import agents
import relloc_env
from agents import AGENTS, Task, make, scripted
from agents.feedback import Edge
from relloc_env.config import load_config
from relloc_env.envs.observation import bounds
from relloc_env.wrappers import RecordLog


def rows_of(task, n, time=0.0, **fields):
    """Observations (N, R, D) that are zero but for the fields given."""
    rows = np.zeros((n, task.robots, bounds(task.config)[0].size), np.float32)
    rows[..., task.slices["progress"]] = time
    for name, value in fields.items():
        rows[..., task.slices[name]] = value
    return rows


def point(bearing, distance, elevation=0.1):
    """A point as robots tell it."""
    y = elevation / np.cos(bearing)
    return [1.0, np.tan(-bearing), -y, np.sin(bearing), np.cos(bearing), elevation, 1.0 / distance, -2.0]


@pytest.fixture(scope="module")
def task():
    return Task.of(load_config(robots=1))


@pytest.fixture(scope="module")
def pair():
    return Task.of(load_config())


@pytest.mark.parametrize("robots", [1, 2])
@pytest.mark.parametrize("name", AGENTS)
def test_actions_are_finite_and_within_the_limits(name, robots):
    task = Task.of(load_config(robots=robots))
    policy = make(name, task)
    policy.reset(16, 3)
    low, high = bounds(task.config)
    stream = np.random.default_rng(5)
    for k in range(40):  # 640 random observations per robot
        rows = stream.uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (16, robots, low.size)).astype(np.float32)
        rows[..., task.slices["progress"]] = k / task.config.max_cycles
        action = policy.act(rows)
        assert action.shape == (16, robots, 2)
        assert np.isfinite(action).all()
        assert (np.abs(action) <= 1.0).all()


@pytest.mark.parametrize("name", AGENTS)
def test_neighbours_in_the_batch_do_not_matter(name, pair):
    stream = np.random.default_rng(8)
    low, high = bounds(pair.config)
    many, few = make(name, pair), make(name, pair)
    many.reset(8, 21)
    few.reset(3, 21)
    for k in range(20):
        rows = stream.uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (8, 2, low.size)).astype(np.float32)
        rows[..., pair.slices["progress"]] = k / pair.config.max_cycles
        np.testing.assert_array_equal(many.act(rows)[:3], few.act(rows[:3]))


@pytest.mark.parametrize("name", [name for name in AGENTS if name != "random"])  # which draws a new motion each time
def test_a_row_whose_time_is_zero_begins_anew(name, pair):
    stream = np.random.default_rng(9)
    low, high = bounds(pair.config)
    used, fresh = make(name, pair), make(name, pair)
    used.reset(1, 0)
    fresh.reset(1, 0)
    episodes = stream.uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (2, 30, 1, 2, low.size)).astype(np.float32)
    episodes[..., pair.slices["progress"]] = (np.arange(30) / pair.config.max_cycles)[None, :, None, None, None]
    for rows in episodes[0]:
        used.act(rows)
    for rows in episodes[1]:
        np.testing.assert_array_equal(used.act(rows), fresh.act(rows))


def test_time_of_an_observation_is_that_of_the_episode(task):
    for k in range(task.config.max_cycles + 1):
        share = np.float32(k / task.config.max_cycles)
        assert task.time(rows_of(task, 1, share))[0] == pytest.approx(0.25 * k, abs=1e-12)


def test_speeds_become_shares_of_each_robots_own_limits():
    task = Task.of(
        load_config(robot=[{"max_speed": 0.2, "max_yaw_rate": 0.5}, {"max_speed": 0.4, "max_yaw_rate": 1.0}])
    )
    action = make("paper", task).act(rows_of(task, 1))
    np.testing.assert_allclose(action[0], [[0.5, 0.04], [0.25, -0.03]], atol=1e-12)


@pytest.mark.parametrize(
    ("law", "duration", "turn"),
    [
        (scripted.sinusoid, 8.0, 0.0),
        (scripted.figure_eight, 4.0 * np.pi / 0.6, 0.0),
        (scripted.circle, 2.0 * np.pi * 0.6 / 0.3, 2.0 * np.pi),
    ],
)
def test_closed_motions_turn_as_they_should(law, duration, turn):
    time = (np.arange(200_000) + 0.5) * (duration / 200_000)
    _, yaw_rate = law(time, 0.3, 0)
    assert np.mean(yaw_rate) * duration == pytest.approx(turn, abs=1e-3)


def test_back_and_forth_returns_to_the_start():
    time = np.linspace(0.0, 16.0, 16_000, endpoint=False) + 5e-4
    speed, yaw_rate = scripted.back_and_forth(time, 0.3, 0)
    assert np.sum(speed) * 1e-3 == pytest.approx(0.0, abs=1e-9)
    assert np.sum(np.abs(speed)) * 1e-3 == pytest.approx(0.3 * 16.0)
    assert not yaw_rate.any()


def test_random_motion_differs_between_rows_and_seeds_and_repeats(pair):
    policy = make("random", pair)
    actions = []
    for seed in (1, 1, 2):
        policy.reset(2, seed)
        actions.append(policy.act(rows_of(pair, 2, 0.5)))
    np.testing.assert_array_equal(actions[0], actions[1])
    assert not np.allclose(actions[0], actions[2])
    assert not np.allclose(actions[0][0], actions[0][1])


class TestEdge:
    def act(self, task, *points, time=0.0, policy=None, **fields):
        policy = policy or self.built(task)
        return policy.act(rows_of(task, 1, time, points=np.ravel(points), **fields))[0, 0]

    def built(self, task, **options):
        policy = Edge(task, **options)
        policy.reset(1, 0)
        return policy

    def test_law(self, task):
        half = np.arctan(320.0 / task.config.camera_of(0).focal_length)
        speed, turn = self.act(task, point(0.3, 3.0), point(0.1, 3.0))
        assert speed == 1.0
        # The nearer edge is the left one (+): w = 3 (0.3 - 0.85 half view), as a share of 0.8 rad/s.
        assert turn == pytest.approx(3.0 * (0.3 - 0.85 * half) / 0.8, abs=1e-6)

    def test_turns_so_that_the_outermost_point_moves_outwards(self, task):
        assert self.act(task, point(0.2, 3.0), point(0.0, 3.0))[1] < 0.0
        assert self.act(task, point(-0.2, 3.0), point(0.0, 3.0))[1] > 0.0

    def test_brings_a_lost_point_back_into_view(self, task):
        assert self.act(task, point(0.9, 3.0), point(0.6, 3.0))[1] > 0.0
        assert self.act(task, point(-0.9, 3.0), point(-0.6, 3.0))[1] < 0.0

    @pytest.mark.parametrize(
        "points",
        [
            (point(0.1, 0.9), point(0.2, 3.0)),  # near
            (point(0.5, 3.0), point(-0.45, 3.0)),  # bearings spread over 0.85 of the view
            (point(0.1, 3.0, 0.4), point(0.2, 3.0)),  # 0.4 of 0.45 up in the image
        ],
    )
    def test_reverses(self, task, points):
        assert self.act(task, *points)[0] == -1.0

    def test_goes_ahead_again_when_far_and_at_the_other_edge(self, task):
        policy = self.built(task)
        near, middle, far = ((point(0.1, d), point(0.2, d)) for d in (0.9, 3.0, 4.6))
        first = self.act(task, *near, policy=policy)
        speeds = [self.act(task, *middle, time=(k + 1) / 120, policy=policy)[0] for k in range(8)]
        last = self.act(task, *far, time=9 / 120, policy=policy)
        assert first[0] == -1.0
        assert speeds == [-1.0] * 8
        assert last[0] == 1.0
        # Ahead at the left edge, back at the right one, ahead at the left one again.
        assert first[1] > 0.0 > last[1]

    def test_turns_round_when_held(self, task):
        points = (point(0.1, 3.0), point(0.2, 3.0))
        assert self.act(task, *points)[0] == 1.0
        assert self.act(task, *points, blocked=0.4)[0] == -1.0

    def test_goes_straight_while_nothing_is_known(self, task):
        np.testing.assert_array_equal(self.act(task, np.zeros(16)), [1.0, 0.0])

    def test_says_what_it_needs(self):
        task = Task.of(load_config(estimator=None))
        with pytest.raises(ValueError, match="must have the field `points`"):
            self.built(task).act(rows_of(task, 1))


class TestNames:
    def test_unknown_name_is_told_with_a_suggestion(self, task):
        with pytest.raises(ValueError, match="Unknown agent `edgy`; did you mean `edge`"):
            make("edgy", task)

    def test_unknown_name_is_told_with_every_known_one(self, task):
        with pytest.raises(ValueError, match="Unknown agent `nobody`") as told:
            make("nobody", task)
        for policy in Path(agents.__file__).parent.glob("policies/*.onnx"):
            assert f"learned:{policy.stem}" in str(told.value)
        assert set(AGENTS) < set(str(told.value).replace(",", " ").split())

    def test_dict_observations_are_refused(self):
        with pytest.raises(ValueError, match='must have `observation="flat"`'):
            Task.of(load_config(observation="dict"))


@pytest.fixture(scope="module")
def poses():
    env = relloc_env.parallel_env()
    policy, task = make("edge", Task.of(env)), Task.of(env)
    policy.reset(1, 0)
    observations, _ = env.reset(seed=7)
    for _ in range(20):
        action = policy.act(task.rows(observations))[0]
        observations, *_, infos = env.step(dict(zip(env.agents, action, strict=True)))
    return infos["robot_a"]["truth/poses"]


class TestDoors:
    """The same episode through every door: 20 actions, bit for bit."""

    def test_gymnasium(self, poses):
        env = gym.make("relloc_env/RelativePose-v0")
        policy, task = make("edge", Task.of(env)), Task.of(env)
        policy.reset(1, 0)
        observation, _ = env.reset(seed=7)
        for _ in range(20):
            action = policy.act(task.rows(observation)).ravel()
            observation, *_, info = env.step(action.astype(np.float32))
        np.testing.assert_allclose(info["truth/poses"], poses, atol=1e-5)

    def test_aec(self, poses):
        env = relloc_env.env()
        policy, task = make("edge", Task.of(env)), Task.of(env)
        policy.reset(1, 0)
        env.reset(seed=7)
        for _ in range(20):
            action = policy.act(task.rows({agent: env.observe(agent) for agent in env.agents}))[0]
            for one in action:
                env.step(one)
        np.testing.assert_array_equal(env.infos["robot_a"]["truth/poses"], poses)

    def test_wrapped(self, tmp_path):
        env = RecordLog(gym.make("relloc_env/ActiveDepth-v0"), tmp_path)
        assert Task.of(env).robots == 1


def test_edge_law_tells_more_than_going_straight():
    """Paired over 24 scenarios of one robot: the information at the end, in the order it should have."""
    from relloc_env.envs.core import Core

    config = load_config(robots=1)
    core, rows, ends = Core(config, 24), np.arange(24), {}
    for name in ("edge", "straight", "stationary"):
        policy = make(name, Task.of(config))
        policy.reset(24, 0)
        core.reset(rows, list(range(500, 524)))
        for _ in range(config.max_cycles):
            core.step(policy.act(core.observation), rows)
        ends[name] = core.score.depth_information[:, 0].copy()
    assert np.mean(ends["edge"] - ends["straight"]) > 0.1
    assert np.mean(ends["straight"] - ends["stationary"]) > 2.0
