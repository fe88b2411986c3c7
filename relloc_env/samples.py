"""What passes between the physical world, the estimators and whoever reads them: plain arrays with named fields.

Shapes: N environments, K samples, R robots, M points, P ordered pairs of robots, in the order of `ordered_pairs`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]
Rows = NDArray[np.int64]
"""Indices of the environments a call works on; what the others hold is left as it is."""


class Sharing:
    """Hands out views of its own arrays. Copied or pickled, views would be arrays of their own: they are made anew."""

    def _share(self) -> None:
        """Make the views."""
        raise NotImplementedError

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what a copy or a pickle holds."""
        self.__dict__.update(state)
        self._share()


def ordered_pairs(robots: int) -> NDArray[np.int64]:
    """Return (P, 2) pairs (observer, observed): the first estimates the pose of the second. A→B first, then B→A."""
    pairs = [(a, b) for a in range(robots) for b in range(robots) if a != b]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


class Samples(NamedTuple):
    """K consecutive samples of what each robot measures and receives. No truth is in here.

    A sample is taken at the end of an interval of length `period` over which the robot moved with `odometry`; the
    first sample of an episode has period 0. Fields are C-contiguous.
    """

    period: Float
    """[s] (N, K) length of the interval before the sample."""
    odometry: Float32
    """[m/s, m/s, rad/s] (N, K, R, 3) measured forward speed, lateral speed (left), yaw rate over that interval."""
    image: Float32
    """[-] (N, K, R, M, 2) normalised image coordinates at the end of it; 0 where not seen. NaN as the second
    coordinate means that the sensor gave a bearing without a height."""
    seen: Bool
    """(N, K, R, M) whether the camera gave this point in this sample."""
    arrived: NDArray[np.uint64]
    """(N, K, P) bit j is set where the message that the pair's observed robot made j samples ago reaches the
    observer now (bit 0: at once)."""


def empty_samples(n: int, k: int, r: int, m: int, p: int) -> Samples:
    """Samples in which nothing was measured: K samples of N environments, R robots, M points, P pairs."""
    return Samples(
        period=np.zeros((n, k)),
        odometry=np.zeros((n, k, r, 3), np.float32),
        image=np.zeros((n, k, r, m, 2), np.float32),
        seen=np.zeros((n, k, r, m), np.bool_),
        arrived=np.zeros((n, k, p), np.uint64),
    )


def copy_sample(source: Samples, k: int, target: Samples, at: int, rows: Rows) -> None:
    """Put sample k of `source` into place `at` of `target`, for the environments `rows`."""
    for name in Samples._fields:
        getattr(target, name)[rows, at] = getattr(source, name)[rows, k]


class Prior(NamedTuple):
    """What the robots are told at the start: guesses, not the truth."""

    depth: Float
    """[m] (N, R, M) guess of the depth (along the optical axis) of a point, taken at its first sight. The simulator
    makes it at the start of the episode."""
    pose: Float
    """[m, m, rad] (N, P, 3) guess of the observed robot's pose in the observer's frame."""
    depth_sd: float
    """[m] standard deviation of the depth guess."""
    pose_sd: Float
    """[m, m, rad] (3,) standard deviation of the pose guess."""


class Estimate(NamedTuple):
    """What the estimators believe now. Points are polar, so that they stay regular beside and behind the camera."""

    points: Float
    """[rad, -, 1/m] (N, R, M, 3) bearing beta (counter-clockwise from the heading), elevation eta (height above the
    camera over horizontal range), inverse horizontal range rho, in the robot's body frame."""
    points_covariance: Float
    """(N, R, M, 3, 3) covariance of the above."""
    known: Bool
    """(N, R, M) whether the robot has seen the point since the start."""
    pose: Float
    """[m, m, rad] (N, P, 3) pose xi of the observed robot in the observer's frame."""
    pose_covariance: Float
    """(N, P, 3, 3) covariance of the above."""
