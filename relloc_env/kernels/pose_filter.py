"""The pose filter of an ordered pair of robots (A observes, B is observed) with messages that may be late or lost.

A message of B made at sample s holds what B knew then: its points in the plane of its body, with covariance, and its
dead reckoning. It is used at the time it was made for. A ring keeps the last L samples of every robot (what A knew
itself, what a message of B holds), and the filter keeps an anchor, the state just after the update, for each sample
of the ring whose message has come, and one before the ring. When a message comes, the filter goes back to the newest
anchor before it, and takes in that message and every later one that is there, in order. Between two anchors both
robots' displacements are differences of their dead reckoning, however many messages are missing.

All arrays have the environment as their first axis. Rows of the arrays:

- `motion` (N, L, R, 14): dead reckoning x, y, theta, cos theta, sin theta; velocity v, l, w; covariance of the dead
  reckoning, carried in the frame where it began (upper triangle), so that the difference of two is what the motion
  between them added.
- `clock` (N, L, 2): time since the start, and the number of samples since then over which time passed.
- `point` (N, L, R, M, 5): q_x, q_y and its covariance xx, xy, yy, in the body frame; `usable` (N, L, R, M): bool.
- `anchor` (N, P, L + 1, 36), (N, P, 1, 36) if L is 1: xi, its covariance; time and sample count; dead reckoning of A
  (5), of B (5); velocity of B; covariance of the dead reckoning of A (6), of B (6). The last row is the anchor
  before the ring.
- `received` (N, P): bit j tells whether the message of age j has been taken in.
"""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import relative_pose as rp
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import arc

MOTION, CLOCK, POINT, ANCHOR = 14, 2, 5, 36

# first columns within an anchor
_TIME, _STEPS, _OWN, _OTHER, _SPEED, _OWN_NOISE, _OTHER_NOISE = 9, 10, 11, 16, 21, 24, 30


class FilterOptions(NamedTuple):
    """Options of the pose filter, as numbers."""

    model: int
    """`relative_pose.POSITION`, `VELOCITY` or `PRINTED`."""
    from_depth: bool
    """Whether the covariance of a point comes from the depth observers."""
    variance: float
    """[m²; m²/s²] of a point on each axis; added to the former if `from_depth`."""
    from_odometry: bool
    """Whether process noise comes from the odometry."""
    process: float
    """[m², m², rad²] process variance per sample if not."""
    var_v: float
    """[m²/s²] variance of a sample's measured speed."""
    var_w: float
    """[rad²/s²] variance of a sample's measured yaw rate."""


class Ring(NamedTuple):
    """Arrays of the filter; see the top of this file."""

    motion: np.ndarray
    clock: np.ndarray
    point: np.ndarray
    usable: np.ndarray
    anchor: np.ndarray
    received: np.ndarray


@kernel
def start(e, prior, sd, ring):
    """Start environment `e` of `ring` from the prior poses (N, P, 3) with standard deviations sd (3,)."""
    ring.motion[e] = 0.0
    ring.motion[e, :, :, 3] = 1.0
    ring.clock[e] = 0.0
    ring.point[e] = 0.0
    ring.usable[e] = False
    ring.received[e] = 0
    ring.anchor[e] = 0.0
    base = ring.anchor.shape[2] - 1
    for p in range(ring.anchor.shape[1]):
        for i in range(3):
            ring.anchor[e, p, base, i] = prior[e, p, i]
        ring.anchor[e, p, base, 3] = sd[0] * sd[0]
        ring.anchor[e, p, base, 6] = sd[1] * sd[1]
        ring.anchor[e, p, base, 8] = sd[2] * sd[2]
        ring.anchor[e, p, base, _OWN + 3] = 1.0
        ring.anchor[e, p, base, _OTHER + 3] = 1.0


