"""Errors of agents that users wrote, said so that they can be mended: which agent, which file, which line."""

import inspect
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import agents
import relloc_env

_OURS = [str(Path(module.__file__ or "").parent) for module in (agents, relloc_env)]
_LIBRARIES = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")]


class AgentError(Exception):
    """The code of an agent raised an error, or gave what no policy gives.

    Args:
        name: of the agent.
        place: file and line.
        reason: what was raised, in words.
    """

    def __init__(self, name: str, place: str, reason: str) -> None:
        super().__init__(name, place, reason)
        self.name, self.place, self.reason = name, place, reason

    def __str__(self) -> str:
        return f"The agent `{self.name}` failed in {self.place}: {self.reason}"


@contextmanager
def code_of(name: str, thing: object) -> Iterator[None]:
    """Call an agent's code inside.

    Args:
        name: of the agent.
        thing: it, or what builds it: named where the error comes from no line of its own.

    Raises:
        AgentError: code outside of this project raised something. Errors of the project's own agents stay as they are.
    """
    try:
        yield
    except AgentError:
        raise
    except Exception as error:
        place = place_of(error, thing)
        if place is None:
            raise
        raise AgentError(name, place, f"{type(error).__name__}: {error}") from error


def place_of(error: BaseException, thing: object) -> str | None:
    """File and line of the user's that an error of an agent comes from; None where these are the project's own."""
    return _line(error) or _source(thing)


def _line(error: BaseException) -> str | None:
    """The last line of the user's that led to an error; those in libraries are passed over."""
    frames = traceback.extract_tb(error.__traceback__)
    users = [frame for frame in frames if _is_users(frame.filename)]
    return f"{users[-1].filename}, line {users[-1].lineno}" if users else None


def _source(thing: object) -> str | None:
    """Where the user wrote a class, a function, or the class of an object."""
    for made in (thing, type(thing)):
        try:
            file = inspect.getsourcefile(made)  # type: ignore[arg-type]
            line = inspect.getsourcelines(made)[1]  # type: ignore[arg-type]
        except (TypeError, OSError):
            continue
        if file is not None and _is_users(file):
            return f"{file}, line {line}"
    return None


def _is_users(file: str) -> bool:
    return not file.startswith("<frozen") and not any(Path(file).is_relative_to(each) for each in (*_OURS, *_LIBRARIES))
