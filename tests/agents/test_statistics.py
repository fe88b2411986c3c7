import numpy as np
import pytest
from scipy import stats

from agents.statistics import RESAMPLES, mean, mean_difference, median, root_mean_square


def normal(n, seed=0):
    return np.random.default_rng(seed).normal(size=n)


@pytest.mark.parametrize("n", [2, 17, 100, 501])
def test_median_is_scipys_bootstrap(n):
    values = normal(n)
    found = stats.bootstrap(
        (np.sort(values),), np.median, n_resamples=RESAMPLES, batch=250, method="percentile",
        rng=np.random.default_rng(0),
    )  # fmt: skip
    interval = median(values)
    assert interval.value == np.median(values)
    # The ends are resamples themselves: SciPy's, up to the step to the next one.
    spread = np.sort(found.bootstrap_distribution)
    for end, theirs in zip(interval[1:], found.confidence_interval, strict=True):
        k = np.searchsorted(spread, theirs)
        assert end in spread[max(0, k - 1) : k + 2]


def test_widths_are_those_of_large_samples():
    values = normal(2000)
    deviation = 1.0 / np.sqrt(2000)
    of_mean, of_median = mean(values), median(values)
    assert of_mean.high - of_mean.low == pytest.approx(2 * 1.96 * deviation, rel=0.1)
    assert of_median.high - of_median.low == pytest.approx(2 * 1.96 * deviation * np.sqrt(np.pi / 2), rel=0.25)
    assert root_mean_square(values).value == pytest.approx(np.sqrt(np.mean(values**2)))


def test_intervals_cover():
    """200 samples of 60: an interval of 95 % misses the true median about ten times."""
    inside = 0
    for seed in range(200):
        _, low, high = median(normal(60, seed))
        inside += low <= 0.0 <= high
    assert 180 <= inside <= 199


def test_times_that_did_not_come_are_later_than_all_others():
    times = np.arange(1.0, 102.0)
    late = np.where(times > 55.0, np.inf, times)
    assert median(late).value == median(times).value == 51.0
    assert median(late).low == median(times).low
    assert np.isinf(median(late).high)
    assert median(np.where(times > 40.0, np.inf, times))[::2] == (np.inf, np.inf)
    assert median(np.full(9, np.inf)) == (np.inf,) * 3
    with pytest.raises(ValueError, match="must be finite for a mean"):
        mean(late)


def test_differences_are_paired():
    first = normal(300, 1)
    second = first + 0.1 + 0.01 * normal(300, 2)
    value, low, high = mean_difference(second, first)
    assert value == pytest.approx(np.mean(second) - np.mean(first))
    assert 0.098 < low < 0.1 + 0.002 < high + 0.002 < 0.105


def test_nothing_and_one():
    assert np.isnan(median(np.full(5, np.nan))).all()
    assert np.isnan(mean(np.zeros(0))).all()
    assert median(np.array([3.0])) == (3.0, 3.0, 3.0)
    assert mean(np.full(4, 2.0)) == (2.0, 2.0, 2.0)
