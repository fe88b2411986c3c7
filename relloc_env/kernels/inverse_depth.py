"""A Kalman filter of inverse range for every point on its own, and the cascade's pose filter over them.

A point is (beta, eta, rho) as in `local_map`, whose kernels run here on maps of one point each: the noise of the
odometry, which moves all points of a robot at once, counts as if each point had its own. The pose filter takes points
in the plane of the body, with their covariance, as if each sample's were independent of the last one's.
"""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import anchors as an
from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import pose_filter as pf
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.lanes import W
from relloc_env.kernels.local_map import depth_prior, map_correct, map_enter, map_predict

LEAST_INVERSE_RANGE = 0.01
"""[1/m] a point that seems further than this is not used for the pose."""


class Filters(NamedTuple):
    """What is remembered beside the ring: N environments, R robots, M points, P ordered pairs."""

    state: np.ndarray
    """(N, R, M, 3) points (beta, eta, rho)."""
    covariance: np.ndarray
    """(N, R, M, 3, 3)."""
    known: np.ndarray
    """(N, R, M) which points have been seen since the start."""
    depth: np.ndarray
    """(N, R, M) [m] guess of the depth at first sight."""
    depth_sd: np.ndarray
    """(N,) [m] its standard deviation; 0 before the first reset."""
    motion: np.ndarray
    """(N, R, 14) motion, see `kernels.anchors`."""
    clock: np.ndarray
    """(N, 2) the clock."""
    sample: np.ndarray
    """(N,) int64 number of the last sample; -1 after a reset."""
    received: np.ndarray
    """(N, P) uint64, see `pose_filter.listen`."""


@kernel
def take_samples(
    period, odometry, image, seen, arrived, pairs, options, image_variance, use_unseen, filters, ring,
    pose, pose_covariance, rows,
):  # fmt: skip
    """Take all K samples of the environments `rows` in, in order, and refresh their poses.

    Args:
        period, odometry, image, seen, arrived: `samples.Samples`.
        pairs: (P, 2) ordered pairs (observer, observed).
        options: (9,) float64, in the order of `anchors.FilterOptions`.
        image_variance: [-] of a normalised image coordinate.
        use_unseen: whether remembered points take part in the pose update.
        filters, ring: Filters and `pose_filter.Ring`, changed in place.
        pose, pose_covariance: (N, P, 3), (N, P, 3, 3) poses at the last sample, written.
        rows: environments to work on.

    Returns:
        Whether all messages were of samples still in the ring; if not, nothing was done.
    """
    length = ring.clock.shape[1]
    beyond = ~(np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - length))
    for n in rows:
        for k in range(period.shape[1]):
            for p in range(pairs.shape[0]):
                if arrived[n, k, p] & beyond:
                    return False
    o, t, work, lane = an.filter_options(options), np.zeros(an.WORKSPACE * W), np.zeros((3, 3)), np.int64(0)
    for n in rows:
        for k in range(period.shape[1]):
            filters.sample[n] += 1
            filters.clock[n, 0] += period[n, k]
            filters.clock[n, 1] += 1.0 if period[n, k] > 0.0 else 0.0
            row = filters.sample[n] % length
            ring.clock[n, row, 0], ring.clock[n, row, 1] = filters.clock[n, 0], filters.clock[n, 1]
            for r in range(seen.shape[2]):
                _reckon(t, o, period[n, k], odometry[n, k, r], filters.motion[n, r], ring.motion[n, row, r])
                for i in range(seen.shape[3]):
                    _observe(
                        filters, o, n, r, i, period[n, k], odometry[n, k, r], image[n, k, r, i], seen[n, k, r, i],
                        image_variance, work,
                    )  # fmt: skip
                    state, covariance = filters.state[n, r, i], filters.covariance[n, r, i]
                    _to_plane(state, covariance, use_unseen or seen[n, k, r, i], ring.point[n, row, r, i])
            for p in range(pairs.shape[0]):
                filters.received[n, p] = pf.listen(
                    t, lane, ring, n, p, pairs[p, 0], pairs[p, 1], filters.sample[n], arrived[n, k, p],
                    filters.received[n, p], o,
                )  # fmt: skip
        _show(t, lane, o, filters, ring, pairs, pose, pose_covariance, n)
    return True


