"""A batch cut into parts that run on several threads. Compiled kernels release the interpreter's lock meanwhile."""

import functools
import numbers
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from relloc_env.config import ConfigError
from relloc_env.kernels.lanes import W
from relloc_env.samples import Rows

LEAST = 256
"""Environments that are worth a thread of their own."""


def check_threads(threads: int | None, num_envs: int) -> int:
    """Return how many threads a batch runs on: as many as asked for; all cores, but no idle ones, by default."""
    if threads is None:
        return max(1, min(cores(), num_envs // LEAST))
    if isinstance(threads, bool) or not isinstance(threads, numbers.Integral) or threads < 1:
        raise ConfigError(f"Argument `threads` must be a positive integer or None, but is {threads!r}")
    return int(threads)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def parts(rows: Rows, count: int) -> list[Rows]:
    """Cut ascending `rows` into at most `count` parts of about one size, never within a block of lanes."""
    if count == 1 or len(rows) < 2 * W or not (np.diff(rows) > 0).all():
        return [rows]
    begins = np.flatnonzero(np.diff(rows // W, prepend=-1))
    cuts = begins[np.arange(1, count) * len(begins) // count]
    return [part for part in np.split(rows, cuts) if len(part)]


def run(work: Callable[[Rows, int], None], rows: list[Rows]) -> None:
    """Call `work(part, which)` for each part at once; raises what any of them raises, when all are done."""
    if len(rows) == 1:
        work(rows[0], 0)
        return
    others = [_pool(len(rows) - 1).submit(work, part, which) for which, part in enumerate(rows) if which > 0]
    try:
        work(rows[0], 0)
    finally:
        errors = [future.exception() for future in others]
    for error in errors:
        if error is not None:
            raise error


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that wait for work, shared by all batches of this process."""
    return ThreadPoolExecutor(threads, "relloc_env")


if hasattr(os, "register_at_fork"):  # threads do not outlive a fork
    os.register_at_fork(after_in_child=_pool.cache_clear)
