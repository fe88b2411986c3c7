"""What the numbers of a recording must be, whichever source they come from, before anything is computed from them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from relloc_env.samples import Bool, Float, Samples, ordered_pairs


@dataclass(frozen=True)
class Limits:
    """What is refused in a recording; all are positive numbers."""

    speed: float = 20.0
    """[m/s] greatest size of a speed, forward or lateral."""
    turn: float = 100.0
    """[rad/s] greatest size of a yaw rate."""
    gap: float = 60.0
    """[s] longest time without a word from a source: between two of its stamps, or a period between samples."""
    disorder: float = 1.0
    """[s] rows this late are sorted, if they are few."""
    uncovered: float = 30.0
    """[s] longest part of the detections before the odometry begins or after it ends."""
    image: float = 1e6
    """Greatest size of a normalised image coordinate."""
    distance: float = 1e8
    """[m] greatest size of a coordinate or a depth."""
    cells: float = 2e7
    """Greatest number of samples times robots times points: about 100 bytes are needed for each."""

    def __post_init__(self) -> None:
        """Raise where a limit is not a positive number."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
                raise ValueError(f"Argument `limits.{field.name}` must be a positive number, but is {value!r}")

    @classmethod
    def of(cls, words: Sequence[str]) -> Self:
        """Return the limits with those of `NAME=VALUE` in the place of the defaults."""
        known, found = [field.name for field in fields(cls)], {}
        for word in words:
            name, _, value = word.partition("=")
            if name not in known:
                raise ValueError(f"Argument `limit` must be one of {', '.join(known)}, as gap=120, but is {word!r}")
            try:
                found[name] = float(value)
            except ValueError:
                raise ValueError(f"Argument `limit` must be a name and a number, as gap=120, but is {word!r}") from None
        return cls(**found)


LIMITS = Limits()
FEW = (10, 0.01)
"""Rows out of order are few where they are at most so many, or at most this part of all."""
CONTRADICTION = 0.02
"""[rad or normalised image coordinates] detections of one point at one time contradict each other from here on."""
UNSET = (1e6, 1e8)
"""[s] a clock that goes from below the first to above the second was set in between."""
LATEST = 1e11
"""[s] the year 5138: greater stamps are not seconds."""