@kernel
def show(pairs, options, filters, ring, pose, pose_covariance, rows):
    """Write the poses of the environments `rows`; arguments as for `take_samples`."""
    o, t, lane = an.filter_options(options), np.zeros(an.WORKSPACE * W), np.int64(0)
    for n in rows:
        _show(t, lane, o, filters, ring, pairs, pose, pose_covariance, n)


@kernel
def _reckon(t, options, dt, odometry, motion, kept):
    """Carry the dead reckoning of a robot over one sample, and keep it in the ring."""
    t[ds.DT] = dt
    t[ds.V], t[ds.LATERAL], t[ds.YAW_RATE] = odometry[0], odometry[1], odometry[2]
    for i in range(an.MOTION):
        t[an.OWN + i * W] = motion[i]
    an.reckon(t, options.var_v, options.var_w, 1)
    for i in range(an.MOTION):
        motion[i] = kept[i] = t[an.OWN + i * W]


@kernel
def _observe(filters, options, n, r, i, dt, odometry, image, seen, image_variance, work):
    """Predict a point over one sample by the exact arc; correct it if it is seen."""
    state, covariance, known = filters.state[n, r, i], filters.covariance[n, r, i], filters.known[n, r, i : i + 1]
    v, lateral, w = float(odometry[0]), float(odometry[1]), float(odometry[2])
    if dt > 0.0:
        map_predict(state, covariance, known, v, lateral, w, dt, options.var_v, 0.0, options.var_w, work)
    if not seen:
        return
    x, y = float(image[0]), float(image[1])
    if known[0]:
        map_correct(state, covariance, 1, 0, x, y, w, image_variance, np.inf, np.inf, work)
    else:
        rho, rho_variance = depth_prior(x, filters.depth[n, r, i], filters.depth_sd[n])
        map_enter(state, covariance, known, 0, x, y, w, image_variance, rho, rho_variance)


@kernel
def _to_plane(state, covariance, wanted, point):
    """A point (beta, eta, rho) as q = u(beta)/rho in the plane of the body, with its covariance, first order.

    dq = J q dbeta - q/rho drho

    Args:
        state, covariance: (3,), (3, 3).
        wanted: whether it may be used for the pose, if it is known.
        point: (8,) written as `anchors.POINT` says, without heights.
    """
    beta, rho = state[0], state[2]
    if not (wanted and rho > LEAST_INVERSE_RANGE):
        for i in range(an.POINT):
            point[i] = 0.0
        return
    x, y = math.cos(beta) / rho, math.sin(beta) / rho
    bb, br, rr = covariance[0, 0], covariance[0, 2] / rho, covariance[2, 2] / (rho * rho)
    point[an.P_X // W], point[an.P_Y // W] = x, y
    point[an.P_XX // W] = y * y * bb + 2.0 * x * y * br + x * x * rr
    point[an.P_XY // W] = -x * y * bb + (y * y - x * x) * br + x * y * rr
    point[an.P_YY // W] = x * x * bb - 2.0 * x * y * br + y * y * rr
    point[an.USABLE // W] = 1.0


@kernel
def _show(t, lane, options, filters, ring, pairs, pose, pose_covariance, n):
    """Write the poses of an environment at its last sample."""
    for p in range(pairs.shape[0]):
        pf.present(t, lane, ring, n, p, pairs[p, 0], pairs[p, 1], filters.sample[n], filters.received[n, p], options)
        place = an.POSE + 3 * W
        for i in range(3):
            pose[n, p, i] = t[an.POSE + i * W]
            for j in range(i, 3):
                pose_covariance[n, p, i, j] = pose_covariance[n, p, j, i] = t[place]
                place += W