@kernel
def move(old, new, v, lateral, w, dt, c_x, c_y, delta, cos_d, sin_d, options):
    """Carry the dead reckoning of a robot over one sample.

    Args:
        old, new: (14,) rows of `motion` before and after; may be the same.
        v, lateral, w: [m/s, m/s, rad/s] measured velocity.
        dt: [s] length of the interval.
        c_x, c_y, delta, cos_d, sin_d: its arc: chord [m], turn [rad], cosine and sine of the turn.
        options: FilterOptions.
    """
    theta, cos, sin = old[2], old[3], old[4]
    x, y = old[0] + cos * c_x - sin * c_y, old[1] + sin * c_x + cos * c_y
    cos, sin = cos * cos_d - sin * sin_d, sin * cos_d + cos * sin_d
    unit = 1.5 - 0.5 * (cos * cos + sin * sin)
    cos, sin = cos * unit, sin * unit
    new[0], new[1], new[2], new[3], new[4] = x, y, theta + delta, cos, sin
    new[5], new[6], new[7] = v, lateral, w
    if options.from_odometry:
        a_x, a_y, b_x, b_y = rp.arc_jacobian(v, lateral, w, dt)
        # from the body frame at the end to the frame where dead reckoning began: e = [[R, -J p], [0, 1]] n
        a_x, a_y = cos * a_x - sin * a_y, sin * a_x + cos * a_y
        b_x, b_y = cos * b_x - sin * b_y + dt * y, sin * b_x + cos * b_y - dt * x
        nxx, nxy, nxt, nyy, nyt, ntt = rp.displacement_noise(a_x, a_y, b_x, b_y, dt, options.var_v, options.var_w)
        new[8], new[9], new[10] = old[8] + nxx, old[9] + nxy, old[10] + nxt
        new[11], new[12], new[13] = old[11] + nyy, old[12] + nyt, old[13] + ntt


@kernel
def between(x0, y0, cos0, sin0, theta0, x1, y1, cos1, sin1, theta1):
    """Displacement between two poses of dead reckoning: (c_x, c_y, delta, cos delta, sin delta)."""
    d_x, d_y = x1 - x0, y1 - y0
    return (
        cos0 * d_x + sin0 * d_y,
        cos0 * d_y - sin0 * d_x,
        theta1 - theta0,
        cos0 * cos1 + sin0 * sin1,
        cos0 * sin1 - sin0 * cos1,
    )


@kernel
def held_noise(c_x, c_y, cos_h, sin_h, dt, steps, var_v, var_w):
    """Noise of a displacement over `steps` samples of equal velocity, in the body frame at its start.

    Per sample var_v forward and var_w on the turn; the path is taken as its chord, for steps -> infinity:
    with c the chord, e_xy = n_v [cos h, sin h] - J c t n_w at t in [0, 1], summed over the path.

    Args:
        c_x, c_y: [m] chord.
        cos_h, sin_h: of half the turn, the mean heading.
        dt: [s] duration.
        steps: number of samples.
        var_v, var_w: [m²/s², rad²/s²] variances of one sample.

    Returns:
        (xx, xy, xt, yy, yt, tt): upper triangle.
    """
    square = dt * dt / steps
    along, turn = var_v * square, var_w * square
    return (
        along * cos_h * cos_h + turn * c_y * c_y / 3.0,
        along * cos_h * sin_h - turn * c_x * c_y / 3.0,
        0.5 * turn * c_y,
        along * sin_h * sin_h + turn * c_x * c_x / 3.0,
        -0.5 * turn * c_x,
        turn,
    )


