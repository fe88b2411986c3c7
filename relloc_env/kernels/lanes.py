"""Lanes: several environments side by side, so that one instruction works on four of them.

A block holds `W` environments. Number f of lane l stands at `f * W + l`, so that the numbers of neighbouring
environments are neighbours in memory, and a loop over the lanes whose body has no branch that stores, and calls no
function of the C library (`kernels.elementary` has what is needed), is compiled to vector instructions. Where something
is chosen, both alternatives are computed and one is taken; the rare cases are mended lane by lane afterwards. The
arithmetic of a lane does not depend on the other lanes, and no operation is reordered: an environment gives the same
bits in any lane, alone or in company.

Some habits keep the compiler able to do so. All that one loop reads and writes is in one array, a workspace, at places
that are constants: nothing has to be told apart at run time. `width`, the bound of such a loop, is an argument: with a
constant the loop would be unrolled before it could become vectors. And what is chosen is not stored where one of the
alternatives came from, or else the compiler stores some lanes alone, which is slow.

Between lanes and the arrays that users read, an environment a row, numbers are carried one by one. So that this is
little more than a load and a store each, kernels take those arrays flat (`flat`), count places themselves, tell the
compiler that they are not negative (`natural`), and go over the lanes inside: arguments cost more than numbers.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import inlined

W = 32
"""Environments in a block."""
VECTOR = 4
"""Numbers of a vector."""
_POSITIVE = np.int64(0x7FFFFFFFFFFFFFFF)


def width_of(num_envs: int) -> int:
    """Lanes to work on in a batch of so many environments: all, or those of the first vectors for a few."""
    return min(W, VECTOR * -(-num_envs // VECTOR))


def blocks(num_envs: int, size: int) -> NDArray[np.float64]:
    """Zeros (B, size W) for `size` numbers of each of `num_envs` environments."""
    return np.zeros((-(-num_envs // W), size * W))


def gather(table: NDArray[np.float64], rows: NDArray[Any]) -> NDArray[np.float64]:
    """Return (len(rows), size), a copy of the numbers of the environments `rows`."""
    found: NDArray[np.float64] = table.reshape(len(table), -1, W)[rows // W, :, rows % W]
    return found


def scatter(table: NDArray[np.float64], rows: NDArray[Any], values: NDArray[np.float64]) -> None:
    """Put back what `gather` gave."""
    table.reshape(len(table), -1, W)[rows // W, :, rows % W] = values


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
def copy(source, at, target, to, size, width):
    """Copy `size` numbers, from place `at` of `source` to place `to` of `target`: all lanes, or those of one vector."""
    source_at, target_at = natural(at), natural(to)
    if width == VECTOR:
        for k in range(size):
            for i in range(VECTOR):
                target[target_at + natural(k * W) + i] = source[source_at + natural(k * W) + i]
    else:
        for i in range(size * W):
            target[target_at + i] = source[source_at + i]
