"""What the doors show: each field of the observation, `info`, `state()`, options of a reset, and how episodes end."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import relloc_env
from relloc_env.config import REWARD_TERMS, ConfigError
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.metrics import point_errors, pose_errors, relative_poses, wrap

EXACT: dict[str, Any] = {
    "camera": {"preset": "pi", "pixel_noise": 0.0},
    "robot": {"odometry_noise": (0.0, 0.0)},
    "max_cycles": 40,
}
SINGLE, PAIR = "relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0"


def choose(rng: np.random.Generator, agents: list[str]) -> dict[str, NDArray[np.float32]]:
    return {agent: rng.uniform(-1.5, 1.5, 2).astype(np.float32) for agent in agents}


def field(env: RellocParallelEnv, observation: Any, name: str) -> NDArray[np.float32]:
    """A named part of a robot's observation, flat or not."""
    if isinstance(observation, dict):
        return observation[name]
    return observation[env.field_slices[name]]


def pinhole(pose: NDArray[np.float64], points: NDArray[np.float64], height: float) -> NDArray[np.float64]:
    """(M, 2) normalised image coordinates."""
    z = (points[:, 0] - pose[0] + 1j * (points[:, 1] - pose[1])) * np.exp(-1j * pose[2])
    return np.stack([-z.imag / z.real, (height - points[:, 2]) / z.real], axis=-1)


@pytest.mark.parametrize("form", ["flat", "dict"])
@pytest.mark.parametrize("robots", [1, 2])
def test_fields_of_the_composed_environment(robots: int, form: str) -> None:
    """Three episodes of 40 actions without noise: motion, time, images from the truth; the rest from the estimate."""
    env = relloc_env.parallel_env(EXACT, robots=robots, observation=form)
    rng = np.random.default_rng(1)
    unseen = blocked = 0
    for seed in range(3):
        observations, infos = env.reset(seed=seed)
        start = infos["robot_a"]["truth/poses"]
        actions = {agent: np.zeros(2, np.float32) for agent in env.agents}
        for step in range(41):
            truth, estimate = infos["robot_a"], env.core.onboard.estimate
            for r, agent in enumerate(env.possible_agents):
                seen = observations[agent]
                assert env.observation_space(agent).contains(seen)
                np.testing.assert_array_equal(field(env, seen, "last_action"), np.clip(actions[agent], -1, 1))
                assert math.isclose(field(env, seen, "progress")[0], step / 40, rel_tol=1e-6)
                moved = relative_poses(np.stack([start[r], truth["truth/poses"][r]]))[0]
                expected = (moved[0], moved[1], math.sin(moved[2]), math.cos(moved[2]))
                np.testing.assert_allclose(field(env, seen, "dead_reckoning"), expected, atol=2e-5)
                assert field(env, seen, "bumper")[0] == 0.0
                share = infos[agent]["reward/blocked"]
                assert math.isclose(field(env, seen, "blocked")[0], share, rel_tol=1e-6)
                blocked += share > 0.0
                points = field(env, seen, "points").reshape(-1, 8)
                image = pinhole(truth["truth/poses"][r], truth["truth/points"], 0.3)
                half = math.tan(math.radians(31.1))
                clear = np.all(np.abs(image) < (half, 0.75 * half), axis=1).tolist()
                known, polar = estimate.known[0, r], estimate.points[0, r]
                cov = estimate.points_covariance[0, r]
                for i, line in enumerate(points):
                    if line[0] == 1.0:
                        np.testing.assert_allclose(line[1:3], image[i], rtol=1e-5, atol=1e-6)
                        assert clear[i]
                    else:
                        assert line[0] == 0.0
                        assert not line[1:3].any()
                        unseen += 1
                    assert known[i]
                    relative = math.sqrt(cov[i, 2, 2]) / polar[i, 2]
                    told = (math.sin(polar[i, 0]), math.cos(polar[i, 0]), polar[i, 1], polar[i, 2], math.log(relative))
                    np.testing.assert_allclose(line[3:], told, rtol=1e-5, atol=1e-6)
                if robots == 2:
                    pose, covariance = estimate.pose[0, r], estimate.pose_covariance[0, r]
                    expected = (pose[0], pose[1], math.sin(pose[2]), math.cos(pose[2]))
                    np.testing.assert_allclose(field(env, seen, "pose"), expected, rtol=1e-5, atol=1e-6)
                    sd = np.sqrt(np.diag(covariance))
                    np.testing.assert_allclose(field(env, seen, "pose_log_sd"), np.log(sd), rtol=1e-5, atol=1e-5)
                    correlation = (covariance / np.outer(sd, sd))[[0, 0, 1], [1, 2, 2]]
                    np.testing.assert_allclose(field(env, seen, "pose_correlation"), correlation, atol=1e-5)
                    log_det = np.linalg.slogdet(covariance)[1]
                    np.testing.assert_allclose(field(env, seen, "pose_log_det"), log_det, rtol=1e-4, atol=1e-3)
            if step < 40:
                actions = choose(rng, env.agents)
                observations, _, _, _, infos = env.step(actions)
    assert unseen > 20
    assert blocked > 0 or robots == 1


def test_first_guesses_show_in_the_first_observation() -> None:
    """The estimates at the start are what the robots were told: the depths, and the other's pose."""
    env = relloc_env.parallel_env(EXACT, estimator="cascade")
    observations, infos = env.reset(seed=3)
    for r, agent in enumerate(env.agents):
        prior = infos[agent]
        points = field(env, observations[agent], "points").reshape(-1, 8)
        depth = points[:, 4] / points[:, 6]
        np.testing.assert_allclose(depth, prior["prior/depth"][r], rtol=1e-5)
        relative = points[:, 7]
        np.testing.assert_allclose(np.exp(relative), prior["prior/depth_sd"] / prior["prior/depth"][r], rtol=0.05)


@pytest.mark.parametrize("samples_per_action", [1, 5])
def test_fields_of_the_bare_environment(samples_per_action: int) -> None:
    """The block of samples: images, what was seen, odometry; after a reset only the last of the block is valid."""
    env = relloc_env.parallel_env(EXACT, estimator=None, samples_per_action=samples_per_action)
    rng = np.random.default_rng(2)
    observations, infos = env.reset(seed=4)
    k = samples_per_action
    for step in range(30):
        truth = env.core.simulation.truth
        for r, agent in enumerate(env.possible_agents):
            seen = observations[agent]
            valid = field(env, seen, "valid")
            image, sight = field(env, seen, "image").reshape(k, -1, 2), field(env, seen, "seen").reshape(k, -1)
            velocity = field(env, seen, "velocity").reshape(k, 3)
            if step == 0:
                np.testing.assert_array_equal(valid, np.arange(k) == k - 1)
                assert not velocity.any()
                assert not image[:-1].any()
                assert sight[-1].all()
                expected = pinhole(infos[agent]["truth/poses"][r], infos[agent]["truth/points"], 0.3)
                np.testing.assert_allclose(image[-1], expected, rtol=1e-5, atol=1e-6)
                continue
            assert valid.all()
            np.testing.assert_allclose(velocity, truth.velocity[0, :, r], rtol=1e-6, atol=1e-7)
            np.testing.assert_array_equal(sight, truth.visible[0, :, r])
            for j in range(k):
                expected = pinhole(truth.pose[0, j, r], infos[agent]["truth/points"], 0.3)
                np.testing.assert_allclose(image[j], expected * sight[j][:, None], rtol=1e-5, atol=1e-6)
        observations, _, _, _, infos = env.step(choose(rng, env.agents))
        assert "errors/range" not in infos["robot_a"]


@pytest.mark.parametrize("estimator", ["cascade", "cascade-critical", "inverse-depth", "map-alignment", None])
@pytest.mark.parametrize("name", [SINGLE, PAIR])
def test_observations_stay_finite_and_within_bounds(name: str, estimator: str | None) -> None:
    """Two episodes of 120 actions at random, without shield, among obstacles: bounds, and slices that cover it all."""
    obstacles = [{"shape": "disc", "position": (0.0, 0.0), "radius": 0.3}]
    env: Any = gym.make(name, estimator=estimator, shield=None, obstacles=obstacles, camera={"miss_probability": 0.3})
    inner = env.unwrapped
    places = np.concatenate([np.arange(inner.observation_space.shape[0])[part] for part in inner.field_slices.values()])
    np.testing.assert_array_equal(places, np.arange(inner.observation_space.shape[0]))
    assert len({f.name for f in inner.core.fields}) == len(inner.core.fields)
    env.action_space.seed(1)
    for seed in range(2):
        observation, _ = env.reset(seed=seed)
        truncated = False
        while not truncated:
            assert np.isfinite(observation).all()
            assert observation.dtype == np.float32
            assert env.observation_space.contains(observation)
            assert np.isfinite(inner.state()).all()
            assert inner.state_space.contains(inner.state())
            observation, reward, _, truncated, _ = env.step(env.action_space.sample())
            assert math.isfinite(reward)


@pytest.mark.parametrize("estimator", ["cascade-critical", None])
def test_dict_holds_the_same_numbers_as_the_flat_vector(estimator: str | None) -> None:
    rng = np.random.default_rng(3)
    flat: Any = gym.make(PAIR, estimator=estimator).unwrapped
    named: Any = gym.make(PAIR, estimator=estimator, observation="dict").unwrapped
    a, _ = flat.reset(seed=5)
    b, _ = named.reset(seed=5)
    assert list(b) == list(flat.field_slices)
    for _ in range(10):
        for key, part in flat.field_slices.items():
            np.testing.assert_array_equal(a[part], b[key])
            assert b[key].shape == named.observation_space[key].shape
        action = rng.uniform(-1, 1, 4).astype(np.float32)
        a, *_ = flat.step(action)
        b, *_ = named.step(action)


def test_bumper_reads_one_where_something_is_touched() -> None:
    env = relloc_env.parallel_env(shield=None, poses=[(4.78, 0.0, 0.0), (0.0, 0.0, 0.0)], points=[(3.0, 1.0, 0.4)])
    env.reset(seed=1)
    for _ in range(3):
        observations, *_ = env.step({"robot_a": np.array([1.0, 0.0]), "robot_b": np.zeros(2)})
        assert field(env, observations["robot_a"], "bumper")[0] == 1.0
        assert field(env, observations["robot_b"], "bumper")[0] == 0.0
    observations, *_ = env.step({"robot_a": np.array([-1.0, 0.0]), "robot_b": np.zeros(2)})
    assert field(env, observations["robot_a"], "bumper")[0] == 0.0


def test_info_has_the_truth_and_the_errors() -> None:
    """Errors against this project's metrics, computed from the estimate and the truth in `info`; angles are wrapped."""
    env, rng = relloc_env.parallel_env(), np.random.default_rng(4)
    for seed in range(3):
        _, infos = env.reset(seed=seed)
        for _ in range(20):
            for agent in env.agents:
                info = infos[agent]
                assert {f"reward/{name}" for name in REWARD_TERMS} < info.keys()
                poses, points = info["truth/poses"], info["truth/points"]
                np.testing.assert_array_equal(poses, env.core.simulation.world.pose[0])
                estimate = env.core.onboard.estimate
                found = point_errors(estimate, poses[None], points[None], np.array([0.3, 0.3]))
                np.testing.assert_allclose(info["errors/range"], found.range[0], atol=1e-9)
                error = pose_errors(estimate, poses[None])[0]
                expected = np.stack([np.hypot(error[:, 0], error[:, 1]), np.abs(wrap(error[:, 2]))], axis=-1)
                np.testing.assert_allclose(info["errors/pose"], expected, atol=1e-9)
            *_, infos = env.step(choose(rng, env.agents))


def test_what_is_handed_out_is_fresh() -> None:
    """Writing into observations, infos and states changes nothing for the environment."""
    runs = []
    for spoil in (False, True):
        env: Any = gym.make(PAIR).unwrapped
        observation, info = env.reset(seed=1)
        seen = []
        for _ in range(5):
            if spoil:
                observation[:] = 99.0
                for value in info.values():
                    value[...] = 99.0
                env.state()[:] = 99.0
                env.get_state()["core"]["world"]["pose"][:] = 99.0
            observation, _, _, _, info = env.step(np.full(4, 0.5, np.float32))
            seen.append(observation.copy())
        runs.append(seen)
    np.testing.assert_array_equal(runs[0], runs[1])


def test_state_for_critics_has_the_truth_and_the_observations() -> None:
    env = relloc_env.parallel_env()
    observations, infos = env.reset(seed=2)
    for _ in range(3):
        state, truth = env.state(), infos["robot_a"]
        assert state.dtype == np.float32
        assert state.shape == env.state_space.shape
        np.testing.assert_array_equal(state[:6], truth["truth/poses"].astype(np.float32).ravel())
        np.testing.assert_array_equal(state[12:18], truth["truth/points"].astype(np.float32).ravel())
        np.testing.assert_array_equal(state[22:], np.concatenate(list(observations.values())))
        observations, _, _, _, infos = env.step({agent: np.ones(2) for agent in env.agents})


