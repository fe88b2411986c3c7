"""Anchors of the pose filter: what is remembered between two updates, and the prediction from one to the next.

Everything here works on a workspace (`kernels.lanes`): the places below are those of lane 0. An anchor is xi, its
covariance; its time and sample count; the dead reckoning of A and of B then; the velocity of B; cosine and sine of
theta; the covariance of both dead reckonings. The motion of a robot is its dead reckoning x, y, theta, cos theta, sin
theta; its velocity v, l, w; and the covariance of its dead reckoning, carried in the frame where it began (upper
triangle), so that the difference of two is what the motion between them added.
"""

from typing import NamedTuple

from relloc_env.kernels import depth_state as ds
from relloc_env.kernels import relative_pose as rp
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.lanes import W
from relloc_env.kernels.motion import arc

MOTION, CLOCK, ANCHOR, POINT = 14, 2, 38, 8
"""Numbers of a motion; of the clock: time [s] and samples since the start over which time passed; of an anchor; and
of a point: the first seven from `depth_state.Q_X` on, and whether it may be used."""
P_X, P_Y, P_XX, P_XY, P_YY, USABLE = 0 * W, 1 * W, 3 * W, 4 * W, 6 * W, 7 * W
"""Of a point: q_x, q_y in the plane of the body, their covariance, 1 where it may be used."""
PLAIN_MOTION, PLAIN_ANCHOR = 8, 26
"""Those that are kept where the covariance of dead reckoning, which comes last, is not used."""

_TIME, _STEPS, _OWN, _OTHER, _SPEED = 9 * W, 10 * W, 11 * W, 16 * W, 21 * W
_COS, _SIN, _OWN_NOISE, _OTHER_NOISE = 24 * W, 25 * W, 26 * W, 32 * W
_X, _Y, _THETA, _M_COS, _M_SIN, _V, _LATERAL, _YAW_RATE, _NOISE = (k * W for k in range(9))

# Places in the workspace, after those of `depth_state`.
BASE = ds.WORKSPACE * W
"""The anchor."""
OWN, OTHER = BASE + ANCHOR * W, BASE + (ANCHOR + MOTION) * W
"""Motions of A and B."""
NOW = OTHER + MOTION * W
"""The clock."""
OWN_POINT, OTHER_POINT = NOW + CLOCK * W, NOW + (CLOCK + POINT) * W
"""A point as A and as B knows it."""
HEARD = OTHER_POINT + POINT * W
"""1 where the message of this sample has come, else 0."""
POSE = HEARD + W
"""The pose now (3) and its covariance (6)."""
NEXT = POSE + 9 * W
"""What an update makes of the pose (3), its covariance (6), cosine and sine of theta."""
WORKSPACE = NEXT // W + 11
"""Numbers in a workspace."""


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


@kernel
def reckon(t, var_v, var_w, width):
    """Carry the dead reckoning of a robot, at `OWN`, over one sample (the interval of `depth_state`), in all lanes.

    Fills in the arc of that interval too.
    """
    for i in range(width):
        v, lateral, w, dt = t[i + ds.V], t[i + ds.LATERAL], t[i + ds.YAW_RATE], t[i + ds.DT]
        c_x, c_y, delta = arc(v, lateral, w, dt)
        sin_d, cos_d = sin_cos(delta)
        t[i + ds.CHORD_X], t[i + ds.CHORD_Y], t[i + ds.DELTA] = c_x, c_y, delta
        t[i + ds.COS], t[i + ds.SIN] = cos_d, sin_d
        m = i + OWN
        cos, sin = t[m + _M_COS], t[m + _M_SIN]
        x, y = t[m + _X] + cos * c_x - sin * c_y, t[m + _Y] + sin * c_x + cos * c_y
        cos, sin = cos * cos_d - sin * sin_d, sin * cos_d + cos * sin_d
        unit = 1.5 - 0.5 * (cos * cos + sin * sin)
        cos, sin = cos * unit, sin * unit
        t[m + _X], t[m + _Y], t[m + _THETA] = x, y, t[m + _THETA] + delta
        t[m + _M_COS], t[m + _M_SIN] = cos, sin
        t[m + _V], t[m + _LATERAL], t[m + _YAW_RATE] = v, lateral, w
        a_x, a_y, b_x, b_y = rp.arc_jacobian(v, lateral, w, dt)
        # from the body frame at the end to the frame where dead reckoning began: e = [[R, -J p], [0, 1]] n
        a_x, a_y = cos * a_x - sin * a_y, sin * a_x + cos * a_y
        b_x, b_y = cos * b_x - sin * b_y + dt * y, sin * b_x + cos * b_y - dt * x
        added = rp.displacement_noise(a_x, a_y, b_x, b_y, dt, var_v, var_w)
        ds.put_six(t, m + _NOISE, _sum(ds.six(t, m + _NOISE), added))


