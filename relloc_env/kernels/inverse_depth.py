"""A Kalman filter of inverse range for every point on its own, and the cascade's pose filter over them.

A point is (beta, eta, rho) as in `local_map`, whose kernels run here on maps of one point each: the noise of the
odometry, which moves all points of a robot at once, counts as if each point had its own. The pose filter takes points
in the plane of the body, with their covariance, as if each sample's were independent of the last one's.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from relloc_env.kernels import anchors as an
from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import pose_filter as pf
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.lanes import VECTOR, load_lane, scratch, store_lane
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
    """(N, R, ...) rows of `anchors.MOTION`."""
    clock: np.ndarray
    """[s, -] (N, 2) rows of `anchors.CLOCK`."""
    sample: np.ndarray
    """(N,) int64 number of the last sample; -1 after a reset."""
    received: np.ndarray
    """(N, P) uint64, see `pose_filter.listen`."""


class Setup(NamedTuple):
    """What stays as it is."""

    pairs: np.ndarray
    """(P, 2) ordered pairs (observer, observed)."""
    options: np.ndarray
    """(1,) `anchors.OPTIONS`."""
    image_variance: float
    """[-] of a normalised image coordinate."""
    use_unseen: bool
    """Whether remembered points take part in the pose update."""


_LANE: Any = np.int64(0)
"""The lane of the pose filters' records that is used here."""


@kernel
def take_samples(samples, setup, filters, ring, estimate, rows):
    """Take all K samples of the environments `rows` in, in order, and refresh their poses.

    Args:
        samples: `samples.Samples`.
        setup: Setup.
        filters, ring: Filters and `pose_filter.Ring`, changed in place.
        estimate: `samples.Estimate`, whose poses are written.
        rows: environments to work on.

    Returns:
        Whether all messages were of samples still in the ring; if not, nothing was done.
    """
    length, steps, pairs = ring.clock.shape[1], samples.period.shape[1], setup.pairs
    beyond = ~(np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - length))
    for n in rows:
        for k in range(steps):
            for p in range(pairs.shape[0]):
                if samples.arrived[n, k, p] & beyond:
                    return False
    o, work = an.filter_options(setup.options[0]), pf.work_of(VECTOR)
    interval, scratch_3 = scratch(1, ds.INTERVAL, VECTOR), np.zeros((3, 3))
    for n in rows:
        for k in range(steps):
            filters.sample[n] += 1
            dt, row = samples.period[n, k], filters.sample[n] % length
            filters.clock[n, 0] += dt
            filters.clock[n, 1] += 1.0 if dt > 0.0 else 0.0
            ring.clock[n, row] = filters.clock[n]
            for r in range(samples.seen.shape[2]):
                _reckon(work.own, interval[0], o, dt, samples.odometry[n, k, r], filters.motion[n, r])
                ring.motion[n, row, r] = filters.motion[n, r]
                for i in range(samples.seen.shape[3]):
                    _observe(samples, setup, filters, o, (n, k, r, i), scratch_3)
                    wanted = setup.use_unseen or samples.seen[n, k, r, i]
                    _to_plane(filters.state[n, r, i], filters.covariance[n, r, i], wanted, work.own_point[0])
                    store_lane(work.own_point, _LANE, ring.point[n, row, r, i])
            for p in range(pairs.shape[0]):
                at = pf.Place(n, p, pairs[p, 0], pairs[p, 1], _LANE)
                filters.received[n, p] = pf.listen(
                    work, ring, at, filters.sample[n], samples.arrived[n, k, p], filters.received[n, p], o
                )
        _show(work, setup, filters, ring, estimate, n)
    return True


@kernel
def show(setup, filters, ring, estimate, rows):
    """Write the poses of the environments `rows`; arguments as for `take_samples`."""
    work = pf.work_of(VECTOR)
    for n in rows:
        _show(work, setup, filters, ring, estimate, n)


@kernel
def _reckon(work, interval, options, dt, odometry, motion):
    """Carry the dead reckoning of a robot, a row of `anchors.MOTION`, over one sample."""
    interval.dt[_LANE], interval.v[_LANE] = dt, odometry[0]
    interval.lateral[_LANE], interval.yaw_rate[_LANE] = odometry[1], odometry[2]
    load_lane(work, _LANE, motion)
    an.reckon(work[0], interval, options.var_v, options.var_w, 1)
    store_lane(work, _LANE, motion)


@kernel
def _observe(samples, setup, filters, options, at, work):
    """Predict a point over one sample by the exact arc; correct it if it is seen.

    Args:
        samples, setup, filters: as of `take_samples`.
        options: FilterOptions.
        at: environment, sample, robot, point.
        work: (3, 3) scratch.
    """
    n, k, r, i = at
    state, covariance, known = filters.state[n, r, i], filters.covariance[n, r, i], filters.known[n, r, i : i + 1]
    odometry, dt = samples.odometry[n, k, r], samples.period[n, k]
    v, lateral, w = float(odometry[0]), float(odometry[1]), float(odometry[2])
    if dt > 0.0:
        map_predict(state, covariance, known, v, lateral, w, dt, options.var_v, 0.0, options.var_w, work)
    if not samples.seen[n, k, r, i]:
        return
    x, y, variance = float(samples.image[n, k, r, i, 0]), float(samples.image[n, k, r, i, 1]), setup.image_variance
    if known[0]:
        map_correct(state, covariance, 1, 0, x, y, w, variance, np.inf, np.inf, work)
    else:
        rho, rho_variance = depth_prior(x, filters.depth[n, r, i], filters.depth_sd[n])
        map_enter(state, covariance, known, 0, x, y, w, variance, rho, rho_variance)


@kernel
def _to_plane(state, covariance, wanted, point):
    """A point (beta, eta, rho) as q = u(beta)/rho in the plane of the body, with its covariance, first order.

    dq = J q dbeta - q/rho drho

    Args:
        state, covariance: (3,), (3, 3).
        wanted: whether it may be used for the pose, if it is known.
        point: `anchors.PLANE_POINT`, of which a lane is written.
    """
    beta, rho, i = state[0], state[2], _LANE
    point.x[i] = point.y[i] = point.xx[i] = point.xy[i] = point.yy[i] = point.usable[i] = 0.0
    if not (wanted and rho > LEAST_INVERSE_RANGE):
        return
    x, y = math.cos(beta) / rho, math.sin(beta) / rho
    bb, br, rr = covariance[0, 0], covariance[0, 2] / rho, covariance[2, 2] / (rho * rho)
    point.x[i], point.y[i] = x, y
    point.xx[i] = y * y * bb + 2.0 * x * y * br + x * x * rr
    point.xy[i] = -x * y * bb + (y * y - x * x) * br + x * y * rr
    point.yy[i] = x * x * bb - 2.0 * x * y * br + y * y * rr
    point.usable[i] = 1.0


@kernel
def _show(work, setup, filters, ring, estimate, n):
    """Write the poses of an environment at its last sample."""
    o = an.filter_options(setup.options[0])
    for p in range(setup.pairs.shape[0]):
        at = pf.Place(n, p, setup.pairs[p, 0], setup.pairs[p, 1], _LANE)
        pf.present(work, ring, at, filters.sample[n], filters.received[n, p], o)
        pf.show_pose(work.pose[0], _LANE, estimate, n, p)
