"""Environments made again from what Gymnasium notes of them: one horizon, and options as plain data."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import relloc_env
from relloc_env.config import ConfigError, load_config
from relloc_env.envs.vector import RellocVectorEnv

IDS = ("relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0")


def length(env: Any) -> int:
    """Actions until the end of an episode, of all environments at once."""
    env.reset(seed=0)
    for k in range(1, 1000):
        _, _, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape, np.float32))
        if np.any(terminated | truncated):
            return k
    raise AssertionError("no end")


def through_json(spec: EnvSpec) -> EnvSpec:
    return EnvSpec.from_json(spec.to_json())


@pytest.mark.parametrize("form", [lambda spec: spec, through_json])
@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("cycles", [4, 20])
def test_other_options_hold_in_what_is_made_again(name: str, form: Callable[[EnvSpec], EnvSpec], cycles: int) -> None:
    """Shorter or longer than at first, twice over; the specification says what is."""
    env = gym.make(name, estimator="cascade", max_cycles=10)
    assert env.spec is not None
    assert env.spec.max_episode_steps == 10
    again = gym.make(form(env.spec), max_cycles=cycles)
    assert length(again) == cycles
    assert again.spec is not None
    assert again.spec.max_episode_steps == cycles
    assert length(gym.make(form(again.spec), max_cycles=7)) == 7
    assert length(gym.make(form(again.spec))) == cycles
    if tuple(map(int, gym.__version__.split(".")[:2])) >= (1, 3):  # `Box` before takes no `Horizon` for an integer
        assert gym.wrappers.TimeAwareObservation(again).max_timesteps == cycles
    assert length(env) == 10


@pytest.mark.parametrize("name", IDS)
def test_limits_of_gymnasium(name: str) -> None:
    """`max_episode_steps` of `gym.make` shortens episodes, also of what is made again; it cannot lengthen them."""
    env = gym.make(name, estimator="cascade", max_cycles=10, max_episode_steps=5)
    assert length(env) == 5
    assert env.spec is not None
    assert env.spec.max_episode_steps == 5
    assert length(gym.make(env.spec)) == 5
    longer = gym.make(name, estimator="cascade", max_cycles=10, max_episode_steps=50)
    assert length(longer) == 10
    assert longer.spec is not None
    assert longer.spec.max_episode_steps == 10


@pytest.mark.parametrize("form", [lambda spec: spec, through_json])
@pytest.mark.parametrize("name", IDS)
def test_horizons_of_batches(name: str, form: Callable[[EnvSpec], EnvSpec]) -> None:
    """`max_episode_steps` and `max_cycles` are one."""
    ways: list[dict[str, Any]] = [
        {"max_episode_steps": 7},
        {"max_cycles": 7},
        {"max_episode_steps": 7, "max_cycles": 7},
    ]
    for given in ways:
        env: Any = gym.make_vec(name, num_envs=2, estimator="cascade", **given)
        assert (length(env), env.spec.max_episode_steps, env.config.max_cycles) == (7, 7, 7)
        again: Any = gym.make_vec(form(env.spec), max_cycles=9)
        assert (length(again), again.spec.max_episode_steps, again.num_envs) == (9, 9, 2)
        assert length(gym.make_vec(form(env.spec))) == 7
    assert length(gym.make_vec(env.spec, max_episode_steps=9)) == 9
    assert gym.make_vec(name).spec.max_episode_steps == load_config().max_cycles  # type: ignore[union-attr]
    with pytest.raises(
        ConfigError, match=r"`max_episode_steps` must be `max_cycles` \(8\) where both are given, but is 7"
    ):
        gym.make_vec(name, max_episode_steps=7, max_cycles=8)


def test_horizons_elsewhere() -> None:
    assert relloc_env.parallel_env(estimator=None, max_episode_steps=3).config.max_cycles == 3
    assert RellocVectorEnv(1, estimator=None, max_episode_steps=3).config.max_cycles == 3


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_options_are_written_down(make: Any, tmp_path: Path) -> None:
    """Paths, arrays, enumerations and configurations: what is made from the text is configured alike."""
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({"max_cycles": 11, "targets": 3}), "utf-8")
    points = np.array([[3.0, 0.0, 0.3], [3.0, 1.0, 0.5]])
    given: list[dict[str, Any]] = [
        {"config": file},
        {"config": str(file), "estimator": None},
        {"config": load_config(targets=3, estimator="cascade")},
        {"config": {"points": points}, "max_cycles": np.int64(4)},
        {"points": points, "robot": ({"max_speed": np.float64(0.2)}, {}), "info": ("truth",)},
    ]
    if make is gym.make_vec:
        given.append({"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP})
    for options in given:
        env = make(IDS[1], **options)
        again = make(through_json(env.spec))
        assert again.unwrapped.config == env.unwrapped.config
        np.testing.assert_equal(again.reset(seed=1), env.reset(seed=1))
        assert again.unwrapped.metadata == env.unwrapped.metadata
