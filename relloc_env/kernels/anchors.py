"""Anchors of the pose filter: what is remembered between two updates, and the prediction from one to the next.

The arrays are tables: rows of numbers, one row per element of the leading axes (row-major), for P pairs:

- `motion` (N, L, R; 14): dead reckoning x, y, theta, cos theta, sin theta; velocity v, l, w; covariance of the dead
  reckoning, carried in the frame where it began (upper triangle), so that the difference of two is what the motion
  between them added.
- `clock` (N, L; 2): time since the start, and the number of samples since then over which time passed.
- `point` (N, L, R, M; 5): q_x, q_y and its covariance xx, xy, yy, in the body frame; `usable` (N, L, R, M): bool.
- `anchor` (N, P, L + 1; 38), (N, P, 1; 38) if L is 1: xi, its covariance; time and sample count; dead reckoning of A
  (5), of B (5); velocity of B; covariance of the dead reckoning of A (6), of B (6); cos and sin of theta. The last
  row of a pair is the anchor before the ring.
- `received` (N, P): bit j tells whether the message of age j has been taken in.
"""

import math
from typing import NamedTuple

import numpy as np

from relloc_env.kernels import relative_pose as rp
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import arc

MOTION, CLOCK, POINT, ANCHOR = 14, 2, 5, 38

# first columns within an anchor
TIME, STEPS, OWN, OTHER, SPEED, OWN_NOISE, OTHER_NOISE, COS, SIN = 9, 10, 11, 16, 21, 24, 30, 36, 37


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
    hold_v: float
    """[m²/s²] variance of the difference between B's speed and the last one heard, while no message comes."""
    hold_w: float
    """[rad²/s²] the same for its yaw rate."""


@kernel
def filter_options(numbers):
    """FilterOptions from a float64 array of the same order (quicker to hand over than a tuple)."""
    n = numbers
    return FilterOptions(int(n[0]), n[1] != 0.0, n[2], n[3] != 0.0, n[4], n[5], n[6], n[7], n[8])


class Sizes(NamedTuple):
    """Sizes that the tables do not show."""

    length: int
    """L, of the ring."""
    robots: int
    """R"""
    points: int
    """M"""
    pairs: int
    """P"""


class Tables(NamedTuple):
    """Tables of the filter; see the top of this file.

    Kernels that run once per sample take them one by one: taking an array out of a tuple counts references, which
    costs as much as a good part of an update.
    """

    motion: np.ndarray
    clock: np.ndarray
    point: np.ndarray
    usable: np.ndarray
    anchor: np.ndarray
    received: np.ndarray


@kernel
def first_anchor(e, p, sizes):
    """Index of the anchor in row 0 of the ring, of pair `p` of environment `e`; that before the ring is L later."""
    return (e * sizes.pairs + p) * (sizes.length + 1 if sizes.length > 1 else 1)


@kernel
def start(e, prior, sd, sizes, tables):
    """Start environment `e` from the prior poses (N, P, 3) with standard deviations sd (3,)."""
    length = sizes.length
    per = length * sizes.robots
    tables.motion[e * per : (e + 1) * per] = 0.0
    tables.motion[e * per : (e + 1) * per, 3] = 1.0
    tables.clock[e * length : (e + 1) * length] = 0.0
    per *= sizes.points
    tables.point[e * per : (e + 1) * per] = 0.0
    tables.usable[e * per : (e + 1) * per] = False
    tables.received[e] = 0
    for p in range(sizes.pairs):
        first = first_anchor(e, p, sizes)
        base = first + length if length > 1 else first
        anchor = tables.anchor
        anchor[first : base + 1] = 0.0
        for i in range(3):
            anchor[base, i] = prior[e, p, i]
        anchor[base, 3], anchor[base, 6], anchor[base, 8] = sd[0] ** 2, sd[1] ** 2, sd[2] ** 2
        anchor[base, OWN + 3] = 1.0
        anchor[base, OTHER + 3] = 1.0


