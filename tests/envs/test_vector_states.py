"""States and clones of batches."""

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from relloc_env.config import ConfigError
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.estimators.cascade import Cascade
from relloc_env.estimators.config import CascadeConfig
from tests.envs.batches import IDS, ROUGH, drive, mask_of, same


def test_restored_states_go_on_bit_for_bit() -> None:
    """A mask's states, one of them in contact, through a pickle, to other places of another environment; 30 steps."""
    options = {**ROUGH, "terminate_on_collision": False, "max_cycles": 50}
    env, other = RellocVectorEnv(5, **options), RellocVectorEnv(3, **options)
    rng = np.random.default_rng(5)
    env.reset(seed=3)
    contact = env.core.simulation.world.contact
    actions = drive(rng, env)
    for _ in range(40):
        env.step(actions)
        if contact[1:].any():
            break
    one = 1 + int(np.flatnonzero(contact[1:].any(axis=1))[0])
    other.reset(seed=77)
    left_alone = other.get_state(1)
    other.set_state(pickle.loads(pickle.dumps(env.get_state(mask_of(5, [0, one])))), [2, 0])
    np.testing.assert_equal(other.get_state(1), left_alone)
    for _ in range(30):
        actions = drive(rng, env)
        a, b = env.step(actions), other.step(actions[[one, 2, 0]])
        for found, expected in zip(b[:4], a[:4], strict=True):
            np.testing.assert_array_equal(found[[2, 0]], expected[[0, one]])


def test_state_of_another_kind_is_refused() -> None:
    env = RellocVectorEnv(2, **ROUGH)
    env.reset(seed=1)
    before = pickle.dumps(env.get_state())
    wrong: list[Any] = [None, {}, env.get_state(0), RellocVectorEnv(2, estimator=None).get_state()]
    for state in wrong:
        with pytest.raises(ValueError, match="Argument `state"):
            env.set_state(state)
    for which in (np.ones(3, np.bool_), [2], [-1], [0.5], "all"):
        with pytest.raises(ValueError, match=r"Argument `which` must be a mask of \(2,\) or indices below 2"):
            env.get_state(which)  # type: ignore[arg-type]
    assert pickle.dumps(env.get_state()) == before


def test_clones() -> None:
    """50 copies in mid-episode: with the same streams they go on as the original does; else each on its own."""
    env = RellocVectorEnv(3, **{**ROUGH, "max_cycles": 100, "terminate_on_collision": False})
    rng = np.random.default_rng(6)
    env.reset(seed=3)
    for _ in range(5):
        env.step(drive(rng, env))
    before = pickle.dumps(env.get_state())
    replay, apart = env.clone(1, 50, same_streams=True), env.clone(1, 50, seed=9)
    again = env.clone(1, 50, seed=9)
    assert pickle.dumps(env.get_state()) == before
    streams = apart.core.simulation.world.streams.reshape(-1, 2)
    assert len({line.tobytes() for line in streams}) == len(streams)
    np.testing.assert_array_equal(apart.core.simulation.world.pose, env.core.simulation.world.pose[[1] * 50])
    for _ in range(4):
        actions = drive(rng, env)
        every = np.tile(actions[1], (50, 1))
        line = env.step(actions)[0][1]
        np.testing.assert_array_equal(replay.step(every)[0], np.tile(line, (50, 1)))
        found = apart.step(every)[0]
        np.testing.assert_array_equal(again.step(every)[0], found)
        assert len({line.tobytes() for line in found}) == 50
    drawn = [env.clone(0, 1).core.simulation.world.streams.tobytes() for _ in range(2)]
    assert drawn[0] != drawn[1]


def test_estimator_of_ones_own() -> None:
    """An object that serves all environments of the batch shows what the name shows; it cannot be cloned."""
    options = {**ROUGH, "robots": 1, "network": {}}
    named = RellocVectorEnv(2, **options)
    settings = CascadeConfig(image_noise=named.config.camera_of(0).image_noise, odometry_noise=(0.01, 0.01))
    own = RellocVectorEnv(2, **{**options, "estimator": Cascade(2, 1, 2, settings)})
    same(own.reset(seed=1), named.reset(seed=1))
    same(own.step(np.ones((2, 2))), named.step(np.ones((2, 2))))
    with pytest.raises(ConfigError, match="cannot be cloned"):
        own.clone(0, 2)


def test_states_for_critics_are_those_of_the_single_environments() -> None:
    env = RellocVectorEnv(3, estimator=None)
    env.reset(seed=4)
    for n in range(3):
        single: Any = gym.make(IDS[1], estimator=None).unwrapped
        single.reset(seed=4 + n)
        np.testing.assert_array_equal(env.state()[n], single.state())
