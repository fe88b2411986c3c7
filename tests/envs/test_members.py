"""The environments of a batch one by one, beside Gymnasium's `SyncVectorEnv`."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env
from relloc_env.config import ConfigError, EnvConfig

PAIR = "relloc_env/RelativePose-v0"


def both(**options: Any) -> tuple[Any, Any]:
    given = {"num_envs": 3, "estimator": "cascade", "max_cycles": 4, **options}
    return gym.make_vec(PAIR, **given), gym.make_vec(PAIR, vectorization_mode="sync", **given)


@pytest.mark.parametrize("seed", [42, [7, 7, 9], [3, 2**40, 0]])
def test_seeds_and_generators(seed: Any) -> None:
    """What wrappers draw is that of the single environments; a reset without a seed goes on."""
    batch, single = both()
    for env in (batch, single):
        env.reset(seed=seed)
    assert batch.np_random_seed == single.np_random_seed == tuple(np.add(seed, range(3)) if seed == 42 else seed)
    for _ in range(2):
        assert [g.random() for g in batch.np_random] == [g.random() for g in single.np_random]
        for env in (batch, single):
            env.reset()
    assert batch.np_random_seed == single.np_random_seed
    batch.reset(seed=[None, 5, None])
    single.reset(seed=[None, 5, None])
    assert batch.np_random_seed == single.np_random_seed
    assert [g.random() for g in batch.np_random] == [g.random() for g in single.np_random]


def test_generators_before_a_seed_differ() -> None:
    batch, _ = both()
    assert len(set(batch.np_random_seed)) == 3
    assert len({g.random() for g in batch.np_random}) == 3
    assert [g.random() for g in batch.np_random] != [g.random() for g in batch.get_attr("np_random")]


def test_calls_and_attributes() -> None:
    batch, single = both(observation="dict")
    for env in (batch, single):
        env.reset(seed=1)
        env.step(np.full((3, 4), 0.5, np.float32))
    np.testing.assert_array_equal(batch.call("state"), single.call("state"))
    for name in ("config", "observation_space", "action_space", "state_space", "field_slices", "render_mode"):
        assert batch.get_attr(name) == single.get_attr(name)
        assert isinstance(batch.get_attr(name), tuple)
    assert all(spec.max_episode_steps == 4 for spec in batch.get_attr("spec"))
    for env in (batch, single):
        env.set_attr("level", 3)
        assert env.get_attr("level") == (3, 3, 3)
        env.set_attr("level", [4, 5, 6])
        assert env.get_attr("level") == (4, 5, 6)
        with pytest.raises(ValueError, match="values"):
            env.set_attr("level", [1, 2])
        with pytest.raises(AttributeError, match="nothing"):
            env.get_attr("nothing")


def test_states_of_one() -> None:
    """Put back, the environment goes on as before; the others are left alone."""
    batch, _ = both()
    batch.reset(seed=1)
    kept, before = batch.call("get_state"), batch.call("state")
    batch.step(np.ones((3, 4), np.float32))
    moved = batch.call("state")
    batch.member(1).set_state(kept[1])
    np.testing.assert_array_equal(batch.call("state"), [moved[0], before[1], moved[2]])


def test_pictures_of_one() -> None:
    pytest.importorskip("pygame")
    batch, _ = both(render_mode="rgb_array")
    batch.reset(seed=1)
    np.testing.assert_array_equal(batch.call("render"), batch.render())


@pytest.mark.parametrize("name", [*EnvConfig.model_fields, "max_episode_steps", "render_mode", "spec", "np_random"])
def test_what_is_built_stays(name: str) -> None:
    """An attribute that would do nothing is refused, rather than taken in silence."""
    batch, _ = both()
    for kind in (AttributeError, ConfigError):
        with pytest.raises(kind, match=f"`{name}` of an environment is fixed when it is made"):
            batch.set_attr(name, 4)


def test_generator_of_agents() -> None:
    """`np_random` of the PettingZoo environments, which SuperSuit's wrappers draw from."""
    doors: list[Any] = [relloc_env.parallel_env(estimator=None), relloc_env.env(estimator=None).unwrapped]
    for env in doors:
        drawn = []
        for seed in (3, 3, 4, None):
            env.reset(seed=seed)
            drawn.append(env.np_random.random())
        assert drawn[0] == drawn[1] == np.random.default_rng(3).random()
        assert len(set(drawn)) == 3