@kernel
def leap(anchor, own, other, held, time, steps, options):
    """Predict from an anchor to a sample of the ring: pose and covariance there.

    Args:
        anchor: (36,) row of `anchor` to start from.
        own, other: (14,) rows of `motion` of A and of B at the sample.
        held: whether B's motion up to the sample is unknown: its last known velocity is held, `other` is not read.
        time: [s] of the sample.
        steps: count of the sample.
        options: FilterOptions.

    Returns:
        (r_x, r_y, theta, cos, sin, pxx, pxy, pxt, pyy, pyt, ptt): cos and sin of the predicted theta.
    """
    c_ax, c_ay, delta_a, cos_a, sin_a = between(
        anchor[11], anchor[12], anchor[14], anchor[15], anchor[13], own[0], own[1], own[3], own[4], own[2]
    )
    if held:
        dt = time - anchor[_TIME]
        c_bx, c_by, delta_b = arc(anchor[_SPEED], anchor[_SPEED + 1], anchor[_SPEED + 2], dt)
        cos_b, sin_b = math.cos(delta_b), math.sin(delta_b)
    else:
        c_bx, c_by, delta_b, cos_b, sin_b = between(
            anchor[16], anchor[17], anchor[19], anchor[20], anchor[18], other[0], other[1], other[3], other[4], other[2]
        )
    cos_t, sin_t = math.cos(anchor[2]), math.sin(anchor[2])
    r_x, r_y, theta, d_x, d_y = rp.predict_rotated(
        anchor[0], anchor[1], anchor[2], cos_t, sin_t, c_ax, c_ay, delta_a, cos_a, sin_a, c_bx, c_by, delta_b
    )
    pxx, pxy, pxt, pyy, pyt, ptt = rp.propagate(
        cos_a, sin_a, -d_y, d_x, anchor[3], anchor[4], anchor[5], anchor[6], anchor[7], anchor[8]
    )
    turn_x, turn_y = cos_a * cos_b + sin_a * sin_b, cos_a * sin_b - sin_a * cos_b
    cos, sin = cos_t * turn_x - sin_t * turn_y, sin_t * turn_x + cos_t * turn_y
    if options.from_odometry:
        axx, axy, axt, ayy, ayt, att = rp.noise_of_a(
            r_x, r_y, own[0], own[1], own[3], own[4],
            own[8] - anchor[24], own[9] - anchor[25], own[10] - anchor[26],
            own[11] - anchor[27], own[12] - anchor[28], own[13] - anchor[29],
        )  # fmt: skip
        if not held:
            bxx, bxy, bxt, byy, byt, btt = rp.noise_of_b(
                cos, sin, other[0], other[1], other[3], other[4],
                other[8] - anchor[30], other[9] - anchor[31], other[10] - anchor[32],
                other[11] - anchor[33], other[12] - anchor[34], other[13] - anchor[35],
            )  # fmt: skip
        elif steps > anchor[_STEPS]:
            nxx, nxy, nxt, nyy, nyt, ntt = held_noise(
                c_bx, c_by, math.cos(0.5 * delta_b), math.sin(0.5 * delta_b),
                dt, steps - anchor[_STEPS], options.var_v, options.var_w,
            )  # fmt: skip
            bxx, bxy, bxt, byy, byt, btt = rp.noise_of_b(
                cos, sin, c_bx, c_by, cos_b, sin_b, nxx, nxy, nxt, nyy, nyt, ntt
            )
        else:
            bxx, bxy, bxt, byy, byt, btt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        pxx, pxy, pxt, pyy, pyt, ptt = (
            pxx + axx + bxx, pxy + axy + bxy, pxt + axt + bxt, pyy + ayy + byy, pyt + ayt + byt, ptt + att + btt
        )  # fmt: skip
    else:
        noise = options.process * (steps - anchor[_STEPS])
        pxx, pyy, ptt = pxx + noise, pyy + noise, ptt + noise
    return r_x, r_y, theta, cos, sin, pxx, pxy, pxt, pyy, pyt, ptt


