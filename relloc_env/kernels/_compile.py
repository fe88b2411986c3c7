"""Compile options of every kernel, in one place, and the cache of what was compiled.

A kernel is a function of numbers and arrays, compiled once and cached on disk. It releases the global interpreter
lock, so a batch may be cut into parts that run on several threads; `fastmath` stays off, so that an environment gives
the same bits alone and in a batch of any size.

numba keeps the cache where NUMBA_CACHE_DIR says, else beside the sources, else, where those are read-only, in the
user's cache folder. It notices a change of the file that a kernel stands in, not of the kernels that it calls in other
files: here a kernel is compiled anew after a change of its file or of any file with kernels that this one imports.
Of several processes that need a kernel at once, one compiles it and the others load it.

`_linking.py` does that by the inside of numba. With a numba that it does not know, kernels are plain `numba.njit` with
`cache=True`: the same numbers, but a longer first compilation, once in every process that starts meanwhile, and no
notice of a change in other files.
"""

import functools
import hashlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numba

_FOLDER = Path(__file__).parent
_IMPORT = re.compile(rb"^ *(?:from|import) +(relloc_env[\w.]*)", re.MULTILINE)
_MARK = b"relloc_env.kernels._compile"
F = TypeVar("F", bound=Callable[..., Any])
QUIET = "RELLOC_QUIET"
"""Environment variable: anything but empty or 0 switches off what is said on stderr."""


def kernel(function: F) -> F:
    """Compile `function`, of a module, with the project's options (typed as the function itself)."""
    return _compile(function)


def inlined(function: F) -> F:
    """The same, put in the place of each call in other kernels: for small functions in the innermost loops."""
    return _compile(function, forceinline=True)


def plain(function: Any) -> Callable[..., Any]:
    """The equation of a kernel as plain Python, for whole arrays: nothing is compiled for their types."""
    found: Callable[..., Any] = getattr(function, "py_func", function)
    return found


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": False}


def _compile(function: F, **as_part: bool) -> F:
    if is_set("NUMBA_DISABLE_JIT"):
        return function
    linking = _linking()
    compiled: Any
    if linking is not None:
        compiled = linking.compiled(function, _OPTIONS, as_part)
    else:
        try:
            compiled = numba.njit(**_OPTIONS, cache=True)(function)
        except RuntimeError:  # there is nowhere to write
            compiled = numba.njit(**_OPTIONS)(function)
    return compiled  # type: ignore[no-any-return]


@functools.cache
def _linking() -> ModuleType | None:
    """What compiles by the inside of numba, where that is as it should be."""
    try:
        import relloc_env.kernels._linking as linking
    except (ImportError, AttributeError):  # what it is built upon is no more
        return None
    return linking if linking.fits() else None


def is_set(variable: str) -> bool:
    """Whether an environment variable is anything but empty or 0."""
    return os.environ.get(variable, "0") not in ("", "0")


def is_awaited(function: Any) -> bool:
    """Whether a kernel has a cache, which holds nothing of it yet."""
    cache = getattr(function, "_cache", None)
    return bool(getattr(cache, "is_empty", bool)())


@functools.cache
def sources_digest(path: Path) -> str:
    """Digest of a file, and of all files with kernels of this package that it imports, directly or not."""
    found: dict[Path, bytes] = {}
    ahead = [path]
    while ahead:
        path = ahead.pop()
        if path not in found:
            found[path], imported = _source(path)
            ahead.extend(imported)
    return hashlib.sha256(b"".join(found[path] for path in sorted(found))).hexdigest()


@functools.cache
def _source(path: Path) -> tuple[bytes, list[Path]]:
    """Digest of a file, and the files that it imports from this package; empty where a file holds no kernels."""
    try:
        content = path.read_bytes()
    except OSError:
        return b"", []
    if path.parent != _FOLDER and _MARK not in content:
        return b"", []
    imported: list[Path] = []
    for name in set(_IMPORT.findall(content)):
        place = _FOLDER.parents[1].joinpath(*name.decode().split("."))
        imported += place.glob("*.py") if place.is_dir() else [place.with_suffix(".py")]
    return hashlib.sha256(content).digest(), imported


@functools.cache
def announce() -> None:
    """Say once in a process that something has to be compiled, since that takes a while."""
    if not is_set(QUIET):
        sys.stderr.write(
            f"relloc_env: compiling kernels, about a minute; they are cached for the next time ({QUIET}=1 hides this)\n"
        )
        sys.stderr.flush()
