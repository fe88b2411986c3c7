"""Wrong input raises at the call that made it; the message names the argument, what it must be, and what it was."""

import re
from typing import Any

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from gymnasium.error import ResetNeeded

import relloc_env
from relloc_env.config import ConfigError, load_config

SINGLE, PAIR = "relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0"
ZERO = {"robot_a": np.zeros(2), "robot_b": np.zeros(2)}

WRONG_ACTIONS: dict[str, tuple[Any, str]] = {
    "nan": ([0.0, np.nan], r"must be finite, but is \[0.0, nan\]"),
    "infinite": ([np.inf, 0.0], r"must be finite, but is \[inf, 0.0\]"),
    "too long": ([0.0, 0.0, 0.0], r"must have shape \(2,\), but has \(3,\)"),
    "too short": ([0.0], r"must have shape \(2,\), but has \(1,\)"),
    "a matrix": ([[0.0, 0.0]], r"must have shape \(2,\), but has \(1, 2\)"),
    "a number": (0.5, r"must have shape \(2,\), but has \(\)"),
    "words": (["fast", "left"], r"must be numbers of shape \(2,\), but is \['fast', 'left'\]"),
    "nothing": (None, r"must be numbers of shape \(2,\), but is None"),
    "an object": (object(), r"must be numbers of shape \(2,\), but is <object"),
    "ragged": ([[0.0], [0.0, 1.0]], r"must be numbers of shape \(2,\), but is"),
    "complex": ([1j, 0.0], r"must be numbers of shape \(2,\), but is"),
    "complex array": (np.zeros(2, np.complex64), r"must be numbers of shape \(2,\), but is an array of complex64"),
    "masked": (np.ma.masked_array([0.0, 0.5], [True, False]), r"must be numbers of shape \(2,\), but is masked"),
    "masked, nothing hidden": (np.ma.masked_array([0.0, 0.5]), r"must be numbers of shape \(2,\), but is masked"),
    "masked integers": (np.ma.masked_array([0, 1], [True, False]), r"must be numbers of shape \(2,\), but is masked"),
    "durations": (np.zeros(2, "m8[s]"), r"must be numbers of shape \(2,\), but is an array of timedelta64"),
    "dates": (np.zeros(2, "M8[D]"), r"must be numbers of shape \(2,\), but is an array of datetime64"),
    "numbers as text": (np.array(["0.1", "1"]), r"must be numbers of shape \(2,\), but is an array of <U3"),
    "numbers as bytes": (np.array([b"0", b"1"]), r"must be numbers of shape \(2,\), but is an array of \|S1"),
    "list of text": (["0.1", "1"], r"must be numbers of shape \(2,\), but is \['0.1', '1'\]"),
    "objects": (np.array([0.5, 1.0], object), r"must be numbers of shape \(2,\), but is an array of object"),
    "truth values": (np.array([True, False]), r"must be numbers of shape \(2,\), but is an array of bool"),
    "list of truth values": ([True, False], r"must be numbers of shape \(2,\), but is \[True, False\]"),
    "records": (np.zeros(2, [("v", "f8")]), r"must be numbers of shape \(2,\), but is an array of \[\('v', '<f8'\)\]"),
    "a mapping": ({"v": 1.0}, r"must be numbers of shape \(2,\), but is \{'v': 1.0\}"),
    "too large for a float": (np.array([0.0, np.finfo(np.longdouble).max]), r"must be finite, but is"),
    "huge integers": ([0, 10**5000], r"must be numbers of shape \(2,\), but is <list>"),
}


@pytest.fixture(scope="module")
def parallel() -> Any:
    return relloc_env.parallel_env()


@pytest.fixture(scope="module")
def single() -> Any:
    return gym.make(SINGLE).unwrapped


@pytest.fixture(scope="module")
def joint() -> Any:
    return gym.make(PAIR).unwrapped


