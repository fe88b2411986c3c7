"""Medians, differences and their intervals, by SciPy's bootstrap."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from relloc_env.samples import Float

LEVEL = 0.95
RESAMPLES = 1000
NEVER = 1e9
"""Stands for infinity while medians are taken: a time that did not come is later than any that did."""


class Interval(NamedTuple):
    """A statistic of the episodes, and the ends of its bootstrapped 95 % interval; infinite for "never"."""

    value: float
    low: float
    high: float


def median(values: Float) -> Interval:
    """Median over the episodes; infinite times take part as later than all others. NaN where there is nothing."""
    return _interval(values, np.median)


def mean_difference(values: Float, others: Float) -> Interval:
    """Mean over the episodes of value less other: both arrays are of the same episodes."""
    return _interval(values - others, np.mean)


def _interval(values: Float, statistic: Callable[..., Any]) -> Interval:
    kept = values[~np.isnan(values)]
    if kept.size == 0:
        return Interval(np.nan, np.nan, np.nan)
    finite = np.where(np.isfinite(kept), kept, NEVER)
    value = float(statistic(finite))
    low = high = value
    if np.ptp(finite) > 0.0:
        found = stats.bootstrap(
            (finite,), statistic, confidence_level=LEVEL, n_resamples=RESAMPLES, method="percentile",
            rng=np.random.default_rng(0), batch=250,
        ).confidence_interval  # fmt: skip
        low, high = float(found.low), float(found.high)
    return Interval(*(np.inf if part > 0.4 * NEVER else part for part in (value, low, high)))
