"""How kernels are linked into one another, and cached, by what numba keeps to itself.

All of that stands here. `fits` tells whether the numba at hand is one that it goes by; where it is not, `_compile.py`
does without.
"""

import contextlib
import glob
import inspect
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from relloc_env.kernels._compile import announce, sources_digest

_BELOW = (0, 69)
"""The first numba that nobody tried this with."""
_USED = {
    CPUDispatcher: ("_numba_type_", "compile"),
    Compiler: ("compile_extra",),
    FunctionCache: ("flush", "load_overload", "save_overload"),
    IndexDataCacheFile: ("_load_index",),
    JITCodeLibrary: (
        "_ensure_finalized", "_finalize_dynamic_globals", "_finalize_final_module", "_optimize_final_module", "codegen",
        "get_pointer_to_function",
    ),
}  # fmt: skip
"""Classes of numba, and what is called or replaced of each."""
_PATIENCE = 120.0
"""[s] for which another process that compiles the same kernel is waited for."""


if hasattr(os, "register_at_fork"):  # a fork waits for a thread that compiles, whose locks the child could never free
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


def fits() -> bool:
    """Whether the inside of numba is what this module goes by."""
    try:
        first = list(inspect.signature(Compiler.__init__).parameters)[:4]
        return (
            numba.version_info.short < _BELOW
            and all(hasattr(known, name) for known, names in _USED.items() for name in names)
            and first == ["self", "typingctx", "targetctx", "library"]
            and compiled(fits, {}, {})._cache is not None  # noqa: SLF001 (a kernel can be made; nothing is compiled)
        )
    except Exception:  # noqa: BLE001 (whatever changed, and however it shows)
        return False


def compiled(function: Callable[..., Any], options: dict[str, Any], as_part: dict[str, bool]) -> Any:
    """Return the kernel of `function`.

    Args:
        function: what to compile, at its first call.
        options: those of `numba.njit`.
        as_part: further ones, where other kernels call it.
    """
    options = {**options, "no_cfunc_wrapper": True}
    found: Any = numba.njit(**options)(function)
    found.__class__ = _Kernel
    part: dict[str, Any] = {**options, **as_part, "no_cpython_wrapper": True, "pipeline_class": _PartCompiler}
    found.part = numba.njit(**part)(function)
    cache: _KernelCache | _NoCache
    try:
        cache = _KernelCache(function)
    except (OSError, RuntimeError):  # there is nowhere to write
        cache = _NoCache()
    found._cache = cache  # noqa: SLF001 (what numba's `cache=True` does, with a cache of its own)
    return found


class _Kernel(CPUDispatcher):
    """What Python calls. Kernels that call it get its part: code that is linked into theirs.

    Made machine code, optimised and stored of its own as well, as numba would do it, what kernels call would cost as
    much time again at each level of calls.
    """

    part: Any
    _cache: "_KernelCache | _NoCache"

    def compile(self, sig: Any) -> Any:
        """Compile one signature, or load it; meanwhile other processes wait."""
        with global_compiler_lock:
            try:
                return super().compile(sig)
            finally:
                self._cache.end_turn()

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
    """The compiled forms of one kernel on disk: one file for its index, one for each signature, and one as a lock.

    Files are named after the kernel alone, so that what was compiled from other sources is written over. A cache that
    cannot be read, written or locked is as good as an empty one of this process alone.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        name = f"{function.__module__}.{function.__qualname__}.{sys.implementation.cache_tag}{sys.abiflags}"
        name = name.replace("<locals>", "")
        stamp = (sources_digest(Path(function.__code__.co_filename)), self._impl.locator.get_source_stamp())
        self._cache_file = IndexDataCacheFile(self._cache_path, name, stamp)
        self._base = Path(self._cache_path, name)
        self._turn: BinaryIO | None = None

    def is_empty(self) -> bool:
        """Whether nothing was compiled from these sources yet."""
        try:
            return not self._cache_file._load_index()  # noqa: SLF001
        except Exception:  # noqa: BLE001 (as below)
            return True

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was compiled before, perhaps by another process just now, or None: then it is this one's turn."""
        found = self._load(sig, target_context)
        if found is None:
            announce()
            self._begin_turn()
            found = self._load(sig, target_context)
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 (a damaged file may raise anything, and so may types that are no more)
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, where that is possible."""
        with contextlib.suppress(OSError):
            if self.is_empty():  # the index is written first, and must never point to what other sources gave
                for path in self._base.parent.glob(f"{glob.escape(self._base.name)}.*.nbc"):
                    path.unlink()
            super().save_overload(sig, data)

    def _begin_turn(self) -> None:
        """Wait while another process compiles the kernel, but not for ever; if it ends or is killed, its turn ends."""
        last = time.monotonic() + _PATIENCE
        with contextlib.suppress(OSError):  # there are no locks in that folder
            self._turn = self._base.with_name(f"{self._base.name}.lock").open("ab")
            while not _locked(self._turn.fileno()) and time.monotonic() < last:
                time.sleep(0.05)

    def end_turn(self) -> None:
        """Let other processes go on, if it was this one's turn."""
        if self._turn is not None:
            self._turn.close()
            self._turn = None


def _locked(file: int) -> bool:
    """Whether this process got the lock of an open file, which it has until it closes the file or ends."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # another process has it
        return False
    return True


class _NoCache(NullCache):
    """Stands in where nothing can be written: each process compiles what it needs."""

    def load_overload(self, sig: Any, target_context: Any) -> None:  # noqa: ARG002 (numba's signature)
        """Return None: nothing was compiled before."""
        announce()

    def end_turn(self) -> None:
        """Do nothing: nobody waits."""
