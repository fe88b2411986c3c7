"""Files put in place whole: a reader, or a program that ends half way, never meets half of one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Yield a path to write to; what stands there at the end takes the place of `path`, and nothing does on an error.

    Args:
        path: the file to be. The one to write to has the same suffix and lies in the same folder.
    """
    target = Path(path)
    partial = target.with_name(f".partial-{os.getpid()}-{target.name}")
    try:
        yield partial
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def write_whole(path: str | Path, data: bytes | str) -> Path:
    """Write a file at once, text as UTF-8; return its path."""
    with whole(path) as partial:
        partial.write_bytes(data.encode() if isinstance(data, str) else data)
    return Path(path)
