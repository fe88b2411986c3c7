"""The pose filter of an ordered pair of robots (A observes, B is observed) with messages that may be late or lost.

A message of B made at sample s holds what B knew then: its points in the plane of its body, with covariance, and its
dead reckoning. It is used at the time it was made for. Where messages come at once or never, the anchor (the state
just after the last update) is all that has to be kept, and a block of environments is worked on in lanes.

Else a ring keeps the last L samples of every robot (what A knew itself, what a message of B holds), and an anchor for
each sample of the ring whose message has come, and one before the ring. When a message comes, the filter goes back to
the newest anchor before it, and takes in that message and every later one that is there, in order. Between two anchors
both robots' displacements are differences of their dead reckoning, however many messages are missing.
"""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import anchors as an
from relloc_env.kernels import relative_pose as rp
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.depth_state import put_six, six
from relloc_env.kernels.lanes import clear_lane, load_lane, numbers_of, scratch, store_lane


class Work(NamedTuple):
    """What a pose filter works with where it does not work in place: one record of each kind, each in an array."""

    anchor: np.ndarray
    own: np.ndarray
    other: np.ndarray
    clock: np.ndarray
    own_point: np.ndarray
    other_point: np.ndarray
    update: np.ndarray
    pose: np.ndarray


@kernel
def work_of(width):
    """A `Work` for so many lanes."""
    return Work(
        np.empty(1, an.ANCHOR), np.empty(1, an.MOTION), np.empty(1, an.MOTION), np.empty(1, an.CLOCK),
        np.empty(1, an.PLANE_POINT), np.empty(1, an.PLANE_POINT), scratch(1, an.UPDATE, width), np.empty(1, an.POSE),
    )  # fmt: skip


class Ring(NamedTuple):
    """What is kept of the last L samples, in rows: the numbers of a lane of each record, in the order of its fields."""

    motion: np.ndarray
    """(N, L, R, ...) `anchors.MOTION` of the robots."""
    clock: np.ndarray
    """(N, L, ...) `anchors.CLOCK`."""
    point: np.ndarray
    """(N, L, R, M, ...) `anchors.PLANE_POINT`."""
    anchor: np.ndarray
    """(N, P, L + 1, ...) `anchors.ANCHOR`; the last is the one before the ring."""


def ring_of(num_envs: int, robots: int, points: int, pairs: int, length: int) -> Ring:
    """A ring of `length` samples, all zeros."""
    n, size = num_envs, numbers_of
    return Ring(
        motion=np.zeros((n, length, robots, size(an.MOTION))),
        clock=np.zeros((n, length, size(an.CLOCK))),
        point=np.zeros((n, length, robots, points, size(an.PLANE_POINT))),
        anchor=np.zeros((n, pairs, length + 1, size(an.ANCHOR))),
    )


class Place(NamedTuple):
    """Where a pose filter with a ring is: environment, pair, its observer A and observed robot B, lane to work in."""

    environment: int
    pair: int
    observer: int
    observed: int
    lane: int


@kernel
def start(anchor, i, pose, pose_sd):
    """Write lane `i` of an anchor, which is all zeros: a guess of the pose and its standard deviations."""
    anchor.pose.x[i], anchor.pose.y[i], anchor.pose.theta[i] = pose[0], pose[1], pose[2]
    anchor.pose.covariance[0, i], anchor.pose.covariance[3, i] = pose_sd[0] ** 2, pose_sd[1] ** 2
    anchor.pose.covariance[5, i] = pose_sd[2] ** 2
    anchor.cos[i], anchor.sin[i] = math.cos(pose[2]), math.sin(pose[2])
    anchor.own.cos[i] = anchor.other.cos[i] = 1.0


@kernel
def start_rings(ring, pose, pose_sd, rows):
    """Forget all anchors of the environments `rows` but the one before the ring, which is the guess (N, P, 3)."""
    lane, anchor = np.int64(0), np.empty(1, an.ANCHOR)
    for e in rows:
        for p in range(pose.shape[1]):
            clear_lane(anchor, lane)
            start(anchor[0], lane, pose[e, p], pose_sd)
            ring.anchor[e, p] = 0.0
            store_lane(anchor, lane, ring.anchor[e, p, ring.clock.shape[1]])


@kernel
def move_anchors(anchor, own, other, clock, options, width):
    """`anchors.move_anchor` in all lanes."""
    o = options
    if o.from_odometry:  # a loop for each, so that a lane has no branch
        known = an.FilterOptions(o.model, o.from_depth, o.variance, True, 0.0, o.var_v, o.var_w, o.hold_v, o.hold_w)
        for i in range(width):
            an.move_anchor(anchor, own, other, clock, i, known)
    else:
        steps = an.FilterOptions(o.model, o.from_depth, o.variance, False, o.process, 0.0, 0.0, 0.0, 0.0)
        for i in range(width):
            an.move_anchor(anchor, own, other, clock, i, steps)


@kernel
def move_heard(anchor, update, own, other, clock, i, options):
    """`anchors.move_anchor` in one lane, where a message has come."""
    if update.heard[i] != 0.0:
        an.move_anchor(anchor, own, other, clock, i, options)


