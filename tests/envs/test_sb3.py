"""The Stable-Baselines3 door: rows that are single environments or robots, and what the algorithms need of them."""

from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import relloc_env

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecMonitor, VecNormalize

from relloc_env.config import ConfigError
from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.sb3 import RellocVecEnv

SHORT: dict[str, Any] = {"estimator": "cascade", "max_cycles": 6}
ROUGH: dict[str, Any] = {
    **SHORT,
    "shield": None,
    "arena": (4.0, 3.0),
    "start": {"target_distance": (0.5, 3.5), "in_view": False, "robot_distance": 0.45, "margin": 0.25},
    "terminate_on_collision": True,
    "max_cycles": 12,
}


def drive(rng: np.random.Generator, env: Any) -> Any:
    actions = rng.uniform(-1, 1, (env.num_envs, *env.action_space.shape)).astype(np.float32)
    actions[:, ::2] = np.sign(actions[:, ::2] + 0.5)
    return actions


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_centralised_rows_are_single_environments(form: str) -> None:
    """40 steps of 4 rows beside Stable-Baselines3's own `DummyVecEnv`: observations, rewards, ends, infos of ends."""
    options = {**ROUGH, "observation": form}
    ours = RellocVecEnv(4, **options)
    dummy = DummyVecEnv([lambda: RellocEnv(**options)] * 4)
    rng = np.random.default_rng(1)
    assert ours.seed(5) == dummy.seed(5)
    np.testing.assert_equal(ours.reset(), dummy.reset())
    ends = []
    for _ in range(40):
        actions = drive(rng, ours)
        found: Any = ours.step(actions)
        expected: Any = dummy.step(actions)
        np.testing.assert_equal(found[0], expected[0])
        np.testing.assert_array_equal(found[1], expected[1])
        np.testing.assert_array_equal(found[2], expected[2])
        assert (found[1].dtype, found[2].dtype) == (np.float32, np.bool_)
        for row in range(4):
            if not found[2][row]:
                assert found[3][row] == {}
                continue
            for entry in ("terminal_observation", "TimeLimit.truncated"):
                np.testing.assert_equal(found[3][row][entry], expected[3][row][entry])
            ends.append(found[3][row]["TimeLimit.truncated"])
    assert {True, False} == set(ends)


def test_decentralised_rows_are_robots() -> None:
    """Three environments, six rows, beside the PettingZoo environment of each: observations, rewards, ends."""
    env = RellocVecEnv(3, **SHORT, decentralised=True)
    assert (env.num_envs, env.action_space.shape) == (6, (2,))
    assert env.seed(4) == [4, 4, 5, 5, 6, 6]
    shown: Any = env.reset()
    singles = [relloc_env.parallel_env(SHORT) for _ in range(3)]
    for n, single in enumerate(singles):
        lines, _ = single.reset(seed=4 + n)
        np.testing.assert_array_equal(shown[2 * n : 2 * n + 2], list(lines.values()))
    rng = np.random.default_rng(2)
    for step in range(6):
        actions = drive(rng, env)
        shown, rewards, dones, infos = env.step(actions)
        assert dones.tolist() == [step == 5] * 6
        for n, single in enumerate(singles):
            lines, expected, *_ = single.step(dict(zip(single.agents, actions[2 * n : 2 * n + 2], strict=True)))
            np.testing.assert_array_equal(rewards[2 * n : 2 * n + 2], np.array(list(expected.values()), np.float32))
            rows = range(2 * n, 2 * n + 2)
            seen = [infos[row]["terminal_observation"] if dones[row] else shown[row] for row in rows]
            np.testing.assert_array_equal(seen, list(lines.values()))
    assert [env.row(row).robot for row in range(3)] == ["robot_a", "robot_b", "robot_a"]


