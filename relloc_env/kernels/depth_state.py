"""The depth observers of a batch: one row of numbers per (environment, robot, point), advanced sample by sample.

`state` is float64 (N, R, M, SIZE), C-contiguous, all zeros at the start of an episode; rows may be copied to save and
restore an environment. A row holds two views of one point:

- now: the point (q_x, q_y, height) in the robot's body frame and its covariance, at the latest sample. Regular beside
  and behind the camera, where image coordinates are not.
- base: the observer's state (x_hat, y_hat, chi_hat), its covariance and the measured s at the last measured sample,
  with the motion since. The next measured sample redoes one observer step from there, so a camera slower than the
  odometry is followed at second order, and what lies between frames is a prediction.
"""

import math
from typing import NamedTuple

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.depth_covariance import body_to_image, covariance_step, image_to_body, move_covariance
from relloc_env.kernels.depth_observer import correct, gains, interval_means, modes
from relloc_env.kernels.motion import arc

KNOWN = 0
"""1 once the point has been seen, else 0."""
Q_X, Q_Y, HEIGHT = 1, 2, 3
"""[m] the point now, in the body frame; height above the camera (0 for a sensor without heights)."""
COVARIANCE = 4
"""First of six: covariance of (q_x, q_y, height) now, upper triangle by rows."""
TIME = 10
"""[s] since the last measured sample: 0 where the point is seen now."""
X, Y = 11, 12
"""[-] the last measured image coordinates."""
X_HAT, Y_HAT, CHI_HAT = 13, 14, 15
"""[-, -, 1/m] the observer's state at the last measured sample."""
BASE_COVARIANCE = 16
"""First of six: covariance of (x_hat, y_hat, chi_hat) there, upper triangle by rows."""
FORWARD, SIDE, TURN, SQUARES = 22, 23, 24, 25
"""[m, m, rad, s²] sums of v dt, l dt, w dt and dt² since then."""
SIZE = 26


class Settings(NamedTuple):
    """Settings of one robot's observers, in the order of the columns of `settings` (R, 12) float64 below."""

    h: float = 2.5
    """[1/s] gain H."""
    alpha_lambda: float = 120.0
    """[1/m²] gain alpha Lambda."""
    critical: float = 0.0
    """1 where H follows the excitation (critically damped), 0 where it is fixed."""
    floor: float = 0.5
    """[1/s] smallest H when it follows."""
    z_min: float = 0.1
    """[m] smallest depth."""
    z_max: float = 30.0
    """[m] largest depth."""
    max_gap: float = 0.3
    """[s] longest time between two measured samples that one observer step spans."""
    depth_sd: float = 1.0
    """[m] standard deviation of the depth guess."""
    image_sd: float = 0.002
    """[-] standard deviation of a measured image coordinate."""
    v_sd: float = 0.005
    """[m/s] standard deviation of the measured forward speed, per sample."""
    lateral_sd: float = 0.0
    """[m/s] standard deviation of the measured lateral speed, per sample."""
    w_sd: float = 0.005
    """[rad/s] standard deviation of the measured yaw rate, per sample."""


_H, _ALPHA_LAMBDA, _CRITICAL, _FLOOR, _Z_MIN, _Z_MAX, _MAX_GAP = range(7)
_DEPTH_SD, _IMAGE_SD, _V_SD, _LATERAL_SD, _W_SD = range(7, 12)


@kernel
def six(table, p, first):
    """Six consecutive numbers of a row."""
    a, b, c = table[p, first], table[p, first + 1], table[p, first + 2]
    return a, b, c, table[p, first + 3], table[p, first + 4], table[p, first + 5]


@kernel
def put_six(table, p, first, values):
    """Write six consecutive numbers of a row."""
    for j in range(6):
        table[p, first + j] = values[j]


@kernel
def image_now(table, p, z_min):
    """The estimate in the image now, (x, y, chi); a point nearer than `z_min`, beside or behind is put at `z_min`."""
    chi = 1.0 / max(table[p, Q_X], z_min)
    return -table[p, Q_Y] * chi, -table[p, HEIGHT] * chi, chi


@kernel
def image_covariance_now(table, p, z_min):
    """Covariance of `image_now`, six numbers (regular, but without meaning where the point is not in front)."""
    return body_to_image(max(table[p, Q_X], z_min), table[p, Q_Y], table[p, HEIGHT], six(table, p, COVARIANCE))


