"""The cascade over a batch: depth observers of every robot and point, then the pose filter of every ordered pair."""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import anchors as an
from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import pose_filter as pf
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.depth_covariance import body_to_polar
from relloc_env.kernels.motion import arc

DEPTH_SD = ds.Settings._fields.index("depth_sd")
"""Column of `settings`."""

OK, ROW_OUT_OF_RANGE, MESSAGE_TOO_OLD, NOT_RESET = 0, 1, 2, 3


class State(NamedTuple):
    """All that the cascade remembers of N environments; tables have one row per element of the leading axes."""

    sample: np.ndarray
    """(N,) int64 number of the last sample; -1 after a reset, -2 before it."""
    depth: np.ndarray
    """(N R M, depth_state.SIZE) depth observers."""
    settings: np.ndarray
    """(N R, 12) `depth_state.Settings`; the first two columns are the gains."""
    guess: np.ndarray
    """[m] (N R M,) depth guesses."""
    motion: np.ndarray
    """This and the following: `anchors.Tables`."""
    clock: np.ndarray
    point: np.ndarray
    usable: np.ndarray
    anchor: np.ndarray
    received: np.ndarray


@kernel
def in_range(rows, num_envs):
    """Whether all `rows` are environments."""
    return rows.size == 0 or (rows.min() >= 0 and rows.max() < num_envs)


@kernel
def reset(
    depth_guess, pose_guess, depth_sd, pose_sd,
    sizes, sample, depth, settings, guess, motion, clock, point, usable, anchor, received, rows,
):  # fmt: skip
    """Start the environments `rows` from a prior.

    Args:
        depth_guess, pose_guess, depth_sd, pose_sd: of `samples.Prior`.
        sizes: (4,) int64, in the order of `anchors.Sizes`.
        sample, depth, settings, guess, motion, clock, point, usable, anchor, received: `State`, changed in place.
        rows: environments to work on.

    Returns:
        OK, or ROW_OUT_OF_RANGE (then nothing was done).
    """
    if not in_range(rows, sample.shape[0]):
        return ROW_OUT_OF_RANGE
    length, robots, points, pairs = sizes
    shape = an.Sizes(length, robots, points, pairs)
    for e in rows:
        sample[e] = -1
        for i in range(robots):
            r = e * robots + i
            settings[r, DEPTH_SD] = depth_sd
            for m in range(points):
                depth[r * points + m] = 0.0
                guess[r * points + m] = depth_guess[e, i, m]
        an.start(e, pose_guess, pose_sd, shape, an.Tables(motion, clock, point, usable, anchor, received))
    return OK


@kernel
def update(
    period, odometry, image, seen, arrived, pairs, options, use_unseen,
    sizes, sample, depth, settings, guess, motion, clock, point, usable, anchor, received,
    e_points, e_points_covariance, e_known, e_pose, e_pose_covariance, rows,
):  # fmt: skip
    """Take all K samples of the environments `rows` in, in order, and refresh the estimate.

    Args:
        period, odometry, image, seen, arrived: `samples.Samples`.
        pairs: (P, 2) ordered pairs (observer, observed).
        options: (9,) float64, in the order of `anchors.FilterOptions`.
        use_unseen: whether remembered points take part in the pose update.
        sizes: (4,) int64, in the order of `anchors.Sizes`; P is at most 64.
        sample, depth, settings, guess, motion, clock, point, usable, anchor, received: `State`, changed in place.
        e_points, e_points_covariance, e_known, e_pose, e_pose_covariance: `samples.Estimate`, refreshed in place.
        rows: environments to work on, each once.

    Returns:
        OK; ROW_OUT_OF_RANGE or NOT_RESET (then nothing was done); or MESSAGE_TOO_OLD (such messages were left out).
    """
    if not in_range(rows, sample.shape[0]):
        return ROW_OUT_OF_RANGE
    for e in rows:
        if sample[e] < -1:
            return NOT_RESET
    shape, options = an.Sizes(sizes[0], sizes[1], sizes[2], sizes[3]), an.filter_options(options)
    length, per_env = shape.length, shape.pairs
    status = OK
    beyond = ~(np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - length))
    # the updates of one pair wait for each other, those of a block of environments do not: keep them together
    block = max(1, min(8, 64 // max(1, per_env)))
    for begin in range(0, rows.shape[0], block):
        end = min(begin + block, rows.shape[0])
        for k in range(period.shape[1]):
            waiting = np.uint64(0)
            for n in range(begin, end):
                e = rows[n]
                now = sample[e] + 1
                sample[e] = now
                at = e * length + now % length
                before = at - 1 if now % length > 0 else at + length - 1
                dt = period[e, k]
                clock[at, 0] = clock[before, 0] + dt
                clock[at, 1] = clock[before, 1] + (1.0 if dt > 0.0 else 0.0)
                for i in range(shape.robots):
                    sense(
                        e, k, i, before, at, dt, options, use_unseen, shape,
                        odometry, image, seen, depth, settings, guess, motion, point, usable,
                    )  # fmt: skip
                for p in range(per_env):
                    ages = arrived[e, k, p]
                    if ages & beyond:
                        status = MESSAGE_TOO_OLD
                    if pf.listen(
                        e, p, pairs[p, 0], pairs[p, 1], now, ages, options, shape,
                        motion, clock, point, usable, anchor, received,
                    ):  # fmt: skip
                        waiting |= np.uint64(1) << np.uint64((n - begin) * per_env + p)
            for m in range(shape.points):
                for n in range(begin, end):
                    e = rows[n]
                    row = sample[e] % length
                    for p in range(per_env):
                        if (waiting >> np.uint64((n - begin) * per_env + p)) & np.uint64(1):
                            pf.take_point(
                                e, pairs[p, 0], pairs[p, 1], m, an.first_anchor(e, p, shape) + row, row,
                                options, shape, motion, point, usable, anchor,
                            )  # fmt: skip
        for n in range(begin, end):
            show_environment(
                rows[n], pairs, options, shape, e_points, e_points_covariance, e_known, e_pose, e_pose_covariance,
                sample[rows[n]], depth, motion, clock, anchor, received,
            )  # fmt: skip
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
        sizes: `anchors.Sizes`.
        odometry, image, seen: of `samples.Samples`.
        depth, settings, guess: of `State`.
        motion, point, usable: of `anchors.Tables`.
    """
    robots, points = sizes.robots, sizes.points
    v, lateral, w = float(odometry[e, k, i, 0]), float(odometry[e, k, i, 1]), float(odometry[e, k, i, 2])
    c_x, c_y, delta = arc(v, lateral, w, dt)
    cos, sin = math.cos(delta), math.sin(delta)
    robot, place = e * robots + i, now * robots + i
    an.move(motion, before * robots + i, place, v, lateral, w, dt, c_x, c_y, delta, cos, sin, options)
    for m in range(points):
        j, to, sees = robot * points + m, place * points + m, seen[e, k, i, m]
        x, y = float(image[e, k, i, m, 0]), float(image[e, k, i, m, 1])
        ds.observe_point(depth, j, settings, robot, sees, x, y, guess[j], v, lateral, w, dt, c_x, c_y, cos, sin, True)
        point[to, 0], point[to, 1] = depth[j, ds.Q_X], depth[j, ds.Q_Y]
        point[to, 2], point[to, 3] = depth[j, ds.COVARIANCE], depth[j, ds.COVARIANCE + 1]
        point[to, 4] = depth[j, ds.COVARIANCE + 3]
        usable[to] = depth[j, ds.KNOWN] != 0.0 and (sees or use_unseen)


@kernel
def show(
    points, points_covariance, known, pose, pose_covariance, pairs, options,
    sizes, sample, depth, motion, clock, anchor, received, rows,
):  # fmt: skip
    """Write the estimate of the environments `rows`, see `show_environment`.

    Args:
        points, points_covariance, known, pose, pose_covariance: `samples.Estimate`, written.
        pairs, options, sizes: as for `update`.
        sample, depth, motion, clock, anchor, received: of `State`.
        rows: environments to work on, in range.
    """
    shape, options = an.Sizes(sizes[0], sizes[1], sizes[2], sizes[3]), an.filter_options(options)
    for e in rows:
        show_environment(
            e, pairs, options, shape, points, points_covariance, known, pose, pose_covariance,
            sample[e], depth, motion, clock, anchor, received,
        )  # fmt: skip


@kernel
def show_environment(
    e, pairs, options, shape, points, points_covariance, known, pose, pose_covariance,
    now, depth, motion, clock, anchor, received,
):  # fmt: skip
    """Write the estimate of environment `e`: points in polar form, poses predicted to its last sample `now`."""
    for i in range(shape.robots):
        for m in range(shape.points):
            show_point(e, i, m, (e * shape.robots + i) * shape.points + m, depth, points, points_covariance, known)
    c = pose_covariance
    for p in range(shape.pairs):
        r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt = pf.present(
            e, p, pairs[p, 0], pairs[p, 1], now, options, shape, motion, clock, anchor, received
        )
        pose[e, p, 0], pose[e, p, 1], pose[e, p, 2] = r_x, r_y, theta
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
