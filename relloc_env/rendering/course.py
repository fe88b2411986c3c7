"""How an episode went so far: errors, honesty and excitation of each robot over time, and the strips that show them."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import plain
from relloc_env.kernels.information import excitation
from relloc_env.rendering.scene import Strip
from relloc_env.samples import Float


class Instant(NamedTuple):
    """Numbers of one instant, for R robots; NaN is none. With a leading axis of T everywhere: of several instants."""

    time: float | Float
    """[s] since the start of the episode."""
    depth_error: Float
    """[m] (R,) greatest size of the error of a known point's range."""
    position_error: Float
    """[m] (R,) distance between the other robot's estimated and true place."""
    heading_error: Float
    """[rad] (R,) of the other robot."""
    nees: Float
    """(R,) of the other robot's pose; for a single robot the mean over its known points."""
    excitation: Float
    """[m/s] (R,) least excitation sigma of a point in view, see `least_excitation`."""
    depth_bound: float | Float = math.nan
    """[m] what any estimator's worst range is uncertain by at least, one standard deviation."""
    position_bound: float | Float = math.nan
    """[m] the same of the position of robot B in {A}."""


def least_excitation(odometry: NDArray[Any], image: NDArray[Any], seen: NDArray[Any]) -> Float:
    """How much the motion tells of the depth of the worst point in view.

    Args:
        odometry: [m/s, m/s, rad/s] (..., K, R, 3) of K samples.
        image: [-] (..., K, R, M, 2) image coordinates.
        seen: (..., K, R, M) whether there are any.

    Returns:
        [m/s] (..., R) root mean square of sigma over those samples in which a point was seen, the least of all points;
        NaN where none was.
    """
    speed, lateral = odometry[..., None, 0].astype(np.float64), odometry[..., None, 1].astype(np.float64)
    square = plain(excitation)(image[..., 0].astype(np.float64), np.nan_to_num(image[..., 1]), speed, lateral)
    count = seen.sum(axis=-3)
    mean = np.where(seen, square, 0.0).sum(axis=-3) / np.maximum(count, 1)
    least = np.where(count > 0, mean, np.inf).min(axis=-1)
    return np.sqrt(np.where(np.isfinite(least), least, np.nan))


class Table:
    """Rows of numbers, one after the other. Of very many only every second, fourth, ... is kept, and the newest.

    Args:
        width: of a row.
        most: rows that are kept at most.
        past: how much smaller than that of the newest row the first number of a kept row may be, where rows are many.
    """

    def __init__(self, width: int, most: int = 2**14, past: float = math.inf) -> None:
        self._most, self._past = most, past
        self._rows: Float = np.zeros((64, width))
        self._numbers = np.zeros(64, np.int64)
        self._count = self._next = 0
        self._stride = 1

    @property
    def rows(self) -> Float:
        """(T, width) what is kept, a view."""
        return self._rows[: self._count]

    def clear(self) -> None:
        """Forget everything."""
        self._count = self._next = 0
        self._stride = 1

    def add(self, rows: Float) -> None:
        """Append (T, width)."""
        numbers = np.arange(self._next, self._next + len(rows))
        self._next += len(rows)
        if self._stride > 1:  # the newest of the last call was kept for being the newest
            self._count -= int(self._numbers[self._count - 1] % self._stride != 0)
            kept = self._on_stride(numbers)
            rows, numbers = rows[kept], numbers[kept]
        end = self._count + len(rows)
        while end > len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
            self._numbers = np.concatenate([self._numbers, np.zeros_like(self._numbers)])
        self._rows[self._count : end], self._numbers[self._count : end] = rows, numbers
        self._count = end
        if end > self._most:
            self._keep(self.rows[:, 0] >= self.rows[-1, 0] - self._past)
            while self._count > self._most:
                self._stride *= 2
                self._keep(self._on_stride(self._numbers[: self._count]))

    def _on_stride(self, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
        kept: NDArray[np.bool_] = numbers % self._stride == 0
        kept[-1:] = True
        return kept

    def _keep(self, kept: NDArray[np.bool_]) -> None:
        count = int(kept.sum())
        self._rows[:count], self._numbers[:count] = self.rows[kept], self._numbers[: self._count][kept]
        self._count = count


class Course:
    """Collects the instants of an episode.

    Args:
        robots: number R of robots.
        band: where 95 % of the NEES lie when all is right.
        past: [s] of the past that strips show at most.
    """

    def __init__(self, robots: int, band: tuple[float, float], past: float = math.inf) -> None:
        self._robots, self._band = robots, band
        self._table = Table(3 + 5 * robots, past=past)

    def clear(self) -> None:
        """Forget everything."""
        self._table.clear()

    def add(self, instant: Instant) -> None:
        """Take in the next instant, or the next T."""
        heads = [np.atleast_1d(part) for part in (instant.time, instant.depth_bound, instant.position_bound)]
        columns = [np.broadcast_to(part, heads[0].shape)[:, None] for part in heads]
        self._table.add(np.concatenate([*columns, *map(np.atleast_2d, instant[1:6])], axis=1))

    def strips(self) -> list[Strip]:
        """Depth error, pose error, NEES and excitation, those of them that there are."""
        r, table = self._robots, self._table.rows
        time, depth_bound, position_bound = (table[:, k].copy() for k in range(3))
        depth, position, heading, nees, excited = (table[:, 3 + k * r : 3 + (k + 1) * r].T.copy() for k in range(5))
        told = [
            Strip("depth error [m]", time, depth, _words(depth), (0.003, 5.0), bound=_any(depth_bound)),
            Strip(
                "pose error [m, °]", time, position,
                [f"{a}, {b}" for a, b in zip(_words(position), _words(np.degrees(heading), 1), strict=True)],
                (0.003, 5.0), bound=_any(position_bound),
            ),
            Strip("NEES", time, nees, [_large(v) for v in _last(nees)], (0.05, 500.0), band=self._band),
        ]  # fmt: skip
        told = [strip for strip in told if strip.bound is not None or np.isfinite(strip.lines).any()]
        return [*told, Strip("excitation [m/s]", time, excited, _words(excited, 3), (0.001, 0.5))]


def _any(values: Float) -> Float | None:
    return values if np.isfinite(values).any() else None


def _last(lines: Float) -> list[float]:
    return [float(line[-1]) if len(line) else math.nan for line in lines]


def _words(lines: Float, digits: int | None = None) -> list[str]:
    """The newest number of each line; without `digits` to the centimetre, small ones to the millimetre."""
    values = _last(lines)
    places = [(2 if value >= 0.1 else 3) if digits is None else digits for value in values]
    return ["–" if math.isnan(v) else f"{v:.{k}f}" if v < 1e4 else "> 10⁴" for v, k in zip(values, places, strict=True)]


def _large(value: float) -> str:
    """A number that may be very large."""
    if math.isnan(value):
        return "–"
    return (f"{value:.1f}" if value < 100.0 else f"{value:,.0f}") if value < 1e5 else "> 10⁵"
