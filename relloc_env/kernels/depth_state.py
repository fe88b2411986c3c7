"""The depth observers of a batch, in lanes (`kernels.lanes`): a `POINT` each, advanced sample by sample.

All zeros at the start of an episode; copied, they save and restore an environment. They hold two views of one point:

- now: the point (q_x, q_y, height) in the robot's body frame and its covariance, at the latest sample. Regular beside
  and behind the camera, where image coordinates are not.
- base: the observer's state (x_hat, y_hat, chi_hat), its covariance and the measured s at the last measured sample,
  with the motion since. The next measured sample redoes one observer step from there, so a camera slower than the
  odometry is followed at second order, and what lies between frames is a prediction.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.depth_covariance import body_to_image, covariance_step, image_to_body, move_covariance
from relloc_env.kernels.depth_observer import (
    correct,
    gains,
    interval_means,
    is_slow,
    mean_decay,
    modes,
    slow_mean_decay,
    slow_modes,
)
from relloc_env.kernels.lanes import record

POINT = record(
    known=1, q_x=1, q_y=1, height=1, covariance=6, time=1, x=1, y=1, x_hat=1, y_hat=1, chi_hat=1, base_covariance=6,
    forward=1, side=1, turn=1, squares=1,
)  # fmt: skip
"""What is remembered of a point:

- known: 1 once the point has been seen, else 0.
- q_x, q_y, height: [m] the point now, in the body frame; height above the camera (0 for a sensor without heights).
- covariance: of (q_x, q_y, height), upper triangle by rows.
- time: [s] since the last measured sample: 0 where the point is seen now.
- x, y: [-] the last measured image coordinates.
- x_hat, y_hat, chi_hat: [-, -, 1/m] the observer's state at the last measured sample.
- base_covariance: of (x_hat, y_hat, chi_hat), upper triangle by rows.
- forward, side, turn, squares: [m, m, rad, s²] sums of v dt, l dt, w dt and dt² since then.
"""
INTERVAL = record(dt=1, v=1, lateral=1, yaw_rate=1, chord_x=1, chord_y=1, cos=1, sin=1)
"""The motion of a robot over the interval before a sample.

- dt: [s] its length. v, lateral, yaw_rate: [m/s, m/s, rad/s] measured velocity.
- chord_x, chord_y: [m] its arc (`motion.arc`). cos, sin: [-] of the turn.
"""
MEASUREMENT = record(seen=1, x=1, y=1, guess=1, depth_sd=1, gain_h=1, gain_alpha=1)
"""What a sample says of a point, and with which gains its observer works.

- seen: 1 where the point is measured, else 0. x, y: [-] where; y may be NaN, for bearings without heights.
- guess, depth_sd: [m] depth at first sight, and its standard deviation.
- gain_h, gain_alpha: [1/s, 1/m²] H and alpha Lambda.
"""
STEP = record(route=1, mean_x=1, mean_y=1, mean_xx=1, mean_xy=1, h=1, s_0=1, s=1, integral=1, decay=1, covariance=6)
"""One observer step: its route (below), `interval_means`, H [1/s], `modes`, `mean_decay`; the covariance after it."""
WORK = record(interval=INTERVAL, measured=MEASUREMENT, step=STEP)
"""What `observe` works with beside the point."""
_CORRECT, _QUICK, _RARE = 1.0, 2.0, 3.0
"""Routes of a lane: an observer step, the same beyond the power series of `slow_modes`, a new beginning."""

SETTINGS = np.dtype(
    [(name, np.float64) for name in ("floor", "z_min", "z_max", "max_gap", "image_sd", "v_sd", "lateral_sd", "w_sd")]
    + [("critical", np.bool_)]
)
"""Settings of one robot's observers.

- floor: [1/s] least H where it follows the excitation. critical: whether it does (critically damped), or is fixed.
- z_min, z_max: [m] least and greatest depth.
- max_gap: [s] longest time between two measured samples that one observer step spans.
- image_sd: [-] standard deviation of a measured image coordinate.
- v_sd, lateral_sd, w_sd: [m/s, m/s, rad/s] standard deviation of the measured velocity, per sample.
"""


@inlined
def six(c, i):
    """Six numbers of lane `i`, such as a covariance's upper triangle by rows."""
    return c[0, i], c[1, i], c[2, i], c[3, i], c[4, i], c[5, i]


@inlined
def put_six(c, i, values):
    """Write six numbers of lane `i`."""
    c[0, i], c[1, i], c[2, i], c[3, i], c[4, i], c[5, i] = values


@inlined
def choose(first, a, b):
    """The six numbers `a` where `first`, else `b`."""
    return (
        a[0] if first else b[0], a[1] if first else b[1], a[2] if first else b[2],
        a[3] if first else b[3], a[4] if first else b[4], a[5] if first else b[5],
    )  # fmt: skip


@kernel
def image_now(point, i, z_min):
    """The estimate in the image now, (x, y, chi); a point nearer than `z_min`, beside or behind is put at `z_min`."""
    chi = 1.0 / max(point.q_x[i], z_min)
    return -point.q_y[i] * chi, -point.height[i] * chi, chi


