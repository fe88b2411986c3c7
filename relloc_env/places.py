"""Where the name of something of the user's own leads: `module:Name` or `path/to/file.py:Name`."""

import importlib
import importlib.util
import operator
import sys
from pathlib import Path
from types import ModuleType
from typing import Any


def load(path: str, argument: str = "estimator") -> Any:
    """Return what `module:Name` or `path/to/file.py:Name` names.

    Args:
        path: see above.
        argument: what the caller calls it, for errors.

    Raises:
        ValueError: a module or file that cannot be imported or raises, or has no such name; the cause is chained.
    """
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
