"""The joint map of one robot: an extended Kalman filter over all its points, in polar coordinates.

A point is (beta, eta, rho): bearing, height over horizontal range, inverse horizontal range, in the body frame; regular
beside and behind the camera, where image coordinates are not. The state of m points is their 3 m coordinates, then,
where the robot's own calibration is estimated too, (k_v, k_w, kappa, psi, tau): the scales of speed and yaw rate, the
speed lost in turns [m/rad], the yaw of the camera in the body [rad] and the delay of its images behind the odometry
[s]; D = 3 m or 3 m + 5. The full covariance keeps what the shared odometry noise and calibration tie together.
"""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.camera import to_polar
from relloc_env.kernels.motion import arc, sinc, wrap_angle

CALIBRATION = 5
"""Numbers of a robot's calibration at the end of the state."""
NO_HEIGHT_VARIANCE = 1.0
"""[-] variance of eta where the sensor gives bearings alone; eta is 0 there and carries nothing."""


@kernel
def transfer(beta, eta, rho, r_x, r_y, theta, height):
    """A point seen from another place: b = u(beta) - rho r, n = |b|, and its Jacobian.

    beta' = atan2(b) - theta,  eta' = (eta - rho height)/n,  rho' = rho/n

    For any db: dbeta' = (b × db)/n², dn = b·db/n, drho' = (drho - rho' dn)/n,
    deta' = (d(eta - rho height) - eta' dn)/n.
    Serves a robot's own motion (r, theta = chord and turn) and another robot's view (r, theta = its pose).

    Args:
        beta, eta, rho: [rad, -, 1/m] the point in the first frame.
        r_x, r_y, theta: [m, m, rad] pose of the second frame in the first.
        height: [m] of the second camera above the first.

    Returns:
        (beta', eta', rho', 1/n), then the derivatives of (beta', eta', rho') with respect to beta, rho, r_x, r_y:
        twelve numbers, three for each. Those for eta are (0, 1/n, 0), theta (-1, 0, 0), height (0, -rho/n, 0).
    """
    cos, sin = math.cos(beta), math.sin(beta)
    b_x, b_y = cos - rho * r_x, sin - rho * r_y
    inv = 1.0 / math.sqrt(b_x * b_x + b_y * b_y)
    eta_2, rho_2 = (eta - rho * height) * inv, rho * inv
    b_x, b_y = b_x * inv, b_y * inv
    # Along and across the unit vector b/n: dn = b·db and n dbeta' = b × db.
    n_beta, t_beta = (-b_x * sin + b_y * cos), (b_x * cos + b_y * sin) * inv
    n_rho, t_rho = -(b_x * r_x + b_y * r_y), -(b_x * r_y - b_y * r_x) * inv
    n_x, t_x = -rho * b_x, rho * b_y * inv
    n_y, t_y = -rho * b_y, -rho * b_x * inv
    return (
        wrap_angle(math.atan2(b_y, b_x) - theta),
        eta_2,
        rho_2,
        inv,
        t_beta,
        -eta_2 * n_beta * inv,
        -rho_2 * n_beta * inv,
        t_rho,
        (-height - eta_2 * n_rho) * inv,
        (1.0 - rho_2 * n_rho) * inv,
        t_x,
        -eta_2 * n_x * inv,
        -rho_2 * n_x * inv,
        t_y,
        -eta_2 * n_y * inv,
        -rho_2 * n_y * inv,
    )


@kernel
def arc_jacobian(v, lateral, w, dt):
    """Derivatives of the chord of `motion.arc`: (dc/dv, dc/dlateral, dc/dw), x and y of each.

    With h = w dt/2: dc/dw = dt²/2 (sinc'(h) R(h) + sinc(h) R'(h)) [v, l].
    """
    half = 0.5 * w * dt
    cos, sin, ratio = math.cos(half), math.sin(half), sinc(half)
    slope = -half / 3.0 if abs(half) < 1e-3 else (cos - ratio) / half
    m_x, m_y = v * cos - lateral * sin, v * sin + lateral * cos
    scale = 0.5 * dt * dt
    return (
        dt * ratio * cos,
        dt * ratio * sin,
        -dt * ratio * sin,
        dt * ratio * cos,
        scale * (slope * m_x - ratio * m_y),
        scale * (slope * m_y + ratio * m_x),
    )


@kernel
def image_noise(x, y, variance):
    """Covariance of (beta, eta) from that of an image point, variance × T Tᵀ.

    T = [[-cos² beta, 0], [x y cos³ beta, -cos beta]],  cos beta = 1/√(1 + x²)

    Returns:
        (r_bb, r_be, r_ee): its three entries.
    """
    cos = 1.0 / math.sqrt(1.0 + x * x)
    t_bx, t_ex, t_ey = -cos * cos, x * y * cos * cos * cos, -cos
    return variance * t_bx * t_bx, variance * t_bx * t_ex, variance * (t_ex * t_ex + t_ey * t_ey)


