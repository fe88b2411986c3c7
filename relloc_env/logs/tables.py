"""Numeric text tables, read fast and checked line by line only where something is wrong."""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relloc_env.logs.checks import LIMITS, Kind, Limits, Numbers, check_numbers, in_order
from relloc_env.logs.errors import LogError
from relloc_env.logs.text import read_text, stored
from relloc_env.samples import Float


@dataclass
class Table:
    """A table of numbers, one row a line."""

    path: Path
    text: str
    skip: int
    columns: tuple[str, ...]
    rows: Float
    """(T, C)."""
    order: NDArray[np.int64]
    """(T,) number of each row in the file, from 0."""
    warnings: list[str] = field(default_factory=list)

    def __getitem__(self, name: str) -> Float:
        """Return a column."""
        return self.rows[:, self.columns.index(name)]

    def line(self, row: int) -> int:
        """Return the line number of a row."""
        return _data_lines(self.text, self.skip)[int(self.order[row])][0]

    def fail(self, row: int, message: str) -> LogError:
        """Return the error that names the file and the line of a row."""
        return LogError(self.path, message, self.line(row))

    def warn(self, message: str, row: int | None = None) -> None:
        """Note what is odd, and where."""
        self.warnings.append(f"{self.path.name}{'' if row is None else f', line {self.line(row)}'}: {message}")

    def check(self, kinds: dict[str, Kind], limits: Limits = LIMITS) -> None:
        """Raise at the first number that cannot be of its column's kind; small disorder of the stamps is mended."""
        found = [Numbers(kind, (name,), self[name][:, None]) for name, kind in kinds.items()]
        check_numbers(found, self.fail, limits)
        for name in (name for name, kind in kinds.items() if kind in ("stamp", "moment")):
            order, words = in_order(self[name], self.fail, limits)
            if words:
                self.warn(words, int(np.argmax(np.diff(self[name]) < 0.0)) + 1)
                self.rows, self.order = self.rows[order], self.order[order]

    def check_whole(self, name: str, least: int = 0) -> None:
        """Raise at the first row of a column that holds no whole number from `least` on."""
        wrong = (self[name] != np.rint(self[name])) | (self[name] < least) | (self[name] > 2.0**53)
        if wrong.any():
            row = int(wrong.argmax())
            raise self.fail(row, f"`{name}` must be a whole number, but is {self[name][row]:g}")


def _data_lines(text: str, skip: int) -> list[tuple[int, str]]:
    """Return (line number, text) of the lines that hold data."""
    lines = enumerate(text.splitlines(), start=1)
    return [(n, line) for n, line in lines if n > skip and line.strip() and not line.lstrip().startswith("#")]


def _explain(
    path: Path, text: str, columns: tuple[str, ...], delimiter: str | None, skip: int, finite: bool
) -> LogError:
    """Return the error that names the first line which is not `columns` numbers."""
    for number, line in _data_lines(text, skip):
        cells = line.partition("#")[0].split(delimiter)
        if len(cells) != len(columns):
            wanted = f"{len(columns)} columns ({', '.join(columns[:8])}{', …' if len(columns) > 8 else ''})"
            return LogError(path, f"must have {wanted}, but has {len(cells)}", number)
        for cell, name in zip(cells, columns, strict=True):
            try:
                value = float(cell) if cell.isascii() and "_" not in cell else float("")
            except ValueError:
                return LogError(path, f"`{name}` must be a number, but is {cell.strip()[:40]!r}", number)
            if finite and not math.isfinite(value):
                return LogError(path, f"`{name}` must be finite, but is {cell.strip()[:40]}", number)
    return LogError(path, "is not a table of numbers")


def read_table(
    path: Path, columns: tuple[str, ...], *, delimiter: str | None = None, skip: int = 0, finite: bool = True
) -> Table:
    """Read a table of numbers, one row a line; lines that begin with # are comments.

    Args:
        path: the file.
        columns: names of its columns, for the count and the messages.
        delimiter: between the cells; None is white space.
        skip: lines before the data, comments included.
        finite: whether NaN and infinity are refused.
    """
    text, path = read_text(path), stored(path)
    lines = text.splitlines()[skip:]
    if not any(line.strip() and not line.lstrip().startswith("#") for line in lines):
        raise LogError(path, "holds no data, only comments")
    try:
        rows = np.loadtxt(lines, dtype=np.float64, comments="#", delimiter=delimiter, ndmin=2)
    except ValueError:
        raise _explain(path, text, columns, delimiter, skip, finite) from None
    if rows.shape[1] != len(columns) or (finite and not np.isfinite(rows).all()):
        raise _explain(path, text, columns, delimiter, skip, finite)
    table = Table(path, text, skip, columns, rows, np.arange(len(rows)))
    _check_end(table, delimiter)
    return table


def _check_end(table: Table, delimiter: str | None) -> None:
    """Raise where the file ends inside a number, and note where that cannot be known.

    A file ends inside a number at most where its last line has no end. It does so where all other rows have the same
    number of decimals in the last column, and the last row has another.
    """
    text, (number, line) = table.text, _data_lines(table.text, table.skip)[-1]
    if text[-1].isspace() or not text.endswith(line):
        return
    rows = (row.partition("#")[0].rstrip() for _, row in _data_lines(text, table.skip))
    every = [row.rsplit(delimiter, 1)[-1].strip() for row in rows]
    *others, last = (len(cell.partition(".")[2]) for cell in every)
    if len(set(others)) == 1 and others[0] > 0:
        if last != others[0]:
            raise LogError(
                table.path,
                f"`{table.columns[-1]}` must have {others[0]} decimals like all others, but is {every[-1]}, and the "
                "line has no end: cut inside a number?",
                number,
            )
    else:
        table.warn("the last line has no end: if it was cut, its last number is wrong", len(table.rows) - 1)
