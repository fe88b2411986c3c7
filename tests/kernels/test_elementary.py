"""Sine, cosine, arc tangent and logarithm of the kernels, against numpy's in extended precision."""

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest

from relloc_env.kernels import elementary

sin_cos, atan2, log = elementary.sin_cos, elementary.atan2, elementary.log
CASES = 100_000
REFERENCE = 0.0 if np.finfo(np.longdouble).nmant > 52 else 1.0
"""Error [ulp] of the reference, where a long double is no longer than a double."""


@numba.njit
def sines(a, out):
    for i in range(a.size):
        out[0, i], out[1, i] = sin_cos(a[i])


@numba.njit
def angles(y, x, out):
    for i in range(y.size):
        out[i] = atan2(y[i], x[i])


@numba.njit
def logarithms(a, out):
    for i in range(a.size):
        out[i] = log(a[i])


def error(kernel: Any, function: Callable[..., Any], *arguments: Any, shape: tuple[int, ...] = ()) -> float:
    """Return the greatest error of `kernel` in units in the last place of the exact value."""
    found = np.empty((*shape, len(arguments[0])))
    kernel(*arguments, found)
    exact = function(*(a.astype(np.longdouble) for a in arguments))
    unit = np.spacing(np.abs(exact).astype(np.float64))
    return float(np.max(np.abs(found - exact) / unit))


def both(a: Any) -> Any:
    return np.stack([np.sin(a), np.cos(a)])


@pytest.mark.parametrize(("size", "bound"), [(1.0, 2.0), (10.0, 2.0), (1e3, 2.0), (1e5, 2.5)])
def test_sine_and_cosine(size: float, bound: float) -> None:
    a = np.random.default_rng(1).uniform(-size, size, CASES)
    assert error(sines, both, a, shape=(2,)) < bound + REFERENCE


def test_sine_and_cosine_next_to_multiples_of_a_quarter_turn() -> None:
    """Where one of them is all but 0: at the multiple, beside it by 1e-16 to 1, and one double before and after."""
    rng = np.random.default_rng(2)
    a = rng.integers(-60_000, 60_001, CASES) * (math.pi / 2)
    a += np.where(rng.random(CASES) < 0.5, 10.0 ** rng.uniform(-16, 0, CASES), 0.0)
    a = np.concatenate([a, np.nextafter(a, 0.0), np.nextafter(a, np.inf)])
    assert error(sines, both, a, shape=(2,)) < 2.5 + REFERENCE


def test_sine_and_cosine_of_tiny_angles() -> None:
    a = np.concatenate([[0.0, 5e-324, -1e-310, 1e-200], 10.0 ** np.random.default_rng(3).uniform(-300, -3, CASES)])
    assert error(sines, both, a, shape=(2,)) < 1.0 + REFERENCE
    assert sin_cos(0.0) == (0.0, 1.0)


def test_arc_tangent_in_every_direction_and_at_every_scale() -> None:
    rng = np.random.default_rng(4)
    angle, size = rng.uniform(-math.pi, math.pi, CASES), 10.0 ** rng.uniform(-150, 150, CASES)
    assert error(angles, np.arctan2, size * np.sin(angle), size * np.cos(angle)) < 2.0 + REFERENCE
    steepness = 10.0 ** rng.uniform(-20, 20, CASES)
    assert error(angles, np.arctan2, steepness, np.where(rng.random(CASES) < 0.5, 1.0, -1.0)) < 2.0 + REFERENCE


@pytest.mark.parametrize("ratio", [1e-8, 1 / 3, 0.5, 1.0, 2.0, 3.0, 1e8])
def test_arc_tangent_where_its_ways_meet(ratio: float) -> None:
    """A thousand doubles to both sides of the ratio, in all four quadrants."""
    y = np.abs(ratio * (1.0 + np.arange(-1000, 1001) * 2.0**-53))
    for sign in (1.0, -1.0):
        for x in (1.0, -1.0):
            assert error(angles, np.arctan2, sign * y, np.full_like(y, x)) < 2.0 + REFERENCE


def test_arc_tangent_on_the_axes_and_diagonals() -> None:
    for size in (1e-300, 1.0, 3.7, 1e300):
        for y, x in ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)):
            assert atan2(y * size, x * size) == pytest.approx(math.atan2(y, x), abs=0.0, rel=2.3e-16)
    for zero in (0.0, -0.0):
        assert atan2(zero, 1.0) == atan2(zero, 0.0) == atan2(zero, -0.0) == 0.0
        assert atan2(zero, -1.0) == math.pi


def test_logarithm_of_normal_numbers() -> None:
    rng = np.random.default_rng(6)
    a = np.concatenate([10.0 ** rng.uniform(-307, 308, CASES), [np.finfo(float).tiny, np.finfo(float).max]])
    assert error(logarithms, np.log, a) < 1.0 + REFERENCE


def test_logarithm_near_one_and_where_its_interval_ends() -> None:
    """1 and half a root of 2, times powers of 2."""
    rng = np.random.default_rng(7)
    near = 1.0 + rng.choice([-1.0, 1.0], CASES) * 10.0 ** rng.uniform(-16, -0.5, CASES)
    assert error(logarithms, np.log, near) < 1.0 + REFERENCE
    ends = np.outer(math.sqrt(0.5) * (1.0 + np.arange(-50, 51) * 2.0**-53), 2.0 ** np.arange(-5, 6)).ravel()
    assert error(logarithms, np.log, ends) < 1.0 + REFERENCE
    assert log(1.0) == 0.0
