"""Attributes of environments: what is set on one takes effect, or is refused with a word on what to do instead."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env
from relloc_env.config import ConfigError, EnvConfig

pytest.importorskip("stable_baselines3")

from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from relloc_env.envs.sb3 import RellocVecEnv
from relloc_env.envs.varied import VariedVecEnv

SHORT: dict[str, Any] = {"estimator": "cascade", "max_cycles": 5}


def _aec() -> Any:
    return relloc_env.env(**SHORT).unwrapped


OBJECTS: dict[str, Callable[[], Any]] = {
    "gymnasium": lambda: gym.make("relloc_env/RelativePose-v0", **SHORT).unwrapped,
    "parallel": lambda: relloc_env.parallel_env(**SHORT),
    "aec": _aec,
    "vector": lambda: gym.make_vec("relloc_env/RelativePose-v0", 2, **SHORT),
    "stable-baselines": lambda: RellocVecEnv(2, **SHORT),
    "varied": lambda: VariedVecEnv(2, SHORT, groups=1),
    "row": lambda: RellocVecEnv(2, **SHORT).row(0),
    "robot": lambda: RellocVecEnv(2, **SHORT, decentralised=True).row(0),
}
EFFECTIVE = {
    "agents": "PettingZoo's list of the robots that act now",
    "copy": "looked at in each step of the native vector environment",
    "metadata": "read by wrappers",
    "np_random": "for wrappers that draw from the environment's generator",
    "reset_infos": "what Stable-Baselines3 reads after a reset",
    "spec": "set by Gymnasium",
    "timesteps": "where a curriculum goes on",
}
"""Attributes that may be set, and who looks at them."""
HORIZON = {("max_cycles", "parallel"), ("max_cycles", "aec")}
"""Where PettingZoo's own test suite sets the horizon."""


def _public(thing: Any) -> list[str]:
    """Names of options and of everything public that is no method and no constant of the class."""
    own = {name for name in vars(thing) if not name.startswith("_")}
    own |= {name for name in dir(type(thing)) if isinstance(getattr(type(thing), name, None), property)}
    return sorted(own | set(EnvConfig.model_fields))


@pytest.mark.parametrize("kind", OBJECTS)
def test_every_attribute_takes_effect_or_is_refused(kind: str) -> None:
    thing = OBJECTS[kind]()
    refused = []
    for name in _public(thing):
        if (name in EFFECTIVE and kind not in {"row", "robot"}) or (name, kind) in HORIZON:
            continue
        with pytest.raises(AttributeError, match=name):
            setattr(thing, name, object())
        refused.append(name)
    assert {"robots", "config", "render_mode", "estimator", "camera"} <= set(refused)
    thing.note = 1  # a name of the caller's own
    thing.note = 2
    assert thing.note == 2


@pytest.mark.parametrize("kind", ["parallel", "aec"])
def test_the_horizon_of_pettingzoo_holds_from_the_next_reset(kind: str) -> None:
    def length() -> int:
        count = 0
        while env.agents:
            shown = env.step({agent: np.zeros(2) for agent in env.agents})[0]
            count += 1
            times.append(float(shown["robot_a"][env.field_slices["progress"]][0]))
        return count

    env, times = OBJECTS[kind](), list[float]()
    env.reset(seed=1)
    env.max_cycles = 9
    assert length() == 5
    env.reset(seed=1)
    assert (length(), env.max_cycles, env.config.max_cycles) == (9, 9, 9)
    other = relloc_env.parallel_env(**{**SHORT, "max_cycles": 9})
    other.reset(seed=1)
    for time in times[5:]:
        assert other.step({agent: np.zeros(2) for agent in other.agents})[0]["robot_a"][
            other.field_slices["progress"]
        ] == pytest.approx(time)
    with pytest.raises(ConfigError, match="max_cycles"):
        env.max_cycles = 0


@pytest.mark.parametrize("name", ["targets", "render_mode", "config", "reward"])
def test_a_refusal_names_what_to_use(name: str) -> None:
    for make in OBJECTS.values():
        with pytest.raises(AttributeError, match=f"make another with `{name}=...`"):
            setattr(make(), name, 4)
    with pytest.raises(AttributeError, match=r"give it to `reset`, `options=\{'poses'"):
        OBJECTS["gymnasium"]().poses = 3


