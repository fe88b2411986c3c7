"""The cascade over a batch: depth observers of every robot and point, then the pose filter of every ordered pair.

The state of `W` environments is a block (`kernels.lanes`). For one sample of a block, each point and then each pair
is copied to a workspace, worked on in all lanes, and copied back.
"""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import anchors as an
from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import pose_filter as pf
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.depth_covariance import body_to_polar
from relloc_env.kernels.elementary import atan2
from relloc_env.kernels.lanes import W, copy, natural, width_of, workspace

OK, ROW_OUT_OF_RANGE, MESSAGE_TOO_OLD, NOT_RESET = 0, 1, 2, 3

_POLAR = an.WORKSPACE * W
"""Place of a point in polar form (3) and its covariance (6)."""
_USABLE = _POLAR + 9 * W
"""Place of R M numbers: 1 where a robot's point may take part in the pose update."""
_WORKSPACE = _USABLE // W
_NOW = ds.TIME // W
"""Count of the numbers of a point that are about now."""


class Shape(NamedTuple):
    """Sizes, and where things are in a block: places of lane 0, of the first of each kind."""

    robots: int
    points: int
    pairs: int
    num_envs: int
    ring: int
    """L, of the ring; 0 for none."""
    use_unseen: int
    """Whether remembered points take part in the pose update."""
    width: int
    """Lanes to work on."""
    motion_size: int
    """Numbers of a motion."""
    anchor_size: int
    """Numbers of an anchor."""
    guess: int
    """R M numbers: depth guesses [m]."""
    depth_sd: int
    """1 number [m]: standard deviation of the guesses."""
    clock: int
    """2 numbers."""
    motion: int
    """R motions."""
    depth: int
    """R M depth observers."""
    anchor: int
    """P anchors; none where there is a ring."""
    size: int
    """Numbers of an environment."""


def shape(
    robots: int, points: int, pairs: int, num_envs: int, ring: int, *, use_unseen: bool, from_odometry: bool
) -> Shape:
    """Lay out a block."""
    full = from_odometry or ring > 0
    motion, anchor = (an.MOTION, an.ANCHOR) if full else (an.PLAIN_MOTION, an.PLAIN_ANCHOR)
    places = [0]
    for numbers in (robots * points, 1, an.CLOCK, robots * motion, robots * points * ds.SIZE):
        places.append(places[-1] + numbers * W)
    size = places[-1] // W + (0 if ring else pairs * anchor)
    return Shape(
        robots, points, pairs, num_envs, ring, int(use_unseen), width_of(num_envs), motion, anchor, *places, size
    )


@kernel
def _shape(s):
    """Shape from an int64 array (quicker to hand over than a tuple)."""
    return Shape(s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9], s[10], s[11], s[12], s[13], s[14], s[15])


@kernel
def _in_range(rows, num_envs):
    """Whether all `rows` are environments."""
    beyond = 0
    for n in rows:
        beyond += n < 0 or n >= num_envs
    return beyond == 0