@kernel
def image_covariance_now(point, i, z_min):
    """Covariance of `image_now`, six numbers (regular, but without meaning where the point is not in front)."""
    return body_to_image(max(point.q_x[i], z_min), point.q_y[i], point.height[i], six(point.covariance, i))


@kernel
def observe(point, work, settings, width):
    """One sample of one point, in all lanes.

    Not seen yet: begins at first sight, with the depth guess. Seen, and last measured at most `max_gap` ago: one
    observer step from that sample to this. Seen after a longer gap: the predicted state stays, and correction begins
    with the next interval (a point that was predicted behind the camera starts anew, at the predicted range). Not
    seen: predicted in the body frame.

    Args:
        point: `POINT`, changed in place.
        work: `WORK`: the interval and the measurement; its step is written.
        settings: `SETTINGS` of the robot.
        width: lanes to work on.
    """
    _prepare(point, work, settings, width)
    rare = False
    for i in range(width):
        rare |= work.step.route[i] == _RARE
        if work.step.route[i] == _QUICK:
            _exact_modes(point, work, i)
    _advance(point, work, settings, width)
    if rare:
        for i in range(width):
            if work.step.route[i] == _RARE:
                _begin_or_restart(point, work.measured, settings, i)


@inlined
def _motion(point, now, i):
    """(time, 1/time, v, l, w) since the last measured sample: what `observe` steps over."""
    dt = now.dt[i]
    time = point.time[i] + dt
    per = 1.0 / time
    return (
        time,
        per,
        (point.forward[i] + now.v[i] * dt) * per,
        (point.side[i] + now.lateral[i] * dt) * per,
        (point.turn[i] + now.yaw_rate[i] * dt) * per,
    )


@inlined
def _image(measured, i):
    """(x, y, whether it is a bearing without a height) of a measurement."""
    flat = measured.y[i] != measured.y[i]
    return measured.x[i], 0.0 if flat else measured.y[i], flat


@kernel
def _prepare(point, work, settings, width):
    """Which route each lane takes, means over its interval and modes of its step."""
    critical, floor, max_gap = settings.critical, settings.floor, settings.max_gap
    measured, step = work.measured, work.step
    for i in range(width):
        time, _, v, lateral, w = _motion(point, work.interval, i)
        x, y, _ = _image(measured, i)
        known, seen = point.known[i] != 0.0, measured.seen[i] != 0.0
        near = known & seen & (time > 0.0) & (time <= max_gap + 1e-9)
        begin = seen & ((not known) | (time > 0.0))
        m_x, m_y, m_xx, m_xy = interval_means(point.x[i], point.y[i], x, y, point.chi_hat[i], v, w, time)
        h = gains(v, lateral, m_x, m_y, measured.gain_h[i], measured.gain_alpha[i], critical, floor)
        stiffness = _stiffness(measured.gain_alpha[i], v, lateral, m_x, m_y)
        a, k, u = h * time, stiffness * time * time, 0.5 * time * w * m_x
        s_0, s, integral = slow_modes(a, k)
        step.route[i] = (_CORRECT if is_slow(a, k, u) else _QUICK) if near else (_RARE if begin else 0.0)
        step.mean_x[i], step.mean_y[i], step.mean_xx[i], step.mean_xy[i] = m_x, m_y, m_xx, m_xy
        step.h[i], step.s_0[i], step.s[i], step.integral[i], step.decay[i] = h, s_0, s, integral, slow_mean_decay(u)


@inlined
def _stiffness(alpha_lambda, v, lateral, mean_x, mean_y):
    """The stiffness alpha Lambda sigma² [1/s²] of a step."""
    o_x, o_y = v * mean_x + lateral, v * mean_y
    return alpha_lambda * (o_x * o_x + o_y * o_y)


@kernel
def _exact_modes(point, work, i):
    """The modes of a step that is not slow."""
    step = work.step
    time, _, v, lateral, w = _motion(point, work.interval, i)
    stiffness = _stiffness(work.measured.gain_alpha[i], v, lateral, step.mean_x[i], step.mean_y[i])
    step.s_0[i], step.s[i], step.integral[i] = modes(step.h[i], stiffness, time)
    step.decay[i] = mean_decay(0.5 * time * w * step.mean_x[i])


