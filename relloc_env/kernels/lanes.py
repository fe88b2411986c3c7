"""Lanes: several environments side by side, so that one instruction works on four of them.

A block holds `W` environments. Their state is records whose fields are lanes: `POINT = record(known=1, covariance=6)`
is a dtype of which `point.known[i]` is a number of lane i, and `point.covariance[k, i]` the k-th of six. The same
number of neighbouring environments is side by side in memory, and a loop over the lanes whose body has no branch that
stores, and calls no function of the C library (`kernels.elementary` has what is needed), is compiled to vector
instructions. Where something is chosen, both alternatives are computed and one is taken; the rare cases are treated
lane by lane afterwards. The arithmetic of a lane does not depend on the other lanes, and no operation is reordered: an
environment gives the same bits in any lane, alone or in company.

Some habits keep the compiler able to do so. A loop reads and writes few records, so that a few comparisons at run time
show that they do not overlap. `width`, the bound of such a loop, is an argument: with a constant the loop would be
unrolled before it could become vectors. What is chosen is not stored where one of the alternatives came from, or else
the compiler stores some lanes alone, which is slow. And records begin at a multiple of `ALIGNMENT` (`aligned`): 16
bytes beside it cost a third of the time.

This module alone knows where a number of a record is in memory.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import inlined

W = 32
"""Environments in a block."""
VECTOR = 4
"""Numbers of a vector."""
ALIGNMENT = 64
"""[bytes] of a line of the cache."""
_POSITIVE = np.int64(0x7FFFFFFFFFFFFFFF)


def width_of(num_envs: int) -> int:
    """Lanes to work on in a batch of so many environments: all, or those of the first vectors for a few."""
    return min(W, VECTOR * -(-num_envs // VECTOR))


def record(**fields: int | np.dtype[Any]) -> np.dtype[Any]:
    """A dtype whose fields are lanes.

    Args:
        fields: the count of numbers of each field, or the dtype of a record within this one.
    """
    kinds: list[Any] = []
    for name, kind in fields.items():
        if isinstance(kind, np.dtype):
            kinds.append((name, kind))
        else:
            kinds.append((name, np.float64, (W,) if kind == 1 else (kind, W)))
    return np.dtype(kinds)


def of_one(kind: np.dtype[Any]) -> np.dtype[Any]:
    """The dtype of one lane of a record: the same fields in the same order, as it is kept in rows."""
    kinds: list[Any] = []
    for name in kind.names or ():
        inner = kind[name]
        if inner.names:
            kinds.append((name, of_one(inner)))
        else:
            kinds.append((name, np.float64, inner.shape[:-1]))
    return np.dtype(kinds)


def named(rows: NDArray[np.float64], kind: np.dtype[Any]) -> NDArray[Any]:
    """Rows (..., numbers) of a record as a structured array (...), in the same memory."""
    found: NDArray[Any] = rows.view(of_one(kind))[..., 0]
    return found


def numbers_of(kind: np.dtype[Any]) -> int:
    """How many numbers a lane of a record has."""
    return kind.itemsize // (8 * W)


def aligned(shape: int | tuple[int, ...], kind: Any) -> NDArray[Any]:
    """Zeros that begin at a multiple of `ALIGNMENT`."""
    dtype = np.dtype(kind)
    size = int(np.prod(shape)) * dtype.itemsize
    raw = np.zeros(size + ALIGNMENT, np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    found: NDArray[Any] = raw[start : start + size].view(dtype).reshape(shape)
    return found


def align(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself where it is aligned, else a copy that is: copies and pickles need not be."""
    if array.ctypes.data % ALIGNMENT == 0:
        return array
    copied = aligned(array.shape, array.dtype)
    copied[...] = array
    return copied


def lanes_of(records: NDArray[Any], rows: NDArray[Any]) -> NDArray[np.float64]:
    """Return (len(rows), numbers), a copy of what records (B, ...) hold of the environments `rows`."""
    found: NDArray[np.float64] = _table(records)[rows // W, :, rows % W]
    return found


def put_lanes(records: NDArray[Any], rows: NDArray[Any], values: NDArray[np.float64]) -> None:
    """Put back what `lanes_of` gave."""
    _table(records)[rows // W, :, rows % W] = values


def _table(records: NDArray[Any]) -> NDArray[np.float64]:
    """The numbers of records (B, ...), (B, numbers, W), in the same memory."""
    return records.reshape(len(records), -1).view(np.float64).reshape(len(records), -1, W)


def block_count(num_envs: int) -> int:
    """Count B of the blocks of so many environments."""
    return -(-num_envs // W)


def fill(records: NDArray[Any], values: Mapping[str, Any]) -> NDArray[Any]:
    """Write all fields of records and return them; a field that is left out or unknown cannot be."""
    assert records.dtype.names is not None
    assert set(records.dtype.names) == set(values), (records.dtype.names, tuple(values))
    for name, value in values.items():
        records[name] = value
    return records


def flat(arrays: Iterable[NDArray[Any]]) -> tuple[NDArray[Any], ...]:
    """C-contiguous arrays as lines of numbers, which share their memory."""
    return tuple(array.reshape(-1) for array in arrays)


@inlined
def natural(number):
    """A number that is not negative, which the compiler then knows: as a place it needs no test for a sign."""
    return number & _POSITIVE


@inlined
def workspace(size, width):
    """Zeros for `size` numbers of the lanes that are worked on."""
    t = np.empty(size * W)
    if width == VECTOR:
        for k in range(size):
            for i in range(VECTOR):
                t[natural(k * W) + i] = 0.0
    else:
        for i in range(size * W):
            t[i] = 0.0
    return t


@inlined
def raw(records):
    """Numbers of records one after the other, in the same memory: number k of lane i is at k W + i."""
    return records.reshape(-1).view(np.float64)


@inlined
def clear_lane(records, lane):
    """Set all numbers of a lane to 0."""
    numbers = raw(records)
    for k in range(numbers.shape[0] // W):
        numbers[natural(k * W + lane)] = 0.0


@inlined
def load_lane(records, lane, row):
    """Copy a row of numbers, in the order of the fields, to a lane of records."""
    numbers = raw(records)
    for k in range(row.shape[0]):
        numbers[natural(k * W + lane)] = row[k]


@inlined
def store_lane(records, lane, row):
    """Copy a lane of records to a row of numbers."""
    numbers = raw(records)
    for k in range(row.shape[0]):
        row[k] = numbers[natural(k * W + lane)]


@inlined
def keep_lanes(source, target, rows):
    """Copy the lanes of the environments `rows`, all of one block, from records to records of the same kind."""
    a, b = raw(source), raw(target)
    for k in range(a.shape[0] // W):
        for n in rows:
            b[natural(k * W + n % W)] = a[natural(k * W + n % W)]


@inlined
def scratch(count, kind, width):
    """`count` records, zeros in the lanes that are worked on."""
    records = np.empty(count, kind)
    numbers = raw(records)
    if width == VECTOR:
        for k in range(numbers.shape[0] // W):
            for i in range(VECTOR):
                numbers[natural(k * W) + i] = 0.0
    else:
        for i in range(numbers.shape[0]):
            numbers[i] = 0.0
    return records