@kernel
def reset(depth_guess, pose_guess, depth_sd, pose_sd, shape, sample, table, received, ring, rows):
    """Start the environments `rows` from a prior.

    Args:
        depth_guess, pose_guess, depth_sd, pose_sd: of `samples.Prior`.
        shape: int64, in the order of `Shape`.
        sample: (N,) int64 number of the last sample; -1 after a reset, -2 before it.
        table: (B, size W) blocks.
        received: (N P) uint64, see `pose_filter.listen`.
        ring: `pose_filter.Ring`, or None where messages come at once or never.
        rows: environments to work on.

    Returns:
        OK, or ROW_OUT_OF_RANGE (then nothing was done).
    """
    s = _shape(shape)
    if not _in_range(rows, s.num_envs):
        return ROW_OUT_OF_RANGE
    for e in rows:
        sample[e] = -1
        t, lane = table[e // W], e % W
        for i in range(s.size):
            t[lane + i * W] = 0.0
        for i in range(s.robots * s.points):
            t[lane + s.guess + i * W] = depth_guess[e, i // s.points, i % s.points]
        t[lane + s.depth_sd] = depth_sd
        for r in range(s.robots):
            t[lane + s.motion + r * s.motion_size * W + 3 * W] = 1.0
        for p in range(s.pairs):
            received[natural(e * s.pairs + p)] = 0
            if ring is None:
                _start(t, lane + s.anchor + p * s.anchor_size * W, np.int64(W), pose_guess[e, p], pose_sd)
            else:
                ring.anchor[e, p] = 0.0
                _start(ring.anchor[e, p, s.ring], lane * 0, np.int64(1), pose_guess[e, p], pose_sd)
    return OK


@kernel
def _start(anchor, at, stride, pose, sd):
    """Write an anchor at the start; it is all zeros."""
    for k in range(3):
        anchor[at + k * stride] = pose[k]
    anchor[at + 3 * stride], anchor[at + 6 * stride], anchor[at + 8 * stride] = sd[0] ** 2, sd[1] ** 2, sd[2] ** 2
    anchor[at + 14 * stride], anchor[at + 19 * stride] = 1.0, 1.0  # cosines of both dead reckonings
    anchor[at + 24 * stride], anchor[at + 25 * stride] = math.cos(pose[2]), math.sin(pose[2])


@inlined
def _keep(t, at, table, to, size, whole, width, rows, begin, end):
    """Copy numbers back to a block: all lanes if `whole`, else those of rows[begin:end]."""
    if whole:
        copy(t, at, table, to, size, width)
    else:
        for j in range(begin, end):
            lane = rows[j] % W
            for i in range(size):
                table[to + i * W + lane] = t[at + i * W + lane]


@kernel
def update(
    period, odometry, image, seen, arrived, samples, pairs, options, settings, gains,
    shape, sample, table, received, ring,
    e_points, e_points_covariance, e_known, e_pose, e_pose_covariance, rows,
):  # fmt: skip
    """Take all K samples of the environments `rows` in, in order, and refresh the estimate.

    Args:
        period, odometry, image, seen, arrived: `samples.Samples`, flat (`lanes.flat`).
        samples: K, how many of them.
        pairs: (P, 2) ordered pairs (observer, observed).
        options: (9,) float64, in the order of `anchors.FilterOptions`.
        settings: (R, 9) float64, `depth_state.Settings` of each robot.
        gains: [1/s, 1/m²] (N R M 2) H and alpha Lambda of each observer.
        shape, sample, table, received, ring: as for `reset`.
        e_points, e_points_covariance, e_known, e_pose, e_pose_covariance: `samples.Estimate`, flat, refreshed in place.
        rows: environments to work on, each once; quickest in ascending order.

    Returns:
        OK; ROW_OUT_OF_RANGE or NOT_RESET (then nothing was done); or MESSAGE_TOO_OLD (such messages were left out).
    """
    s, o = _shape(shape), an.filter_options(options)
    if not _in_range(rows, s.num_envs):
        return ROW_OUT_OF_RANGE
    for e in rows:
        if sample[e] < -1:
            return NOT_RESET
    beyond = ~(np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - max(s.ring, 1)))
    status, t = OK, workspace(_WORKSPACE + s.robots * s.points, s.width)
    begin = np.int64(0)  # else numba would compile for the number 0, and again for any
    while begin < rows.shape[0]:
        block, end = rows[begin] // W, begin + 1
        while end < rows.shape[0] and rows[end] // W == block:
            end += 1
        b = table[block]
        whole = end - begin == min(W, s.num_envs - block * W)
        for k in range(samples):
            _tick(t, b, s, period, samples, k, sample, rows, begin, end)
            for r in range(s.robots):
                _sense(t, b, s, o, settings, gains, odometry, image, seen, samples, k, r, whole, rows, begin, end)
            for j in range(begin, end):
                at = natural((rows[j] * samples + k) * s.pairs)
                for p in range(s.pairs):
                    if arrived[at + p] & beyond:
                        status = MESSAGE_TOO_OLD
            if ring is None:
                for p in range(s.pairs):
                    _listen(t, b, s, o, arrived, received, samples, k, p, pairs, whole, rows, begin, end)
            else:
                _listen_ring(t, b, s, o, ring, arrived, received, sample, samples, k, pairs, rows, begin, end)
        _show_points(t, b, s, e_points, e_points_covariance, e_known, rows, begin, end)
        if ring is None:
            _show_poses(t, b, s, o, pairs, sample, received, e_pose, e_pose_covariance, rows, begin, end)
        else:
            _show_ring(t, s, o, ring, pairs, sample, received, e_pose, e_pose_covariance, rows, begin, end)
        begin = end
    return status


@kernel
def _tick(t, b, s, period, samples, k, sample, rows, begin, end):
    """Carry the clocks to sample k; its interval goes to the workspace."""
    for j in range(begin, end):
        e = natural(rows[j])
        sample[e] += 1
        dt, lane = period[natural(e * samples + k)], e % W
        t[ds.DT + lane] = dt
        t[ds.DEPTH_SD + lane] = b[natural(s.depth_sd + lane)]
        clock = natural(s.clock + lane)
        b[clock] += dt
        b[clock + W] += 1.0 if dt > 0.0 else 0.0


@kernel
def _sense(t, b, s, o, settings, gains, odometry, image, seen, samples, k, r, whole, rows, begin, end):
    """Dead reckoning and depth observers of one robot over one sample."""
    for j in range(begin, end):
        e, lane = natural(rows[j]), natural(rows[j]) % W
        at = natural(3 * ((e * samples + k) * s.robots + r))
        t[ds.V + lane], t[ds.LATERAL + lane], t[ds.YAW_RATE + lane] = odometry[at], odometry[at + 1], odometry[at + 2]
    motion = s.motion + r * s.motion_size * W
    copy(b, motion, t, an.OWN, s.motion_size, s.width)
    an.reckon(t, o.var_v, o.var_w, s.width)
    _keep(t, an.OWN, b, motion, s.motion_size, whole, s.width, rows, begin, end)
    for m in range(s.points):
        point = r * s.points + m
        copy(b, s.guess + point * W, t, ds.GUESS, 1, s.width)
        for j in range(begin, end):
            e, lane = natural(rows[j]), natural(rows[j]) % W
            at = natural(((e * samples + k) * s.robots + r) * s.points + m)
            t[ds.SEEN + lane] = 1.0 if seen[at] else 0.0
            t[ds.SEEN_X + lane], t[ds.SEEN_Y + lane] = image[2 * at], image[2 * at + 1]
            at = natural(2 * ((e * s.robots + r) * s.points + m))
            t[ds.GAIN_H + lane], t[ds.GAIN_ALPHA + lane] = gains[at], gains[at + 1]
        place = s.depth + point * ds.SIZE * W
        copy(b, place, t, ds.KNOWN, ds.SIZE, s.width)
        ds.observe(t, settings, r, s.width)
        _mark(t, _USABLE + point * W, s.use_unseen != 0, s.width)
        _keep(t, ds.KNOWN, b, place, ds.SIZE, whole, s.width, rows, begin, end)


@kernel
def _mark(t, usable, use_unseen, width):
    """Note where the point of the workspace may take part in the pose update."""
    usable = natural(usable)
    for i in range(width):
        t[usable + i] = 1.0 if (t[i + ds.KNOWN] != 0.0) & ((t[i + ds.SEEN] != 0.0) | use_unseen) else 0.0


@kernel
def _point(t, to, b, s, r, m):
    """Point m as robot r knows it, to the workspace."""
    point = r * s.points + m
    place = s.depth + point * ds.SIZE * W
    copy(b, place + ds.Q_X, t, to, an.POINT - 1, s.width)
    copy(t, _USABLE + point * W, t, to + an.USABLE, 1, s.width)


@kernel
def _listen(t, b, s, o, arrived, received, samples, k, p, pairs, whole, rows, begin, end):
    """One sample of the pose filter of a pair whose messages come at once or never."""
    first, second, everyone = pairs[p, 0], pairs[p, 1], True
    for j in range(begin, end):
        e = natural(rows[j])
        heard = arrived[natural((e * samples + k) * s.pairs + p)] & np.uint64(1)
        received[natural(e * s.pairs + p)] = heard
        t[an.HEARD + e % W] = 1.0 if heard else 0.0
        everyone &= heard != 0
    place = s.anchor + p * s.anchor_size * W
    copy(b, place, t, an.BASE, s.anchor_size, s.width)
    copy(b, s.motion + first * s.motion_size * W, t, an.OWN, s.motion_size, s.width)
    copy(b, s.motion + second * s.motion_size * W, t, an.OTHER, s.motion_size, s.width)
    copy(b, s.clock, t, an.NOW, an.CLOCK, s.width)
    if everyone:
        pf.move_anchors(t, o, s.width)
    else:
        for j in range(begin, end):
            pf.move_heard(t, o, rows[j] % W)
    for m in range(s.points):
        _point(t, an.OWN_POINT, b, s, first, m)
        _point(t, an.OTHER_POINT, b, s, second, m)
        pf.take_points(t, o, s.width)
    _keep(t, an.BASE, b, place, s.anchor_size, whole, s.width, rows, begin, end)


@kernel
def _listen_ring(t, b, s, o, ring, arrived, received, sample, samples, k, pairs, rows, begin, end):
    """One sample of the pose filters of all pairs whose messages may be late."""
    for j in range(begin, end):
        e = natural(rows[j])
        _remember(t, b, s, ring, e, sample[e] % s.ring)
        at, to = natural((e * samples + k) * s.pairs), natural(e * s.pairs)
        for p in range(s.pairs):
            received[to + p] = pf.listen(
                t, e % W, ring, e, p, pairs[p, 0], pairs[p, 1], sample[e], arrived[at + p], received[to + p], o
            )


@kernel
def _remember(t, b, s, ring, e, row):
    """Put the present sample of environment e into the ring."""
    lane = e % W
    for i in range(an.CLOCK):
        ring.clock[e, row, i] = b[s.clock + i * W + lane]
    for r in range(s.robots):
        for i in range(an.MOTION):
            ring.motion[e, row, r, i] = b[s.motion + (r * s.motion_size + i) * W + lane]
        for m in range(s.points):
            place = s.depth + (r * s.points + m) * ds.SIZE * W + lane
            point = ring.point[e, row, r, m]
            for i in range(an.POINT - 1):
                point[i] = b[place + ds.Q_X + i * W]
            point[an.POINT - 1] = t[_USABLE + (r * s.points + m) * W + lane]


@kernel
def show(
    pairs, options, shape, sample, table, received, ring,
    e_points, e_points_covariance, e_known, e_pose, e_pose_covariance, rows,
):  # fmt: skip
    """Write the estimate of the environments `rows` (in range); arguments as for `update`."""
    s, o = _shape(shape), an.filter_options(options)
    t = workspace(_WORKSPACE, s.width)
    for j in range(rows.shape[0]):
        b = table[rows[j] // W]
        _show_points(t, b, s, e_points, e_points_covariance, e_known, rows, j, j + 1)
        if ring is None:
            _show_poses(t, b, s, o, pairs, sample, received, e_pose, e_pose_covariance, rows, j, j + 1)
        else:
            _show_ring(t, s, o, ring, pairs, sample, received, e_pose, e_pose_covariance, rows, j, j + 1)


@kernel
def _show_points(t, b, s, points, covariance, known, rows, begin, end):
    """Write the points of rows[begin:end], all of one block, in polar form."""
    for r in range(s.robots):
        for m in range(s.points):
            copy(b, s.depth + (r * s.points + m) * ds.SIZE * W, t, ds.KNOWN, _NOW, s.width)
            _polar(t, s.width)
            for j in range(begin, end):
                i, point = natural(rows[j]) % W, natural((rows[j] * s.robots + r) * s.points + m)
                known[point] = t[ds.KNOWN + i] != 0.0
                _show_three(t, _POLAR + i, point, points, covariance)


@inlined
def _show_three(t, i, which, mean, c):
    """Write three numbers and their covariance, the first number at i."""
    at = 3 * which
    mean[at], mean[at + 1], mean[at + 2] = t[i], t[i + W], t[i + 2 * W]
    at = 9 * which
    xx, xy, xt, yy, yt, tt = ds.six(t, i + 3 * W)
    c[at], c[at + 1], c[at + 2] = xx, xy, xt
    c[at + 3], c[at + 4], c[at + 5] = xy, yy, yt
    c[at + 6], c[at + 7], c[at + 8] = xt, yt, tt


@kernel
def _show_poses(t, b, s, o, pairs, sample, received, pose, covariance, rows, begin, end):
    """Write the poses of rows[begin:end], all of one block, at their last sample."""
    for p in range(s.pairs):
        copy(b, s.anchor + p * s.anchor_size * W, t, an.BASE, s.anchor_size, s.width)
        copy(b, s.motion + pairs[p, 0] * s.motion_size * W, t, an.OWN, s.motion_size, s.width)
        copy(b, s.clock, t, an.NOW, an.CLOCK, s.width)
        for j in range(begin, end):
            e = natural(rows[j])
            pair, place = natural(e * s.pairs + p), an.BASE
            if sample[e] >= 0 and not received[pair]:
                pf.show_held(t, e % W, o)
                place = an.POSE
            _show_three(t, natural(place + e % W), pair, pose, covariance)


@kernel
def _show_ring(t, s, o, ring, pairs, sample, received, pose, covariance, rows, begin, end):
    """The same, where messages may be late."""
    for p in range(s.pairs):
        for j in range(begin, end):
            e = natural(rows[j])
            pair = natural(e * s.pairs + p)
            pf.present(t, e % W, ring, e, p, pairs[p, 0], pairs[p, 1], sample[e], received[pair], o)
            _show_three(t, an.POSE + e % W, pair, pose, covariance)


@kernel
def _polar(t, width):
    """The point of the workspace in polar form, with its covariance; zeros where it is not known."""
    for i in range(width):
        known = t[i + ds.KNOWN] != 0.0
        q_x, q_y, height = t[i + ds.Q_X], t[i + ds.Q_Y], t[i + ds.HEIGHT]
        rho = 1.0 / np.sqrt(q_x * q_x + q_y * q_y)
        t[i + _POLAR] = atan2(q_y, q_x)
        t[i + _POLAR + W] = height * rho if known else 0.0
        t[i + _POLAR + 2 * W] = rho if known else 0.0
        c = body_to_polar(q_x, q_y, height, ds.six(t, i + ds.COVARIANCE))
        none = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        ds.put_six(t, i + _POLAR + 3 * W, ds.choose(known, c, none))