@kernel
def move(motion, old, new, v, lateral, w, dt, c_x, c_y, delta, cos_d, sin_d, options):
    """Carry the dead reckoning of a robot over one sample.

    Args:
        motion: table; old, new: its rows before and after, may be the same.
        v, lateral, w: [m/s, m/s, rad/s] measured velocity.
        dt: [s] length of the interval.
        c_x, c_y, delta, cos_d, sin_d: its arc: chord [m], turn [rad], cosine and sine of the turn.
        options: FilterOptions.
    """
    theta, cos, sin = motion[old, 2], motion[old, 3], motion[old, 4]
    x, y = motion[old, 0] + cos * c_x - sin * c_y, motion[old, 1] + sin * c_x + cos * c_y
    cos, sin = cos * cos_d - sin * sin_d, sin * cos_d + cos * sin_d
    unit = 1.5 - 0.5 * (cos * cos + sin * sin)
    cos, sin = cos * unit, sin * unit
    motion[new, 0], motion[new, 1], motion[new, 2], motion[new, 3], motion[new, 4] = x, y, theta + delta, cos, sin
    motion[new, 5], motion[new, 6], motion[new, 7] = v, lateral, w
    if options.from_odometry:
        a_x, a_y, b_x, b_y = rp.arc_jacobian(v, lateral, w, dt)
        # from the body frame at the end to the frame where dead reckoning began: e = [[R, -J p], [0, 1]] n
        a_x, a_y = cos * a_x - sin * a_y, sin * a_x + cos * a_y
        b_x, b_y = cos * b_x - sin * b_y + dt * y, sin * b_x + cos * b_y - dt * x
        nxx, nxy, nxt, nyy, nyt, ntt = rp.displacement_noise(a_x, a_y, b_x, b_y, dt, options.var_v, options.var_w)
        motion[new, 8], motion[new, 9], motion[new, 10] = (
            motion[old, 8] + nxx,
            motion[old, 9] + nxy,
            motion[old, 10] + nxt,
        )
        motion[new, 11], motion[new, 12], motion[new, 13] = (
            motion[old, 11] + nyy,
            motion[old, 12] + nyt,
            motion[old, 13] + ntt,
        )


@kernel
def between(anchor, i, first, motion, j):
    """Displacement from the dead reckoning in row `i` of `anchor`, columns from `first` on, to row `j` of `motion`.

    Returns:
        (c_x, c_y, delta, cos, sin): [m, m, rad, -, -] chord and turn, cosine and sine of the turn.
    """
    d_x, d_y = motion[j, 0] - anchor[i, first], motion[j, 1] - anchor[i, first + 1]
    cos0, sin0 = anchor[i, first + 3], anchor[i, first + 4]
    cos1, sin1 = motion[j, 3], motion[j, 4]
    return (
        cos0 * d_x + sin0 * d_y,
        cos0 * d_y - sin0 * d_x,
        motion[j, 2] - anchor[i, first + 2],
        cos0 * cos1 + sin0 * sin1,
        cos0 * sin1 - sin0 * cos1,
    )


@kernel
def added_noise(anchor, i, first, motion, j):
    """What the motion from row `i` of `anchor` to row `j` of `motion` added to the covariance of dead reckoning."""
    return (
        motion[j, 8] - anchor[i, first],
        motion[j, 9] - anchor[i, first + 1],
        motion[j, 10] - anchor[i, first + 2],
        motion[j, 11] - anchor[i, first + 3],
        motion[j, 12] - anchor[i, first + 4],
        motion[j, 13] - anchor[i, first + 5],
    )


@kernel
def held_noise(c_x, c_y, cos_h, sin_h, dt, var_v, var_w, hold_v, hold_w):
    """Noise of a displacement predicted with a held velocity, in the body frame at its start.

    In the frame at the start a small turn at the place c t of the path (its chord, t in [0, 1]) moves the end by
    [-J c t, 1]. White noise of the velocity and a constant error of it are summed along the path.

    Args:
        c_x, c_y: [m] chord.
        cos_h, sin_h: of half the turn: the mean heading.
        dt: [s] duration.
        var_v, var_w: [m²; rad²] variances of path length and turn from the noise of single samples.
        hold_v, hold_w: [m²/s², rad²/s²] variances of the error of the held velocity.

    Returns:
        (xx, xy, xt, yy, yt, tt): upper triangle.
    """
    along = var_v + hold_v * dt * dt
    held = hold_w * dt * dt
    turn, lever = var_w + held, var_w / 3.0 + 0.25 * held
    return (
        along * cos_h * cos_h + lever * c_y * c_y,
        along * cos_h * sin_h - lever * c_x * c_y,
        0.5 * turn * c_y,
        along * sin_h * sin_h + lever * c_x * c_x,
        -0.5 * turn * c_x,
        turn,
    )


