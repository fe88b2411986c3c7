"""A batch cut into parts: never within a block of lanes, all rows once, errors not lost."""

import threading
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relloc_env.config import ConfigError
from relloc_env.envs.threads import check_threads, parts, run
from relloc_env.kernels.lanes import W


@given(rows=st.sets(st.integers(0, 300), min_size=1), count=st.integers(1, 9))
def test_parts_are_all_rows_and_whole_blocks(rows: set[int], count: int) -> None:
    """100 cases."""
    ascending = np.array(sorted(rows))
    found = parts(ascending, count)
    assert len(found) <= count
    np.testing.assert_array_equal(np.concatenate(found), ascending)
    blocks = [set((part // W).tolist()) for part in found]
    assert sum(map(len, blocks)) == len(set.union(*blocks))


def test_rows_in_no_order_stay_together() -> None:
    rows = np.arange(100)[::-1]
    assert [part.tolist() for part in parts(rows, 4)] == [rows.tolist()]


def test_parts_run_at_once_and_what_one_raises_is_raised_when_all_are_done() -> None:
    meet, done = threading.Barrier(3, timeout=10.0), []

    def work(rows: Any, part: int) -> None:
        meet.wait()  # nobody gets past it unless all three are there
        if part == 1:
            raise ValueError(f"part {part}")
        done.append(part)

    with pytest.raises(ValueError, match="part 1"):
        run(work, [np.arange(3)] * 3)
    assert sorted(done) == [0, 2]


def test_small_batches_stay_on_one_thread_and_large_ones_have_no_idle_ones() -> None:
    assert check_threads(None, 1) == check_threads(None, 300) == 1
    assert check_threads(7, 1) == 7


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2"])
def test_bad_numbers_of_threads_are_told_at_the_door(threads: Any) -> None:
    with pytest.raises(ConfigError, match="Argument `threads` must be a positive integer or None"):
        gym.make_vec("relloc_env/RelativePose-v0", num_envs=2, threads=threads)
