"""The pose filter of an ordered pair of robots (A observes, B is observed) with messages that may be late or lost.

A message of B made at sample s holds what B knew then: its points in the plane of its body, with covariance, and its
dead reckoning. It is used at the time it was made for. A ring keeps the last L samples of every robot (what A knew
itself, what a message of B holds), and the filter keeps an anchor, the state just after the update, for each sample
of the ring whose message has come, and one before the ring. When a message comes, the filter goes back to the newest
anchor before it, and takes in that message and every later one that is there, in order. Between two anchors both
robots' displacements are differences of their dead reckoning, however many messages are missing.
"""

import math

import numpy as np

from relloc_env.kernels import relative_pose as rp
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.anchors import (
    ANCHOR,
    COS,
    OTHER,
    OTHER_NOISE,
    OWN,
    OWN_NOISE,
    SIN,
    SPEED,
    STEPS,
    TIME,
    first_anchor,
    leap,
)


@kernel
def open_anchor(e, a, b, source, target, row, options, sizes, motion, clock, anchor):
    """Predict from one anchor to a sample of the ring, and store the anchor there; its points are still to come.

    Args:
        e, a, b: environment, the pair's observer and its observed robot.
        source: index of the anchor to start from.
        target: index of the anchor to write; may be `source`.
        row: row of the ring, of the sample.
        options: FilterOptions.
        sizes, motion, clock, anchor: see `Sizes` and `Tables`.
    """
    at = e * sizes.length + row
    own, other = at * sizes.robots + a, at * sizes.robots + b
    time, steps = clock[at, 0], clock[at, 1]
    r_x, r_y, theta, cos, sin, pxx, pxy, pxt, pyy, pyt, ptt = leap(
        anchor, source, motion, own, other, False, time, steps, options
    )
    anchor[target, 0], anchor[target, 1], anchor[target, 2] = r_x, r_y, theta
    anchor[target, 3], anchor[target, 4], anchor[target, 5] = pxx, pxy, pxt
    anchor[target, 6], anchor[target, 7], anchor[target, 8] = pyy, pyt, ptt
    anchor[target, TIME], anchor[target, STEPS] = time, steps
    anchor[target, COS], anchor[target, SIN] = cos, sin
    for i in range(5):
        anchor[target, OWN + i], anchor[target, OTHER + i] = motion[own, i], motion[other, i]
    for i in range(3):
        anchor[target, SPEED + i] = motion[other, 5 + i]
    if options.from_odometry:
        for i in range(6):
            anchor[target, OWN_NOISE + i] = motion[own, 8 + i]
            anchor[target, OTHER_NOISE + i] = motion[other, 8 + i]


@kernel
def take_point(e, a, b, m, target, row, options, sizes, motion, point, usable, anchor):
    """Take point `m` of a sample of the ring into the anchor of that sample, where both robots know it.

    Args:
        e, a, b: environment, the pair's observer and its observed robot.
        m: the point.
        target: index of the anchor.
        row: row of the ring, of the sample.
        options: FilterOptions.
        sizes, motion, point, usable, anchor: see `Sizes` and `Tables`.
    """
    at = e * sizes.length + row
    own, other = at * sizes.robots + a, at * sizes.robots + b
    i, j = own * sizes.points + m, other * sizes.points + m
    if not (usable[i] and usable[j]):
        return
    r_x, r_y, theta, cos, sin = (
        anchor[target, 0],
        anchor[target, 1],
        anchor[target, 2],
        anchor[target, COS],
        anchor[target, SIN],
    )
    pxx, pxy, pxt = anchor[target, 3], anchor[target, 4], anchor[target, 5]
    pyy, pyt, ptt = anchor[target, 6], anchor[target, 7], anchor[target, 8]
    w_a = motion[own, 7]
    y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t = rp.observe(
        options.model, r_x, r_y, cos, sin, point[i, 0], point[i, 1], point[j, 0], point[j, 1],
        motion[own, 5], motion[own, 6], w_a, motion[other, 5], motion[other, 6],
    )  # fmt: skip
    rxx, rxy, ryy = options.variance, 0.0, options.variance
    if options.from_depth:
        rxx, rxy, ryy = rp.observe_covariance(
            options.model, cos, sin, w_a, point[i, 2], point[i, 3], point[i, 4],
            point[j, 2], point[j, 3], point[j, 4], options.variance,
        )  # fmt: skip
    r_x, r_y, new, pxx, pxy, pxt, pyy, pyt, ptt = rp.correct(
        r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt,
        y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t, rxx, rxy, ryy,
    )  # fmt: skip
    anchor[target, 0], anchor[target, 1], anchor[target, 2] = r_x, r_y, new
    anchor[target, 3], anchor[target, 4], anchor[target, 5] = pxx, pxy, pxt
    anchor[target, 6], anchor[target, 7], anchor[target, 8] = pyy, pyt, ptt
    anchor[target, COS], anchor[target, SIN] = turned(cos, sin, new - theta, new)


