"""Files that are put in their places whole: what is stopped on the way, or loses power, leaves the one before."""

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Yield a path beside `path` to write to, of the same suffix; the file takes its place, unless there is an error.

    What writers that were killed have left of the same file is removed. Where `path` is something other than a file,
    as /dev/stdout is, it is written to as it is.
    """
    path = Path(os.path.realpath(path))  # where a link leads: the link stays
    if path.exists() and not path.is_file():
        yield path
        return
    _clear(path)
    partial = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield partial
        _sync(partial)
        partial.replace(path)
        with suppress(PermissionError):  # a folder cannot be opened everywhere
            _sync(path.parent)
    finally:
        partial.unlink(missing_ok=True)


def write_whole(path: str | Path, data: bytes | str) -> None:
    """Write bytes, or a text as UTF-8, its line ends as they are, and names of files too that are not UTF-8."""
    with whole(path) as partial:
        partial.write_bytes(data if isinstance(data, bytes) else data.encode("utf-8", "surrogateescape"))


def write_json(path: str | Path, data: Any, **options: Any) -> None:
    """Write plain data as JSON, NaN and infinity as Python has them; `options` as for `json.dumps`."""
    write_whole(path, json.dumps(data, **({"indent": 1} | options)) + "\n")


def read_json(path: str | Path) -> Any:
    """Read JSON.

    Raises:
        ValueError: a file that is none, with its name.
    """
    try:
        return json.loads(Path(path).read_bytes())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} must be JSON, but: {error}") from None


def _sync(path: Path) -> None:
    """Wait until a file or a folder is on the disk."""
    file = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def _clear(path: Path) -> None:
    """Remove what processes that are no more have left beside `path`."""
    form = re.compile(rf"\.{re.escape(path.stem)}\.(\d+){re.escape(path.suffix)}")
    with suppress(FileNotFoundError):  # the writer says so
        for entry in os.scandir(path.parent):
            found = form.fullmatch(entry.name)
            if found and not _runs(int(found[1])):
                Path(entry.path).unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Whether a process is there; where that cannot be asked harmlessly, it is."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass
    return True