@kernel
def leap(anchor, i, motion, own, other, held, time, steps, options):
    """Predict from an anchor to a sample of the ring: pose and covariance there.

    Args:
        anchor, i: table, and its row to start from.
        motion, own, other: table, and its rows of A and of B at the sample.
        held: whether B's motion up to the sample is unknown: its last known velocity is held, `other` is not read.
        time, steps: [s] and count of the sample (see `clock`).
        options: FilterOptions.

    Returns:
        (r_x, r_y, theta, cos, sin, pxx, pxy, pxt, pyy, pyt, ptt): cos and sin of the predicted theta.
    """
    dt, steps = time - anchor[i, TIME], steps - anchor[i, STEPS]
    c_ax, c_ay, delta_a, cos_a, sin_a = between(anchor, i, OWN, motion, own)
    if held:
        c_bx, c_by, delta_b = arc(anchor[i, SPEED], anchor[i, SPEED + 1], anchor[i, SPEED + 2], dt)
        cos_b, sin_b = math.cos(delta_b), math.sin(delta_b)
    else:
        c_bx, c_by, delta_b, cos_b, sin_b = between(anchor, i, OTHER, motion, other)
    cos_t, sin_t = math.cos(anchor[i, 2]), math.sin(anchor[i, 2])
    r_x, r_y, theta, d_x, d_y = rp.predict_rotated(
        anchor[i, 0], anchor[i, 1], anchor[i, 2], cos_t, sin_t, c_ax, c_ay, delta_a, cos_a, sin_a, c_bx, c_by, delta_b
    )
    pxx, pxy, pxt, pyy, pyt, ptt = rp.propagate(
        cos_a, sin_a, -d_y, d_x, anchor[i, 3], anchor[i, 4], anchor[i, 5], anchor[i, 6], anchor[i, 7], anchor[i, 8]
    )
    cos_d, sin_d = cos_a * cos_b + sin_a * sin_b, cos_a * sin_b - sin_a * cos_b
    cos, sin = cos_t * cos_d - sin_t * sin_d, sin_t * cos_d + cos_t * sin_d
    if options.from_odometry:
        n = added_noise(anchor, i, OWN_NOISE, motion, own)
        n = rp.noise_of_a(r_x, r_y, motion[own, 0], motion[own, 1], motion[own, 3], motion[own, 4], *n)
        pxx, pxy, pxt, pyy, pyt, ptt = pxx + n[0], pxy + n[1], pxt + n[2], pyy + n[3], pyt + n[4], ptt + n[5]
        if not held:
            n = added_noise(anchor, i, OTHER_NOISE, motion, other)
            x, y, cos_o, sin_o = motion[other, 0], motion[other, 1], motion[other, 3], motion[other, 4]
            n = rp.noise_of_b(cos, sin, x, y, cos_o, sin_o, *n)
            pxx, pxy, pxt, pyy, pyt, ptt = pxx + n[0], pxy + n[1], pxt + n[2], pyy + n[3], pyt + n[4], ptt + n[5]
    else:
        noise = options.process * steps
        pxx, pyy, ptt = pxx + noise, pyy + noise, ptt + noise
    if held:
        square = dt * dt / steps if options.from_odometry and steps > 0.0 else 0.0
        cos_h, sin_h = math.cos(0.5 * delta_b), math.sin(0.5 * delta_b)
        var_v, var_w = options.var_v * square, options.var_w * square
        n = held_noise(c_bx, c_by, cos_h, sin_h, dt, var_v, var_w, options.hold_v, options.hold_w)
        n = rp.noise_of_b(cos, sin, c_bx, c_by, cos_b, sin_b, *n)
        pxx, pxy, pxt, pyy, pyt, ptt = pxx + n[0], pxy + n[1], pxt + n[2], pyy + n[3], pyt + n[4], ptt + n[5]
    return r_x, r_y, theta, cos, sin, pxx, pxy, pxt, pyy, pyt, ptt