@pytest.mark.parametrize("decentralised", [False, True])
@pytest.mark.parametrize("on_collision", [False, True])
def test_ppo_bootstraps_at_the_time_limit(decentralised: bool, on_collision: bool) -> None:
    """What PPO learns from is the reward plus gamma V(last observation) at the horizon, and the reward elsewhere.

    The last observation is that of a single environment driven alike. With collisions that end episodes the value of
    what follows is zero there.
    """
    options = {**ROUGH, "terminate_on_collision": on_collision}
    env = RellocVecEnv(3, **options, decentralised=decentralised)
    model = PPO("MlpPolicy", env, n_steps=30, batch_size=90, n_epochs=1, gamma=0.9, seed=3, device="cpu")
    _, callback = model._setup_learn(90)
    assert model.collect_rollouts(env, callback, model.rollout_buffer, 30)
    buffer = model.rollout_buffer
    kinds = {"horizon": 0, "collision": 0}
    singles = [relloc_env.parallel_env(options) for _ in range(3)]
    for n, single in enumerate(singles):
        single.reset(seed=3 + n)
        for step in range(30):
            each = env.rows_each
            rows = slice(n * each, (n + 1) * each)
            actions = np.clip(buffer.actions[step, rows], -1.0, 1.0).reshape(2, 2)
            lines, rewards, ends, limits, _ = single.step(dict(zip(single.possible_agents, actions, strict=True)))
            last = np.array(list(lines.values()))
            reward = np.array(list(rewards.values()))
            if not decentralised:
                last, reward = last.reshape(1, -1), reward.mean(keepdims=True)
            if ends["robot_a"]:
                kinds["collision"] += 1
            elif limits["robot_a"]:
                kinds["horizon"] += 1
                value = model.policy.predict_values(model.policy.obs_to_tensor(last)[0]).detach().numpy()[:, 0]
                assert np.abs(value).min() > 1e-3
                reward = reward + 0.9 * value
            np.testing.assert_allclose(buffer.rewards[step, rows], reward, rtol=1e-4, atol=1e-6)
            if ends["robot_a"] or limits["robot_a"]:
                single.reset()
    assert kinds["horizon"] > 3
    assert (kinds["collision"] > 0) is on_collision


