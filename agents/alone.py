"""One process at a time in a folder of results."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from relloc_env.extras import extra
from relloc_env.folders import open_folder

with extra("agents"):
    from filelock import FileLock, Timeout

LOCK = ".lock"
"""File whose lock a process has; the system frees it however that process ends, and the file may stay."""


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Have a folder, which is made where it is missing, for oneself.

    Raises:
        ValueError: another process has it.
    """
    folder = open_folder(folder)
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise ValueError(
            f"Argument `out` must be a folder that no other process works on, but {folder} is in use: wait until that "
            "one is over, or name another"
        ) from None
    try:
        yield
    finally:
        lock.release()
