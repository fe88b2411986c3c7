"""Anchors of the pose filter: what is remembered between two updates, and the prediction from one to the next.

Everything here works on records of lanes (`kernels.lanes`).
"""

from typing import NamedTuple

import numpy as np

from relloc_env.kernels import relative_pose as rp
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.depth_state import choose, put_six, six
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.lanes import record
from relloc_env.kernels.motion import arc

DEAD_RECKONING = record(x=1, y=1, theta=1, cos=1, sin=1)
"""[m, m, rad, -, -] pose in the frame where dead reckoning began, cosine and sine of theta."""
MOTION = record(at=DEAD_RECKONING, v=1, lateral=1, yaw_rate=1, noise=6)
"""The motion of a robot.

- at: its dead reckoning.
- v, lateral, yaw_rate: [m/s, m/s, rad/s] its velocity over the last interval.
- noise: covariance of the dead reckoning, upper triangle by rows, carried in the frame where it began, so that the
  difference of two is what the motion between them added.
"""
CLOCK = record(time=1, steps=1)
"""[s, -] time since the start, and samples over which time passed."""
POSE = record(x=1, y=1, theta=1, covariance=6)
"""[m, m, rad] a pose, and its covariance, upper triangle by rows."""
ANCHOR = record(
    pose=POSE, cos=1, sin=1, time=1, steps=1, own=DEAD_RECKONING, other=DEAD_RECKONING,
    v=1, lateral=1, yaw_rate=1, own_noise=6, other_noise=6,
)  # fmt: skip
"""The state of the pose filter of a pair (A observes, B is observed) just after an update.

- pose: xi of B in {A}. cos, sin: [-] of its theta.
- time, steps: the clock then. own, other: dead reckoning of A and of B then.
- v, lateral, yaw_rate: [m/s, m/s, rad/s] velocity of B. own_noise, other_noise: `MOTION.noise` of A and of B.
"""
PLANE_POINT = record(x=1, y=1, xx=1, xy=1, yy=1, usable=1)
"""[m, m, m², m², m², -] a point in the plane of a robot's body, its covariance, 1 where the pose filter may use it."""
UPDATE = record(heard=1, pose=POSE, cos=1, sin=1)
"""Of an update: 1 where the message of this sample has come, else 0; and what a point makes of the anchor's pose."""

OPTIONS = np.dtype(
    [("model", np.int64), ("from_depth", np.bool_), ("from_odometry", np.bool_)]
    + [(name, np.float64) for name in ("variance", "process", "var_v", "var_w", "hold_v", "hold_w")]
)
"""`FilterOptions` as a record, which is what Python hands over."""


class FilterOptions(NamedTuple):
    """Options of the pose filter."""

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
def filter_options(options):
    """FilterOptions from a record `OPTIONS`."""
    o = options
    return FilterOptions(
        o.model, o.from_depth, o.variance, o.from_odometry, o.process, o.var_v, o.var_w, o.hold_v, o.hold_w
    )


@kernel
def reckon(motion, interval, var_v, var_w, width):
    """Carry the dead reckoning of a robot over one sample, in all lanes, and fill in the arc of the interval.

    Args:
        motion: `MOTION`, changed in place.
        interval: `depth_state.INTERVAL` with length and velocity; its arc is written.
        var_v, var_w: [m²/s², rad²/s²] variance of a sample's measured speed and yaw rate.
        width: lanes to work on.
    """
    at = motion.at
    for i in range(width):
        v, lateral, w, dt = interval.v[i], interval.lateral[i], interval.yaw_rate[i], interval.dt[i]
        c_x, c_y, delta = arc(v, lateral, w, dt)
        sin_d, cos_d = sin_cos(delta)
        interval.chord_x[i], interval.chord_y[i] = c_x, c_y
        interval.cos[i], interval.sin[i] = cos_d, sin_d
        cos, sin = at.cos[i], at.sin[i]
        x, y = at.x[i] + cos * c_x - sin * c_y, at.y[i] + sin * c_x + cos * c_y
        cos, sin = cos * cos_d - sin * sin_d, sin * cos_d + cos * sin_d
        unit = 1.5 - 0.5 * (cos * cos + sin * sin)
        cos, sin = cos * unit, sin * unit
        at.x[i], at.y[i], at.theta[i] = x, y, at.theta[i] + delta
        at.cos[i], at.sin[i] = cos, sin
        motion.v[i], motion.lateral[i], motion.yaw_rate[i] = v, lateral, w
        a_x, a_y, b_x, b_y = rp.arc_jacobian(v, lateral, w, dt)
        # from the body frame at the end to the frame where dead reckoning began: e = [[R, -J p], [0, 1]] n
        a_x, a_y = cos * a_x - sin * a_y, sin * a_x + cos * a_y
        b_x, b_y = cos * b_x - sin * b_y + dt * y, sin * b_x + cos * b_y - dt * x
        added = rp.displacement_noise(a_x, a_y, b_x, b_y, dt, var_v, var_w)
        put_six(motion.noise, i, _sum(six(motion.noise, i), added))


