"""What `info` holds, by the conventions of clients that collect it: flat names, always the same, and arrays."""

import itertools
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env
from relloc_env.config import REWARD_TERMS, ConfigError
from relloc_env.envs.information import ENTRIES, SOURCES
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.wrappers import EstimateObservation

SHORT: dict[str, Any] = {"estimator": "cascade", "max_cycles": 3}
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "one robot": {"robots": 1},
    "bare": {"estimator": None},
    "without the bound": {"reward": {"visibility": 1.0}},
    "dict": {"observation": "dict"},
}


def single(**options: Any) -> list[list[dict[str, Any]]]:
    """Infos of two episodes, one list for each call."""
    robots = options.pop("robots", 2)
    env = gym.make("relloc_env/ActiveDepth-v0" if robots == 1 else "relloc_env/RelativePose-v0", **options)
    found = []
    for seed in (1, None):
        found.append([env.reset(seed=seed)[1]])
        found += [[env.step(env.action_space.sample())[4]] for _ in range(3)]
    return found


def parallel(**options: Any) -> list[list[dict[str, Any]]]:
    env = relloc_env.parallel_env(**options)
    found = []
    for seed in (1, None):
        found.append(list(env.reset(seed=seed)[1].values()))
        while env.agents:
            found.append(list(env.step({a: env.action_space(a).sample() for a in env.agents})[4].values()))
    return found


def by_turns(**options: Any) -> list[list[dict[str, Any]]]:
    env = relloc_env.env(**options)
    found = []
    for seed in (1, None):
        env.reset(seed=seed)
        for agent in env.agent_iter():
            _, _, terminated, truncated, info = env.last()
            found.append([info])
            env.step(None if terminated or truncated else env.action_space(agent).sample())
    return found


def rows(**options: Any) -> list[list[dict[str, Any]]]:
    sb3 = pytest.importorskip("relloc_env.envs.sb3")
    found = []
    for decentralised in (False, True):
        env = sb3.RellocVecEnv(2, decentralised=decentralised, **{"info": ENTRIES, **options})
        env.reset()
        found.append(env.reset_infos)
        actions = np.zeros((env.num_envs, *env.action_space.shape))
        for _ in range(4):
            infos = env.step(actions)[3]
            extra = ("TimeLimit.truncated", "terminal_observation")  # Stable-Baselines3's own
            found.append([{name: info[name] for name in info if name not in extra} for info in infos])
    return found


