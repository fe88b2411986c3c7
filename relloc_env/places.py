"""Where the name of something of the user's own leads: `module:Name` or `path/to/file.py:Name`.

What is named in Python or on the command line is the user's own. What a file names may be a stranger's: it runs where
the user says so alone (SECURITY.md).
"""

import importlib
import importlib.util
import operator
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from relloc_env.quoting import quote


class UntrustedError(ValueError):
    """A file names code that would run, and nobody has said that it may."""


def leads_to_code(text: str) -> bool:
    """Whether a text has the form of `module:Name` or `path/to/file.py:Name`; nothing else is ever imported."""
    place, _, name = text.rpartition(":")
    return (place.endswith(".py") or _dotted(place)) and _dotted(name)


def _dotted(text: str) -> bool:
    return all(part.isidentifier() for part in text.split("."))


def code_in(data: Any) -> set[str]:
    """Texts in plain data, at any depth, that lead to code."""
    found: set[str] = set()
    todo = [data]
    while todo:
        each = todo.pop()
        if isinstance(each, str) and leads_to_code(each):
            found.add(each)
        elif isinstance(each, Mapping):
            todo.extend(each.values())
        elif isinstance(each, list | tuple | set):
            todo.extend(each)
    return found


def refuse_code(data: Any, path: str | Path, allowed: Collection[str] = ()) -> None:
    """Raise where plain data from a file lead to code.

    Args:
        data: to look through.
        path: of the file, for the error.
        allowed: what it may lead to.

    Raises:
        UntrustedError: they do.
    """
    for text in sorted(code_in(data) - set(allowed)):
        raise UntrustedError(
            f"{path} names code that would run, {quote(text)}: say `--trust`, in Python `trust=True`, if you trust it"
        )


def load(path: str, argument: str = "estimator") -> Any:
    """Return what `module:Name` or `path/to/file.py:Name` names.

    Args:
        path: see above.
        argument: what the caller calls it, for errors.

    Raises:
        ValueError: a module or file that cannot be imported or raises, or has no such name; the cause is chained.
    """
    if not leads_to_code(path):
        raise ValueError(
            f"Argument `{argument}` must lead to a class or function, as 'module:Name' or 'path/to/file.py:Name', but "
            f"is {quote(path)}"
        )
    place, _, name = path.rpartition(":")
    try:
        module = _run_file(Path(place)) if place.endswith(".py") else importlib.import_module(place)
        found = operator.attrgetter(name)(module)
    except Exception as error:  # whatever the user's own code raises
        known = isinstance(error, ImportError | OSError | AttributeError)
        what = str(error) if known else f"{type(error).__name__}: {error}"
        raise ValueError(
            f"Argument `{argument}` must lead to a class or function, but {path!r} does not: {what}"
        ) from error
    if not callable(found):
        raise TypeError(
            f"Argument `{argument}` must lead to a class or function, but {path!r} is {type(found).__name__}"
        )
    return found


def place_of(thing: Any) -> str | None:
    """Return the `module:Name` of a class or function, or None where it is not found again by that.

    A lambda, a partial or a function inside another is not.
    """
    module, name = getattr(thing, "__module__", None), getattr(thing, "__qualname__", None)
    try:
        found = operator.attrgetter(str(name))(sys.modules[str(module)])
    except (KeyError, AttributeError):
        return None
    return f"{module}:{name}" if found is thing else None


def _run_file(path: Path) -> ModuleType:
    """Import a file by its place, once in a process."""
    name = str(path.resolve())
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        sys.path.insert(0, str(path.resolve().parent))  # where its neighbours are
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
        finally:
            sys.path.remove(str(path.resolve().parent))
    return sys.modules[name]
