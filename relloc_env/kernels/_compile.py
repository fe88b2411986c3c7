"""Compile options of every kernel, in one place.

A kernel is a function of numbers and arrays, compiled once and cached on disk. It releases the global interpreter
lock, so a batch may be cut into parts that run on several threads; `fastmath` stays off, so that an environment gives
the same bits alone and in a batch of any size.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile `function` with the project's options (typed as the function itself)."""
    return _compile(function)


def inlined(function: F) -> F:
    """The same, and compiled into each kernel that calls it: for small functions in the innermost loops."""
    return _compile(function, forceinline=True)


def _compile(function: F, **extra: bool) -> F:
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": False, **extra}
    try:
        compiled: F = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no writable place for numba's cache: compile anew in this process
        compiled = numba.njit(**options)(function)
    return compiled