@pytest.mark.parametrize("name", ["max_cycles", "render_mode", "config"])
def test_wrappers_hand_refusals_on(name: str) -> None:
    wrapped = gym.make("relloc_env/RelativePose-v0", **SHORT)
    with pytest.raises(AttributeError, match=name):
        wrapped.set_wrapper_attr(name, 4)
    assert wrapped.set_wrapper_attr("note", 3)
    assert wrapped.get_wrapper_attr("note") == 3
    for env in (RellocVecEnv(2, **SHORT), VariedVecEnv(2, SHORT, groups=1)):
        with pytest.raises(AttributeError, match=name):
            VecNormalize(VecMonitor(env)).set_attr(name, 4)


@pytest.mark.parametrize("decentralised", [False, True])
@pytest.mark.parametrize("mode", [None, "rgb_array"])
@pytest.mark.parametrize("make", [RellocVecEnv, lambda n, **options: VariedVecEnv(n, groups=2, **options)])
def test_rows_have_what_single_environments_have(make: Any, mode: str | None, decentralised: bool) -> None:
    env = make(2, **SHORT, render_mode=mode, decentralised=decentralised, samples_per_action=2)
    count = 4 if decentralised else 2
    assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 10}
    assert env.render_mode == mode
    assert env.get_attr("render_mode") == [mode] * count
    assert env.get_attr("metadata") == [env.metadata] * count
    assert env.get_attr("field_slices") == [env.field_slices] * count
    assert [row.index for row in env.get_attr("unwrapped")] == env.get_attr("index")
    specs = env.get_attr("spec")
    if decentralised:
        assert specs == [None] * count
    else:
        assert [spec.max_episode_steps for spec in specs] == [5] * count
        again = gym.make(specs[0])
        assert again.unwrapped.config == env.get_attr("config")[0]  # type: ignore[attr-defined]
    env.seed(3)
    env.reset()
    pictures = env.env_method("render")
    if mode is None:
        assert pictures == [None] * count
        return
    assert len(env.get_images()) == 2
    each = count // 2
    for row, picture in enumerate(pictures):
        assert np.array_equal(picture, env.get_images()[row // each])
    assert env.render().shape[2] == 3


def test_pictures_of_varied_environments_follow_their_lives() -> None:
    env = VariedVecEnv(2, SHORT, groups=2, render_mode="rgb_array", stages=[{"vary": {"targets": {"choices": [1, 3]}}}])
    env.seed(1)
    env.reset()
    seen = set()
    for _ in range(24):
        env.step(np.full((2, 4), 0.2, np.float32))
        for group in env._groups:
            (scene,) = (picture.scene() for picture in group.env._pictures)
            assert scene.time == pytest.approx(0.25 * group.age)
            assert len(scene.points) == group.env.config.targets
            seen.add(group.env.config.targets)
    assert seen == {1, 3}


def test_what_callers_set_on_rows_outlives_their_lives() -> None:
    env = VariedVecEnv(4, SHORT, groups=2)
    env.reset()
    env.set_attr("note", 3, [0, 2])
    for _ in range(12):
        env.step(np.zeros((4, 4), np.float32))
    env.set_state(env.get_state())
    assert env.get_attr("note", [0, 2]) == [3, 3]
    assert not hasattr(env.row(1), "note")


@pytest.mark.parametrize("make", [RellocVecEnv, lambda n, config: VariedVecEnv(n, config, groups=1)])
def test_seeds_of_rows(make: Any) -> None:
    env = make(2, SHORT)
    wanted = env.seed(3)
    for same in (np.array(3), np.int64(3), np.uint8(3)):
        assert env.seed(same) == wanted == [3, 4]
        assert all(type(each) is int for each in env.seed(same))
    for wrong in ("a", -1, 2.5, np.array(2.5), np.array([1, 2]), [3], True, object()):
        with pytest.raises(ValueError, match="Argument `seed` must be a non-negative integer"):
            env.seed(wrong)
    np.random.seed(4)  # noqa: NPY002 - what Stable-Baselines3's `set_random_seed` seeds
    drawn = env.seed()
    np.random.seed(4)  # noqa: NPY002 - as above
    assert env.seed(None) == drawn


@pytest.mark.parametrize("kind", ["gymnasium", "parallel", "vector"])
def test_seeds_of_resets(kind: str) -> None:
    env = OBJECTS[kind]()
    env.reset(seed=np.array(3))
    poses = env.core.simulation.world.pose.copy()
    env.reset(seed=3)
    assert np.array_equal(poses, env.core.simulation.world.pose)
    for wrong in ("a", np.array(2.5), -1):
        with pytest.raises(ValueError, match="Argument `seed` must be"):
            env.reset(seed=wrong)
