"""Numeric text tables, read fast and checked line by line only where something is wrong."""

import math
from pathlib import Path

import numpy as np

from relloc_env.logs.errors import LogError
from relloc_env.samples import Float


def read_text(path: Path) -> str:
    """Return the text of a file, or raise `LogError` where it is missing, unreadable, not text, or empty."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise LogError(path, "file not found") from None
    except UnicodeDecodeError:
        raise LogError(path, "is not a text file") from None
    except OSError as error:
        raise LogError(path, f"cannot be read ({error.strerror})") from None
    if not text.strip():
        raise LogError(path, "is empty")
    return text


def _data_lines(text: str, skip: int) -> list[tuple[int, str]]:
    """Return (line number, text) of the lines that hold data."""
    lines = enumerate(text.splitlines(), start=1)
    return [(n, line) for n, line in lines if n > skip and line.strip() and not line.lstrip().startswith("#")]


def _explain(
    path: Path, text: str, columns: tuple[str, ...], delimiter: str | None, skip: int, finite: bool
) -> LogError:
    """Return the error that names the first line which is not `columns` numbers."""
    for number, line in _data_lines(text, skip):
        cells = line.split(delimiter)
        if len(cells) != len(columns):
            wanted = f"{len(columns)} columns ({', '.join(columns[:8])}{', …' if len(columns) > 8 else ''})"
            return LogError(path, f"must have {wanted}, but has {len(cells)}", number)
        for cell, name in zip(cells, columns, strict=True):
            try:
                value = float(cell)
            except ValueError:
                return LogError(path, f"`{name}` must be a number, but is {cell.strip()!r}", number)
            if finite and not math.isfinite(value):
                return LogError(path, f"`{name}` must be finite, but is {cell.strip()}", number)
    return LogError(path, "holds no data, only comments")


def line_of_row(text: str, row: int, skip: int = 0) -> int:
    """Return the line number of data row `row` (from 0)."""
    return _data_lines(text, skip)[row][0]


def read_table(
    path: Path, columns: tuple[str, ...], *, delimiter: str | None = None, skip: int = 0, finite: bool = True
) -> tuple[Float, str]:
    """Read a table of numbers, one row a line; lines that begin with # are comments.

    Args:
        path: the file.
        columns: names of its columns, for the count and the messages.
        delimiter: between the cells; None is white space.
        skip: lines before the data, comments included.
        finite: whether NaN and infinity are refused.

    Returns:
        (rows, len(columns)) numbers, and the text of the file (for `line_of_row`).
    """
    text = read_text(path)
    lines = text.splitlines()[skip:]
    if not any(line.strip() and not line.lstrip().startswith("#") for line in lines):
        raise LogError(path, "holds no data, only comments")
    try:
        table = np.loadtxt(lines, dtype=np.float64, comments="#", delimiter=delimiter, ndmin=2)
    except ValueError:
        raise _explain(path, text, columns, delimiter, skip, finite) from None
    if table.shape[1] != len(columns) or (finite and not np.isfinite(table).all()):
        raise _explain(path, text, columns, delimiter, skip, finite)
    return table, text


def check_order(path: Path, text: str, time: Float, skip: int = 0) -> None:
    """Raise `LogError` at the first row whose time is before that of the row above."""
    back = np.flatnonzero(np.diff(time) < 0.0)
    if back.size:
        row = int(back[0]) + 1
        message = f"time must not go back, but is {time[row]:.3f} after {time[row - 1]:.3f}"
        raise LogError(path, message, line_of_row(text, row, skip))