@kernel
def take_points(anchor, update, own, other, own_point, other_point, options, width):
    """`anchors.take_point` in all lanes."""
    o = options
    if o.model == rp.POSITION and not o.from_depth:  # the same with less to choose from
        known = an.FilterOptions(rp.POSITION, False, o.variance, False, 0.0, 0.0, 0.0, 0.0, 0.0)
        for i in range(width):
            an.take_point(anchor, update, own, other, own_point, other_point, i, known)
    else:
        for i in range(width):
            an.take_point(anchor, update, own, other, own_point, other_point, i, o)
    for i in range(width):
        an.accept(anchor, update, i)


@kernel
def show_held(anchor, own, clock, pose, i, options):
    """The pose now is that of the anchor carried forward, with B's last velocity, lane `i`."""
    r_x, r_y, theta, _, _, p = an.leap(anchor, own, own, clock, i, True, options)
    pose.x[i], pose.y[i], pose.theta[i] = r_x, r_y, theta
    put_six(pose.covariance, i, p)


@inlined
def show_covariance(c, i, matrix):
    """Write the covariance of lane i as a matrix (3, 3)."""
    xx, xy, xt, yy, yt, tt = six(c, i)
    matrix[0, 0], matrix[0, 1], matrix[0, 2] = xx, xy, xt
    matrix[1, 0], matrix[1, 1], matrix[1, 2] = xy, yy, yt
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = xt, yt, tt


@inlined
def show_pose(pose, i, estimate, e, p):
    """Write the pose of lane i."""
    mean = estimate.pose[e, p]
    mean[0], mean[1], mean[2] = pose.x[i], pose.y[i], pose.theta[i]
    show_covariance(pose.covariance, i, estimate.pose_covariance[e, p])


@kernel
def _to_sample(work, ring, at, row):
    """Load a sample of the ring: the clock and both motions."""
    load_lane(work.clock, at.lane, ring.clock[at.environment, row])
    load_lane(work.own, at.lane, ring.motion[at.environment, row, at.observer])
    load_lane(work.other, at.lane, ring.motion[at.environment, row, at.observed])


@kernel
def listen(work, ring, at, sample, arrived, got, options):
    """Take in the messages that reach the observer of a pair at sample `sample` (counted from 0).

    Args:
        work: `Work`, of which one lane is used.
        ring: Ring; the present sample is in it already.
        at: Place.
        sample: number of the present sample.
        arrived: bit j is set where the message of age j reaches the observer now. Ages beyond the ring, or before the
            first sample, are ignored.
        got: uint64, bit j tells whether the message of age j has been taken in, at the sample before.
        options: FilterOptions.

    Returns:
        The same at this sample.
    """
    length, points = ring.clock.shape[1], ring.point.shape[3]
    e, i = at.environment, at.lane
    one, anchors = np.uint64(1), ring.anchor[e, at.pair]
    window = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - min(length, sample + 1))
    if (got >> np.uint64(length - 1)) & one:
        anchors[length] = anchors[sample % length]
    got = (got << one) & window
    new = arrived & window & ~got
    if not new:
        return got
    oldest = length - 1
    while not (new >> np.uint64(oldest)) & one:
        oldest -= 1
    source = length
    for age in range(oldest + 1, length):
        if (got >> np.uint64(age)) & one:
            source = (sample - age) % length
            break
    got |= new
    anchor, update, own, other = work.anchor[0], work.update[0], work.own[0], work.other[0]
    load_lane(work.anchor, i, anchors[source])
    update.heard[i] = 1.0
    for age in range(oldest, -1, -1):
        if (got >> np.uint64(age)) & one:
            row = (sample - age) % length
            _to_sample(work, ring, at, row)
            an.move_anchor(anchor, own, other, work.clock[0], i, options)
            for m in range(points):
                load_lane(work.own_point, i, ring.point[e, row, at.observer, m])
                load_lane(work.other_point, i, ring.point[e, row, at.observed, m])
                an.take_point(anchor, update, own, other, work.own_point[0], work.other_point[0], i, options)
                an.accept(anchor, update, i)
            store_lane(work.anchor, i, anchors[row])
    return got


@kernel
def present(work, ring, at, sample, got, options):
    """Put the pose of a pair at sample `sample`, predicted from the newest anchor, into the lane of `work.pose`."""
    length = newest = ring.clock.shape[1]
    for age in range(length):
        if (got >> np.uint64(age)) & np.uint64(1):
            newest = (sample - age) % length
            break
    anchor, pose, i = work.anchor[0], work.pose[0], at.lane
    load_lane(work.anchor, i, ring.anchor[at.environment, at.pair, newest])
    if sample < 0 or (got & np.uint64(1)):
        pose.x[i], pose.y[i], pose.theta[i] = anchor.pose.x[i], anchor.pose.y[i], anchor.pose.theta[i]
        put_six(pose.covariance, i, six(anchor.pose.covariance, i))
        return
    _to_sample(work, ring, at, sample % length)
    show_held(anchor, work.own[0], work.clock[0], pose, i, options)
