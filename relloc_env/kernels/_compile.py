"""Compile options of every kernel, in one place, and the cache of what was compiled.

A kernel is a function of numbers and arrays, compiled once and cached on disk. It releases the global interpreter
lock, so a batch may be cut into parts that run on several threads; `fastmath` stays off, so that an environment gives
the same bits alone and in a batch of any size.

numba keeps the cache where NUMBA_CACHE_DIR says, else beside the sources, else, where those are read-only, in the
user's cache folder. It notices a change of the file that a kernel stands in, not of the kernels that it calls in other
files: here a kernel is compiled anew after a change of its file or of any file with kernels that this one imports.
"""

import contextlib
import functools
import hashlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

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


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}


def _compile(function: F, **as_part: bool) -> F:
    if is_set("NUMBA_DISABLE_JIT"):
        return function
    compiled: Any = numba.njit(**_OPTIONS)(function)
    compiled.__class__ = _Kernel
    part_options = {**_OPTIONS, **as_part, "no_cpython_wrapper": True, "pipeline_class": _PartCompiler}
    compiled.part = numba.njit(**part_options)(function)
    cache: _KernelCache | _NoCache
    try:
        cache = _KernelCache(function)
    except (OSError, RuntimeError):  # there is nowhere to write
        cache = _NoCache()
    compiled._cache = cache  # noqa: SLF001 (what numba's `cache=True` does, with a cache of its own)
    return compiled  # type: ignore[no-any-return]


class _Kernel(CPUDispatcher):
    """What Python calls. Kernels that call it get its part: code that is linked into theirs.

    Made machine code, optimised and stored of its own as well, as numba would do it, what kernels call would cost as
    much time again at each level of calls.
    """

    part: Any

    @property
    def _numba_type_(self) -> Any:
        return self.part._numba_type_


class _PartCompiler(Compiler):
    """Compiles into a `_Part`."""

    def __init__(self, typingctx: Any, targetctx: Any, _library: None, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, _Part(targetctx.codegen(), "part"), *rest)


class _Part(JITCodeLibrary):
    """LLVM's code of a part."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def _optimize_final_module(self) -> None:
        """Leave that to the kernels that the part is linked into."""

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002 (numba's signature)
        """Return 0: there is no machine code."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """Whoever is asked to tell machine code its environment."""
        return _Unheard


class _Unheard:
    """Nobody to tell."""

    @staticmethod
    def set_env(name: str, env: Any) -> None:
        """Do nothing."""


class _KernelCache(FunctionCache):
    """The compiled forms of one kernel on disk: one file for its index, one for each signature.

    Files are named after the kernel alone, so that what was compiled from other sources is written over. A cache that
    cannot be read or written is as good as an empty one.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        name = f"{function.__module__}.{function.__qualname__}.{sys.implementation.cache_tag}{sys.abiflags}"
        stamp = (sources_digest(Path(function.__code__.co_filename)), self._impl.locator.get_source_stamp())
        self._cache_file = IndexDataCacheFile(self._cache_path, name.replace("<locals>", ""), stamp)

    def is_empty(self) -> bool:
        """Whether nothing was compiled from these sources yet."""
        try:
            return not self._cache_file._load_index()  # noqa: SLF001
        except Exception:  # noqa: BLE001 (as below)
            return True

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was compiled before, or None."""
        try:
            found = super().load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 (a damaged file may raise anything, and so may types that are no more)
            found = None
            with contextlib.suppress(OSError):
                self.flush()
        if found is None:
            announce()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, where that is possible."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


class _NoCache(NullCache):
    """Stands in where nothing can be written: each process compiles what it needs."""

    def load_overload(self, sig: Any, target_context: Any) -> None:  # noqa: ARG002 (numba's signature)
        """Return None: nothing was compiled before."""
        announce()


def is_set(variable: str) -> bool:
    """Whether an environment variable is anything but empty or 0."""
    return os.environ.get(variable, "0") not in ("", "0")


def is_awaited(function: Any) -> bool:
    """Whether a kernel has a cache, which holds nothing of it yet."""
    cache = getattr(function, "_cache", None)
    return isinstance(cache, _KernelCache) and cache.is_empty()


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