@kernel
def _restart(table, p, x, y):
    """Let the next observer step begin here, where (x, y) was measured."""
    table[p, X], table[p, Y] = x, y
    table[p, TIME] = table[p, FORWARD] = table[p, SIDE] = table[p, TURN] = table[p, SQUARES] = 0.0


@kernel
def _show(table, p, covariance):
    """Refresh the view of now from the base (the point was measured at this sample)."""
    z = 1.0 / table[p, CHI_HAT]
    table[p, Q_X], table[p, Q_Y], table[p, HEIGHT] = z, -table[p, X_HAT] * z, -table[p, Y_HAT] * z
    if covariance:
        values = image_to_body(table[p, X_HAT], table[p, Y_HAT], table[p, CHI_HAT], six(table, p, BASE_COVARIANCE))
        put_six(table, p, COVARIANCE, values)


@kernel
def _begin(table, p, settings, r, x, y, z, flat, covariance):
    """First sight: s_hat = s, chi_hat = 1/z with the depth guess z."""
    z = min(max(z, settings[r, _Z_MIN]), settings[r, _Z_MAX])
    table[p, KNOWN] = 1.0
    table[p, X_HAT], table[p, Y_HAT], table[p, CHI_HAT] = x, y, 1.0 / z
    _restart(table, p, x, y)
    if covariance:
        var = settings[r, _IMAGE_SD] * settings[r, _IMAGE_SD]
        chi_sd = settings[r, _DEPTH_SD] / (z * z)
        put_six(table, p, BASE_COVARIANCE, (var, 0.0, 0.0, 0.0 if flat else var, 0.0, chi_sd * chi_sd))
    _show(table, p, covariance)


@kernel
def _correct(table, p, settings, r, x, y, flat, covariance):
    """One observer step from the last measured sample to (x, y) now."""
    alpha_lambda, z_min, z_max = settings[r, _ALPHA_LAMBDA], settings[r, _Z_MIN], settings[r, _Z_MAX]
    dt = table[p, TIME]
    per = 1.0 / dt
    v, lateral, w = table[p, FORWARD] * per, table[p, SIDE] * per, table[p, TURN] * per
    x0, y0, chi = table[p, X], table[p, Y], table[p, CHI_HAT]
    means = interval_means(x0, y0, x, y, chi, v, w, dt)
    critical, floor = settings[r, _CRITICAL] != 0.0, settings[r, _FLOOR]
    h = gains(v, lateral, means[0], means[1], settings[r, _H], alpha_lambda, critical, floor)
    o_x, o_y = v * means[0] + lateral, v * means[1]
    mode = modes(h, alpha_lambda * (o_x * o_x + o_y * o_y), dt)
    chi_min, chi_max = 1.0 / z_max, 1.0 / z_min
    table[p, X_HAT], table[p, Y_HAT], table[p, CHI_HAT] = correct(
        x0,
        y0,
        x,
        y,
        means,
        table[p, X_HAT],
        table[p, Y_HAT],
        chi,
        v,
        lateral,
        w,
        dt,
        h,
        alpha_lambda,
        mode,
        chi_min,
        chi_max,
    )
    if covariance:
        var = settings[r, _IMAGE_SD] ** 2
        v_sd, lateral_sd, w_sd = settings[r, _V_SD], settings[r, _LATERAL_SD], settings[r, _W_SD]
        share = table[p, SQUARES] * per * per
        middle = 0.5 * (chi + table[p, CHI_HAT])
        values = six(table, p, BASE_COVARIANCE)
        values = covariance_step(
            values, means[0], means[1], middle, v, lateral, w, dt, h, alpha_lambda, mode,
            var, 0.0 if flat else var, v_sd * v_sd * share, lateral_sd * lateral_sd * share, w_sd * w_sd * share,
        )  # fmt: skip
        put_six(table, p, BASE_COVARIANCE, values)
    _restart(table, p, x, y)
    _show(table, p, covariance)


@kernel
def _move(table, p, settings, r, c_x, c_y, cos, sin, dt, covariance):
    """Open loop: the remembered point in the body frame after the body moved."""
    d_x, d_y = table[p, Q_X] - c_x, table[p, Q_Y] - c_y
    q_x, q_y = cos * d_x + sin * d_y, cos * d_y - sin * d_x
    table[p, Q_X], table[p, Q_Y] = q_x, q_y
    if covariance:
        v_sd, lateral_sd, w_sd = settings[r, _V_SD], settings[r, _LATERAL_SD], settings[r, _W_SD]
        values = six(table, p, COVARIANCE)
        values = move_covariance(values, q_x, q_y, cos, sin, dt, v_sd * v_sd, lateral_sd * lateral_sd, w_sd * w_sd)
        put_six(table, p, COVARIANCE, values)