Fail = Callable[[int, str], Exception]
"""Makes the error for a row (from 0), which names where it is recorded."""
Kind = Literal["stamp", "moment", "period", "speed", "turn", "image", "height", "seen", "place", "depth", "number"]
_UNITS = ((1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds"))


class Numbers(NamedTuple):
    """Recorded numbers of one kind."""

    kind: Kind
    """"moment": a stamp of a source that may be silent for as long as it likes, as a camera is that sees nothing."""
    keys: Sequence[str]
    """Names of the C columns."""
    values: NDArray[Any]
    """(T, C)."""
    words: str = ""
    """What they are in a message; default: the name of the column."""
    unknown: bool = False
    """Whether NaN is allowed, for what is not known."""


def check_numbers(numbers: Sequence[Numbers], fail: Fail, limits: Limits = LIMITS) -> None:
    """Raise at the first recorded number that is not finite, or beyond what its kind can be.

    Every reader calls this for the columns of its tables, and `check_samples` calls it for samples from anywhere.

    Args:
        numbers: what was recorded; stamps stand in the order of the rows.
        fail: makes the error.
        limits: what is refused.
    """
    for part in numbers:
        values = np.asarray(part.values)
        rule, good = _rule(part.kind, values, limits)
        good = (np.isfinite(values) & good) | (np.isnan(values) if part.unknown else False)
        if not good.all():
            row, column = (int(i) for i in np.argwhere(~good)[0])
            value, key = values[row, column], part.keys[column]
            rule = rule if np.isfinite(value) or part.kind in ("period", "seen") else "finite"
            but = f"`{key}` is {value:g}" if part.words else f"is {value:g}"
            hint = f": are these {_unit(abs(value))}?" if part.kind in ("stamp", "moment") and rule != "finite" else ""
            raise fail(row, f"{part.words or f'`{key}`'} must be {rule}, but {but}{hint}")
        if part.kind == "stamp":
            for stamps in values.T:
                _check_jumps(stamps, fail, limits)


def _rule(kind: Kind, x: NDArray[Any], limits: Limits) -> tuple[str, Bool]:
    """What numbers of a kind must be, in words, and which of them are."""
    size = np.abs(x)
    match kind:
        case "stamp" | "moment":
            return f"a time in seconds (at most {LATEST:g})", size <= LATEST
        case "period":
            return f"0 or more, and at most {limits.gap:g} s", (x >= 0.0) & (x <= limits.gap)
        case "speed":
            return f"at most {limits.speed:g} m/s in size", size <= limits.speed
        case "turn":
            return f"at most {limits.turn:g} rad/s in size", size <= limits.turn
        case "image" | "height":
            return f"at most {limits.image:g} in size", size <= limits.image
        case "seen":
            return "0 or 1", (x == 0.0) | (x == 1.0)
        case "depth":
            return f"positive, and at most {limits.distance:g} m", (x > 0.0) & (x <= limits.distance)
        case "place" | "number":
            return f"at most {limits.distance:g} in size", size <= limits.distance


def _check_jumps(stamps: Float, fail: Fail, limits: Limits) -> None:
    """Raise at the first row whose stamp is far from that of the row before."""
    step = np.diff(stamps)
    jumps = np.flatnonzero((step > limits.gap) | (step < -limits.disorder))
    if not jumps.size:
        return
    row = int(jumps[0]) + 1
    jump, usual = float(step[row - 1]), float(np.median(step))
    if usual > limits.gap:
        hint = f"are these {_unit(usual * 1e10)}?"
    elif abs(stamps[row - 1]) < UNSET[0] and stamps[row] > UNSET[1]:
        hint = "was the clock not set yet in the row before?"
    elif jump < 0.0:
        hint = "was the clock set anew, or are these two recordings?"
    else:
        hint = "did the clock jump, or are these two recordings?"
    told = f"must not jump by more than {limits.gap:g} s" if jump > 0.0 else "must not go back"
    raise fail(
        row, f"time {told}, but is {stamps[row]:.3f} after {stamps[row - 1]:.3f}: it jumps by {jump:.2g} s; {hint}"
    )


def _unit(stamp: float) -> str:
    """Return the unit in which a stamp of our time, in seconds about 1e9, has this size."""
    return next((name for unit, name in _UNITS if stamp < 3e10 * unit), _UNITS[-1][1])


def in_order(stamps: Float, fail: Fail, limits: Limits = LIMITS) -> tuple[NDArray[np.int64], str]:
    """Return the order of the rows by time, and what was done in words; "" where they stood in order.

    Args:
        stamps: [s] (T,) finite.
        fail: makes the error.
        limits: what is refused: rows later than `disorder`, or more than a few.
    """
    late = np.maximum.accumulate(stamps) - stamps
    back = np.flatnonzero(np.diff(stamps) < 0.0) + 1
    if not back.size:
        return np.arange(len(stamps)), ""
    far = np.flatnonzero(late > limits.disorder)
    if far.size or back.size > max(FEW[0], FEW[1] * len(stamps)):
        row = int(far[0]) if far.size else int(back[0])
        before = float(stamps[:row].max())
        rest = "" if far.size else f" (like {back.size} other rows)"
        raise fail(row, f"time must not go back, but is {stamps[row]:.3f} after {before:.3f}{rest}")
    words = f"{back.size} rows" if back.size > 1 else "a row"
    return np.argsort(stamps, kind="stable"), f"{words} out of order, by up to {late.max():.3f} s: sorted"


def contradictions(stamps: Float, names: NDArray[Any], values: Float) -> list[int]:
    """Return the rows whose detection of a point contradicts the one before it of the same point at the same time.

    Args:
        stamps: [s] (T,) of the detections. names: (T,) of the points. values: (T, C) what was measured.
    """
    order = np.lexsort((np.arange(len(stamps)), names, stamps))
    s, n, v = stamps[order], names[order], values[order]
    twice = (np.diff(s) == 0.0) & (n[1:] == n[:-1]) & (np.abs(np.diff(v, axis=0)) > CONTRADICTION).any(axis=1)
    found: list[int] = np.sort(order[1:][twice]).tolist()
    return found


def check_cells(samples: float, robots: int, points: int, limits: Limits = LIMITS) -> str:
    """Return what is wrong with the size of a log, "" where nothing is; called before arrays of that size are made."""
    cells = samples * robots * points
    if cells <= limits.cells:
        return ""
    return (
        f"must have at most {limits.cells:g} samples x robots x points, but has {samples:.0f} x {robots} x {points}: "
        "are the time stamps in milliseconds, or the steps too short?"
    )


def check_samples(
    samples: Samples, robots: Sequence[str], points: Sequence[str], fail: Fail, limits: Limits = LIMITS
) -> list[str]:
    """Raise at the first sample that cannot be; return what is odd about the others, in words.

    Args:
        samples: of one environment, in order from the first of the log.
        robots, points: their names.
        fail: makes the error for a sample (from 0).
        limits: what is refused.
    """
    period, odometry, image, seen = samples.period[0], samples.odometry[0], samples.image[0], samples.seen[0]
    count, marks = len(period), [f"{r}.{p}" for r in robots for p in points]
    flat = image.reshape(count, len(marks), 2)
    moving = "velocities"
    check_numbers(
        (
            Numbers("period", ("period",), period[:, None]),
            Numbers("speed", [f"{r}.v" for r in robots], odometry[..., 0], moving),
            Numbers("speed", [f"{r}.lateral" for r in robots], odometry[..., 1], moving),
            Numbers("turn", [f"{r}.w" for r in robots], odometry[..., 2], moving),
            Numbers("image", [f"{mark}.x" for mark in marks], flat[..., 0], "`x`"),
            Numbers("height", [f"{mark}.y" for mark in marks], flat[..., 1], "`y`", unknown=True),
        ),
        fail,
        limits,
    )
    old = samples.arrived[0] & ~sent_by(count)[:, None]
    if old.any():
        k, pair = (int(i) for i in np.argwhere(old)[0])
        age = int(old[k, pair]).bit_length() - 1
        a, b = ordered_pairs(len(robots))[pair]
        raise fail(
            k,
            f"`age` of a message must be at most {k} in sample {k}, but is {age}: {robots[b]} would have made it for "
            f"{robots[a]} before the log began",
        )
    same = seen[1:] & seen[:-1] & (period[1:, None, None] == 0.0)
    apart = np.nan_to_num(np.abs(np.diff(image, axis=0)), nan=0.0).max(axis=-1, initial=0.0)
    odd = np.argwhere(same & (apart > CONTRADICTION))
    if not len(odd):
        return []
    k, r, m = odd[0]
    return [contradiction(len(odd), f"sample {k + 1}, {robots[r]}, {points[m]}")]


def contradiction(count: int, first: str) -> str:
    """What is said of detections of one point at one time that differ."""
    many = f"{count} detections" if count > 1 else "a detection"
    return f"{many} of a point unlike another of the same point at the same time: the last counts ({first})"


def sent_by(count: int) -> NDArray[np.uint64]:
    """(T,) bits of `Samples.arrived` that a message made since the first of `count` samples can have."""
    ages = np.minimum(np.arange(1, count + 1), 64).astype(np.uint64)
    full: NDArray[np.uint64] = np.uint64(2**64 - 1) >> (np.uint64(64) - ages)
    return full
