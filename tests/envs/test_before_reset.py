"""Every public method and property of every interface before the first `reset`, and after one that was refused."""

import inspect
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import relloc_env
from relloc_env.config import ConfigError
from relloc_env.envs.vector import RellocVectorEnv

PAIR = "relloc_env/RelativePose-v0"
OPTIONS: dict[str, Any] = {"estimator": "cascade", "max_cycles": 3}
AGENTS = ("robot_a", "robot_b")


def rows(decentralised: bool) -> Any:
    sb3 = pytest.importorskip("relloc_env.envs.sb3")
    return sb3.RellocVecEnv(2, decentralised=decentralised, **OPTIONS)


DOORS: dict[str, Callable[[], Any]] = {
    "gymnasium": lambda: gym.make(PAIR, **OPTIONS),
    "unwrapped": lambda: gym.make(PAIR, **OPTIONS).unwrapped,
    "parallel": lambda: relloc_env.parallel_env(**OPTIONS),
    "aec": lambda: relloc_env.env(**OPTIONS),
    "aec of one robot": lambda: relloc_env.env(robots=1, **OPTIONS),
    "vector": lambda: RellocVectorEnv(2, **OPTIONS),
    "member of a vector": lambda: RellocVectorEnv(2, **OPTIONS).member(1),
    "sb3": lambda: rows(decentralised=False),
    "row of sb3": lambda: rows(decentralised=True).row(1),
}
OF_AEC = ("rewards", "terminations", "truncations", "infos", "agent_selection", "num_agents", "agents")
"""What an AEC environment has from its first reset on."""
NEEDS_AN_EPISODE = {"step", "step_async", "step_wait", "state", "states", "state_of", "observations", "render"}
OTHERS = {"reset", "from_belief"}
"""Starts an episode; takes what only an episode gives."""
WORDS = r"(?i)reset"


def arguments(door: str, name: str, method: Any) -> dict[str, Any]:
    """A sensible value for each argument that must be given."""
    actions: Any = np.zeros((2, 4), np.float32)
    if door in ("gymnasium", "unwrapped"):
        actions = np.zeros(4, np.float32)
    known = {
        "actions": dict.fromkeys(AGENTS, np.zeros(2)) if door == "parallel" else actions,
        "action": np.zeros(2) if door.startswith("aec") else actions,
        "agent": "robot_a",
        "index": 0,
        "rows": {},
        "copies": 2,
        "name": "mine" if name in ("set_attr", "set_wrapper_attr") else "config",
        "attr_name": "mine" if name == "set_attr" else "config",
        "method_name": "get_state",
        "wrapper_class": gym.Wrapper,
        "already_found": False,
        "value": 1,
        "values": 1,
    }
    if name == "set_state":
        return {}
    needed = [p.name for p in inspect.signature(method).parameters.values() if p.default is p.empty]
    return {each: known[each] for each in needed if each in known}


def use(env: Any, door: str, name: str) -> Any:
    """Read an attribute, and call it where it can be."""
    found = getattr(env, name)
    if not callable(found) or inspect.isclass(found):
        return found
    if name == "set_state":
        return found(env.get_state())
    result = found(**arguments(door, name, found))
    return list(result) if name == "agent_iter" else result


def expected(door: str, name: str) -> tuple[type[Exception], ...]:
    """The errors that a call before `reset` may end in; PettingZoo's own for its AEC environments."""
    if not door.startswith("aec"):
        return (ResetNeeded,)
    return (AttributeError,) if name in (*OF_AEC, "last") else (AssertionError,)


CASES = [
    (door, name)
    for door, make in DOORS.items()
    if "sb3" not in door
    for env in [make()]
    for name in sorted({*(n for n in dir(env) if not n.startswith("_")), *(OF_AEC if "aec" in door else ())})
    if name not in OTHERS
]


def check(env: Any, door: str, name: str) -> None:
    by_turns = door.startswith("aec") and name in (*OF_AEC, "last", "observe", "agent_iter")
    needs = name in NEEDS_AN_EPISODE or by_turns
    if name == "render" and env.render_mode is None and not door.startswith("aec") and door != "gymnasium":
        return  # draws nothing, and says so
    if needs:
        with pytest.raises(expected(door, name), match=WORDS):
            use(env, door, name)
    else:
        use(env, door, name)


@pytest.mark.filterwarnings("ignore:The `(observation|action)_spaces` dictionary is deprecated")
@pytest.mark.parametrize(("door", "name"), CASES)
def test_before_the_first_reset(door: str, name: str) -> None:
    check(DOORS[door](), door, name)


@pytest.mark.parametrize("door", ["sb3", "row of sb3"])
def test_before_the_first_reset_of_rows(door: str) -> None:
    first = DOORS[door]()
    for name in [n for n in dir(first) if not n.startswith("_") and n not in (*OTHERS, "get_images", "render")]:
        check(DOORS[door](), door, name)


@pytest.mark.parametrize("door", ["unwrapped", "parallel", "aec", "vector", "sb3"])
def test_after_a_reset_that_was_refused(door: str) -> None:
    """As before the first one, also where there was an episode; then the next reset heals it."""
    env = DOORS[door]()
    refused = {"poses": [(4.0, 0.0, 0.0), (4.0, 1.5, 0.0)]}  # looking at the wall: nothing can be in view
    rows = door == "sb3"
    for _ in range(2):
        if rows:
            env.set_options(refused)
        with pytest.raises(ConfigError, match="No start was found"):
            env.reset() if rows else env.reset(options=refused)
        for name in ("step", "states" if rows else "state", *((*OF_AEC, "last", "observe") if door == "aec" else ())):
            check(env, door, name)
        if rows:
            env.set_options({"poses": None, "points": None})
        env.reset(**({} if rows else {"options": {}}))
        assert np.isfinite(env.states() if rows else env.state()).all()
