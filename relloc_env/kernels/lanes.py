"""Lanes: several environments side by side, so that one instruction works on four of them.

A block holds `W` environments. Number f of lane l stands at `f * W + l`, so that the numbers of neighbouring
environments are neighbours in memory, and a loop over the lanes whose body has no branch that stores, and calls no
function of the C library (`kernels.elementary` has what is needed), is compiled to vector instructions. Where something
is chosen, both alternatives are computed and one is taken; the rare cases are mended lane by lane afterwards. The
arithmetic of a lane does not depend on the other lanes, and no operation is reordered: an environment gives the same
bits in any lane, alone or in company.

Two habits keep the compiler able to do so. All that one loop reads and writes is in one array, a workspace, at places
that are constants: nothing has to be told apart at run time. And `width`, the bound of such a loop, is an
argument: with a constant the loop would be unrolled before it could become vectors.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import inlined

W = 8
"""Environments in a block."""


def width_of(num_envs: int) -> int:
    """Lanes to work on in a batch of so many environments: all, or those of the first vector for a few."""
    return W if num_envs > W // 2 else W // 2


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


@inlined
def copy(source, at, target, to, size):
    """Copy `size` numbers of all lanes, from place `at` of `source` to place `to` of `target`."""
    source_at, target_at = np.uint64(at), np.uint64(to)  # places without a sign need no test for one
    for i in range(np.uint64(size * W)):
        target[target_at + i] = source[source_at + i]