POSES = [(-2.0, -0.5, 0.1), (-2.0, 1.5, -0.2)]
POINTS = [(2.0, 0.0, 0.4), (2.5, 1.5, 0.5)]


@pytest.mark.parametrize("door", ["parallel", "gymnasium"])
def test_options_of_a_reset_survive_until_others_come(door: str) -> None:
    env: Any = relloc_env.parallel_env() if door == "parallel" else gym.make(PAIR, disable_env_checker=True)

    def start(**given: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        _, info = env.reset(**given)
        truth = info["robot_a"] if door == "parallel" else info
        return truth["truth/poses"], truth["truth/points"]

    start(seed=1, options={"poses": POSES, "points": POINTS})
    for given in ({}, {"seed": 2}, {}):
        poses, points = start(**given)
        np.testing.assert_array_equal(poses, POSES)
        np.testing.assert_array_equal(points, POINTS)
    poses, points = start(options={})
    assert not np.array_equal(poses, POSES)
    assert not np.array_equal(points, POINTS)
    again, _ = start()
    assert not np.array_equal(poses, again)


def test_impossible_start_is_an_error_and_the_environment_recovers() -> None:
    env: Any = gym.make(PAIR).unwrapped
    env.reset(seed=1)
    with pytest.raises(ConfigError, match="No start was found"):
        env.reset(options={"poses": [(4.0, 0.0, 0.0), (4.0, 1.5, 0.0)]})
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(4))
    env.reset(options={})
    env.step(np.zeros(4))


def test_episode_is_truncated_at_its_horizon() -> None:
    """`max_cycles` actions, at both doors; ends and rewards are Python's own types."""
    env = relloc_env.parallel_env(max_cycles=7)
    joint: Any = gym.make(PAIR, max_cycles=7)
    for _ in range(2):
        env.reset(seed=1)
        joint.reset(seed=1)
        for step in range(1, 8):
            _, rewards, terminations, truncations, _ = env.step({agent: np.zeros(2) for agent in env.agents})
            _, reward, terminated, truncated, _ = joint.step(np.zeros(4, np.float32))
            for name in ("robot_a", "robot_b"):
                assert truncations[name] is (step == 7)
                assert terminations[name] is False
                assert type(rewards[name]) is float
            assert terminated is False
            assert truncated is (step == 7)
            assert type(reward) is float
            assert math.isclose(reward, sum(rewards.values()) / 2, rel_tol=1e-12)
        assert env.agents == []
    assert joint.spec.max_episode_steps == 7


def test_collision_ends_the_episode_where_asked() -> None:
    """Robot A has 0.295 m to the wall and drives 0.075 m an action: the fourth touches it."""
    start = {"poses": [(4.525, 0.0, 0.0), (0.0, 0.0, 0.0)], "points": [(3.0, 1.0, 0.4)], "shield": None}
    for terminate in (True, False):
        env = relloc_env.parallel_env(start, terminate_on_collision=terminate)
        env.reset(seed=1)
        for step in range(1, 7):
            _, _, terminations, truncations, _ = env.step({"robot_a": np.array([1.0, 0.0]), "robot_b": np.zeros(2)})
            touched = 4.525 + 0.075 * step > 4.82
            assert touched is (step >= 4)
            assert terminations["robot_a"] is (terminate and touched)
            assert terminations["robot_b"] is (terminate and touched)
            assert truncations["robot_a"] is False
            if terminate and touched:
                assert env.agents == []
                break


def test_success_ends_the_episode_where_asked() -> None:
    """The bound reaches 0.4 m and 10° at some action: there it ends, and not before."""
    rng = np.random.default_rng(5)
    env: Any = gym.make(PAIR, terminate_on_success=True, success=(0.4, 10.0), max_cycles=120).unwrapped
    ended = 0
    for seed in range(5):
        _, info = env.reset(seed=seed)
        terminated = truncated = False
        while not (terminated or truncated):
            _, _, terminated, truncated, info = env.step(rng.uniform(0, 1, 4))
            length, angle = info["bound_sd"]
            assert terminated is (bool(length <= 0.4) and bool(angle <= math.radians(10.0)))
        ended += terminated
    assert ended >= 3


def test_robot_without_neighbour_hears_nothing() -> None:
    """One robot alone has no fields about others."""
    env: Any = gym.make(SINGLE).unwrapped
    assert not [name for name in env.field_slices if "message" in name or "pose" in name]
    _, info = env.reset(seed=1)
    assert info["errors/pose"].shape == (0, 2)