@pytest.mark.parametrize("form", ["flat", "dict"])
@pytest.mark.parametrize("decentralised", [False, True])
def test_wrappers_and_algorithms(decentralised: bool, form: str) -> None:
    """PPO trains on `VecNormalize(VecMonitor(VecCheckNan(env)))`, SAC on the flat one; episodes are as long as set."""
    inner = RellocVecEnv(4, **SHORT, decentralised=decentralised, observation=form)
    env = VecNormalize(VecMonitor(VecCheckNan(inner, raise_exception=True)), gamma=0.9)
    policy = "MlpPolicy" if form == "flat" else "MultiInputPolicy"
    model = PPO(policy, env, n_steps=16, batch_size=32, n_epochs=1, seed=1, device="cpu")
    model.learn(4 * 32 * inner.rows_each)
    assert model.ep_info_buffer is not None
    lengths = [episode["l"] for episode in model.ep_info_buffer]
    assert lengths == [6] * (4 * inner.rows_each * (32 // 6))
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=4, return_episode_rewards=True)  # type: ignore[assignment]
    assert lengths == [6] * 4
    assert np.isfinite(returns).all()
    if form == "flat":
        SAC("MlpPolicy", inner, learning_starts=16, batch_size=16, seed=1, device="cpu").learn(40)


def test_attributes_and_methods() -> None:
    env = RellocVecEnv(2, **SHORT, decentralised=True)
    env.reset()
    assert env.get_attr("render_mode") == [None] * 4
    assert env.get_attr("index", [1, 2]) == [0, 1]
    assert env.get_attr("config", 0) == [env.config]
    assert env.env_is_wrapped(Monitor, [0, 3]) == [False, False]
    assert env.has_attr("robot")
    assert not env.has_attr("no_such_thing")
    env.set_attr("lesson", 3, indices=[0, 2])
    assert env.get_attr("lesson", [0, 2]) == [3, 3]
    with pytest.raises(AttributeError, match="lesson"):
        env.get_attr("lesson", 1)
    with pytest.raises(IndexError):
        env.get_attr("config", 4)
    states = env.env_method("state")
    np.testing.assert_array_equal(states[0], states[1])
    assert not np.array_equal(states[0], states[2])
    saved = env.env_method("get_state", indices=0)[0]
    actions = drive(np.random.default_rng(3), env)
    first: Any = env.step(actions)[0]
    env.env_method("set_state", saved, indices=2)
    again: Any = env.step(np.roll(actions, 2, axis=0))[0]
    np.testing.assert_array_equal(again[2:], first[:2])
    with pytest.raises(ValueError, match="Argument `state"):
        env.env_method("set_state", {}, indices=0)


def test_options_of_the_next_reset() -> None:
    """Once for all, or one for each; they hold for later episodes, until others replace them."""
    poses = [[(-2.0, -0.5, 0.1), (-2.0, 1.5, -0.2)], [(-2.0, 0.0, 0.0), (-2.0, 2.0, -0.4)]]
    env = RellocVecEnv(3, estimator=None, max_cycles=1)
    pose = env.core.simulation.world.pose
    env.set_options({"poses": poses[0]})
    env.reset()
    np.testing.assert_array_equal(pose, [poses[0]] * 3)
    env.step(np.ones((3, 4)))
    np.testing.assert_array_equal(pose, [poses[0]] * 3)
    env.set_options([{"poses": poses[1]}, {}, {"poses": poses[0]}])
    env.reset()
    np.testing.assert_array_equal(pose, [poses[1], poses[0], poses[0]])


def test_infos_on_request() -> None:
    """The entries that were asked for, as the single environment has them; after a start with what the robots know."""
    env = RellocVecEnv(2, **{**SHORT, "max_cycles": 2}, info=["reward", "truth", "prior"])
    single = RellocEnv(**SHORT)
    env.seed(1)
    env.reset()
    _, info = single.reset(seed=1)
    np.testing.assert_equal(env.reset_infos[0]["prior/pose"], info["prior/pose"])
    for step in range(2):
        *_, infos = env.step(np.ones((2, 4)))
        *_, info = single.step(np.ones(4))
        assert infos[0]["reward/effort"] == info["reward/effort"]
        np.testing.assert_equal(infos[0]["truth/poses"], info["truth/poses"])
        assert "errors/range" not in infos[0]
        assert ("terminal_observation" in infos[0]) is (step == 1)
    assert not np.array_equal(env.reset_infos[0]["truth/poses"], info["truth/poses"])
    both = RellocVecEnv(1, **SHORT, info=["reward"], decentralised=True)
    both.reset()
    *_, infos = both.step(np.array([[1.0, 0.0], [0.0, 0.0]]))
    assert [info["reward/effort"] for info in infos] == [0.5, 0.0]


def test_wrong_input() -> None:
    env = RellocVecEnv(2, estimator=None)
    with pytest.raises(ResetNeeded, match="Call `reset` before `step`"):
        env.step(np.zeros((2, 4)))
    env.reset()
    with pytest.raises(ValueError, match=r"Argument `actions` must have shape \(2, 4\), but has \(4, 2\)"):
        env.step(np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"Argument `actions` must be finite, but is .* in row 1"):
        env.step(np.array([[0.0] * 4, [np.nan] * 4]))
    with pytest.raises(ValueError, match="Argument `seed` must be a non-negative integer, but is -3"):
        env.seed(-3)
    with pytest.raises(ConfigError, match="Unknown option `estimater`"):
        RellocVecEnv(2, estimater="cascade")


def test_pictures() -> None:
    pytest.importorskip("pygame")
    env = RellocVecEnv(2, estimator=None, render_mode="rgb_array")
    env.reset()
    env.step(np.ones((2, 4)))
    picture = env.render()
    assert picture is not None
    assert picture.shape == (1080, 960, 3)
    env.close()


@pytest.mark.parametrize("decentralised", [False, True])
def test_fields_are_found_by_name(decentralised: bool) -> None:
    envs: Any = RellocVecEnv(2, decentralised=decentralised, estimator="cascade")
    rows, slices = envs.reset(), envs.field_slices
    assert sum(part.stop - part.start for part in slices.values()) == rows.shape[1]
    envs.step(np.full((envs.num_envs, *envs.action_space.shape), 0.5, np.float32))
    last = "last_action" if decentralised else "robot_b/last_action"
    assert last in slices, list(slices)[:4]
    rows, *_ = envs.step(np.full((envs.num_envs, *envs.action_space.shape), 0.25, np.float32))
    assert np.all(rows[:, slices[last]] == 0.25)


@pytest.mark.parametrize("decentralised", [False, True])
def test_states_of_all_rows_are_those_of_their_environments(decentralised: bool) -> None:
    env = RellocVecEnv(3, **SHORT, decentralised=decentralised)
    env.seed(1)
    env.reset()
    env.step(drive(np.random.default_rng(0), env))
    states = env.states()
    assert len(np.unique(states, axis=0)) == 3
    np.testing.assert_array_equal(states, env.env_method("state"))
