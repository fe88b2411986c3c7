"""The names of the agents: one place to add another."""

import difflib
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from agents import scripted
from agents.feedback import Edge
from agents.learned import PREFIX, learned, options, shipped
from agents.planned import OpenLoop, Planner
from agents.policy import Policy, Task
from relloc_env.places import UntrustedError, load
from relloc_env.quoting import quote, word


def _script(law: scripted.Law) -> Callable[[Task], Policy]:
    return partial(scripted.Scripted, law=law)


SCRIPTED: Mapping[str, Callable[[Task], Policy]] = {
    "stationary": _script(scripted.stationary),
    "straight": _script(scripted.straight),
    "paper": _script(scripted.paper),
    "back-and-forth": _script(scripted.back_and_forth),
    "arc": _script(scripted.arc),
    "circle": _script(scripted.circle),
    "sinusoid": _script(scripted.sinusoid),
    "figure-eight": _script(scripted.figure_eight),
    "spiral": _script(scripted.spiral),
    "random": scripted.RandomSmooth,
}
"""Agents that move by the clock. What builds each from a task, as in the groups below."""

FEEDBACK: Mapping[str, Callable[[Task], Policy]] = {
    "edge": Edge,
    "edge-near": partial(Edge, near=0.7, far=2.0),
    "edge-two": partial(Edge, near=0.7, far=1.5, keep=2),
    "edge-nearest": partial(Edge, near=0.6, far=2.0, keep=1),
}
"""Agents that answer to what they see."""

PLANNED: Mapping[str, Callable[[Task], Policy]] = {"planner": Planner, "open-loop-optimum": OpenLoop}
"""Agents that plan, reported apart, with their cost; `open-loop-optimum` knows the truth."""

AGENTS = {**SCRIPTED, **FEEDBACK}
"""Agents that cost next to nothing: what is played unless others are asked for."""
GROUPS = {"scripted": SCRIPTED, "feedback": FEEDBACK, "planned": PLANNED}


def agent(name: str) -> Callable[[Task], Policy]:
    """Return what builds the agent of this name, or the class that `path/to/file.py:MyAgent` leads to.

    `learned:NAME` is a policy that ships; `learned:path/to/policy.onnx` or `.zip` a file, see `agents.learned`.

    Raises:
        ValueError: an unknown name (with a suggestion), or a path that leads nowhere.
    """
    if name.startswith(PREFIX):
        return partial(learned, name=name.removeprefix(PREFIX))
    if ":" in name:
        build: Callable[[Task], Policy] = load(name, "agents")
        return build
    known = {**AGENTS, **PLANNED}
    if name not in known:
        close = difflib.get_close_matches(name, [*known, *(PREFIX + policy for policy in shipped())], n=1)
        hint = f"; did you mean `{close[0]}`?" if close else ""
        if name.endswith(".py"):
            hint = f": say `{name}:` and the name of the class in it, as in `{name}:MyAgent`"
        elif name.endswith(".zip"):
            hint = f": say `{PREFIX}{name}` for a policy that Stable-Baselines3 saved"
        ships = ", ".join(f"{PREFIX}{policy}" for policy in shipped())
        ways = f"{', '.join(known)}, {ships}; or `{PREFIX}` and a file, .onnx or .zip, or `FILE.py:NAME`"
        raise ValueError(f"Unknown agent `{word(name)}`{hint}; known: {ways}")
    return known[name]


def runs_code(name: str) -> bool:
    """Return whether an agent of this name is code of somebody's, or is read by what runs code: a `.zip` is pickled."""
    return Path(name).suffix == ".zip" if name.startswith(PREFIX) else ":" in name


def refuse_agents(names: Iterable[str], path: str | Path) -> None:
    """Raise where names in a file are of agents that run code.

    Raises:
        UntrustedError: they are.
    """
    for name in names:
        if runs_code(name):
            raise UntrustedError(
                f"{path} names an agent that runs code, {quote(name)}: say `--trust`, in Python `trust=True`, if you "
                "trust it"
            )


def refuse_pickled(names: Iterable[str]) -> None:
    """Raise where names given by a user are of policies that are pickled: it is not plain that these run code.

    Raises:
        UntrustedError: they are.
    """
    for name in names:
        if name.startswith(PREFIX) and runs_code(name):
            path = name.removeprefix(PREFIX)
            raise UntrustedError(f"{path} is pickled, which runs whatever code is in it: say `--trust` if you trust it")


def needs(name: str) -> dict[str, Any]:
    """Return options of the environment without which the agent of this name cannot act in it."""
    return options(name.removeprefix(PREFIX)) if name.startswith(PREFIX) else {}


def group(name: str) -> str:
    """Return the name of the group that an agent is in: `learned` for a saved policy, `own` for one of the user's."""
    if name.startswith(PREFIX):
        return "learned"
    return next((title for title, agents in GROUPS.items() if name in agents), "own")


def short(name: str) -> str:
    """Return what is left of an agent's or estimator's name without its path: `MyAgent`, `policy.zip`.

    Of `RUN/policy.onnx`, as every run of `train` has it, the name of the run.
    """
    above, _, last = name.rpartition(":")[2].rpartition("/")
    return above.rpartition("/")[2] if above and last == "policy.onnx" else last


def make(name: str, task: Task) -> Policy:
    """Build the agent of this name, see `agent`."""
    return agent(name)(task)
