"""Which detection is which target, from picture to picture, through short losses."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.samples import Bool, Float

LOST = 20
"""Samples after which a target that is not found is searched for anew."""
GATE, GROWTH = 0.03, 0.02
"""[-] how far from its prediction a target is taken for itself, and by how much more for each sample since."""
NEVER = -1


class Tracks(NamedTuple):
    """What is remembered of M targets in the pictures of R robots in N environments; live arrays."""

    rays: Float
    """[-] (N, R, M, 2) where each is expected."""
    age: NDArray[np.int64]
    """(N, R, M) samples since it was found; `NEVER` where it is not followed."""


def empty_tracks(n: int, r: int, m: int) -> Tracks:
    """Nothing is followed yet."""
    return Tracks(np.zeros((n, r, m, 2)), np.full((n, r, m), NEVER, np.int64))


def predict(rays: Float, age: NDArray[np.int64], turn: float) -> None:
    """Carry targets (M, 2), (M,) over a sample in which the robot turned by `turn` [rad], counter-clockwise.

    The turn moves all of them alike; what the drive adds is left to the gate.
    """
    for m in np.flatnonzero(age >= 0).tolist():
        bearing = math.atan(rays[m, 0])
        after = bearing + turn
        age[m] += 1
        if age[m] > LOST or abs(after) > 1.5:
            age[m] = NEVER
        else:
            rays[m] = math.tan(after), rays[m, 1] * math.cos(bearing) / math.cos(after)


def assign(rays: Float, age: NDArray[np.int64], found: Float, fits: Bool, score: Float) -> NDArray[np.int64]:
    """Return (M,) which detection each target is, -1 for none.

    A target that is followed is the nearest detection within its gate that it may be, pairs of least distance first.
    Of what is left, the best go to targets that are not followed; where several may be either, from left to right.

    Args:
        rays, age: of the targets, predicted.
        found, fits, score: [-] (D, 2), (D, M), (D,) of the detections, in normalised image coordinates.
    """
    count, chosen = len(age), np.full(len(age), -1, np.int64)
    free = np.ones(len(found), np.bool_)
    away = np.where(fits, np.linalg.norm(found[:, None] - rays, axis=-1), np.inf)
    away[:, age < 0] = np.inf
    away[away > GATE + GROWTH * np.maximum(age, 1)] = np.inf
    for _ in range(min(count, len(found))):
        d, m = np.unravel_index(np.argmin(away), away.shape)
        if not math.isfinite(away[d, m]):
            break
        chosen[m], free[d] = d, False
        away[d], away[:, m] = np.inf, np.inf
    new = np.flatnonzero(age < 0)
    while new.size:
        alike = new[(fits[:, new] == fits[:, new[:1]]).all(axis=0)]
        new = np.setdiff1d(new, alike)
        may = np.flatnonzero(free & fits[:, alike[0]])
        best = may[np.argsort(-score[may], kind="stable")][: alike.size]
        best = best[np.argsort(found[best, 0], kind="stable")]
        chosen[alike[: best.size]] = best
        free[best] = False
    return chosen
