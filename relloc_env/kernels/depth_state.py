"""The depth observers of a batch, in lanes (`kernels.lanes`): `SIZE` numbers per point, advanced sample by sample.

All zeros at the start of an episode; copied, they save and restore an environment. They hold two views of one point:

- now: the point (q_x, q_y, height) in the robot's body frame and its covariance, at the latest sample. Regular beside
  and behind the camera, where image coordinates are not.
- base: the observer's state (x_hat, y_hat, chi_hat), its covariance and the measured s at the last measured sample,
  with the motion since. The next measured sample redoes one observer step from there, so a camera slower than the
  odometry is followed at second order, and what lies between frames is a prediction.
"""

import math
from typing import NamedTuple

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
from relloc_env.kernels.lanes import W

SIZE = 26
"""Numbers that are remembered of a point. The places below are those of lane 0 of a workspace."""
KNOWN = 0 * W
"""1 once the point has been seen, else 0."""
Q_X, Q_Y, HEIGHT = 1 * W, 2 * W, 3 * W
"""[m] the point now, in the body frame; height above the camera (0 for a sensor without heights)."""
COVARIANCE = 4 * W
"""First of six: covariance of (q_x, q_y, height) now, upper triangle by rows."""
TIME = 10 * W
"""[s] since the last measured sample: 0 where the point is seen now."""
X, Y = 11 * W, 12 * W
"""[-] the last measured image coordinates."""
X_HAT, Y_HAT, CHI_HAT = 13 * W, 14 * W, 15 * W
"""[-, -, 1/m] the observer's state at the last measured sample."""
BASE_COVARIANCE = 16 * W
"""First of six: covariance of (x_hat, y_hat, chi_hat) there, upper triangle by rows."""
FORWARD, SIDE, TURN, SQUARES = 22 * W, 23 * W, 24 * W, 25 * W
"""[m, m, rad, s²] sums of v dt, l dt, w dt and dt² since then."""

# Beside the point in the workspace: about the robot,
V, LATERAL, YAW_RATE, DT = 26 * W, 27 * W, 28 * W, 29 * W
"""[m/s, m/s, rad/s, s] measured velocity over the interval before the sample, and its length."""
CHORD_X, CHORD_Y, DELTA, COS, SIN = 30 * W, 31 * W, 32 * W, 33 * W, 34 * W
"""[m, m, rad, -, -] its arc (`motion.arc`), cosine and sine of the turn."""
GAIN_H, GAIN_ALPHA = 35 * W, 36 * W
"""[1/s, 1/m²] gains of the observer."""
DEPTH_SD = 37 * W
"""[m] standard deviation of guesses of the depth."""
# about the point in this sample,
GUESS = 38 * W
"""[m] guess of the depth at first sight."""
SEEN, SEEN_X, SEEN_Y = 39 * W, 40 * W, 41 * W
"""Whether the point is measured (1 or 0), and where [-]; y may be NaN, for bearings without heights."""
# and for scratch.
_ROUTE, _MEAN_X, _MEAN_Y, _MEAN_XX, _MEAN_XY = 42 * W, 43 * W, 44 * W, 45 * W, 46 * W
_H, _S_0, _S, _I, _DECAY = 47 * W, 48 * W, 49 * W, 50 * W, 51 * W
WORKSPACE = 52
"""Numbers in a workspace."""
_CORRECT, _QUICK, _RARE = 1.0, 2.0, 3.0
"""Routes of a lane: an observer step, the same beyond the power series of `slow_modes`, a new beginning."""


class Settings(NamedTuple):
    """Settings of one robot's observers, as numbers."""

    critical: float
    """1 where H follows the excitation (critically damped), 0 where it is fixed."""
    floor: float
    """[1/s] smallest H when it follows."""
    z_min: float
    """[m] smallest depth."""
    z_max: float
    """[m] largest depth."""
    max_gap: float
    """[s] longest time between two measured samples that one observer step spans."""
    image_sd: float
    """[-] standard deviation of a measured image coordinate."""
    v_sd: float
    """[m/s] standard deviation of the measured forward speed, per sample."""
    lateral_sd: float
    """[m/s] standard deviation of the measured lateral speed, per sample."""
    w_sd: float
    """[rad/s] standard deviation of the measured yaw rate, per sample."""


@inlined
def six(t, i):
    """Six consecutive numbers of a lane, the first at `i`."""
    return t[i], t[i + W], t[i + 2 * W], t[i + 3 * W], t[i + 4 * W], t[i + 5 * W]


@inlined
def put_six(t, i, values):
    """Write six consecutive numbers of a lane."""
    t[i], t[i + W], t[i + 2 * W], t[i + 3 * W], t[i + 4 * W], t[i + 5 * W] = values


@inlined
def choose(first, a, b):
    """The six numbers `a` where `first`, else `b`."""
    return (
        a[0] if first else b[0], a[1] if first else b[1], a[2] if first else b[2],
        a[3] if first else b[3], a[4] if first else b[4], a[5] if first else b[5],
    )  # fmt: skip


@kernel
def image_now(t, i, z_min):
    """The estimate in the image now, (x, y, chi); a point nearer than `z_min`, beside or behind is put at `z_min`."""
    chi = 1.0 / max(t[i + Q_X], z_min)
    return -t[i + Q_Y] * chi, -t[i + HEIGHT] * chi, chi


@kernel
def image_covariance_now(t, i, z_min):
    """Covariance of `image_now`, six numbers (regular, but without meaning where the point is not in front)."""
    return body_to_image(max(t[i + Q_X], z_min), t[i + Q_Y], t[i + HEIGHT], six(t, i + COVARIANCE))


@kernel
def observe(t, settings, r, width):
    """One sample of one point, in all lanes of a workspace.

    Not seen yet: begins at first sight, with the depth guess. Seen, and last measured at most `max_gap` ago: one
    observer step from that sample to this. Seen after a longer gap: the predicted state stays, and correction begins
    with the next interval (a point that was predicted behind the camera starts anew, at the predicted range). Not
    seen: predicted in the body frame.

    Args:
        t: the workspace; its first `SIZE` numbers are changed in place.
        settings: (R, 9) float64, `Settings` of each robot.
        r: which robot.
        width: lanes of a block.
    """
    critical, floor, max_gap = settings[r, 0] != 0.0, settings[r, 1], settings[r, 4]
    _prepare(t, critical, floor, max_gap, width)
    rare = False
    for i in range(width):
        rare |= t[i + _ROUTE] == _RARE
        if t[i + _ROUTE] == _QUICK:
            _mend_modes(t, i)
    _advance(t, settings, r, width)
    if rare:
        for i in range(width):
            if t[i + _ROUTE] == _RARE:
                _sight(t, i, settings, r)


@inlined
def _motion(t, i):
    """(time, 1/time, v, l, w) since the last measured sample: what `observe` steps over."""
    dt = t[i + DT]
    time = t[i + TIME] + dt
    per = 1.0 / time
    return (
        time,
        per,
        (t[i + FORWARD] + t[i + V] * dt) * per,
        (t[i + SIDE] + t[i + LATERAL] * dt) * per,
        (t[i + TURN] + t[i + YAW_RATE] * dt) * per,
    )


@inlined
def _image(t, i):
    """(x, y, whether it is flat) of a sight."""
    flat = t[i + SEEN_Y] != t[i + SEEN_Y]
    return t[i + SEEN_X], 0.0 if flat else t[i + SEEN_Y], flat


@kernel
def _prepare(t, critical, floor, max_gap, width):
    """Which way each lane goes, means over its interval and modes of its step."""
    for i in range(width):
        time, _, v, lateral, w = _motion(t, i)
        x, y, _ = _image(t, i)
        known, seen = t[i + KNOWN] != 0.0, t[i + SEEN] != 0.0
        near = known & seen & (time > 0.0) & (time <= max_gap + 1e-9)
        begin = seen & ((not known) | (time > 0.0))
        m_x, m_y, m_xx, m_xy = interval_means(t[i + X], t[i + Y], x, y, t[i + CHI_HAT], v, w, time)
        h = gains(v, lateral, m_x, m_y, t[i + GAIN_H], t[i + GAIN_ALPHA], critical, floor)
        stiffness = _stiffness(t, i, v, lateral, m_x, m_y)
        a, k, u = h * time, stiffness * time * time, 0.5 * time * w * m_x
        s_0, s, integral = slow_modes(a, k)
        t[i + _ROUTE] = (_CORRECT if is_slow(a, k, u) else _QUICK) if near else (_RARE if begin else 0.0)
        t[i + _MEAN_X], t[i + _MEAN_Y], t[i + _MEAN_XX], t[i + _MEAN_XY] = m_x, m_y, m_xx, m_xy
        t[i + _H], t[i + _S_0], t[i + _S], t[i + _I], t[i + _DECAY] = h, s_0, s, integral, slow_mean_decay(u)


@inlined
def _stiffness(t, i, v, lateral, mean_x, mean_y):
    """The stiffness alpha Lambda sigma² [1/s²] of this step."""
    o_x, o_y = v * mean_x + lateral, v * mean_y
    return t[i + GAIN_ALPHA] * (o_x * o_x + o_y * o_y)


@kernel
def _mend_modes(t, i):
    """The modes of a step that is not slow."""
    time, _, v, lateral, w = _motion(t, i)
    stiffness = _stiffness(t, i, v, lateral, t[i + _MEAN_X], t[i + _MEAN_Y])
    t[i + _S_0], t[i + _S], t[i + _I] = modes(t[i + _H], stiffness, time)
    t[i + _DECAY] = mean_decay(0.5 * time * w * t[i + _MEAN_X])


@kernel
def _advance(t, settings, r, width):
    """Both ways of every lane: an observer step to what is seen now, and a prediction in the body frame."""
    chi_min, chi_max = 1.0 / settings[r, 3], 1.0 / settings[r, 2]
    var, var_v = settings[r, 5] * settings[r, 5], settings[r, 6] * settings[r, 6]
    var_l, var_w = settings[r, 7] * settings[r, 7], settings[r, 8] * settings[r, 8]
    for i in range(width):
        known, near = t[i + KNOWN] != 0.0, (t[i + _ROUTE] == _CORRECT) | (t[i + _ROUTE] == _QUICK)
        time, per, v, lateral, w = _motion(t, i)
        x, y, flat = _image(t, i)
        dt, chi = t[i + DT], t[i + CHI_HAT]
        squares = t[i + SQUARES] + dt * dt
        means = t[i + _MEAN_X], t[i + _MEAN_Y], t[i + _MEAN_XX], t[i + _MEAN_XY]
        mode = t[i + _S_0], t[i + _S], t[i + _I]
        h, alpha_lambda = t[i + _H], t[i + GAIN_ALPHA]
        x_hat, y_hat, chi_hat = correct(
            t[i + X], t[i + Y], x, y, means, t[i + X_HAT], t[i + Y_HAT], chi,
            v, lateral, w, time, h, alpha_lambda, mode, t[i + _DECAY], chi_min, chi_max,
        )  # fmt: skip
        share, base = squares * per * per, six(t, i + BASE_COVARIANCE)
        after = covariance_step(
            base, means[0], means[1], 0.5 * (chi + chi_hat), v, lateral, w, time, h, alpha_lambda, mode,
            var, 0.0 if flat else var, var_v * share, var_l * share, var_w * share,
        )  # fmt: skip
        z = 1.0 / chi_hat
        now = image_to_body(x_hat, y_hat, chi_hat, after)
        old, cos, sin = six(t, i + COVARIANCE), t[i + COS], t[i + SIN]
        d_x, d_y = t[i + Q_X] - t[i + CHORD_X], t[i + Q_Y] - t[i + CHORD_Y]
        q_x, q_y = cos * d_x + sin * d_y, cos * d_y - sin * d_x
        moved = move_covariance(old, q_x, q_y, cos, sin, dt, var_v, var_l, var_w)
        gone = known & (not near)
        t[i + Q_X] = z if near else (q_x if known else 0.0)
        t[i + Q_Y] = -x_hat * z if near else (q_y if known else 0.0)
        t[i + HEIGHT] = -y_hat * z if near else t[i + HEIGHT]
        put_six(t, i + COVARIANCE, choose(near, now, choose(known, moved, old)))
        put_six(t, i + BASE_COVARIANCE, choose(near, after, base))
        t[i + TIME] = time if gone else 0.0
        t[i + FORWARD] = t[i + FORWARD] + t[i + V] * dt if gone else 0.0
        t[i + SIDE] = t[i + SIDE] + t[i + LATERAL] * dt if gone else 0.0
        t[i + TURN] = t[i + TURN] + t[i + YAW_RATE] * dt if gone else 0.0
        t[i + SQUARES] = squares if gone else 0.0
        t[i + X] = x if near else t[i + X]
        t[i + Y] = y if near else t[i + Y]
        t[i + X_HAT] = x_hat if near else t[i + X_HAT]
        t[i + Y_HAT] = y_hat if near else t[i + Y_HAT]
        t[i + CHI_HAT] = chi_hat if near else chi


