"""The pose filter of an ordered pair of robots (A observes, B is observed) with messages that may be late or lost.

A message of B made at sample s holds what B knew then: its points in the plane of its body, with covariance, and its
dead reckoning. It is used at the time it was made for. Where messages come at once or never, the anchor (the state
just after the last update) is all that has to be kept, and a block of environments is worked on in lanes.

Else a ring keeps the last L samples of every robot (what A knew itself, what a message of B holds), and an anchor for
each sample of the ring whose message has come, and one before the ring. When a message comes, the filter goes back to
the newest anchor before it, and takes in that message and every later one that is there, in order. Between two anchors
both robots' displacements are differences of their dead reckoning, however many messages are missing.
"""

from typing import NamedTuple

import numpy as np

from relloc_env.kernels import anchors as an
from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import relative_pose as rp
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.lanes import W


class Ring(NamedTuple):
    """What is kept of the last L samples; empty (L = 0) where messages come at once or never."""

    motion: np.ndarray
    """(N, L, R, 14) motions of the robots."""
    clock: np.ndarray
    """(N, L, 2) the clock."""
    point: np.ndarray
    """(N, L, R, M, 8) the points."""
    anchor: np.ndarray
    """(N, P, L + 1, 38) anchors; the last is the one before the ring."""


@kernel
def move_anchors(t, options, width):
    """`anchors.move_anchor` in all lanes."""
    o = options
    if o.from_odometry:  # a loop for each, so that a lane has no branch
        known = an.FilterOptions(o.model, o.from_depth, o.variance, True, 0.0, o.var_v, o.var_w, o.hold_v, o.hold_w)
        for i in range(width):
            an.move_anchor(t, i, known)
    else:
        steps = an.FilterOptions(o.model, o.from_depth, o.variance, False, o.process, 0.0, 0.0, 0.0, 0.0)
        for i in range(width):
            an.move_anchor(t, i, steps)


@kernel
def move_heard(t, options, lane):
    """`anchors.move_anchor` in one lane, where a message has come."""
    if t[lane + an.HEARD] != 0.0:
        an.move_anchor(t, lane, options)


@kernel
def take_points(t, options, width):
    """`anchors.take_point` in all lanes."""
    o = options
    if o.model == rp.POSITION and not o.from_depth:  # the same with less to choose from
        known = an.FilterOptions(rp.POSITION, False, o.variance, False, 0.0, 0.0, 0.0, 0.0, 0.0)
        for i in range(width):
            an.take_point(t, i, known)
    else:
        for i in range(width):
            an.take_point(t, i, o)
    for i in range(width):
        an.accept(t, i)


@kernel
def show_held(t, i, options):
    """The pose now is that of the anchor carried forward, with B's last velocity, lane `i`."""
    r_x, r_y, theta, _, _, p = an.leap(t, i, True, options)
    t[i + an.POSE], t[i + an.POSE + W], t[i + an.POSE + 2 * W] = r_x, r_y, theta
    ds.put_six(t, i + an.POSE + 3 * W, p)


@kernel
def _load(t, place, source):
    """Put numbers into a lane of the workspace."""
    for k in range(source.shape[0]):
        t[place + k * W] = source[k]


@kernel
def _store(t, place, target):
    """Take numbers out of a lane of the workspace."""
    for k in range(target.shape[0]):
        target[k] = t[place + k * W]


@kernel
def _to_sample(t, i, ring, e, row, a, b):
    """Load a sample of the ring into lane `i`: the clock and both motions."""
    _load(t, i + an.NOW, ring.clock[e, row])
    _load(t, i + an.OWN, ring.motion[e, row, a])
    _load(t, i + an.OTHER, ring.motion[e, row, b])


@kernel
def listen(t, i, ring, e, p, a, b, sample, arrived, got, options):
    """Take in the messages that reach the observer of pair `p` at sample `sample` (counted from 0), with lane `i`.

    Args:
        t, i: workspace and lane to work in.
        ring: Ring; the present sample is in it already.
        e, p, a, b: environment, pair, its observer and its observed robot.
        sample: number of the present sample.
        arrived: bit j is set where the message of age j reaches the observer now. Ages beyond the ring, or before the
            first sample, are ignored.
        got: uint64, bit j tells whether the message of age j has been taken in, at the sample before.
        options: FilterOptions.

    Returns:
        The same at this sample.
    """
    length, points = ring.clock.shape[1], ring.point.shape[3]
    one, anchors = np.uint64(1), ring.anchor[e, p]
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
    _load(t, i + an.BASE, anchors[source])
    t[i + an.HEARD] = 1.0
    for age in range(oldest, -1, -1):
        if (got >> np.uint64(age)) & one:
            row = (sample - age) % length
            _to_sample(t, i, ring, e, row, a, b)
            an.move_anchor(t, i, options)
            for m in range(points):
                _load(t, i + an.OWN_POINT, ring.point[e, row, a, m])
                _load(t, i + an.OTHER_POINT, ring.point[e, row, b, m])
                an.take_point(t, i, options)
                an.accept(t, i)
            _store(t, i + an.BASE, anchors[row])
    return got


@kernel
def present(t, i, ring, e, p, a, b, sample, got, options):
    """Put the pose of pair `p` at sample `sample`, predicted from the newest anchor, into lane `i`."""
    length = j = ring.clock.shape[1]
    for age in range(length):
        if (got >> np.uint64(age)) & np.uint64(1):
            j = (sample - age) % length
            break
    _load(t, i + an.BASE, ring.anchor[e, p, j])
    if sample < 0 or (got & np.uint64(1)):
        for k in range(9):
            t[i + an.POSE + k * W] = t[i + an.BASE + k * W]
        return
    _to_sample(t, i, ring, e, sample % length, a, b)
    show_held(t, i, options)