@kernel
def _advance(point, work, settings, width):
    """Both routes of every lane: an observer step to what is measured now, and a prediction in the body frame."""
    chi_min, chi_max = 1.0 / settings.z_max, 1.0 / settings.z_min
    var, var_v = settings.image_sd * settings.image_sd, settings.v_sd * settings.v_sd
    var_l, var_w = settings.lateral_sd * settings.lateral_sd, settings.w_sd * settings.w_sd
    measured, step, now = work.measured, work.step, work.interval
    for i in range(width):
        known, near = point.known[i] != 0.0, (step.route[i] == _CORRECT) | (step.route[i] == _QUICK)
        time, per, v, lateral, w = _motion(point, now, i)
        x, y, flat = _image(measured, i)
        dt, chi = now.dt[i], point.chi_hat[i]
        squares = point.squares[i] + dt * dt
        means = step.mean_x[i], step.mean_y[i], step.mean_xx[i], step.mean_xy[i]
        mode = step.s_0[i], step.s[i], step.integral[i]
        h, alpha_lambda = step.h[i], measured.gain_alpha[i]
        x_hat, y_hat, chi_hat = correct(
            point.x[i], point.y[i], x, y, means, point.x_hat[i], point.y_hat[i], chi,
            v, lateral, w, time, h, alpha_lambda, mode, step.decay[i], chi_min, chi_max,
        )  # fmt: skip
        share, base = squares * per * per, six(point.base_covariance, i)
        after = covariance_step(
            base, means[0], means[1], 0.5 * (chi + chi_hat), v, lateral, w, time, h, alpha_lambda, mode,
            var, 0.0 if flat else var, var_v * share, var_l * share, var_w * share,
        )  # fmt: skip
        z = 1.0 / chi_hat
        seen_now = image_to_body(x_hat, y_hat, chi_hat, after)
        old, cos, sin = six(point.covariance, i), now.cos[i], now.sin[i]
        d_x, d_y = point.q_x[i] - now.chord_x[i], point.q_y[i] - now.chord_y[i]
        q_x, q_y = cos * d_x + sin * d_y, cos * d_y - sin * d_x
        moved = move_covariance(old, q_x, q_y, cos, sin, dt, var_v, var_l, var_w)
        gone = known & (not near)
        point.q_x[i] = z if near else (q_x if known else 0.0)
        point.q_y[i] = -x_hat * z if near else (q_y if known else 0.0)
        point.height[i] = -y_hat * z if near else point.height[i]
        put_six(point.covariance, i, choose(near, seen_now, choose(known, moved, old)))
        put_six(step.covariance, i, after)
        point.time[i] = time if gone else 0.0
        point.forward[i] = point.forward[i] + now.v[i] * dt if gone else 0.0
        point.side[i] = point.side[i] + now.lateral[i] * dt if gone else 0.0
        point.turn[i] = point.turn[i] + now.yaw_rate[i] * dt if gone else 0.0
        point.squares[i] = squares if gone else 0.0
        point.x[i] = x if near else point.x[i]
        point.y[i] = y if near else point.y[i]
        point.x_hat[i] = x_hat if near else point.x_hat[i]
        point.y_hat[i] = y_hat if near else point.y_hat[i]
        point.chi_hat[i] = chi_hat if near else chi
    for i in range(width):  # in the loop above it would be one array too many for the compiler to tell apart
        near = (step.route[i] == _CORRECT) | (step.route[i] == _QUICK)
        put_six(point.base_covariance, i, choose(near, six(step.covariance, i), six(point.base_covariance, i)))


@kernel
def _begin_or_restart(point, measured, settings, i):
    """One lane: the first measurement of a point, or the first after a long gap."""
    x, y, flat = _image(measured, i)
    z_min, z_max = settings.z_min, settings.z_max
    if point.known[i] == 0.0:
        _begin(point, i, (x, y, flat), measured.guess[i], measured.depth_sd[i], settings)
    elif point.q_x[i] < z_min or point.q_x[i] > z_max:
        z = math.sqrt((point.q_x[i] * point.q_x[i] + point.q_y[i] * point.q_y[i]) / (1.0 + x * x))
        _begin(point, i, (x, y, flat), z, measured.depth_sd[i], settings)
    else:
        covariance = image_covariance_now(point, i, z_min)
        point.x_hat[i], point.y_hat[i], point.chi_hat[i] = image_now(point, i, z_min)
        put_six(point.base_covariance, i, covariance)
        _restart(point, i, x, y)


@kernel
def _restart(point, i, x, y):
    """Let the next observer step begin here, where (x, y) was measured."""
    point.x[i], point.y[i] = x, y
    point.time[i] = point.forward[i] = point.side[i] = point.turn[i] = point.squares[i] = 0.0


@kernel
def _begin(point, i, image, z, depth_sd, settings):
    """First measurement: s_hat = s, chi_hat = 1/z with the depth guess z; `image` is `_image`."""
    x, y, flat = image
    z = min(max(z, settings.z_min), settings.z_max)
    chi = 1.0 / z
    point.known[i] = 1.0
    point.x_hat[i], point.y_hat[i], point.chi_hat[i] = x, y, chi
    _restart(point, i, x, y)
    var, chi_sd = settings.image_sd * settings.image_sd, depth_sd / (z * z)
    base = (var, 0.0, 0.0, 0.0 if flat else var, 0.0, chi_sd * chi_sd)
    put_six(point.base_covariance, i, base)
    z = 1.0 / chi
    point.q_x[i], point.q_y[i], point.height[i] = z, -x * z, -y * z
    put_six(point.covariance, i, image_to_body(x, y, chi, base))