@inlined
def _sum(a, b):
    """Sum of two covariances."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]


@inlined
def _between(t, a, m):
    """Displacement from the dead reckoning at `a` (within an anchor) to that of the motion at `m`.

    Returns:
        (c_x, c_y, delta, cos, sin): [m, m, rad, -, -] chord and turn, cosine and sine of the turn.
    """
    d_x, d_y = t[m + _X] - t[a + _X], t[m + _Y] - t[a + _Y]
    cos0, sin0 = t[a + _M_COS], t[a + _M_SIN]
    cos1, sin1 = t[m + _M_COS], t[m + _M_SIN]
    return (
        cos0 * d_x + sin0 * d_y,
        cos0 * d_y - sin0 * d_x,
        t[m + _THETA] - t[a + _THETA],
        cos0 * cos1 + sin0 * sin1,
        cos0 * sin1 - sin0 * cos1,
    )


@inlined
def _added(t, a, m):
    """What the motion from an anchor (noise at `a`) to `m` added to the covariance of dead reckoning."""
    b, c = ds.six(t, m + _NOISE), ds.six(t, a)
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
def leap(t, i, held, options):
    """Predict from the anchor to the time of the clock, lane `i`.

    Args:
        t: workspace.
        i: lane.
        held: whether B's motion is unknown: its last known velocity is held, `OTHER` is not read.
        options: FilterOptions.

    Returns:
        (r_x, r_y, theta, cos, sin, six numbers): the pose, cosine and sine of its theta, its covariance.
    """
    a, own, other = i + BASE, i + OWN, i + OTHER
    dt, steps = t[i + NOW] - t[a + _TIME], t[i + NOW + W] - t[a + _STEPS]
    c_ax, c_ay, delta_a, cos_a, sin_a = _between(t, a + _OWN, own)
    if held:
        c_bx, c_by, delta_b = arc(t[a + _SPEED], t[a + _SPEED + W], t[a + _SPEED + 2 * W], dt)
        sin_b, cos_b = sin_cos(delta_b)
    else:
        c_bx, c_by, delta_b, cos_b, sin_b = _between(t, a + _OTHER, other)
    cos_t, sin_t = t[a + _COS], t[a + _SIN]
    r_x, r_y, theta, d_x, d_y = rp.predict_rotated(
        t[a], t[a + W], t[a + 2 * W], cos_t, sin_t, c_ax, c_ay, delta_a, cos_a, sin_a, c_bx, c_by, delta_b
    )
    p = rp.propagate(cos_a, sin_a, -d_y, d_x, ds.six(t, a + 3 * W))
    cos_d, sin_d = cos_a * cos_b + sin_a * sin_b, cos_a * sin_b - sin_a * cos_b
    cos, sin = cos_t * cos_d - sin_t * sin_d, sin_t * cos_d + cos_t * sin_d
    unit = 1.5 - 0.5 * (cos * cos + sin * sin)
    cos, sin = cos * unit, sin * unit
    if options.from_odometry:
        n = _added(t, a + _OWN_NOISE, own)
        p = _sum(p, rp.noise_of_a(r_x, r_y, t[own + _X], t[own + _Y], t[own + _M_COS], t[own + _M_SIN], n))
        if not held:
            n = _added(t, a + _OTHER_NOISE, other)
            x, y, cos_o, sin_o = t[other + _X], t[other + _Y], t[other + _M_COS], t[other + _M_SIN]
            p = _sum(p, rp.noise_of_b(cos, sin, x, y, cos_o, sin_o, n))
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
def move_anchor(t, i, options):
    """Put the anchor of lane `i` at the time of the clock, where a message of B was made; its points are to come."""
    a, own, other = i + BASE, i + OWN, i + OTHER
    t[a], t[a + W], t[a + 2 * W], t[a + _COS], t[a + _SIN], p = leap(t, i, False, options)
    ds.put_six(t, a + 3 * W, p)
    t[a + _TIME], t[a + _STEPS] = t[i + NOW], t[i + NOW + W]
    _take_over(t, a + _OWN, own)
    _take_over(t, a + _OTHER, other)
    v, to = other + _V, a + _SPEED
    t[to], t[to + W], t[to + 2 * W] = t[v], t[v + W], t[v + 2 * W]
    ds.put_six(t, a + _OWN_NOISE, ds.six(t, own + _NOISE))
    ds.put_six(t, a + _OTHER_NOISE, ds.six(t, other + _NOISE))


@inlined
def _take_over(t, a, m):
    """Copy the dead reckoning of a motion into an anchor."""
    t[a], t[a + W], t[a + 2 * W], t[a + 3 * W], t[a + 4 * W] = t[m], t[m + W], t[m + 2 * W], t[m + 3 * W], t[m + 4 * W]


@inlined
def take_point(t, i, options):
    """What the point makes of the anchor of lane `i`, to `NEXT`: the same as before, where it may not be used.

    It may where it has been heard from B and both robots know it. `accept` follows, in a loop of its own.
    """
    a, own, other, p, q = i + BASE, i + OWN, i + OTHER, i + OWN_POINT, i + OTHER_POINT
    use = (t[i + HEARD] != 0.0) & (t[p + USABLE] != 0.0) & (t[q + USABLE] != 0.0)
    cos, sin, w_a = t[a + _COS], t[a + _SIN], t[own + _YAW_RATE]
    old = ds.six(t, a + 3 * W)
    y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t = rp.observe(
        options.model, t[a], t[a + W], cos, sin, t[p + P_X], t[p + P_Y], t[q + P_X], t[q + P_Y],
        t[own + _V], t[own + _LATERAL], w_a, t[other + _V], t[other + _LATERAL],
    )  # fmt: skip
    n_xx, n_xy, n_yy = options.variance, 0.0, options.variance
    if options.from_depth:
        n_xx, n_xy, n_yy = rp.observe_covariance(
            options.model, cos, sin, w_a, t[p + P_XX], t[p + P_XY], t[p + P_YY],
            t[q + P_XX], t[q + P_XY], t[q + P_YY], options.variance,
        )  # fmt: skip
    r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt = rp.correct(
        t[a], t[a + W], t[a + 2 * W], old, y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t, n_xx, n_xy, n_yy
    )
    sin_new, cos_new = sin_cos(theta)
    n = i + NEXT
    t[n], t[n + W], t[n + 2 * W] = r_x if use else t[a], r_y if use else t[a + W], theta if use else t[a + 2 * W]
    ds.put_six(t, n + 3 * W, ds.choose(use, (pxx, pxy, pxt, pyy, pyt, ptt), old))
    t[n + 9 * W], t[n + 10 * W] = cos_new if use else cos, sin_new if use else sin


@inlined
def accept(t, i):
    """The anchor of lane `i` is what `take_point` found."""
    a, n = i + BASE, i + NEXT
    t[a], t[a + W], t[a + 2 * W] = t[n], t[n + W], t[n + 2 * W]
    ds.put_six(t, a + 3 * W, ds.six(t, n + 3 * W))
    t[a + _COS], t[a + _SIN] = t[n + 9 * W], t[n + 10 * W]