@kernel
def observe_point(table, p, settings, r, seen, x, y, depth, v, lateral, w, dt, c_x, c_y, cos, sin, covariance):
    """One sample of one point.

    Not seen yet: begins at first sight, with the depth guess. Seen, and last measured at most `max_gap` ago: one
    observer step from that sample to this. Seen after a longer gap: the predicted state stays, and correction begins
    with the next interval (a point that was predicted behind the camera starts anew, at the predicted range). Not
    seen: predicted in the body frame.

    Args:
        table: (…, SIZE) float64 rows of state, changed in place; p: which one.
        settings: (12,) float64 in the order of `Settings`.
        seen: whether the point was measured in this sample.
        x, y: [-] measured image coordinates; y may be NaN, for a sensor that gives bearings without heights.
        depth: [m] guess of the depth at first sight.
        v, lateral, w: [m/s, m/s, rad/s] measured velocity over the interval before the sample.
        dt: [s] length of it.
        c_x, c_y, cos, sin: its arc, as `motion.arc` gives it: chord [m], cosine and sine of the turn.
        covariance: whether covariances are kept.
    """
    flat = math.isnan(y)
    if flat:
        y = 0.0
    if table[p, KNOWN] == 0.0:
        if seen:
            _begin(table, p, settings, r, x, y, depth, flat, covariance)
        return
    table[p, TIME] += dt
    table[p, FORWARD] += v * dt
    table[p, SIDE] += lateral * dt
    table[p, TURN] += w * dt
    table[p, SQUARES] += dt * dt
    if seen and 0.0 < table[p, TIME] <= settings[r, _MAX_GAP] + 1e-9:
        _correct(table, p, settings, r, x, y, flat, covariance)
        return
    _move(table, p, settings, r, c_x, c_y, cos, sin, dt, covariance)
    if seen and table[p, TIME] > 0.0:
        z_min, z_max = settings[r, _Z_MIN], settings[r, _Z_MAX]
        if table[p, Q_X] < z_min or table[p, Q_X] > z_max:
            z = math.sqrt((table[p, Q_X] ** 2 + table[p, Q_Y] ** 2) / (1.0 + x * x))
            _begin(table, p, settings, r, x, y, z, flat, covariance)
            return
        table[p, X_HAT], table[p, Y_HAT], table[p, CHI_HAT] = image_now(table, p, z_min)
        if covariance:
            put_six(table, p, BASE_COVARIANCE, image_covariance_now(table, p, z_min))
        _restart(table, p, x, y)


@kernel
def observe(state, settings, period, odometry, image, seen, depth, k, covariance, rows):
    """Sample `k` of all points and robots of some environments; see `observe_point`, and `Samples` for the shapes.

    Args:
        state: (N, R, M, SIZE) float64, changed in place.
        settings: (R, 12) float64, `Settings` of each robot.
        period, odometry, image, seen: (N, K), (N, K, R, 3), (N, K, R, M, 2), (N, K, R, M), the fields of `Samples`.
        depth: [m] (N, R, M) guesses of the depth at first sight.
        k: which of the K samples.
        covariance: whether covariances are kept.
        rows: (…,) int64 environments to work on.
    """
    robots, points = state.shape[1], state.shape[2]
    table = state.reshape(-1, SIZE)
    for n in rows:
        dt = period[n, k]
        for r in range(robots):
            v, lateral, w = float(odometry[n, k, r, 0]), float(odometry[n, k, r, 1]), float(odometry[n, k, r, 2])
            first = (n * robots + r) * points
            open_loop = dt > settings[r, _MAX_GAP]
            for m in range(points):
                open_loop |= not seen[n, k, r, m] or table[first + m, TIME] > 0.0
            c_x, c_y, cos, sin = 0.0, 0.0, 1.0, 0.0
            if open_loop:  # else no point needs the arc
                c_x, c_y, delta = arc(v, lateral, w, dt)
                cos, sin = math.cos(delta), math.sin(delta)
            for m in range(points):
                x, y = float(image[n, k, r, m, 0]), float(image[n, k, r, m, 1])
                observe_point(
                    table, first + m, settings, r, seen[n, k, r, m], x, y, depth[n, r, m],
                    v, lateral, w, dt, c_x, c_y, cos, sin, covariance,
                )  # fmt: skip
