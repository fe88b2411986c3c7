"""How an episode went so far: errors, honesty and excitation of each robot over time, and the strips that show them."""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels._compile import plain
from relloc_env.kernels.information import excitation
from relloc_env.rendering.scene import Strip
from relloc_env.samples import Float, Samples


class Instant(NamedTuple):
    """Numbers of one instant, for R robots; NaN is none."""

    time: float
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
    depth_bound: float = math.nan
    """[m] what any estimator's worst range is uncertain by at least, one standard deviation."""
    position_bound: float = math.nan
    """[m] the same of the position of robot B in {A}."""


def least_excitation(samples: Samples, n: int, rows: slice) -> Float:
    """How much the motion tells of the depth of the worst point in view.

    Args:
        samples: what the robots measured.
        n: of which environment.
        rows: in which samples.

    Returns:
        [m/s] (R,) root mean square of sigma over those samples in which a point was seen, the least of all points;
        NaN where none was.
    """
    odometry, image, seen = (part[n, rows] for part in (samples.odometry, samples.image, samples.seen))
    speed, lateral = odometry[..., None, 0].astype(np.float64), odometry[..., None, 1].astype(np.float64)
    square = plain(excitation)(image[..., 0].astype(np.float64), np.nan_to_num(image[..., 1]), speed, lateral)
    count = seen.sum(axis=0)
    mean = np.where(seen, square, 0.0).sum(axis=0) / np.maximum(count, 1)
    least = np.where(count > 0, mean, np.inf).min(axis=1)
    return np.sqrt(np.where(np.isfinite(least), least, np.nan))


class Course:
    """Collects the instants of an episode.

    Args:
        robots: number R of robots.
        band: where 95 % of the NEES lie when all is right.
    """

    def __init__(self, robots: int, band: tuple[float, float]) -> None:
        self._robots, self._band = robots, band
        self._table: Float = np.zeros((64, 3 + 5 * robots))
        self._count = 0

    def clear(self) -> None:
        """Forget everything."""
        self._count = 0

    def add(self, instant: Instant) -> None:
        """Take in the next instant."""
        if self._count == len(self._table):
            self._table = np.concatenate([self._table, np.zeros_like(self._table)])
        line, r = self._table[self._count], self._robots
        line[:3] = instant.time, instant.depth_bound, instant.position_bound
        for k, values in enumerate(instant[1:6]):
            line[3 + k * r : 3 + (k + 1) * r] = values
        self._count += 1

    def strips(self) -> list[Strip]:
        """Depth error, pose error, NEES and excitation, those of them that there are."""
        r, table = self._robots, self._table[: self._count]
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
