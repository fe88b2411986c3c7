"""What stands in the tables: each column from the scores of the episodes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from agents import statistics
from agents.playing import SCORES, settled
from agents.results import Result
from agents.statistics import Interval
from relloc_env.metrics import chi2_quantile
from relloc_env.samples import Float

POSE_SIZE = 3
"""Degrees of freedom of a pose."""


@dataclass(frozen=True)
class Figure:
    """What one column says of one agent."""

    value: float
    """Infinite for "never", NaN where there is none."""
    low: float = np.nan
    """[value's unit] ends of the bootstrapped 95 % interval; NaN for a figure without."""
    high: float = np.nan
    share: float = np.nan
    """[-] of the episodes that got there at all; of times only."""


@dataclass(frozen=True)
class Column:
    """One column: where it is from, how it is written, and which end is the better one."""

    score: str
    """Of `playing.SCORES`."""
    head: str
    unit: str
    of: Callable[[Float], Figure]
    """From the episodes' scores."""
    digits: int = 2
    better: int = 0
    """1: more is better, -1: less is, 0: neither."""
    kind: str = ""
    """Parts columns of one score; empty for the median."""
    scale: float = 1.0
    """From the score's unit to the one shown."""
    robots: tuple[int, ...] = (1, 2)
    """Numbers of robots for which it is shown."""
    alone: tuple[str, str] | None = None
    """Head of one robot's column and what it is, where that differs."""

    @property
    def key(self) -> str:
        """Its name in summary.json."""
        return f"{self.score}_{self.kind}" if self.kind else self.score

    @property
    def error(self) -> str:
        """The unit of an error at the end, which says nothing where it is very large; empty for what is none."""
        return self.unit if self.score.endswith("_end") and self.better < 0 else ""

    def name(self, robots: int) -> str:
        """What stands above it."""
        return self.alone[0] if robots == 1 and self.alone is not None else self.head

    def about(self, robots: int) -> str:
        """What it is, for the page's reader."""
        ways = {
            "mean": "mean of ",
            "rms": "root mean square of ",
            "inside": "share of episodes inside the 95 % band of ",
        }
        what = self.alone[1] if robots == 1 and self.alone is not None else SCORES[self.score]
        return ways.get(self.kind, "median of ") + what


def _of(statistic: Callable[[Float], Interval]) -> Callable[[Float], Figure]:
    return lambda values: Figure(*statistic(values))


def _time(values: Float) -> Figure:
    return Figure(*statistics.median(values), share=settled(values))


def _plain_mean(values: Float) -> Figure:
    return Figure(float(np.mean(values)))


def _inside(values: Float) -> Figure:
    low, high = (chi2_quantile(tail, POSE_SIZE) for tail in (0.025, 0.975))
    return Figure(float(np.mean((values >= low) & (values <= high))))


MEDIAN, MEAN, RMS = _of(statistics.median), _of(statistics.mean), _of(statistics.root_mean_square)
BOTH = (2,)
"""Numbers of robots that have a pose to find."""

J_END = Column("information_end", "J at the end", "nats", MEDIAN, better=1)
J_10 = Column("information_10s", "J after 10 s", "nats", MEDIAN, better=1)

TOLD = (
    J_END,
    J_10,
    Column("information_mean", "J, mean", "nats", MEDIAN, better=1),
    Column("time_bound_pose", "pose known", "s", _time, 1, -1, robots=BOTH),
    Column("time_bound_depth", "depths known", "s", _time, 1, -1),
    Column(
        "position_bound_end",
        "position, end",
        "m",
        MEDIAN,
        3,
        -1,
        alone=("worst range, end", "bound of the worst range at the end [m]"),
    ),
    Column("heading_bound_end", "heading, end", "°", MEDIAN, 2, -1, robots=BOTH),
)
"""What a motion tells: by the bound, as an ideal estimator would know."""

MADE = (
    Column("time_pose", "pose found", "s", _time, 1, -1, robots=BOTH),
    Column("time_depth", "depths found", "s", _time, 1, -1),
    Column("position_error_end", "position, end", "m", MEDIAN, 3, -1, robots=BOTH),
    Column("heading_error_end", "heading, end", "°", MEDIAN, 2, -1, robots=BOTH),
    Column("depth_error_end", "depth, end", "%", MEDIAN, 2, -1, scale=100.0),
    Column("position_error_area", "position, area", "m s", MEDIAN, 2, -1, robots=BOTH),
    Column("depth_error_area", "depth, area", "s", MEDIAN, 2, -1),
    Column("over_bound", "error / bound", "median", MEDIAN, 2, -1, robots=BOTH),
    Column("over_bound", "error / bound", "RMS", RMS, 2, -1, "rms", robots=BOTH),
    Column("nees", "NEES", "mean", _plain_mean, 2, 0, "mean", robots=BOTH),
    Column("nees", "NEES", "% in band", _inside, 0, 0, "inside", 100.0, robots=BOTH),
)
"""What the estimator makes of it: errors against the truth."""

MOVED = (
    Column("excitation", "least excitation", "m²/s", MEDIAN, 3, 1),
    Column("path", "way", "m", MEDIAN, 2),
    Column("seen", "all see all", "%", MEDIAN, 0, scale=100.0),
    Column("blocked", "held by the shield", "%", MEDIAN, 1, scale=100.0),
    Column("collisions", "collisions", "an episode", MEAN, 2, -1, "mean"),
    Column("change_speed", "change of speed", "%", MEAN, 0, kind="mean", scale=100.0),
    Column("change_yaw_rate", "of yaw rate", "%", MEAN, 0, kind="mean", scale=100.0),
)
"""How the robots move."""

EVERY = TOLD + MADE + MOVED

COMPARED = ("time_pose", "position_error_end", "heading_error_end", "time_depth", "depth_error_end", "over_bound",
            "nees_inside")  # fmt: skip
"""Keys of the columns by which estimators are compared."""


def shown(columns: tuple[Column, ...], robots: int) -> list[Column]:
    """Those of a number of robots."""
    return [column for column in columns if robots in column.robots]


def figures(result: Result, robots: int) -> dict[str, Figure]:
    """All columns of one agent, by key."""
    return {c.key: c.of(result.scores[c.score]) for c in shown(EVERY, robots)}