@kernel
def calibrated_velocity(state, points, v, lateral, w):
    """Velocity of a robot from what its odometry says: (k_v v - kappa |w|, k_v l, k_w w) by the state's calibration."""
    first = 3 * points
    if state.shape[0] > first:
        k_v, k_w, kappa = state[first], state[first + 1], state[first + 2]
        return k_v * v - kappa * abs(w), k_v * lateral, k_w * w
    return v, lateral, w


@kernel
def map_predict(state, covariance, known, v, lateral, w, dt, var_v, var_lateral, var_w, work):
    """Move all known points of a map by the robot's motion over a step, P⁺ = F P Fᵀ + G Q Gᵀ.

    With a calibration in the state, the robot moves with `calibrated_velocity`.

    Args:
        state: (D,) and covariance: (D, D), changed in place.
        known: (m,) which points are in the map.
        v, lateral, w: [m/s, m/s, rad/s] measured velocity.
        dt: [s] length of the step.
        var_v, var_lateral, var_w: variances of the measured velocity over this step.
        work: (≥ D, ≥ 3) scratch.
    """
    points, size = known.shape[0], state.shape[0]
    first = 3 * points
    calibrated = size > first
    u_v, u_l, u_w = calibrated_velocity(state, points, v, lateral, w)
    c_x, c_y, delta = arc(u_v, u_l, u_w, dt)
    vx, vy, lx, ly, wx, wy = arc_jacobian(u_v, u_l, u_w, dt)
    kx, ky = -abs(w) * vx, -abs(w) * vy
    sx, sy = v * vx + lateral * lx, v * vy + lateral * ly
    tx, ty, tt = w * wx, w * wy, w * dt
    for i in range(points):
        if not known[i]:
            continue
        p = 3 * i
        beta, eta, rho, inv, bb, eb, rb, br, er, rr, bx, ex, rx, by, ey, ry = transfer(
            state[p], state[p + 1], state[p + 2], c_x, c_y, delta, 0.0
        )
        state[p], state[p + 1], state[p + 2] = beta, eta, rho
        work[p, 0], work[p + 1, 0], work[p + 2, 0] = bx, ex, rx
        work[p, 1], work[p + 1, 1], work[p + 2, 1] = by, ey, ry
        work[p, 2], work[p + 1, 2], work[p + 2, 2] = -1.0, 0.0, 0.0
        for j in range(size):
            a, b, c = covariance[p, j], covariance[p + 1, j], covariance[p + 2, j]
            covariance[p, j] = bb * a + br * c
            covariance[p + 1, j] = eb * a + inv * b + er * c
            covariance[p + 2, j] = rb * a + rr * c
        if calibrated:
            for j in range(size):
                a, b, c = covariance[first, j], covariance[first + 1, j], covariance[first + 2, j]
                for k in range(3):
                    g_x, g_y, g_t = work[p + k, 0], work[p + k, 1], work[p + k, 2]
                    covariance[p + k, j] += (
                        g_x * (sx * a + tx * b + kx * c) + g_y * (sy * a + ty * b + ky * c) + g_t * tt * b
                    )
        for j in range(size):
            a, b, c = covariance[j, p], covariance[j, p + 1], covariance[j, p + 2]
            covariance[j, p] = bb * a + br * c
            covariance[j, p + 1] = eb * a + inv * b + er * c
            covariance[j, p + 2] = rb * a + rr * c
        if calibrated:
            for j in range(size):
                a, b, c = covariance[j, first], covariance[j, first + 1], covariance[j, first + 2]
                for k in range(3):
                    g_x, g_y, g_t = work[p + k, 0], work[p + k, 1], work[p + k, 2]
                    covariance[j, p + k] += (
                        g_x * (sx * a + tx * b + kx * c) + g_y * (sy * a + ty * b + ky * c) + g_t * tt * b
                    )
    # The velocity noise moves all points at once: (c_x, c_y, delta) has covariance Q, point i takes g_i.
    q_xx = var_v * vx * vx + var_lateral * lx * lx + var_w * wx * wx
    q_xy = var_v * vx * vy + var_lateral * lx * ly + var_w * wx * wy
    q_yy = var_v * vy * vy + var_lateral * ly * ly + var_w * wy * wy
    q_xt, q_yt, q_tt = var_w * wx * dt, var_w * wy * dt, var_w * dt * dt
    for i in range(3 * points):
        if not known[i // 3]:
            continue
        g_x, g_y, g_t = work[i, 0], work[i, 1], work[i, 2]
        h_x = g_x * q_xx + g_y * q_xy + g_t * q_xt
        h_y = g_x * q_xy + g_y * q_yy + g_t * q_yt
        h_t = g_x * q_xt + g_y * q_yt + g_t * q_tt
        for j in range(i + 1):
            if known[j // 3]:
                covariance[i, j] += h_x * work[j, 0] + h_y * work[j, 1] + h_t * work[j, 2]
                covariance[j, i] = covariance[i, j]


@kernel
def map_forget(state, covariance, known, i):
    """Drop point i from a map: its state, its variance and what ties it to the others become zero."""
    p = 3 * i
    known[i] = False
    for k in range(p, p + 3):
        state[k] = 0.0
        for j in range(state.shape[0]):
            covariance[k, j] = 0.0
            covariance[j, k] = 0.0


@kernel
def seen_bearing(state, points, beta, w):
    """Bearing in the body frame of what the camera sees at `beta`: beta + psi - w tau by the state's calibration."""
    first = 3 * points
    if state.shape[0] > first:
        return beta + state[first + 3] - w * state[first + 4]
    return beta


@kernel
def map_enter(state, covariance, known, i, x, y, w, variance, rho, rho_variance):
    """Enter point i with its bearing and elevation as seen now, tied to the others by the calibration alone.

    Args:
        state, covariance, known: (D,), (D, D), (m,) the map, changed in place.
        i: the point.
        x, y: [-] its image; y is NaN where only the bearing is measured.
        w: [rad/s] yaw rate at the image.
        variance: [-] of an image coordinate.
        rho, rho_variance: [1/m, 1/m²] inverse horizontal range and its variance.
    """
    p, first, size = 3 * i, 3 * known.shape[0], state.shape[0]
    map_forget(state, covariance, known, i)
    level = math.isnan(y)
    height = 0.0 if level else y
    beta, eta, _ = to_polar(x, height, 1.0)
    r_bb, r_be, r_ee = image_noise(x, height, variance)
    if size > first:
        for j in range(size):
            covariance[p, j] = covariance[first + 3, j] - w * covariance[first + 4, j]
            covariance[j, p] = covariance[p, j]
        covariance[p, p] = covariance[p, first + 3] - w * covariance[p, first + 4]
    state[p], state[p + 1], state[p + 2] = wrap_angle(seen_bearing(state, known.shape[0], beta, w)), eta, rho
    covariance[p, p] += r_bb
    if not level:
        covariance[p, p + 1] = covariance[p + 1, p] = r_be
    covariance[p + 1, p + 1] = NO_HEIGHT_VARIANCE if level else r_ee
    covariance[p + 2, p + 2] = rho_variance
    known[i] = True


@kernel
def depth_prior(x, depth, depth_sd):
    """(rho, its variance) of a point seen at x [-] whose depth [m] along the optical axis is guessed.

    rho = cos beta/z, with standard deviation cos beta sd/z².
    """
    cos = 1.0 / math.sqrt(1.0 + x * x)
    sd = cos * depth_sd / (depth * depth)
    return cos / depth, sd * sd


@kernel
def map_correct(state, covariance, points, i, x, y, w, variance, gate, bearing_gate, work):
    """Correct a map by the image of one of its points, which is linear in the state.

    -atan x = beta - psi + w tau (psi, tau only where the calibration is in the state),  -y cos(atan x) = eta

    Args:
        state, covariance: (D,), (D, D), changed in place.
        points: m, their number.
        i: the point.
        x, y: [-] its image; y is NaN where only the bearing is measured.
        w: [rad/s] yaw rate at the image.
        variance: [-] of an image coordinate.
        gate, bearing_gate: [-] largest normalised innovation squared that is accepted, for two measured coordinates,
            and for a bearing alone.
        work: (≥ D, ≥ 2) scratch.

    Returns:
        (accepted, innovation squared): whether it passed the gate; if not, nothing is changed.
    """
    size, p, first = state.shape[0], 3 * i, 3 * points
    level = math.isnan(y)
    height = 0.0 if level else y
    beta, eta, _ = to_polar(x, height, 1.0)
    r_bb, r_be, r_ee = image_noise(x, height, variance)
    for j in range(size):
        work[j, 0], work[j, 1] = covariance[j, p], covariance[j, p + 1]
        if size > first:
            work[j, 0] += w * covariance[j, first + 4] - covariance[j, first + 3]
    s_bb = work[p, 0] + r_bb
    if size > first:
        s_bb += w * work[first + 4, 0] - work[first + 3, 0]
    s_be, s_ee = work[p + 1, 0] + r_be, work[p + 1, 1] + r_ee
    e_b, e_e = wrap_angle(seen_bearing(state, points, beta, w) - state[p]), eta - state[p + 1]
    if level:
        # An elevation of endless variance: its gains vanish.
        i_bb, i_be, i_ee = 1.0 / s_bb, 0.0, 0.0
    else:
        inverse = 1.0 / (s_bb * s_ee - s_be * s_be)
        i_bb, i_be, i_ee = s_ee * inverse, -s_be * inverse, s_bb * inverse
    squared = i_bb * e_b * e_b + 2.0 * i_be * e_b * e_e + i_ee * e_e * e_e
    if not squared < (bearing_gate if level else gate):
        return False, squared
    for j in range(size):
        gain_b = i_bb * work[j, 0] + i_be * work[j, 1]
        gain_e = i_be * work[j, 0] + i_ee * work[j, 1]
        state[j] += gain_b * e_b + gain_e * e_e
        for k in range(j + 1):
            covariance[j, k] -= gain_b * work[k, 0] + gain_e * work[k, 1]
            covariance[k, j] = covariance[j, k]
    state[p] = wrap_angle(state[p])
    return True, squared