@inlined
def _sum(a, b):
    """Sum of two covariances."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]


@inlined
def _between(then, now, i):
    """Displacement from a dead reckoning to a later one.

    Returns:
        (c_x, c_y, delta, cos, sin): [m, m, rad, -, -] chord and turn, cosine and sine of the turn.
    """
    d_x, d_y = now.x[i] - then.x[i], now.y[i] - then.y[i]
    cos0, sin0 = then.cos[i], then.sin[i]
    cos1, sin1 = now.cos[i], now.sin[i]
    return (
        cos0 * d_x + sin0 * d_y,
        cos0 * d_y - sin0 * d_x,
        now.theta[i] - then.theta[i],
        cos0 * cos1 + sin0 * sin1,
        cos0 * sin1 - sin0 * cos1,
    )


@inlined
def _added(then, now, i):
    """What the motion between two times added to the covariance of dead reckoning, from those at both."""
    b, c = six(now, i), six(then, i)
    return b[0] - c[0], b[1] - c[1], b[2] - c[2], b[3] - c[3], b[4] - c[4], b[5] - c[5]


@inlined
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


@inlined
def leap(anchor, own, other, clock, i, held, options):
    """Predict from the anchor to the time of the clock, lane `i`.

    Args:
        anchor: `ANCHOR`.
        own, other: `MOTION` of A and of B now.
        clock: `CLOCK`.
        i: lane.
        held: whether B's motion is unknown: its last known velocity is held, `other` is not read.
        options: FilterOptions.

    Returns:
        (r_x, r_y, theta, cos, sin, six numbers): the pose, cosine and sine of its theta, its covariance.
    """
    dt, steps = clock.time[i] - anchor.time[i], clock.steps[i] - anchor.steps[i]
    c_ax, c_ay, delta_a, cos_a, sin_a = _between(anchor.own, own.at, i)
    if held:
        c_bx, c_by, delta_b = arc(anchor.v[i], anchor.lateral[i], anchor.yaw_rate[i], dt)
        sin_b, cos_b = sin_cos(delta_b)
    else:
        c_bx, c_by, delta_b, cos_b, sin_b = _between(anchor.other, other.at, i)
    cos_t, sin_t = anchor.cos[i], anchor.sin[i]
    r_x, r_y, theta, d_x, d_y = rp.predict_rotated(
        anchor.pose.x[i],
        anchor.pose.y[i],
        anchor.pose.theta[i],
        cos_t,
        sin_t,
        c_ax,
        c_ay,
        delta_a,
        cos_a,
        sin_a,
        c_bx,
        c_by,
        delta_b,
    )
    p = rp.propagate(cos_a, sin_a, -d_y, d_x, six(anchor.pose.covariance, i))
    cos_d, sin_d = cos_a * cos_b + sin_a * sin_b, cos_a * sin_b - sin_a * cos_b
    cos, sin = cos_t * cos_d - sin_t * sin_d, sin_t * cos_d + cos_t * sin_d
    unit = 1.5 - 0.5 * (cos * cos + sin * sin)
    cos, sin = cos * unit, sin * unit
    if options.from_odometry:
        n = _added(anchor.own_noise, own.noise, i)
        p = _sum(p, rp.noise_of_a(r_x, r_y, own.at.x[i], own.at.y[i], own.at.cos[i], own.at.sin[i], n))
        if not held:
            n = _added(anchor.other_noise, other.noise, i)
            p = _sum(p, rp.noise_of_b(cos, sin, other.at.x[i], other.at.y[i], other.at.cos[i], other.at.sin[i], n))
    else:
        noise = options.process * steps
        p = _sum(p, (noise, 0.0, 0.0, noise, 0.0, noise))
    if held:
        square = dt * dt / steps if options.from_odometry and steps > 0.0 else 0.0
        sin_h, cos_h = sin_cos(0.5 * delta_b)
        var_v, var_w = options.var_v * square, options.var_w * square
        n = held_noise(c_bx, c_by, cos_h, sin_h, dt, var_v, var_w, options.hold_v, options.hold_w)
        p = _sum(p, rp.noise_of_b(cos, sin, c_bx, c_by, cos_b, sin_b, n))
    return r_x, r_y, theta, cos, sin, p


@inlined
def move_anchor(anchor, own, other, clock, i, options):
    """Put the anchor of lane `i` at the time of the clock, where a message of B was made; its points are to come."""
    anchor.pose.x[i], anchor.pose.y[i], anchor.pose.theta[i], anchor.cos[i], anchor.sin[i], p = leap(
        anchor, own, other, clock, i, False, options
    )
    put_six(anchor.pose.covariance, i, p)
    anchor.time[i], anchor.steps[i] = clock.time[i], clock.steps[i]
    _take_over(anchor.own, own.at, i)
    _take_over(anchor.other, other.at, i)
    anchor.v[i], anchor.lateral[i], anchor.yaw_rate[i] = other.v[i], other.lateral[i], other.yaw_rate[i]
    put_six(anchor.own_noise, i, six(own.noise, i))
    put_six(anchor.other_noise, i, six(other.noise, i))


@inlined
def _take_over(target, source, i):
    """Copy a dead reckoning."""
    target.x[i], target.y[i], target.theta[i] = source.x[i], source.y[i], source.theta[i]
    target.cos[i], target.sin[i] = source.cos[i], source.sin[i]


@inlined
def take_point(anchor, update, own, other, own_point, other_point, i, options):
    """What a point makes of the anchor's pose of lane `i`: the same as before, where it may not be used.

    It may where it has been heard from B and both robots know it. `accept` follows, in a loop of its own.

    Args:
        anchor: `ANCHOR`.
        update: `UPDATE`, written.
        own, other: `MOTION` of A and of B, whose velocities some models need.
        own_point, other_point: `PLANE_POINT` as A and as B knows it.
        i: lane.
        options: FilterOptions.
    """
    use = (update.heard[i] != 0.0) & (own_point.usable[i] != 0.0) & (other_point.usable[i] != 0.0)
    cos, sin, w_a = anchor.cos[i], anchor.sin[i], own.yaw_rate[i]
    old = six(anchor.pose.covariance, i)
    y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t = rp.observe(
        options.model, anchor.pose.x[i], anchor.pose.y[i], cos, sin,
        own_point.x[i], own_point.y[i], other_point.x[i], other_point.y[i],
        own.v[i], own.lateral[i], w_a, other.v[i], other.lateral[i],
    )  # fmt: skip
    n_xx, n_xy, n_yy = options.variance, 0.0, options.variance
    if options.from_depth:
        n_xx, n_xy, n_yy = rp.observe_covariance(
            options.model, cos, sin, w_a, own_point.xx[i], own_point.xy[i], own_point.yy[i],
            other_point.xx[i], other_point.xy[i], other_point.yy[i], options.variance,
        )  # fmt: skip
    r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt = rp.correct(
        anchor.pose.x[i], anchor.pose.y[i], anchor.pose.theta[i], old,
        y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t, n_xx, n_xy, n_yy,
    )  # fmt: skip
    sin_new, cos_new = sin_cos(theta)
    update.pose.x[i], update.pose.y[i] = r_x if use else anchor.pose.x[i], r_y if use else anchor.pose.y[i]
    update.pose.theta[i] = theta if use else anchor.pose.theta[i]
    put_six(update.pose.covariance, i, choose(use, (pxx, pxy, pxt, pyy, pyt, ptt), old))
    update.cos[i], update.sin[i] = cos_new if use else cos, sin_new if use else sin


@inlined
def accept(anchor, update, i):
    """The anchor of lane `i` is what `take_point` found."""
    anchor.pose.x[i], anchor.pose.y[i], anchor.pose.theta[i] = update.pose.x[i], update.pose.y[i], update.pose.theta[i]
    put_six(anchor.pose.covariance, i, six(update.pose.covariance, i))
    anchor.cos[i], anchor.sin[i] = update.cos[i], update.sin[i]