@kernel
def fuse(e, p, a, b, source, row, time, steps, options, ring):
    """Predict from anchor `source` to the sample in `row` of the ring, take B's message of it in, store the anchor.

    Args:
        e, p, a, b: environment, pair, its observer and its observed robot.
        source: row of the anchor to start from.
        row: row of the ring, and of the anchor that is written (0 where the ring has length 1).
        time, steps: [s] and count of the sample.
        options: FilterOptions.
        ring: arrays of the filter.
    """
    own, other, anchor = ring.motion[e, row, a], ring.motion[e, row, b], ring.anchor[e, p, row]
    r_x, r_y, theta, cos, sin, pxx, pxy, pxt, pyy, pyt, ptt = leap(
        ring.anchor[e, p, source], own, other, False, time, steps, options
    )
    rxx, rxy, ryy = options.variance, 0.0, options.variance
    for m in range(ring.point.shape[3]):
        if ring.usable[e, row, a, m] and ring.usable[e, row, b, m]:
            q_a, q_b = ring.point[e, row, a, m], ring.point[e, row, b, m]
            y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t = rp.observe(
                options.model, r_x, r_y, cos, sin, q_a[0], q_a[1], q_b[0], q_b[1],
                own[5], own[6], own[7], other[5], other[6],
            )  # fmt: skip
            if options.from_depth:
                rxx, rxy, ryy = rp.observe_covariance(
                    options.model, cos, sin, own[7], q_a[2], q_a[3], q_a[4], q_b[2], q_b[3], q_b[4], options.variance
                )
            r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt = rp.correct(
                r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt,
                y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t, rxx, rxy, ryy,
            )  # fmt: skip
            cos, sin = math.cos(theta), math.sin(theta)
    anchor[0], anchor[1], anchor[2] = r_x, r_y, theta
    anchor[3], anchor[4], anchor[5], anchor[6], anchor[7], anchor[8] = pxx, pxy, pxt, pyy, pyt, ptt
    anchor[_TIME], anchor[_STEPS] = time, steps
    for i in range(5):
        anchor[_OWN + i], anchor[_OTHER + i] = own[i], other[i]
    for i in range(3):
        anchor[_SPEED + i] = other[5 + i]
    if options.from_odometry:
        for i in range(6):
            anchor[_OWN_NOISE + i], anchor[_OTHER_NOISE + i] = own[8 + i], other[8 + i]


@kernel
def listen(e, p, a, b, sample, arrived, options, ring):
    """Take in the messages that reach the observer of pair `p` at sample `sample` (counted from 0).

    Args:
        e, p, a, b: environment, pair, its observer and its observed robot.
        sample: number of the present sample; its row of the ring is filled already.
        arrived: bit j is set where the message of age j reaches the observer now. Ages beyond the ring, or before the
            first sample, are ignored.
        options: FilterOptions.
        ring: arrays of the filter.
    """
    length = ring.motion.shape[1]
    base = ring.anchor.shape[2] - 1
    one, got = np.uint64(1), ring.received[e, p]
    window = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - min(length, sample + 1))
    if length > 1 and (got >> np.uint64(length - 1)) & one:
        ring.anchor[e, p, base] = ring.anchor[e, p, sample % length]
    got = (got << one) & window
    new = arrived & window & ~got
    if new:
        oldest = length - 1
        while not (new >> np.uint64(oldest)) & one:
            oldest -= 1
        source = base
        for age in range(oldest + 1, length):
            if (got >> np.uint64(age)) & one:
                source = (sample - age) % length
                break
        got |= new
        for age in range(oldest, -1, -1):
            if (got >> np.uint64(age)) & one:
                row = (sample - age) % length
                fuse(e, p, a, b, source, row, ring.clock[e, row, 0], ring.clock[e, row, 1], options, ring)
                source = row
    ring.received[e, p] = got


@kernel
def present(e, p, a, b, sample, options, ring):
    """Pose of pair `p` at sample `sample`, predicted from the newest anchor: (xi (3), its covariance (6))."""
    length = ring.motion.shape[1]
    source, got = ring.anchor.shape[2] - 1, ring.received[e, p]
    for age in range(length):
        if (got >> np.uint64(age)) & np.uint64(1):
            source = (sample - age) % length
            break
    row = sample % length
    anchor = ring.anchor[e, p, source]
    if sample < 0 or (got & np.uint64(1)):
        return anchor[0], anchor[1], anchor[2], anchor[3], anchor[4], anchor[5], anchor[6], anchor[7], anchor[8]
    own, other = ring.motion[e, row, a], ring.motion[e, row, b]
    r_x, r_y, theta, _, _, pxx, pxy, pxt, pyy, pyt, ptt = leap(
        anchor, own, other, True, ring.clock[e, row, 0], ring.clock[e, row, 1], options
    )
    return r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt
