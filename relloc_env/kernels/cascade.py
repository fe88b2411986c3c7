"""The cascade over a batch: depth observers of every robot and point, then the pose filter of every ordered pair.

The state of `W` environments is a block of records (`kernels.lanes`). A sample of a whole block is worked on in place.
Where only some environments of a block take a sample, a copy is worked on, and their lanes are copied back.
"""

from typing import NamedTuple

import numpy as np
from numba.experimental import structref

from relloc_env.kernels import anchors as an
from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import pose_filter as pf
from relloc_env.kernels._compile import kernel
from relloc_env.kernels._handle import Handle, HandleType, define
from relloc_env.kernels.depth_covariance import body_to_polar
from relloc_env.kernels.elementary import atan2
from relloc_env.kernels.lanes import W, clear_lane, keep_lanes, natural, record, scratch, store_lane

OK, ROW_OUT_OF_RANGE, MESSAGE_TOO_OLD, NOT_RESET = 0, 1, 2, 3
POLAR = record(known=1, beta=1, eta=1, rho=1, covariance=6)
"""[-, rad, -, 1/m] whether a point is known; bearing, elevation, inverse range; their covariance."""


class State(NamedTuple):
    """What is remembered: B blocks of N environments, R robots, M points, P ordered pairs."""

    guess: np.ndarray
    """[m] (B, R, M, W) depth guesses."""
    depth_sd: np.ndarray
    """[m] (B, W) their standard deviation."""
    clock: np.ndarray
    """(B,) `anchors.CLOCK`."""
    motion: np.ndarray
    """(B, R) `anchors.MOTION`."""
    point: np.ndarray
    """(B, R, M) `depth_state.POINT`."""
    anchor: np.ndarray
    """(B, P) `anchors.ANCHOR`; (B, 0) where there is a ring."""
    sample: np.ndarray
    """(N,) number of the last sample; -1 after a reset, -2 before it."""
    received: np.ndarray
    """(N, P) uint64, see `pose_filter.listen`."""


class Setup(NamedTuple):
    """What stays as it is, gains apart."""

    pairs: np.ndarray
    """(P, 2) ordered pairs (observer, observed)."""
    options: np.ndarray
    """(1,) `anchors.OPTIONS`."""
    settings: np.ndarray
    """(R,) `depth_state.SETTINGS`."""
    gains: np.ndarray
    """[1/s, 1/m²] (N, R, M, 2) H and alpha Lambda of each observer."""
    use_unseen: bool
    """Whether remembered points take part in the pose update."""
    width: int
    """Lanes to work on."""


class Work(NamedTuple):
    """What the samples of a block are worked on with, beside its state."""

    robot: np.ndarray
    """(1,) `depth_state.WORK`."""
    motion: np.ndarray
    """(1,) copy of a motion, where it is not changed in place."""
    point: np.ndarray
    """(1,) copy of a point."""
    planes: np.ndarray
    """(R, M) `anchors.PLANE_POINT` at this sample."""
    polar: np.ndarray
    """(1,) `POLAR`."""
    filter: pf.Work


class Part(NamedTuple):
    """A part of the rows, all of one block."""

    block: int
    rows: np.ndarray
    """The environments."""
    whole: bool
    """Whether these are all of the block."""


@kernel
def _in_range(rows, num_envs):
    """Whether all `rows` are environments."""
    beyond = 0
    for n in rows:
        beyond += n < 0 or n >= num_envs
    return beyond == 0


@kernel
def reset(prior, depth_sd, state, ring, rows):
    """Start the environments `rows` from a prior.

    Args:
        prior: (depth, pose, pose_sd) of `samples.Prior`.
        depth_sd: [m] of it.
        state: State.
        ring: `pose_filter.Ring`, or None where messages come at once or never.
        rows: environments to work on.

    Returns:
        OK, or ROW_OUT_OF_RANGE (then nothing was done).
    """
    depth, pose, pose_sd = prior
    robots, points, pairs = depth.shape[1], depth.shape[2], pose.shape[1]
    if not _in_range(rows, state.sample.shape[0]):
        return ROW_OUT_OF_RANGE
    for e in rows:
        state.sample[e] = -1
        b, lane = e // W, e % W
        clear_lane(state.clock[b : b + 1], lane)
        clear_lane(state.motion[b], lane)
        clear_lane(state.point[b], lane)
        clear_lane(state.anchor[b], lane)
        state.depth_sd[b, lane] = depth_sd
        for r in range(robots):
            state.motion[b, r].at.cos[lane] = 1.0
            for m in range(points):
                state.guess[b, r, m, lane] = depth[e, r, m]
        for p in range(pairs):
            state.received[e, p] = 0
            if ring is None:
                pf.start(state.anchor[b, p], lane, pose[e, p], pose_sd)
    if ring is not None:
        pf.start_rings(ring, pose, pose_sd, rows)
    return OK


@structref.register
class CascadeType(HandleType):
    """numba's type of a `Cascade`."""


class Cascade(Handle):
    """State, Setup, `samples.Estimate`, which is refreshed in place, and `samples.Samples`."""


define(Cascade, CascadeType, "state", "setup", "estimate", "samples")


@kernel
def hold(state, setup, estimate, samples):
    """A `Cascade`."""
    return Cascade(state, setup, estimate, samples)


@kernel
def update(cascade, ring, rows):
    """Take all K samples of the environments `rows` in, in order, and refresh the estimate.

    Args:
        cascade: Cascade.
        ring: as for `reset`.
        rows: environments to work on, each once; quickest in ascending order.

    Returns:
        OK; ROW_OUT_OF_RANGE or NOT_RESET (then nothing was done); or MESSAGE_TOO_OLD (such messages were left out).
    """
    state, setup, estimate, samples = cascade.state, cascade.setup, cascade.estimate, cascade.samples
    num_envs = state.sample.shape[0]
    if not _in_range(rows, num_envs):
        return ROW_OUT_OF_RANGE
    for e in rows:
        if state.sample[e] < -1:
            return NOT_RESET
    status, work = OK, _work(setup)
    options = an.filter_options(setup.options[0])
    begin = np.int64(0)  # else numba would compile for the number 0, and again for any
    while begin < rows.shape[0]:
        block, end = rows[begin] // W, begin + 1
        while end < rows.shape[0] and rows[end] // W == block:
            end += 1
        whole = end - begin == min(W, num_envs - block * W)
        part = Part(natural(block), rows[begin:end], whole)
        for k in range(samples.period.shape[1]):
            _tick(samples, k, state, work, part)
            for r in range(setup.settings.shape[0]):
                _sense(samples, k, r, state, setup, work, part)
            if ring is None:
                for p in range(setup.pairs.shape[0]):
                    if _listen(samples, k, p, state, setup, work, options, part):
                        status = MESSAGE_TOO_OLD
            elif _listen_ring(samples, k, state, setup, ring, work, options, part):
                status = MESSAGE_TOO_OLD
        _show_points(state, setup, work, estimate, part)
        if ring is None:
            _show_poses(state, setup, work, options, estimate, part)
        else:
            _show_ring(state, setup, ring, work, options, estimate, part)
        begin = end
    return status


@kernel
def show(state, setup, ring, estimate, rows):
    """Write the estimate of the environments `rows` (in range); arguments as for `update`."""
    work, options = _work(setup), an.filter_options(setup.options[0])
    for j in range(rows.shape[0]):
        part = Part(natural(rows[j] // W), rows[j : j + 1], False)
        _show_points(state, setup, work, estimate, part)
        if ring is None:
            _show_poses(state, setup, work, options, estimate, part)
        else:
            _show_ring(state, setup, ring, work, options, estimate, part)


@kernel
def _work(setup):
    """A `Work`."""
    robots, points = setup.gains.shape[1], setup.gains.shape[2]
    return Work(
        scratch(1, ds.WORK, setup.width), np.empty(1, an.MOTION), np.empty(1, ds.POINT),
        np.empty((robots, points), an.PLANE_POINT), np.empty(1, POLAR), pf.work_of(setup.width),
    )  # fmt: skip


@kernel
def _tick(samples, k, state, work, part):
    """Carry the clocks to sample k."""
    robot, clock, depth_sd = work.robot[0], state.clock[part.block], state.depth_sd[part.block]
    for j in range(part.rows.shape[0]):
        e = natural(part.rows[j])
        i = e % W
        state.sample[e] += 1
        dt = samples.period[e, k]
        robot.interval.dt[i], robot.measured.depth_sd[i] = dt, depth_sd[i]
        clock.time[i] += dt
        clock.steps[i] += 1.0 if dt > 0.0 else 0.0


@kernel
def _sense(samples, k, r, state, setup, work, part):
    """Dead reckoning and depth observers of one robot over one sample."""
    b, robot, options, width = part.block, work.robot[0], setup.options[0], setup.width
    interval, measured = robot.interval, robot.measured
    for j in range(part.rows.shape[0]):
        e = natural(part.rows[j])
        i = e % W
        interval.v[i], interval.lateral[i] = samples.odometry[e, k, r, 0], samples.odometry[e, k, r, 1]
        interval.yaw_rate[i] = samples.odometry[e, k, r, 2]
    if part.whole:
        an.reckon(state.motion[b, r], interval, options.var_v, options.var_w, width)
    else:
        work.motion[0] = state.motion[b, r]
        an.reckon(work.motion[0], interval, options.var_v, options.var_w, width)
        keep_lanes(work.motion, state.motion[b, r : r + 1], part.rows)
    for m in range(setup.gains.shape[2]):
        for j in range(part.rows.shape[0]):
            e = natural(part.rows[j])
            i = e % W
            measured.seen[i] = 1.0 if samples.seen[e, k, r, m] else 0.0
            measured.x[i], measured.y[i] = samples.image[e, k, r, m, 0], samples.image[e, k, r, m, 1]
            measured.guess[i] = state.guess[b, r, m, i]
            measured.gain_h[i], measured.gain_alpha[i] = setup.gains[e, r, m, 0], setup.gains[e, r, m, 1]
        if part.whole:
            ds.observe(state.point[b, r, m], robot, setup.settings[r], width)
            _flatten(state.point[b, r, m], measured, work.planes[r, m], setup.use_unseen, width)
        else:
            work.point[0] = state.point[b, r, m]
            ds.observe(work.point[0], robot, setup.settings[r], width)
            _flatten(work.point[0], measured, work.planes[r, m], setup.use_unseen, width)
            keep_lanes(work.point, state.point[b, r, m : m + 1], part.rows)


@kernel
def _flatten(point, measured, plane, use_unseen, width):
    """The point in the plane of the robot's body, as the pose filter takes it."""
    for i in range(width):
        plane.x[i], plane.y[i] = point.q_x[i], point.q_y[i]
        plane.xx[i], plane.xy[i] = point.covariance[0, i], point.covariance[1, i]
        plane.yy[i] = point.covariance[3, i]
        plane.usable[i] = 1.0 if (point.known[i] != 0.0) & ((measured.seen[i] != 0.0) | use_unseen) else 0.0


@kernel
def _listen(samples, k, p, state, setup, work, options, part):
    """One sample of the pose filter of a pair whose messages come at once or never.

    Returns:
        Whether a message was older.
    """
    b, first, second, width = part.block, setup.pairs[p, 0], setup.pairs[p, 1], setup.width
    everyone, late, update = True, False, work.filter.update[0]
    for j in range(part.rows.shape[0]):
        e = natural(part.rows[j])
        arrived = samples.arrived[e, k, p]
        heard = arrived & np.uint64(1)
        late |= arrived > np.uint64(1)
        state.received[e, p] = heard
        update.heard[e % W] = 1.0 if heard else 0.0
        everyone &= heard != 0
    own, other, clock = state.motion[b, first], state.motion[b, second], state.clock[b]
    if not part.whole:
        work.filter.anchor[0] = state.anchor[b, p]
    anchor = state.anchor[b, p] if part.whole else work.filter.anchor[0]
    if everyone:
        pf.move_anchors(anchor, own, other, clock, options, width)
    else:
        for n in part.rows:
            pf.move_heard(anchor, update, own, other, clock, n % W, options)
    for m in range(setup.gains.shape[2]):
        pf.take_points(anchor, update, own, other, work.planes[first, m], work.planes[second, m], options, width)
    if not part.whole:
        keep_lanes(work.filter.anchor, state.anchor[b, p : p + 1], part.rows)
    return late


@kernel
def _listen_ring(samples, k, state, setup, ring, work, options, part):
    """One sample of the pose filters of all pairs whose messages may be late.

    Returns:
        Whether a message was older than the ring.
    """
    length, late = ring.clock.shape[1], False
    beyond = ~(np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - length))
    for n in part.rows:
        e = natural(n)
        _remember(state, ring, work, part.block, e)
        for p in range(setup.pairs.shape[0]):
            late |= (samples.arrived[e, k, p] & beyond) != 0
            at = pf.Place(e, p, setup.pairs[p, 0], setup.pairs[p, 1], e % W)
            state.received[e, p] = pf.listen(
                work.filter, ring, at, state.sample[e], samples.arrived[e, k, p], state.received[e, p], options
            )
    return late


@kernel
def _remember(state, ring, work, b, e):
    """Put the present sample of environment e into the ring."""
    lane, row = e % W, state.sample[e] % ring.clock.shape[1]
    store_lane(state.clock[b : b + 1], lane, ring.clock[e, row])
    for r in range(work.planes.shape[0]):
        store_lane(state.motion[b, r : r + 1], lane, ring.motion[e, row, r])
        for m in range(work.planes.shape[1]):
            store_lane(work.planes[r, m : m + 1], lane, ring.point[e, row, r, m])


@kernel
def _show_points(state, setup, work, estimate, part):
    """Write the points of a part in polar form."""
    polar = work.polar[0]
    for r in range(setup.gains.shape[1]):
        for m in range(setup.gains.shape[2]):
            _polar(state.point[part.block, r, m], polar, setup.width)
            for j in range(part.rows.shape[0]):
                e = natural(part.rows[j])
                i = e % W
                estimate.known[e, r, m] = polar.known[i] != 0.0
                mean = estimate.points[e, r, m]
                mean[0], mean[1], mean[2] = polar.beta[i], polar.eta[i], polar.rho[i]
                pf.show_covariance(polar.covariance, i, estimate.points_covariance[e, r, m])


@kernel
def _show_poses(state, setup, work, options, estimate, part):
    """Write the poses of a part at their last sample."""
    b, pose = part.block, work.filter.pose[0]
    for p in range(setup.pairs.shape[0]):
        anchor, own = state.anchor[b, p], state.motion[b, setup.pairs[p, 0]]
        for j in range(part.rows.shape[0]):
            e = natural(part.rows[j])
            if state.sample[e] >= 0 and not state.received[e, p]:
                pf.show_held(anchor, own, state.clock[b], pose, e % W, options)
                pf.show_pose(pose, e % W, estimate, e, p)
            else:
                pf.show_pose(anchor.pose, e % W, estimate, e, p)


@kernel
def _show_ring(state, setup, ring, work, options, estimate, part):
    """The same, where messages may be late."""
    for p in range(setup.pairs.shape[0]):
        for n in part.rows:
            e = natural(n)
            at = pf.Place(e, p, setup.pairs[p, 0], setup.pairs[p, 1], e % W)
            pf.present(work.filter, ring, at, state.sample[e], state.received[e, p], options)
            pf.show_pose(work.filter.pose[0], e % W, estimate, e, p)


@kernel
def _polar(point, polar, width):
    """A point in polar form, with its covariance; zeros where it is not known."""
    for i in range(width):
        known = point.known[i] != 0.0
        q_x, q_y, height = point.q_x[i], point.q_y[i], point.height[i]
        rho = 1.0 / np.sqrt(q_x * q_x + q_y * q_y)
        polar.known[i], polar.beta[i] = point.known[i], atan2(q_y, q_x)
        polar.eta[i] = height * rho if known else 0.0
        polar.rho[i] = rho if known else 0.0
        c = body_to_polar(q_x, q_y, height, ds.six(point.covariance, i))
        none = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        ds.put_six(polar.covariance, i, ds.choose(known, c, none))
