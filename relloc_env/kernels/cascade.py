"""The cascade over a batch: depth observers of every robot and point, then the pose filter of every ordered pair."""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import pose_filter as pf
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.depth_covariance import body_to_polar
from relloc_env.kernels.motion import arc

DEPTH_SD = 7
"""Column of `settings`."""

OK, ROW_OUT_OF_RANGE, MESSAGE_TOO_OLD = 0, 1, 2


class State(NamedTuple):
    """All that the cascade remembers of N environments; tables have one row per element of the leading axes."""

    sample: np.ndarray
    """(N,) int64 number of the last sample; -1 before the first."""
    depth: np.ndarray
    """(N R M, depth_state.SIZE) depth observers."""
    settings: np.ndarray
    """(N R, 12) `depth_state.Settings`; the first two columns are the gains."""
    guess: np.ndarray
    """[m] (N R M,) depth guesses."""
    sizes: pf.Sizes
    filter: pf.Tables
    """Pose filter."""


@kernel
def reset(depth_guess, pose_guess, depth_sd, pose_sd, pairs, options, state, estimate, rows):
    """Start the environments `rows` of `state` from a prior (see `samples.Prior`)."""
    robots, points = state.sizes.robots, state.sizes.points
    for e in rows:
        if e < 0 or e >= state.sample.shape[0]:
            return ROW_OUT_OF_RANGE
    for e in rows:
        state.sample[e] = -1
        for i in range(robots):
            r = e * robots + i
            state.settings[r, DEPTH_SD] = depth_sd
            for m in range(points):
                state.depth[r * points + m] = 0.0
                state.guess[r * points + m] = depth_guess[e, i, m]
        pf.start(e, pose_guess, pose_sd, state.sizes, state.filter)
        show(e, pairs, options, state, estimate)
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
    sizes, depth, settings, guess = state.sizes, state.depth, state.settings, state.guess
    motion, clock, point, usable, anchor, received = state.filter
    period, odometry, image, seen, arrived = samples
    length = sizes.length
    for e in rows:
        if e < 0 or e >= state.sample.shape[0]:
            return ROW_OUT_OF_RANGE
    status = OK
    beyond = ~(np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - length))
    for e in rows:
        for k in range(period.shape[1]):
            sample = state.sample[e] + 1
            state.sample[e] = sample
            row = sample % length
            now = e * length + row
            before = now - 1 if row > 0 else now + length - 1
            dt = period[e, k]
            clock[now, 0] = clock[before, 0] + dt
            clock[now, 1] = clock[before, 1] + (1.0 if dt > 0.0 else 0.0)
            for i in range(sizes.robots):
                sense(
                    e, k, i, before, now, dt, options, use_unseen, sizes,
                    odometry, image, seen, depth, settings, guess, motion, point, usable,
                )  # fmt: skip
            for p in range(sizes.pairs):
                ages = arrived[e, k, p]
                if ages & beyond:
                    status = MESSAGE_TOO_OLD
                pf.listen(
                    e, p, pairs[p, 0], pairs[p, 1], sample, ages, options, sizes,
                    motion, clock, point, usable, anchor, received,
                )  # fmt: skip
        show(e, pairs, options, state, estimate)
    return status


@kernel
def sense(
    e, k, i, before, now, dt, options, use_unseen, sizes,
    odometry, image, seen, depth, settings, guess, motion, point, usable,
):  # fmt: skip
    """Dead reckoning and depth observers of one robot over one sample, and what its message holds.

    Args:
        e, k, i: environment, which of the K samples, robot.
        before, now: rows of `clock` of the sample before and of this one.
        dt: [s] length of the interval between them.
        options, use_unseen: as for `update`.
        sizes: `pose_filter.Sizes`.
        odometry, image, seen: of `samples.Samples`.
        depth, settings, guess: of `State`.
        motion, point, usable: of `pose_filter.Tables`.
    """
    robots, points = sizes.robots, sizes.points
    v, lateral, w = float(odometry[e, k, i, 0]), float(odometry[e, k, i, 1]), float(odometry[e, k, i, 2])
    c_x, c_y, delta = arc(v, lateral, w, dt)
    cos, sin = math.cos(delta), math.sin(delta)
    robot, place = e * robots + i, now * robots + i
    pf.move(motion, before * robots + i, place, v, lateral, w, dt, c_x, c_y, delta, cos, sin, options)
    for m in range(points):
        j, to, sees = robot * points + m, place * points + m, seen[e, k, i, m]
        x, y = float(image[e, k, i, m, 0]), float(image[e, k, i, m, 1])
        ds.observe_point(depth, j, settings, robot, sees, x, y, guess[j], v, lateral, w, dt, c_x, c_y, cos, sin, True)
        point[to, 0], point[to, 1] = depth[j, ds.Q_X], depth[j, ds.Q_Y]
        point[to, 2], point[to, 3] = depth[j, ds.COVARIANCE], depth[j, ds.COVARIANCE + 1]
        point[to, 4] = depth[j, ds.COVARIANCE + 3]
        usable[to] = depth[j, ds.KNOWN] != 0.0 and (sees or use_unseen)


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
def show(e, pairs, options, state, estimate):
    """Write the estimate of environment `e`: points in polar form, poses predicted to the last sample."""
    sizes, depth = state.sizes, state.depth
    points, points_covariance, known, pose, pose_covariance = estimate
    for i in range(sizes.robots):
        for m in range(sizes.points):
            show_point(e, i, m, (e * sizes.robots + i) * sizes.points + m, depth, points, points_covariance, known)
    motion, clock, _, _, anchor, received = state.filter
    for p in range(sizes.pairs):
        r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt = pf.present(
            e, p, pairs[p, 0], pairs[p, 1], state.sample[e], options, sizes, motion, clock, anchor, received
        )
        pose[e, p, 0], pose[e, p, 1], pose[e, p, 2] = r_x, r_y, theta
        c = pose_covariance
        c[e, p, 0, 0], c[e, p, 0, 1], c[e, p, 0, 2] = pxx, pxy, pxt
        c[e, p, 1, 0], c[e, p, 1, 1], c[e, p, 1, 2] = pxy, pyy, pyt
        c[e, p, 2, 0], c[e, p, 2, 1], c[e, p, 2, 2] = pxt, pyt, ptt


@kernel
def show_point(e, i, m, j, depth, points, points_covariance, known):
    """Write the estimate of point `m` of robot `i` of environment `e`, row `j` of `depth`."""
    beta, eta, rho = 0.0, 0.0, 0.0
    xx, xy, xt, yy, yt, tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    known[e, i, m] = depth[j, ds.KNOWN] != 0.0
    if known[e, i, m]:
        q_x, q_y, height = depth[j, ds.Q_X], depth[j, ds.Q_Y], depth[j, ds.HEIGHT]
        rho = 1.0 / math.sqrt(q_x * q_x + q_y * q_y)
        beta, eta = math.atan2(q_y, q_x), height * rho
        xx, xy, xt, yy, yt, tt = body_to_polar(q_x, q_y, height, ds.six(depth, j, ds.COVARIANCE))
    points[e, i, m, 0], points[e, i, m, 1], points[e, i, m, 2] = beta, eta, rho
    c = points_covariance
    c[e, i, m, 0, 0], c[e, i, m, 0, 1], c[e, i, m, 0, 2] = xx, xy, xt
    c[e, i, m, 1, 0], c[e, i, m, 1, 1], c[e, i, m, 1, 2] = xy, yy, yt
    c[e, i, m, 2, 0], c[e, i, m, 2, 1], c[e, i, m, 2, 2] = xt, yt, tt
