"""What a reader refuses, sorts and tells, whichever source it reads."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from relloc_env.logs import Limits, LogError
from relloc_env.logs.checks import LIMITS, Numbers, check_cells, check_numbers, check_samples, contradictions, in_order
from relloc_env.logs.source import perfect_network
from relloc_env.samples import Float, Samples

START = 1248446190.0


def fail(row: int, words: str) -> LogError:
    return LogError(Path("table"), words, row + 1)


def stamps(values: Float) -> list[Numbers]:
    return [Numbers("stamp", ("time",), np.asarray(values, dtype=np.float64)[:, None])]


@pytest.mark.parametrize(
    ("unit", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")], ids=["ms", "us", "ns"]
)
@pytest.mark.parametrize("begin", [0.0, START], ids=["since the start", "since 1970"])
@pytest.mark.parametrize("step", [0.1, 0.02, 1.0])
def test_the_unit_that_was_probably_meant_is_told(unit: float, name: str, begin: float, step: float) -> None:
    if unit * step < LIMITS.gap and begin == 0.0:
        return  # 20 ms since the start could be 20 s: the size of the log tells
    time: Float = unit * (begin + step * np.arange(20.0))
    with pytest.raises(LogError, match=rf"table, line \d+: .*are these {name}\?"):
        check_numbers(stamps(time), fail)


@pytest.mark.parametrize(
    ("row", "stamp", "line", "words"),
    [
        (0, 0.0, 2, r"jumps by 1\.2e\+09 s; was the clock not set yet in the row before"),
        (7, START + 7200.0, 8, r"must not jump by more than 60 s.* jumps by 7\.2e\+03 s; did the clock jump"),
        (7, 0.0, 8, r"must not go back, .*was the clock set anew"),
        (7, START - 3600.0, 8, "must not go back"),
        (7, np.nan, 8, "`time` must be finite"),
    ],
)
def test_a_stamp_far_from_its_neighbours_is_named(row: int, stamp: float, line: int, words: str) -> None:
    time: Float = START + 0.1 * np.arange(20.0)
    time[row] = stamp
    with pytest.raises(LogError, match=rf"table, line {line}: .*{words}"):
        check_numbers(stamps(time), fail)


def test_the_longest_gap_is_a_limit() -> None:
    time = START + np.array([0.0, 1.0, 91.0])
    with pytest.raises(LogError, match=r"line 3: time must not jump by more than 60 s"):
        check_numbers(stamps(time), fail)
    check_numbers(stamps(time), fail, Limits(gap=90.0))


@pytest.mark.parametrize("shift", [1, 3, 8])
def test_small_disorder_is_sorted_and_told(shift: int) -> None:
    time: Float = START + 0.1 * np.arange(30.0)
    mixed = time.copy()
    mixed[: shift + 1] = np.roll(time[: shift + 1], 1)
    check_numbers(stamps(mixed), fail)
    order, words = in_order(mixed, fail)
    np.testing.assert_array_equal(mixed[order], time)
    assert words == f"a row out of order, by up to {0.1 * shift:.3f} s: sorted"
    order, words = in_order(time, fail)
    assert words == ""
    assert order.tolist() == list(range(30))


def test_large_disorder_is_an_error() -> None:
    time: Float = START + 0.1 * np.arange(30.0)
    late = np.concatenate([time[10:12], time[:10], time[12:]])
    with pytest.raises(LogError, match="line 3: time must not go back"):
        in_order(late, fail)
    many: Float = START + 0.1 * (np.arange(60) ^ 1).astype(np.float64)  # each pair of rows swapped
    with pytest.raises(LogError, match=r"line 2: time must not go back.*\(like 30 other rows\)"):
        in_order(many, fail)


KINDS = [
    ("speed", 20.0, 20.1, "at most 20 m/s"),
    ("turn", 100.0, 101.0, "at most 100 rad/s"),
    ("period", 60.0, 60.1, "0 or more, and at most 60 s"),
    ("period", 0.0, -1e-9, "0 or more"),
    ("image", 1e6, 1.1e6, "at most 1e[+]06"),
    ("depth", 1e-9, 0.0, "positive"),
    ("depth", 1e8, 1e9, "at most 1e[+]08 m"),
    ("place", -1e8, -1e9, "at most 1e[+]08"),
    ("seen", 1.0, 0.5, "0 or 1"),
]


@pytest.mark.parametrize(("kind", "good", "bad", "words"), KINDS)
def test_numbers_end_where_their_limit_is(kind: str, good: float, bad: float, words: str) -> None:
    values = np.full((4, 2), good)
    check_numbers([Numbers(kind, ("a", "b"), values)], fail)  # type: ignore[arg-type]
    for wrong in (bad, np.nan, np.inf):
        values[2, 1] = wrong
        with pytest.raises(LogError, match="line 3: `b` must be") as error:
            check_numbers([Numbers(kind, ("a", "b"), values)], fail)  # type: ignore[arg-type]
        if wrong == bad:
            error.match(words)


def test_what_is_not_known_may_be_nan_and_nothing_else() -> None:
    unknown = Numbers("place", ("x",), np.array([[1.0], [np.nan]]), unknown=True)
    check_numbers([unknown], fail)
    with pytest.raises(LogError, match="line 2: `x` must be finite, but is inf"):
        check_numbers([unknown._replace(values=np.array([[1.0], [np.inf]]))], fail)


def test_limits_are_positive_numbers_and_named() -> None:
    assert Limits.of(["gap=120", "speed=30.5"]) == replace(LIMITS, gap=120.0, speed=30.5)
    for field in fields(Limits):
        for bad in (0.0, -1.0, np.nan, np.inf, "1"):
            with pytest.raises(ValueError, match=rf"`limits\.{field.name}` must be a positive number"):
                Limits(**{field.name: bad})  # type: ignore[arg-type]
    for word in ("gaps=3", "gap", "gap=far", "=3"):
        with pytest.raises(ValueError, match="Argument `limit` must be"):
            Limits.of([word])


def samples(count: int = 6) -> Samples:
    return Samples(
        np.full((1, count), 0.1),
        np.full((1, count, 2, 3), 0.1, np.float32),
        np.full((1, count, 2, 1, 2), 0.2, np.float32),
        np.ones((1, count, 2, 1), np.bool_),
        perfect_network(count, 2),
    )


def look(part: Samples, limits: Limits = LIMITS) -> list[str]:
    return check_samples(part, ("a", "b"), ("p",), fail, limits)


@pytest.mark.parametrize(
    ("field", "at", "value", "words"),
    [
        ("period", (0, 3), 61.0, r"`period` must be 0 or more, and at most 60 s, but is 61"),
        ("odometry", (0, 3, 1, 0), 25.0, r"velocities must be at most 20 m/s in size, but `b\.v` is 25"),
        ("odometry", (0, 3, 0, 1), np.nan, r"velocities must be finite, but `a\.lateral` is nan"),
        ("odometry", (0, 3, 0, 2), 200.0, r"velocities must be at most 100 rad/s in size, but `a\.w` is 200"),
        ("image", (0, 3, 1, 0, 0), np.nan, r"`x` must be finite, but `b\.p\.x` is nan"),
        ("image", (0, 3, 1, 0, 1), np.inf, r"`y` must be finite, but `b\.p\.y` is inf"),
        (
            "arrived",
            (0, 3, 1),
            1 << 4,
            r"`age` of a message must be at most 3 in sample 3, but is 4: a would",
        ),
    ],
)
def test_a_sample_that_cannot_be_is_named(field: str, at: tuple[int, ...], value: float, words: str) -> None:
    part = samples()
    assert look(part) == []
    getattr(part, field)[at] = value
    with pytest.raises(LogError, match=f"line 4: {words}"):
        look(part)


def test_a_bearing_without_a_height_and_a_period_of_zero_are_legal() -> None:
    part = samples()
    part.image[..., 1] = np.nan
    part.period[0, 3] = 0.0
    assert look(part) == []


def test_one_stamp_and_two_answers_are_told() -> None:
    part = samples()
    part.period[0, 3] = 0.0
    part.image[0, 3, 1, 0, 0] += 0.3
    (words,) = look(part)
    assert "unlike another of the same point at the same time" in words
    assert "sample 3, b, p" in words
    part.seen[0, 2, 1] = False
    assert look(part) == []
    time, names, bearing = (
        np.array([1.0, 1.0, 1.0, 2.0]),
        np.array([6, 7, 6, 6]),
        np.array([[0.1], [0.5], [0.4], [0.9]]),
    )
    assert contradictions(time, names, bearing) == [2]
    assert contradictions(time, names, 0.0 * bearing) == []


def test_the_size_is_known_before_anything_is_made() -> None:
    assert check_cells(1e5, 2, 15) == ""
    assert "1000000000 x 2 x 15" in check_cells(1e9, 2, 15)
    assert check_cells(1e9, 2, 15, Limits(cells=1e12)) == ""