@kernel
def _sight(t, i, settings, r):
    """One lane: first sight of a point, or the first after a long gap."""
    x, y, flat = _image(t, i)
    z_min, z_max = settings[r, 2], settings[r, 3]
    if t[i + KNOWN] == 0.0:
        _begin(t, i, x, y, t[i + GUESS], flat, settings, r)
    elif t[i + Q_X] < z_min or t[i + Q_X] > z_max:
        z = math.sqrt((t[i + Q_X] * t[i + Q_X] + t[i + Q_Y] * t[i + Q_Y]) / (1.0 + x * x))
        _begin(t, i, x, y, z, flat, settings, r)
    else:
        covariance = image_covariance_now(t, i, z_min)
        t[i + X_HAT], t[i + Y_HAT], t[i + CHI_HAT] = image_now(t, i, z_min)
        put_six(t, i + BASE_COVARIANCE, covariance)
        _restart(t, i, x, y)


@kernel
def _restart(t, i, x, y):
    """Let the next observer step begin here, where (x, y) was measured."""
    t[i + X], t[i + Y] = x, y
    t[i + TIME] = t[i + FORWARD] = t[i + SIDE] = t[i + TURN] = t[i + SQUARES] = 0.0


@kernel
def _begin(t, i, x, y, z, flat, settings, r):
    """First sight: s_hat = s, chi_hat = 1/z with the depth guess z."""
    z = min(max(z, settings[r, 2]), settings[r, 3])
    chi = 1.0 / z
    t[i + KNOWN] = 1.0
    t[i + X_HAT], t[i + Y_HAT], t[i + CHI_HAT] = x, y, chi
    _restart(t, i, x, y)
    var, chi_sd = settings[r, 5] * settings[r, 5], t[i + DEPTH_SD] / (z * z)
    base = (var, 0.0, 0.0, 0.0 if flat else var, 0.0, chi_sd * chi_sd)
    put_six(t, i + BASE_COVARIANCE, base)
    z = 1.0 / chi
    t[i + Q_X], t[i + Q_Y], t[i + HEIGHT] = z, -x * z, -y * z
    put_six(t, i + COVARIANCE, image_to_body(x, y, chi, base))
