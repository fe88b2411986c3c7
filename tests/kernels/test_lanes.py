"""Blocks of environments: what goes in comes out, no lane knows of the others, and vector instructions do the work."""

import platform
import re
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import binding
from numba.np.numpy_support import from_dtype
from numpy.typing import NDArray

from relloc_env.kernels import anchors, cascade, depth_state, lanes, pose_filter
from relloc_env.kernels.lanes import W
from tests.kernels.observers import SETTINGS, Float, Observers

INNER = lanes.record(a=1, b=2)
KIND = lanes.record(first=1, inner=INNER, six=6)
"""Ten numbers."""
ONE = np.dtype([("first", "f8"), ("inner", [("a", "f8"), ("b", "f8", (2,))]), ("six", "f8", (6,))])


def filled(blocks: int) -> NDArray[Any]:
    """Records whose numbers are all different."""
    records = lanes.aligned((blocks, 3), KIND)
    records.view(np.float64)[:] = np.arange(records.nbytes // 8).reshape(blocks, -1)
    return records


@pytest.mark.parametrize(("num_envs", "count"), [(1, 1), (W, 1), (W + 1, 2), (3 * W, 3)])
def test_blocks_hold_all_environments(num_envs: int, count: int) -> None:
    assert lanes.block_count(num_envs) == count


def test_records_begin_at_a_line_of_the_cache_and_are_aligned_again_where_a_copy_is_not() -> None:
    for shape in (1, 7, (3, 5)):
        assert lanes.aligned(shape, KIND).ctypes.data % 64 == 0
    raw = np.zeros(KIND.itemsize + 24, np.uint8)
    offset = 8 if raw.ctypes.data % 64 != 56 else 16
    crooked = raw[offset : offset + KIND.itemsize].view(KIND)
    crooked["six"] = 3.0
    straight = lanes.align(crooked)
    assert straight.ctypes.data % 64 == 0
    np.testing.assert_array_equal(straight["six"], crooked["six"])
    assert lanes.align(straight) is straight


def test_a_lane_of_records_is_a_row_whose_numbers_have_the_same_names() -> None:
    records, rows = filled(3), np.array([W + 5, 0, 2 * W + 7])
    assert lanes.of_one(KIND) == ONE
    assert lanes.numbers_of(KIND) == 10
    found = lanes.named(lanes.lanes_of(records, rows).reshape(3, 3, -1), KIND)
    for row, each in zip(rows, found, strict=True):
        block, lane = records[row // W], row % W
        np.testing.assert_array_equal(each["first"], block["first"][:, lane])
        np.testing.assert_array_equal(each["inner"]["b"], block["inner"]["b"][..., lane])
        np.testing.assert_array_equal(each["six"], block["six"][..., lane])


def test_what_was_taken_out_is_a_copy_and_goes_back_to_its_rows_alone() -> None:
    records, rows = filled(3), np.array([9, 2, W + 16])
    before = records.copy()
    numbers = lanes.lanes_of(records, rows)
    numbers += 0.5
    np.testing.assert_array_equal(records, before)
    lanes.put_lanes(records, rows, numbers)
    np.testing.assert_array_equal(lanes.lanes_of(records, rows), numbers)
    others = np.delete(np.arange(3 * W), rows)
    np.testing.assert_array_equal(lanes.lanes_of(records, others), lanes.lanes_of(before, others))


def test_filling_asks_for_every_field() -> None:
    records = np.zeros(2, np.dtype([("a", "f8"), ("b", "f8")]))
    assert lanes.fill(records, {"b": 2.0, "a": 1.0})["b"].tolist() == [2.0, 2.0]
    with pytest.raises(AssertionError):
        lanes.fill(records, {"a": 1.0})
    with pytest.raises(AssertionError):
        lanes.fill(records, {"a": 1.0, "b": 2.0, "c": 3.0})


@numba.njit
def through_a_lane(records, lane, row):
    lanes.load_lane(records, lane, row)
    lanes.store_lane(records, lane, 2.0 * row)


@numba.njit
def kept_and_cleared(source, target, rows, lane):
    lanes.keep_lanes(source, target, rows)
    lanes.clear_lane(target, lane)
    return lanes.scratch(2, KIND, lanes.VECTOR), lanes.scratch(2, KIND, W)


def test_lanes_are_loaded_kept_and_cleared_alone() -> None:
    records, row = filled(1)[0], np.arange(30.0)
    before = records.copy()
    through_a_lane(records, 4, row)
    np.testing.assert_array_equal(lanes.lanes_of(records[None], np.array([4]))[0], row)
    source, target, rows = filled(1)[0], lanes.aligned(3, KIND), np.array([W + 1, W + 6, W + 9])
    small, large = kept_and_cleared(source, target, rows, 6)
    expected = np.zeros((W, 30))
    expected[[1, 9]] = lanes.lanes_of(source[None], np.array([1, 9]))
    np.testing.assert_array_equal(lanes.lanes_of(target[None], np.arange(W)), expected)
    assert not lanes.lanes_of(small[None], np.arange(lanes.VECTOR)).any()
    assert not lanes.lanes_of(large[None], np.arange(W)).any()
    others = np.delete(np.arange(W), 4)
    np.testing.assert_array_equal(lanes.lanes_of(records[None], others), lanes.lanes_of(before[None], others))


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
    settings = SETTINGS._replace(critical=True, lateral_sd=0.01, max_gap=1.0)
    observers = Observers(len(order), settings, **{name: values[order] for name, values in own.items()})
    routes = np.zeros(len(order), dtype=np.int64)
    for u, dt, s, there in zip(velocity, period, images, seen, strict=True):
        observers.sample(u[order], dt[order], s[order], there[order])
        routes |= 1 << observers.routes.astype(np.int64)
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


WIDTH = numba.int64
OPTIONS: Any = numba.typeof(anchors.FilterOptions(0, True, 1.0, True, 0.0, 1.0, 1.0, 0.0, 0.0))
OBSERVER: Any = tuple(from_dtype(kind) for kind in (depth_state.POINT, depth_state.WORK, depth_state.SETTINGS))
PAIR: Any = tuple(from_dtype(kind) for kind in (anchors.MOTION, anchors.MOTION))
ANCHOR, UPDATE, PLANE = (from_dtype(kind) for kind in (anchors.ANCHOR, anchors.UPDATE, anchors.PLANE_POINT))
LOOPS: dict[str, tuple[Any, Any]] = {
    "observers, means and modes": (depth_state._prepare, (*OBSERVER, WIDTH)),
    "observers, step": (depth_state._advance, (*OBSERVER, WIDTH)),
    "dead reckoning": (
        anchors.reckon, (PAIR[0], from_dtype(depth_state.INTERVAL), numba.float64, numba.float64, WIDTH)
    ),
    "poses, prediction": (pose_filter.move_anchors, (ANCHOR, *PAIR, from_dtype(anchors.CLOCK), OPTIONS, WIDTH)),
    "poses, points": (pose_filter.take_points, (ANCHOR, UPDATE, *PAIR, PLANE, PLANE, OPTIONS, WIDTH)),
    "points in polar form": (cascade._polar, (OBSERVER[0], from_dtype(cascade.POLAR), WIDTH)),
}  # fmt: skip


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
