"""Pictures as observations: checkers of the interfaces, the same through every door, SB3's convolutional policy."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_for_sb3
from stable_baselines3.common.vec_env import VecFrameStack

import relloc_env
from relloc_env.config import ConfigError
from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.sb3 import RellocVecEnv
from relloc_env.envs.vector import RellocVectorEnv

OPTIONS: dict[str, Any] = {"observation": "image", "estimator": "cascade", "max_cycles": 4}
ACTION = np.array([0.5, 0.15, 0.4, -0.2], np.float32)


@pytest.mark.parametrize("name", ["ActiveDepth", "RelativePose"])
def test_checkers_pass(name) -> None:
    env = gym.make(f"relloc_env/{name}-v0", **OPTIONS).unwrapped
    robots = 1 if name == "ActiveDepth" else 2
    assert env.observation_space == gym.spaces.Box(0, 255, (3 * robots, 84, 84), np.uint8)
    check_env(env, skip_render_check=True)
    check_for_sb3(gym.make(f"relloc_env/{name}-v0", **OPTIONS))


@pytest.mark.filterwarnings("ignore:.*Unknown options of reset")
def test_parallel_api() -> None:
    parallel_api_test(relloc_env.parallel_env(**OPTIONS), num_cycles=20)


def test_every_door_shows_the_same_pictures() -> None:
    """40 environments, through the end of an episode."""
    options = {**OPTIONS, "image_size": (40, 30)}
    batch, rows = RellocVectorEnv(40, **options), RellocVecEnv(40, decentralised=True, **options)
    shown, _ = batch.reset(seed=3)
    rows.seed(3)
    lines = rows.reset()
    assert shown.shape == (40, 6, 30, 40)
    assert shown.dtype == np.uint8
    assert np.array_equal(lines.reshape(40, 6, 30, 40), shown)
    alone, pair = RellocEnv(**options), relloc_env.parallel_env(**options)
    assert np.array_equal(alone.reset(seed=20)[0], shown[17])
    views = pair.reset(seed=20)[0]
    for _ in range(4):
        last, shown = shown, batch.step(np.tile(ACTION, (40, 1)))[0]
        assert np.array_equal(np.concatenate(list(views.values())), last[17])
        assert np.array_equal(alone.step(ACTION)[0], shown[17])
        views = pair.step({"robot_a": ACTION[:2], "robot_b": ACTION[2:]})[0]
        assert not np.array_equal(last, shown)
    assert np.array_equal(np.concatenate(list(views.values())), shown[17])


def test_threads_change_nothing() -> None:
    one, two = (RellocVectorEnv(96, threads=k, image_size=(16, 12), **OPTIONS) for k in (1, 2))
    assert np.array_equal(one.reset(seed=1)[0], two.reset(seed=1)[0])
    for _ in range(6):
        actions = np.tile(ACTION, (96, 1))
        assert np.array_equal(one.step(actions)[0], two.step(actions)[0])


def test_pictures_change_nothing_else() -> None:
    """The estimator, with analytic cameras, sees the same samples whether the policy sees pictures or numbers."""
    shown, told = RellocEnv(**OPTIONS), RellocEnv(**{**OPTIONS, "observation": "flat"})
    for env in (shown, told):
        env.reset(seed=5)
        for _ in range(3):
            env.step(ACTION)
    samples, others = shown.core.simulation.samples, told.core.simulation.samples
    for name in samples._fields:
        assert np.array_equal(getattr(samples, name), getattr(others, name))


def test_state_is_put_back() -> None:
    env = RellocEnv(**OPTIONS)
    env.reset(seed=6)
    env.step(ACTION)
    state = env.get_state()
    after = env.step(ACTION)[0]
    env.set_state(state)
    assert np.array_equal(env.step(ACTION)[0], after)
    assert env.state().shape == env.state_space.shape


@pytest.mark.parametrize("decentralised", [False, True])
def test_ppo_trains_on_stacked_pictures(decentralised) -> None:
    envs = VecFrameStack(RellocVecEnv(2, decentralised=decentralised, **OPTIONS), 3)
    assert envs.observation_space.shape == ((9 if decentralised else 18), 84, 84)
    model = PPO("CnnPolicy", envs, n_steps=4, batch_size=8, n_epochs=1, seed=0)
    model.learn(8)
    assert model.predict(envs.reset(), deterministic=True)[0].shape == ((4, 2) if decentralised else (2, 4))


def test_sizes_that_cannot_be_are_refused() -> None:
    with pytest.raises(ConfigError, match="image_size"):
        relloc_env.parallel_env(observation="image", image_size=(4, 84))