@pytest.mark.parametrize("name", WRONG_ACTIONS)
def test_wrong_actions(name: str, parallel: Any, single: Any) -> None:
    """Refused at each door, and nothing has happened: the episode goes on as if the call had not been."""
    action, message = WRONG_ACTIONS[name]
    parallel.reset(seed=1)
    before = parallel.get_state()
    with pytest.raises(ValueError, match=rf"Argument `actions\['robot_b'\]` {message}"):
        parallel.step({"robot_a": np.ones(2), "robot_b": action})
    after = parallel.get_state()
    for part, value in before["core"]["world"].items():
        np.testing.assert_array_equal(value, after["core"]["world"][part])
    parallel.step(ZERO)
    single.reset(seed=1)
    with pytest.raises(ValueError, match=f"Argument `action` {message}"):
        single.step(action)
    single.step(np.zeros(2))
    turns = relloc_env.env(estimator=None)
    turns.reset(seed=1)
    with pytest.raises(ValueError, match=f"Argument `action` {message}"):
        turns.step(action)
    assert turns.agent_selection == "robot_a"
    turns.step(np.zeros(2))
    assert turns.agent_selection == "robot_b"


@pytest.mark.parametrize("kind", ["i1", "u2", "i4", "u8", "f2", "f4", ">f4", "f8", "g", list, tuple])
def test_numbers_of_any_width_are_actions(kind: Any, parallel: Any) -> None:
    """At every width the same action gives the same observation."""
    shown = []
    for form in ("f8", kind):
        action = kind([1, 0]) if form is kind and isinstance(kind, type) else np.array([1, 0], form)
        parallel.reset(seed=1)
        shown.append(parallel.step({"robot_a": action, "robot_b": action})[0]["robot_a"])
    np.testing.assert_array_equal(*shown)


def test_joint_action_has_four_entries(joint: Any) -> None:
    joint.reset(seed=1)
    with pytest.raises(ValueError, match=r"Argument `action` must have shape \(4,\), but has \(2,\)"):
        joint.step(np.zeros(2))
    with pytest.raises(ValueError, match=r"Argument `action` must be finite, but is \[0.0, 0.0, nan, 0.0\]"):
        joint.step(np.array([0.0, 0.0, np.nan, 0.0]))


@pytest.mark.parametrize(
    ("actions", "given"),
    [
        ({"robot_a": np.zeros(2)}, "['robot_a']"),
        ({**ZERO, "robot_c": np.zeros(2)}, "['robot_a', 'robot_b', 'robot_c']"),
        ({"robot_a": np.zeros(2), "robot_c": np.zeros(2)}, "['robot_a', 'robot_c']"),
        ({}, "[]"),
        ({0: np.zeros(2), 1: np.zeros(2)}, "['0', '1']"),
        (np.zeros((2, 2)), "ndarray"),
        (None, "NoneType"),
    ],
)
def test_missing_and_unknown_robots(actions: Any, given: str, parallel: Any) -> None:
    parallel.reset(seed=1)
    message = f"Argument `actions` must have one action for each of ['robot_a', 'robot_b'], but has {given}"
    with pytest.raises(ValueError, match=re.escape(message)):
        parallel.step(actions)


def test_stepping_before_the_first_reset() -> None:
    with pytest.raises(ResetNeeded, match="Call `reset` before `step`"):
        relloc_env.parallel_env(estimator=None).step(ZERO)
    with pytest.raises(ResetNeeded, match="Call `reset` before `step`"):
        gym.make(PAIR, estimator=None).unwrapped.step(np.zeros(4))
    with pytest.raises(ResetNeeded):
        gym.make(PAIR, estimator=None).step(np.zeros(4, np.float32))
    with pytest.raises(AssertionError, match=r"reset\(\) needs to be called before step"):
        relloc_env.env(estimator=None).step(np.zeros(2))


def test_stepping_after_the_end() -> None:
    env = relloc_env.parallel_env(estimator=None, max_cycles=2)
    joint = gym.make(PAIR, estimator=None, max_cycles=2).unwrapped
    env.reset(seed=1)
    joint.reset(seed=1)
    for _ in range(2):
        env.step(ZERO)
        joint.step(np.zeros(4))
    for _ in range(2):
        assert env.step({}) == ({}, {}, {}, {}, {})  # nobody is left to act, as in the environments of PettingZoo
    with pytest.raises(ResetNeeded, match="no episode is running"):
        env.step(ZERO)
    with pytest.raises(ResetNeeded, match="no episode is running"):
        joint.step(np.zeros(4))
    env.reset()
    env.step(ZERO)


def test_acting_by_turns_after_the_end() -> None:
    env = relloc_env.env(estimator=None, max_cycles=1)
    env.reset(seed=1)
    for _ in range(2):
        env.step(np.zeros(2))
    with pytest.raises(ValueError, match="Argument `action` must be None, as the episode of robot_a is over"):
        env.step(np.zeros(2))
    for _ in range(2):
        env.step(None)
    assert env.agents == []