DOORS: dict[str, Callable[..., list[list[dict[str, Any]]]]] = {
    "gymnasium": single,
    "parallel": parallel,
    "aec": by_turns,
    "sb3": rows,
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("door", DOORS)
def test_the_same_names_of_arrays_at_every_call(door: str, variant: str) -> None:
    """Two episodes, ends and new starts among them: same names, shapes and types, so that all of it can be stacked."""
    calls = DOORS[door](**{**SHORT, **VARIANTS[variant]})
    infos = list(itertools.chain(*calls))
    assert len(infos) >= 8
    first = infos[0]
    assert {f"reward/{name}" for name in REWARD_TERMS} < first.keys()
    assert {"truth/poses", "truth/points", "prior/depth", "prior/pose", "prior/pose_sd"} < first.keys()
    assert ("errors/pose" in first) == (variant != "bare")
    assert ("bound_sd" in first) == (variant != "without the bound")
    for info in infos:
        assert list(info) == list(first)
        assert all(type(value) is np.ndarray and value.dtype == np.float64 for value in info.values())
    for name in first:
        assert np.stack([info[name] for info in infos]).shape == (len(infos), *first[name].shape)
    if door in ("aec", "sb3"):
        return  # hands on what one call gave at the turns of several robots; two runs
    for one, other in itertools.pairwise(calls):  # what is handed out is fresh
        for a, b in zip(one, other, strict=True):
            assert not any(np.shares_memory(a[name], b[name]) for name in a)


@pytest.mark.parametrize("asked", [(), ("truth",), ("truth/poses", "reward/effort"), ["reward", "bound_sd"], ENTRIES])
def test_every_interface_takes_info_with_the_same_meaning(asked: Any) -> None:
    known = [*(f"reward/{name}" for name in REWARD_TERMS), *SOURCES]
    wanted = {name for name in known if name in asked or name.split("/")[0] in asked}
    for door in DOORS.values():
        assert all(info.keys() == wanted for info in itertools.chain(*door(**SHORT, info=asked)))
    batch = RellocVectorEnv(2, **SHORT, info=asked)
    for info in (batch.reset(seed=1)[1], batch.step(np.zeros((2, 4)))[4]):
        assert info.keys() == wanted | {f"_{name}" for name in wanted}


@pytest.mark.parametrize("door", [*DOORS, "vector", "varied"])
def test_names_that_are_none(door: str) -> None:
    def build(**options: Any) -> Any:
        if door == "vector":
            return RellocVectorEnv(2, **options)
        if door == "varied":
            return pytest.importorskip("relloc_env.envs.varied").VariedVecEnv(2, groups=1, **options)
        return DOORS[door](**options)

    with pytest.raises(
        ConfigError, match=r"`info` must have names .*, but has 'truth/pose'; did you mean `truth/poses`"
    ):
        build(info=["truth/pose"])
    with pytest.raises(ConfigError, match=r"`info` must be a sequence of names among .*, but is 'truth'"):
        build(info="truth")


def test_values_are_those_of_the_environment() -> None:
    """Whichever interface: the same seed and actions, the same numbers; what the robots were told stays what it was."""
    env: Any = gym.make("relloc_env/RelativePose-v0", **SHORT)
    agents = relloc_env.parallel_env(**SHORT)
    batch = RellocVectorEnv(2, **SHORT)
    info, infos, many = env.reset(seed=5)[1], agents.reset(seed=5)[1], batch.reset(seed=4)[1]
    told = {name: value.copy() for name, value in info.items() if name.startswith("prior/")}
    action = np.array([0.5, -0.2, 0.1, 0.9], np.float32)
    for _ in range(3):
        for name, value in info.items():
            of_robots = [infos[agent][name] for agent in ("robot_a", "robot_b")]
            np.testing.assert_array_equal(np.mean(of_robots, axis=0) if "reward/" in name else of_robots[1], value)
            np.testing.assert_array_equal(many[name][1], value)
        np.testing.assert_equal({name: info[name] for name in told}, told)
        np.testing.assert_array_equal(info["truth/poses"], env.unwrapped.core.simulation.world.pose[0])
        *_, info = env.step(action)
        *_, infos = agents.step({"robot_a": action[:2], "robot_b": action[2:]})
        *_, many = batch.step(np.tile(action, (2, 1)))


def test_a_copy_tells_of_itself() -> None:
    """Unpickled, an environment goes on, and its `info` is of the copy."""
    env: Any = gym.make("relloc_env/RelativePose-v0", **SHORT).unwrapped
    env.reset(seed=1)
    other = pickle.loads(pickle.dumps(env))
    np.testing.assert_equal(other.step(np.ones(4))[4], env.step(np.ones(4))[4])
    before = env.step(np.zeros(4))[4]
    other.step(np.ones(4))
    *_, info = other.step(np.ones(4))
    assert not np.array_equal(info["truth/poses"], before["truth/poses"])


def test_wrapped_estimators_need_no_info() -> None:
    """They are told what the robots are told, also where the environment hands nothing out."""
    runs = []
    for info in (ENTRIES, ()):
        bare = gym.make("relloc_env/RelativePose-v0", estimator=None, max_cycles=3, info=info)
        env = EstimateObservation(bare, "cascade")
        runs.append([env.reset(seed=1)[0], env.step(np.ones(4))[0]])
    np.testing.assert_array_equal(runs[0], runs[1])
