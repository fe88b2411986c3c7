"""Medians, means, differences and their intervals, by SciPy's bootstrap."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from relloc_env.extras import extra
from relloc_env.samples import Float, Rows

with extra("agents"):
    from scipy import stats


LEVEL = 0.95
RESAMPLES = 1000
BATCH = 250
"""Resamples at once."""


class Interval(NamedTuple):
    """A statistic of the episodes, and the ends of its bootstrapped 95 % interval; infinite for "never"."""

    value: float
    low: float
    high: float


NONE = Interval(np.nan, np.nan, np.nan)


def median(values: Float) -> Interval:
    """Median over the episodes; infinite times take part as later than all others. NaN where there is nothing.

    The ends of the interval are medians of resamples, none between two of them: next to infinity there is no between.
    """
    kept = np.sort(values[~np.isnan(values)])
    if kept.size < 2:
        return Interval(*[float(kept[0])] * 3) if kept.size else NONE
    lower, upper = _middles(kept.size)
    medians = 0.5 * (kept[lower] + kept[upper])
    tail = 0.5 * (1.0 - LEVEL)
    low = np.quantile(medians, tail, method="lower")
    high = np.quantile(medians, 1.0 - tail, method="higher")
    return Interval(0.5 * float(kept[(kept.size - 1) // 2] + kept[kept.size // 2]), float(low), float(high))


def mean(values: Float) -> Interval:
    """Mean over the episodes, of finite values. NaN where there is nothing."""
    return _interval(values[~np.isnan(values)], np.mean)


def root_mean_square(values: Float) -> Interval:
    """Root of the mean square over the episodes, of finite values. NaN where there is nothing."""
    return Interval(*(math.sqrt(part) for part in mean(np.square(values))))


def mean_difference(values: Float, others: Float) -> Interval:
    """Mean over the episodes of value less other: both arrays are of the same episodes."""
    return mean(values - others)


def _interval(values: Float, statistic: Callable[..., Any]) -> Interval:
    if not np.isfinite(values).all():
        raise ValueError("Argument `values` must be finite for a mean, but has infinite ones: take the median")
    if values.size == 0:
        return NONE
    value = low = high = float(statistic(values))
    if np.ptp(values) > 0.0:
        found = stats.bootstrap(
            (values,), statistic, confidence_level=LEVEL, n_resamples=RESAMPLES, method="percentile",
            rng=np.random.default_rng(0), batch=BATCH,
        ).confidence_interval  # fmt: skip
        low, high = float(found.low), float(found.high)
    return Interval(value, low, high)


@lru_cache(maxsize=16)
def _middles(n: int) -> tuple[Rows, Rows]:
    """Ranks of the two in the middle of each resample of n values in ascending order (the same one, for odd n).

    The median of a resample depends on its values through these ranks alone: drawn once, they serve all scores.
    """

    def both(ranks: Rows, axis: int = -1) -> Float:
        ordered = np.partition(ranks, ((n - 1) // 2, n // 2), axis=axis)
        lower, upper = (np.take(ordered, k, axis=axis) for k in ((n - 1) // 2, n // 2))
        return np.asarray(lower * n + upper, np.float64)

    drawn = stats.bootstrap(
        (np.arange(n),), both, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0), batch=BATCH
    ).bootstrap_distribution
    codes = np.asarray(drawn, np.int64)
    return codes // n, codes % n