def test_drawing_before_the_first_reset() -> None:
    pytest.importorskip("pygame")
    for env in (relloc_env.parallel_env(render_mode="rgb_array"), gym.make(PAIR, render_mode="rgb_array").unwrapped):
        with pytest.raises(ResetNeeded, match="Call `reset` before `render`"):
            env.render()
        env.close()


@pytest.mark.parametrize(
    "seed",
    [
        -1,
        1.5,
        3.0,
        "1",
        "a",
        b"1",
        True,
        np.True_,
        np.array(True),
        np.float64(2.0),
        np.array(3.0),
        np.array(-1),
        [1],
        1j,
    ],
)
def test_wrong_seeds(seed: Any, parallel: Any, joint: Any) -> None:
    for env in (parallel, joint):
        with pytest.raises(
            ValueError, match=re.escape(f"Argument `seed` must be a non-negative integer, but is {seed!r}")
        ):
            env.reset(seed=seed)


@pytest.mark.parametrize(
    "seed", [0, np.int64(5), np.uint8(7), np.array(3), np.array(4, np.uint16), 2**63 + 1, 2**64 - 1, 2**64, 2**200]
)
def test_any_other_seed_is_taken(seed: Any, parallel: Any, joint: Any) -> None:
    for env in (parallel, joint):
        first, _ = env.reset(seed=seed)
        again, _ = env.reset(seed=seed)
        np.testing.assert_equal(first, again)


def test_large_seeds_are_not_cut(parallel: Any) -> None:
    """Seeds that agree in their last 64 bits give different episodes."""
    starts = []
    for seed in (3, 2**64 + 3, 2**65 + 3):
        _, infos = parallel.reset(seed=seed)
        starts.append(infos["robot_a"]["truth/poses"].tobytes())
    assert len(set(starts)) == 3


WRONG_OPTIONS: dict[str, tuple[Any, str]] = {
    "no mapping": ([1, 2], "`options` must be a mapping, but is list"),
    "one pose for two": ({"poses": [(0, 0, 0)]}, r"`poses` must have shape \(2, 3\), but has \(1, 3\)"),
    "pose without heading": ({"poses": [(0, 0), (1, 1)]}, r"`poses` must have shape \(2, 3\), but has \(2, 2\)"),
    "points of another count": ({"points": [(1, 1, 1)]}, r"`points` must have shape \(2, 3\), but has \(1, 3\)"),
    "no points": ({"points": []}, r"`points` must have shape \(2, 3\), but has \(0,\)"),
    "not finite": ({"points": [(1, 1, 1), (1, np.nan, 1)]}, "`points` must be finite, but is"),
    "words": ({"poses": "here"}, r"`poses` must be numbers of shape \(2, 3\), but is 'here'"),
    "in a wall": ({"poses": [(0, 0, 0), (0, 4.95, 0)]}, "`options` must have robots within the walls, but robot 1"),
    "in each other": ({"poses": [(0, 0, 0), (0, 0.1, 0)]}, "`options` must have robots apart, but robots 0 and 1"),
}


@pytest.mark.parametrize("name", WRONG_OPTIONS)
def test_wrong_options_of_a_reset(name: str, parallel: Any, joint: Any) -> None:
    """Refused, and forgotten: the next reset is as if they had not been given."""
    options, message = WRONG_OPTIONS[name]
    for env in (parallel, joint):
        expected, _ = env.reset(seed=9, options={})
        with pytest.raises(ConfigError, match=f"Argument {message}"):
            env.reset(options=options)
        with pytest.raises(ResetNeeded):
            env.step(ZERO if env is parallel else np.zeros(4))
        found, _ = env.reset(seed=9)
        np.testing.assert_equal(found, expected)