@kernel
def turned(cos, sin, turn, theta):
    """Cosine and sine of `theta`, given those of theta - turn: a short series where the turn is small."""
    if abs(turn) > 0.05:
        return math.cos(theta), math.sin(theta)
    s = turn * turn
    cos_d = 1.0 - s * (1 / 2) * (1.0 - s * (1 / 12) * (1.0 - s * (1 / 30) * (1.0 - s * (1 / 56))))
    sin_d = turn * (1.0 - s * (1 / 6) * (1.0 - s * (1 / 20) * (1.0 - s * (1 / 42))))
    return cos * cos_d - sin * sin_d, sin * cos_d + cos * sin_d


@kernel
def listen(e, p, a, b, sample, arrived, options, sizes, motion, clock, point, usable, anchor, received):
    """Take in the messages that reach the observer of pair `p` at sample `sample` (counted from 0).

    Args:
        e, p, a, b: environment, pair, its observer and its observed robot.
        sample: number of the present sample; its row of the ring is filled already.
        arrived: bit j is set where the message of age j reaches the observer now. Ages beyond the ring, or before the
            first sample, are ignored.
        options: FilterOptions.
        sizes, motion, clock, point, usable, anchor, received: see `Sizes` and `Tables`.

    Returns:
        Whether the points of the present sample are left to the caller (`take_point`, in the order of the points):
        those of other pairs and environments can go between, which lets a processor work on several at a time.
    """
    length, first = sizes.length, first_anchor(e, p, sizes)
    base = first + length if length > 1 else first
    one, got = np.uint64(1), received[e, p]
    window = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - min(length, sample + 1))
    if length > 1 and (got >> np.uint64(length - 1)) & one:
        for i in range(ANCHOR):
            anchor[base, i] = anchor[first + sample % length, i]
    got = (got << one) & window
    new = arrived & window & ~got
    received[e, p] = got | new
    if not new:
        return False
    oldest = length - 1
    while not (new >> np.uint64(oldest)) & one:
        oldest -= 1
    source = base
    for age in range(oldest + 1, length):
        if (got >> np.uint64(age)) & one:
            source = first + (sample - age) % length
            break
    got |= new
    for age in range(oldest, -1, -1):
        if (got >> np.uint64(age)) & one:
            row = (sample - age) % length
            target = first + row
            open_anchor(e, a, b, source, target, row, options, sizes, motion, clock, anchor)
            if age > 0:
                for m in range(sizes.points):
                    take_point(e, a, b, m, target, row, options, sizes, motion, point, usable, anchor)
            source = target
    return (got & one) != 0


@kernel
def present(e, p, a, b, sample, options, sizes, motion, clock, anchor, received):
    """Pose of pair `p` at sample `sample`, predicted from the newest anchor: (xi (3), its covariance (6))."""
    length, first, got = sizes.length, first_anchor(e, p, sizes), received[e, p]
    j = first + length if length > 1 else first
    for age in range(length):
        if (got >> np.uint64(age)) & np.uint64(1):
            j = first + (sample - age) % length
            break
    if sample < 0 or (got & np.uint64(1)):
        return (
            anchor[j, 0], anchor[j, 1], anchor[j, 2],
            anchor[j, 3], anchor[j, 4], anchor[j, 5], anchor[j, 6], anchor[j, 7], anchor[j, 8],
        )  # fmt: skip
    at = e * length + sample % length
    r_x, r_y, theta, _, _, pxx, pxy, pxt, pyy, pyt, ptt = leap(
        anchor, j, motion, at * sizes.robots + a, at * sizes.robots + b, True,
        clock[at, 0], clock[at, 1], options,
    )  # fmt: skip
    return r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt
