"""The cascade over a batch: depth observers of every robot and point, then the pose filter of every ordered pair."""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import pose_filter as pf
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.depth_covariance import body_to_polar
from relloc_env.kernels.motion import arc

OK, ROW_OUT_OF_RANGE, MESSAGE_TOO_OLD = 0, 1, 2


class State(NamedTuple):
    """All that the cascade remembers of N environments."""

    sample: np.ndarray
    """(N,) int64 number of the last sample; -1 before the first."""
    depth: np.ndarray
    """(N, R, M, depth_state.SIZE) depth observers."""
    settings: np.ndarray
    """(N, R, 12) settings of the depth observers; the first two columns are the gains."""
    guess: np.ndarray
    """[m] (N, R, M) depth guesses."""
    ring: pf.Ring
    """Pose filter."""


@kernel
def reset(depth_guess, pose_guess, depth_sd, pose_sd, pairs, state, estimate, rows):
    """Start the environments `rows` of `state` from a prior (see `samples.Prior`)."""
    for e in rows:
        if e < 0 or e >= state.sample.shape[0]:
            return ROW_OUT_OF_RANGE
    for e in rows:
        state.sample[e] = -1
        state.depth[e] = 0.0
        state.settings[e, :, 7] = depth_sd
        state.guess[e] = depth_guess[e]
        pf.start(e, pose_guess, pose_sd, state.ring)
        show(e, pairs, pf.FilterOptions(0, False, 0.0, False, 0.0, 0.0, 0.0), state, estimate)
    return OK


@kernel
def update(samples, pairs, options, use_unseen, state, estimate, rows):
    """Take all K samples of the environments `rows` in, in order, and refresh the estimate.

    Args:
        samples: `samples.Samples`.
        pairs: (P, 2) ordered pairs (observer, observed).
        options: `pose_filter.FilterOptions`.
        use_unseen: whether remembered points take part in the pose update.
        state: `State`, changed in place.
        estimate: `samples.Estimate`, refreshed in place.
        rows: environments to work on.

    Returns:
        OK, or ROW_OUT_OF_RANGE (then nothing was done), or MESSAGE_TOO_OLD (such messages were left out).
    """
    ring = state.ring
    length, robots, points = ring.motion.shape[1], ring.motion.shape[2], state.depth.shape[2]
    status = OK
    for e in rows:
        if e < 0 or e >= state.sample.shape[0]:
            return ROW_OUT_OF_RANGE
    beyond = ~(np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - length))
    for e in rows:
        for k in range(samples.period.shape[1]):
            sample = state.sample[e] + 1
            state.sample[e] = sample
            before, now = (sample + length - 1) % length, sample % length
            dt = samples.period[e, k]
            ring.clock[e, now, 0] = ring.clock[e, before, 0] + dt
            ring.clock[e, now, 1] = ring.clock[e, before, 1] + (1.0 if dt > 0.0 else 0.0)
            for i in range(robots):
                v = float(samples.odometry[e, k, i, 0])
                lateral = float(samples.odometry[e, k, i, 1])
                w = float(samples.odometry[e, k, i, 2])
                c_x, c_y, delta = arc(v, lateral, w, dt)
                cos, sin = math.cos(delta), math.sin(delta)
                pf.move(
                    ring.motion[e, before, i], ring.motion[e, now, i],
                    v, lateral, w, dt, c_x, c_y, delta, cos, sin, options,
                )  # fmt: skip
                for m in range(points):
                    row, seen = state.depth[e, i, m], samples.seen[e, k, i, m]
                    ds.observe_point(
                        row, state.settings[e, i], seen,
                        float(samples.image[e, k, i, m, 0]), float(samples.image[e, k, i, m, 1]), state.guess[e, i, m],
                        v, lateral, w, dt, c_x, c_y, cos, sin, True,
                    )  # fmt: skip
                    point = ring.point[e, now, i, m]
                    point[0], point[1] = row[ds.Q_X], row[ds.Q_Y]
                    c = ds.COVARIANCE
                    point[2], point[3], point[4] = row[c], row[c + 1], row[c + 3]
                    ring.usable[e, now, i, m] = row[ds.KNOWN] != 0.0 and (seen or use_unseen)
            for p in range(pairs.shape[0]):
                arrived = samples.arrived[e, k, p]
                if arrived & beyond:
                    status = MESSAGE_TOO_OLD
                pf.listen(e, p, pairs[p, 0], pairs[p, 1], sample, arrived, options, ring)
        show(e, pairs, options, state, estimate)
    return status


@kernel
def refresh(pairs, options, state, estimate, rows):
    """Write the estimate of the environments `rows` anew from `state`."""
    for e in rows:
        if e < 0 or e >= state.sample.shape[0]:
            return ROW_OUT_OF_RANGE
    for e in rows:
        show(e, pairs, options, state, estimate)
    return OK


@kernel
def put_symmetric(matrix, c):
    """Write the upper triangle `c`, six numbers by rows, into a 3 by 3 matrix."""
    matrix[0, 0], matrix[0, 1], matrix[0, 2] = c[0], c[1], c[2]
    matrix[1, 0], matrix[1, 1], matrix[1, 2] = c[1], c[3], c[4]
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = c[2], c[4], c[5]


@kernel
def show(e, pairs, options, state, estimate):
    """Write the estimate of environment `e`: points in polar form, poses predicted to the last sample."""
    for i in range(state.depth.shape[1]):
        for m in range(state.depth.shape[2]):
            row, point = state.depth[e, i, m], estimate.points[e, i, m]
            known = row[ds.KNOWN] != 0.0
            estimate.known[e, i, m] = known
            if known:
                q_x, q_y, height = row[ds.Q_X], row[ds.Q_Y], row[ds.HEIGHT]
                rho = 1.0 / math.sqrt(q_x * q_x + q_y * q_y)
                point[0], point[1], point[2] = math.atan2(q_y, q_x), height * rho, rho
                c = body_to_polar(q_x, q_y, height, ds.six(row, ds.COVARIANCE))
                put_symmetric(estimate.points_covariance[e, i, m], c)
            else:
                point[:] = 0.0
                estimate.points_covariance[e, i, m] = 0.0
    for p in range(pairs.shape[0]):
        r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt = pf.present(
            e, p, pairs[p, 0], pairs[p, 1], state.sample[e], options, state.ring
        )
        pose = estimate.pose[e, p]
        pose[0], pose[1], pose[2] = r_x, r_y, theta
        put_symmetric(estimate.pose_covariance[e, p], (pxx, pxy, pxt, pyy, pyt, ptt))