def test_unknown_options_of_a_reset_are_named_in_a_warning(parallel: Any) -> None:
    """Other clients pass options of their own: ours still hold, and nothing that was fixed is lost."""
    points = [(1.0, 0.0, 0.3), (1.0, 1.0, 0.5)]
    with pytest.warns(UserWarning, match="Unknown options of reset, ignored: point; known: poses, points"):
        parallel.reset(seed=1, options={"point": 1, "points": points})
    with pytest.warns(UserWarning, match="ignored: options"):
        _, infos = parallel.reset(options={"options": 1})
    np.testing.assert_array_equal(infos["robot_a"]["truth/points"], points)
    parallel.reset(options={})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera": {"focal_length": -1.0}}, "`camera.focal_length` must be greater than 0, but is -1.0"),
        ({"poses": [(5, 0, 0), (0, 0, 0)]}, "must have robots within the walls, but robot 0 at"),
        ({"targets": 0}, "`targets` must be greater than or equal to 1, but is 0"),
        ({"points": []}, "must have at least one point in `points`, but has none"),
        ({"estimater": "cascade"}, "Unknown option `estimater`; did you mean `estimator`"),
        ({"config": "no/such/file.yaml"}, "`config` must be a readable file, but 'no/such/file.yaml': No such file"),
    ],
)
def test_impossible_configurations_at_every_door(options: dict[str, Any], message: str) -> None:
    for door in (relloc_env.parallel_env, relloc_env.env, lambda **given: gym.make(PAIR, **given)):
        with pytest.raises(ConfigError, match=re.escape(message)):
            door(**options)


def every_interface() -> dict[str, Any]:
    doors: dict[str, Any] = {
        "gymnasium": lambda **given: gym.make(PAIR, **given),
        "vector": lambda **given: gym.make_vec(PAIR, num_envs=2, **given),
        "sync": lambda **given: gym.make_vec(PAIR, num_envs=2, vectorization_mode="sync", **given),
        "parallel": relloc_env.parallel_env,
        "aec": relloc_env.env,
        "configuration": load_config,
    }
    try:
        from relloc_env.envs.sb3 import RellocVecEnv
        from relloc_env.envs.varied import VariedVecEnv
    except ImportError:
        return doors
    return {**doors, "sb3": RellocVecEnv, "varied": lambda **given: VariedVecEnv(2, groups=1, **given)}


@pytest.mark.parametrize("door", every_interface())
@pytest.mark.parametrize(
    ("name", "close"), [("frameskip", ""), ("estimater", "estimator"), ("max_cycle", "max_cycles")]
)
def test_unknown_keywords_are_type_errors_too(door: str, name: str, close: str) -> None:
    """Clients try keywords out, and read the words in which Python refuses one."""
    for kind in (TypeError, ConfigError):
        with pytest.raises(kind, match=f"got an unexpected keyword argument '{name}'") as caught:
            every_interface()[door](**{name: 1})
    assert (f"did you mean `{close}`" in str(caught.value)) == bool(close)


@pytest.mark.parametrize("make", [gym.make, gym.make_vec, "sync", "parallel", "aec"])
@pytest.mark.parametrize(("name", "wrong", "other"), [(SINGLE, 2, PAIR), (PAIR, 1, SINGLE), (PAIR, 3, None)])
def test_robots_that_an_id_does_not_have(make: Any, name: str, wrong: int, other: str | None) -> None:
    """By keyword, mapping, configuration and scenario; what agrees is taken."""

    def build(**options: Any) -> Any:
        options["estimator"] = None
        if make in ("parallel", "aec"):
            registry = getattr(pettingzoo, f"{make}_registry", None)
            if registry is None:
                pytest.skip("PettingZoo has no registry")
            return pettingzoo.make(make, name, **options)
        if make == "sync":
            return gym.make_vec(name, num_envs=1, vectorization_mode="sync", **options)
        return make(name, **options)

    message = f"`robots` must be {3 - wrong if other else 2} for `{name}`, but is {wrong}"
    message += f"; `{other}` has so many" if other else ""
    given: list[dict[str, Any]] = [{"robots": wrong}, {"config": {"robots": wrong}}]
    if other:
        given += [{"config": load_config(robots=wrong)}, {"config": load_config(robots=wrong).to_dict()}]
    if wrong == 1:
        given.append({"config": "paper-depth"})
    for options in given:
        with pytest.raises(ConfigError, match=message):
            build(**options)


def test_robots_that_an_id_has_may_be_stated() -> None:
    for name, robots in ((SINGLE, 1), (PAIR, 2)):
        for options in ({"robots": robots}, {"config": {"robots": robots}}, {"config": load_config()}, {}):
            env: Any = gym.make(name, estimator=None, **options).unwrapped
            assert env.config.robots == robots
    with pytest.raises(ConfigError, match="`task` must be one of relloc_env/ActiveDepth-v0"):
        load_config(task="nothing")
