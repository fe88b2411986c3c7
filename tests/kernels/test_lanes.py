"""Blocks of environments: what goes in comes out, no lane knows of the others, and vector instructions do the work."""

import platform
import re
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import binding
from numpy.typing import NDArray

from relloc_env.kernels import anchors, cascade, depth_state, lanes, pose_filter
from relloc_env.kernels.lanes import W
from tests.kernels.observers import SETTINGS, Float, Observers

SIZE = 5


@pytest.mark.parametrize(("num_envs", "count"), [(1, 1), (W, 1), (W + 1, 2), (3 * W, 3)])
def test_blocks_hold_all_environments(num_envs: int, count: int) -> None:
    assert lanes.blocks(num_envs, SIZE).shape == (count, SIZE * W)


def test_numbers_stand_lane_beside_lane() -> None:
    """Number f of lane l of a block is at f W + l."""
    table = np.arange(3.0 * SIZE * W).reshape(3, SIZE * W)
    rows = np.array([20, 0, 7, 8, 23])
    found = lanes.gather(table, rows)
    for row, numbers in zip(rows, found, strict=True):
        np.testing.assert_array_equal(numbers, [table[row // W, f * W + row % W] for f in range(SIZE)])


def test_what_was_gathered_is_a_copy_and_goes_back_to_its_rows_alone() -> None:
    rng = np.random.default_rng(1)
    table, rows = rng.normal(size=(3, SIZE * W)), np.array([9, 2, 16])
    before = table.copy()
    numbers = lanes.gather(table, rows)
    numbers += 1.0
    np.testing.assert_array_equal(table, before)
    lanes.scatter(table, rows, numbers)
    np.testing.assert_array_equal(lanes.gather(table, rows), numbers)
    others = np.delete(np.arange(3 * W), rows)
    np.testing.assert_array_equal(lanes.gather(table, others), lanes.gather(before, others))


def test_copy_takes_whole_numbers_of_all_lanes_or_of_one_vector() -> None:
    source, target = np.arange(4.0 * W), np.zeros(4 * W)
    lanes.copy(source, W, target, 2 * W, 2, W)
    np.testing.assert_array_equal(target, [*np.zeros(2 * W), *source[W : 3 * W]])
    target[:] = 0.0
    lanes.copy(source, W, target, 2 * W, 2, lanes.VECTOR)
    expected = np.where(np.arange(W) < lanes.VECTOR, source[W : 3 * W].reshape(2, W), 0.0)
    np.testing.assert_array_equal(target.reshape(4, W), [*np.zeros((2, W)), *expected])


COUNT, STEPS = 8 * W, 200


def histories() -> tuple[Any, ...]:
    """Samples of points that go every way there is; each has gains and a pace of its own."""
    rng = np.random.default_rng(2)
    velocity = rng.uniform(-1.0, 1.0, (STEPS, COUNT, 3))
    period = np.where(rng.random((STEPS, COUNT)) < 0.02, 0.0, rng.choice([0.02, 0.1, 0.5], COUNT))
    images = rng.uniform(-0.8, 0.8, (STEPS, COUNT, 2))
    images[:, rng.random(COUNT) < 0.2, 1] = np.nan
    seen = rng.random((STEPS, COUNT)) < rng.choice([0.1, 0.7, 0.95], COUNT)
    own = {"h": 10.0 ** rng.uniform(-1, 2, COUNT), "alpha_lambda": 10.0 ** rng.uniform(0, 4, COUNT)}
    return velocity, period, images, seen, own | {"depth": rng.uniform(0.3, 8.0, COUNT)}


def follow(order: Any) -> tuple[Float, NDArray[np.int64]]:
    """Numbers of these points after all samples, and which routes they took (bit by bit)."""
    velocity, period, images, seen, own = histories()
    settings = SETTINGS._replace(critical=1.0, lateral_sd=0.01, max_gap=1.0)
    observers = Observers(len(order), settings, **{name: values[order] for name, values in own.items()})
    routes = np.zeros(len(order), dtype=np.int64)
    for u, dt, s, there in zip(velocity, period, images, seen, strict=True):
        observers.sample(u[order], dt[order], s[order], there[order])
        routes |= 1 << observers.get(depth_state._ROUTE).astype(np.int64)
    return observers.numbers, routes


def test_a_point_gives_the_same_bits_in_any_lane_and_any_company() -> None:
    rng, usual = np.random.default_rng(3), np.arange(COUNT).reshape(-1, W)
    expected, routes = follow(usual.ravel())
    assert np.isfinite(expected).all()
    assert (np.bitwise_count(routes) >= 2).all()
    assert np.bitwise_or.reduce(routes) == 0b1111
    for shift in range(W):
        order = np.roll(rng.permuted(usual, axis=0), shift, axis=1).ravel()
        np.testing.assert_array_equal(follow(order)[0], expected[order])
    for alone in (0, 13, 63):
        np.testing.assert_array_equal(follow(np.array([alone]))[0][0], expected[alone])


T, WIDTH = numba.float64[::1], numba.int64
OPTIONS: Any = numba.typeof(anchors.FilterOptions(0, True, 1.0, True, 0.0, 1.0, 1.0, 0.0, 0.0))
LOOPS: dict[str, tuple[Any, Any]] = {
    "observers, means and modes": (depth_state._prepare, (T, numba.boolean, numba.float64, numba.float64, WIDTH)),
    "observers, step": (depth_state._advance, (T, numba.float64[:, ::1], numba.int64, WIDTH)),
    "dead reckoning": (anchors.reckon, (T, numba.float64, numba.float64, WIDTH)),
    "poses, prediction": (pose_filter.move_anchors, (T, OPTIONS, WIDTH)),
    "poses, points": (pose_filter.take_points, (T, OPTIONS, WIDTH)),
    "points in polar form": (cascade._polar, (T, WIDTH)),
}


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="the names are those of x86-64")
@pytest.mark.parametrize("name", LOOPS)
def test_loops_over_lanes_become_vector_instructions(name: str) -> None:
    """Each product and sum of a lane stands there twice: for four lanes or more, and for what is left of a width."""
    if not binding.get_host_cpu_features().get("avx"):
        pytest.skip("this processor has no AVX")
    function, signature = LOOPS[name]
    compiled: Any = numba.njit(error_model="numpy")(function.py_func)
    compiled.compile(signature)
    (assembly,) = compiled.inspect_asm().values()
    many = len(re.findall(r"\bv(?:mul|add|sub|f?n?m\w+)pd\b.*%[yz]mm", assembly))
    one = len(re.findall(r"\bv(?:mul|add|sub|f?n?m\w+)sd\b", assembly))
    assert many > 100
    assert many > 0.6 * one
