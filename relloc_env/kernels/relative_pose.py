"""Pose of a robot B seen from a robot A: dynamics, exact prediction, three observation models, Kalman update.

The pose is xi = (r_x, r_y, theta), r in {A}, theta = theta_B - theta_A. The same kernels with the roles swapped give
the pose of A seen from B. A velocity is (v, l, w): forward, lateral (left), yaw rate. Symmetric matrices are passed
as their upper triangle, row by row: (xx, xy, xt, yy, yt, tt) for 3x3, (xx, xy, yy) for 2x2. J = [[0, -1], [1, 0]].
"""

import math

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.motion import wrap_angle

POSITION = 0
VELOCITY = 1
PRINTED = 2
SINGULAR = 1e-10
"""[-] determinant of an innovation's covariance over the product of its diagonal up to which it is not inverted."""


@kernel
def derivative(r_x, r_y, theta, v_a, l_a, w_a, v_b, l_b, w_b):
    """Time derivative of xi: dr/dt = R(theta) u_B - u_A - w_A J r, dtheta/dt = w_B - w_A ([RMDA19] eq. 3).

    Args:
        r_x, r_y, theta: [m, m, rad] pose of B in {A}.
        v_a, l_a, w_a: [m/s, m/s, rad/s] velocity of A in {A}.
        v_b, l_b, w_b: [m/s, m/s, rad/s] velocity of B in {B}.
    """
    cos, sin = math.cos(theta), math.sin(theta)
    return cos * v_b - sin * l_b - v_a + w_a * r_y, sin * v_b + cos * l_b - l_a - w_a * r_x, w_b - w_a


@inlined
def arc_jacobian(v, lateral, w, dt):
    """How errors of a constant velocity move the end of `motion.arc`, in the body frame at its end.

    With h = w dt/2: d/dv = dt sinc(h) R(-h) e1, d/dl = J d/dv, d/dw = dt²/2 (sinc'(h) + sinc(h) J) R(-h) [v, l];
    the turn moves by dt per unit of w (motion.arc differentiated, rotated by -w dt).

    Args:
        v, lateral, w: [m/s, m/s, rad/s] velocity.
        dt: [s] length of the step.

    Returns:
        (a_x, a_y, b_x, b_y): [s, s, m s, m s] d/dv = (a_x, a_y, 0), d/dl = (-a_y, a_x, 0), d/dw = (b_x, b_y, dt).
    """
    half = 0.5 * w * dt
    sin, cos = sin_cos(half)
    ratio = 1.0 - half * half / 6.0 if abs(half) < 1e-4 else sin / half
    slope = (cos - ratio) / half if abs(half) > 1e-2 else half * (-1.0 / 3.0 + half * half * (1.0 / 30.0))
    e_x, e_y = v * cos + lateral * sin, lateral * cos - v * sin
    scale = 0.5 * dt * dt
    return (
        dt * ratio * cos,
        -dt * ratio * sin,
        scale * (slope * e_x - ratio * e_y),
        scale * (slope * e_y + ratio * e_x),
    )


@inlined
def predict_rotated(r_x, r_y, theta, cos, sin, c_ax, c_ay, delta_a, cos_a, sin_a, c_bx, c_by, delta_b):
    """`predict` with cos and sin of theta and of delta_a given."""
    g_x, g_y = cos * c_bx - sin * c_by, sin * c_bx + cos * c_by
    t_x, t_y = r_x + g_x - c_ax, r_y + g_y - c_ay
    return (
        cos_a * t_x + sin_a * t_y,
        cos_a * t_y - sin_a * t_x,
        wrap_angle(theta + delta_b - delta_a),
        cos_a * g_x + sin_a * g_y,
        cos_a * g_y - sin_a * g_x,
    )


@kernel
def predict(r_x, r_y, theta, c_ax, c_ay, delta_a, c_bx, c_by, delta_b):
    """Exact pose after both robots moved: xi+ = Delta_A^-1 ∘ xi ∘ Delta_B (`derivative` integrated over arcs).

    r+ = R(-delta_A) (r + R(theta) c_B - c_A),  theta+ = theta + delta_B - delta_A (wrapped).
    The Jacobian with respect to xi is F = [[R(-delta_A), J d], [0, 1]] with d = R(theta - delta_A) c_B.

    Args:
        r_x, r_y, theta: [m, m, rad] pose of B in {A}.
        c_ax, c_ay, delta_a: [m, m, rad] displacement of A in {A} (`motion.arc`, or composed from several).
        c_bx, c_by, delta_b: [m, m, rad] displacement of B in {B}.

    Returns:
        (r_x+, r_y+, theta+, d_x, d_y): d is what the Jacobian needs.
    """
    cos, sin = math.cos(theta), math.sin(theta)
    cos_a, sin_a = math.cos(delta_a), math.sin(delta_a)
    return predict_rotated(r_x, r_y, theta, cos, sin, c_ax, c_ay, delta_a, cos_a, sin_a, c_bx, c_by, delta_b)


@inlined
def propagate(cos, sin, t_x, t_y, p):
    """Covariance mapped by X = [[R^T, t], [0, 1]], R = [[cos, -sin], [sin, cos]]: X P X^T, upper triangle.

    With R = R(delta_A), t = J d = (-d_y, d_x) this is the F P F^T of `predict`.
    """
    pxx, pxy, pxt, pyy, pyt, ptt = p
    # P times X^T: the columns that meet t first, then the rotation
    axt, ayt = cos * pxt + sin * pyt, cos * pyt - sin * pxt
    a, b = cos * pxx + sin * pxy, cos * pxy + sin * pyy
    c, d = cos * pxy - sin * pxx, cos * pyy - sin * pxy
    xt, yt = axt + t_x * ptt, ayt + t_y * ptt
    return (
        a * cos + b * sin + t_x * (axt + xt),
        b * cos - a * sin + t_y * axt + t_x * yt,
        xt,
        d * cos - c * sin + t_y * (ayt + yt),
        yt,
        ptt,
    )


@inlined
def displacement_noise(a_x, a_y, b_x, b_y, dt, var_v, var_w):
    """Covariance of a displacement in the body frame at its end, from the variances of v and w.

    N = var_v a a^T + var_w b b^T with a = (a_x, a_y, 0), b = (b_x, b_y, dt) of `arc_jacobian`; upper triangle.
    """
    return (
        var_v * a_x * a_x + var_w * b_x * b_x,
        var_v * a_x * a_y + var_w * b_x * b_y,
        var_w * b_x * dt,
        var_v * a_y * a_y + var_w * b_y * b_y,
        var_w * b_y * dt,
        var_w * dt * dt,
    )


@inlined
def noise_of_a(r_x, r_y, x, y, cos, sin, n):
    """Noise on xi from that of A's displacement, which is known in a fixed frame {O}: X N X^T, upper triangle.

    A perturbation n of A's displacement in the body frame at its end moves xi+ to exp(-n) ∘ xi+, that is by
    -[[I, J r+], [0, 1]] n; and a perturbation e of the pose (x, y, phi) of A in {O}, exp(e) ∘ pose, is
    n = [[R^T, R^T J p], [0, 1]] e with p = (x, y), R = R(phi). X is their product.

    Args:
        r_x, r_y: [m] predicted position of B in {A}.
        x, y, cos, sin: [m, m, -, -] pose of A in {O}, cos and sin of its heading; (0, 0, 1, 0) if {O} is {A} itself.
        n: six numbers, covariance of the displacement in {O}.
    """
    return propagate(cos, sin, sin * x - cos * y - r_y, cos * x + sin * y + r_x, n)


@inlined
def noise_of_b(cos_t, sin_t, x, y, cos, sin, n):
    """Noise on xi from that of B's displacement, which is known in a fixed frame {O}; see `noise_of_a`.

    Here xi+ moves to xi+ ∘ exp(n), that is by [[R(theta+), 0], [0, 1]] n.

    Args:
        cos_t, sin_t: of the predicted theta+.
        x, y, cos, sin: [m, m, -, -] pose of B in {O}, cos and sin of its heading; (0, 0, 1, 0) if {O} is {B} itself.
        n: six numbers, covariance of the displacement in {O}.
    """
    c, s = cos * cos_t + sin * sin_t, sin * cos_t - cos * sin_t
    return propagate(c, s, s * x - c * y, c * x + s * y, n)


@inlined
def observe(model, r_x, r_y, cos, sin, q_ax, q_ay, q_bx, q_by, v_a, l_a, w_a, v_b, l_b):
    """Innovation and Jacobian of one point in an observation model (docs/equations.md, section 4).

    POSITION  pi = q_B,                   h = R^T (q_A - r)
    VELOCITY  pi = S(dtheta) q_B + dq_B,  h = R^T (dq_A - dr)
    PRINTED   pi as VELOCITY,             h = R^T dq_A        ([RMDA19] as printed; biased)

    with dq = -w J q - u of a static point, so that pi = -w_A J q_B - u_B.

    Args:
        model: POSITION, VELOCITY or PRINTED.
        r_x, r_y: [m] position of B in {A}.
        cos, sin: of theta.
        q_ax, q_ay: [m] the point in {A}.
        q_bx, q_by: [m] the point in {B}.
        v_a, l_a, w_a: [m/s, m/s, rad/s] velocity of A.
        v_b, l_b: [m/s] speeds of B; its yaw rate cancels.

    Returns:
        (y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t): innovation pi - h, then the rows of H = dh/dxi.
    """
    if model == PRINTED:
        s_x, s_y = w_a * q_ay - v_a, -w_a * q_ax - l_a
        m_0, m_1 = cos * s_x + sin * s_y, cos * s_y - sin * s_x
        return w_a * q_by - v_b - m_0, -w_a * q_bx - l_b - m_1, 0.0, 0.0, m_1, 0.0, 0.0, -m_0
    d_x, d_y = q_ax - r_x, q_ay - r_y
    m_0, m_1 = cos * d_x + sin * d_y, cos * d_y - sin * d_x
    y_0, y_1 = q_bx - m_0, q_by - m_1
    if model == POSITION:
        return y_0, y_1, -cos, -sin, m_1, sin, -cos, -m_0
    return w_a * y_1, -w_a * y_0, w_a * sin, -w_a * cos, -w_a * m_0, w_a * cos, w_a * sin, -w_a * m_1


@inlined
def observe_covariance(model, cos, sin, w_a, axx, axy, ayy, bxx, bxy, byy, floor):
    """Covariance of the innovation from those of both points: C = R^T C_A R + C_B, rank-aware, plus floor I.

    For the velocity models it is w_A² J C J^T plus floor I.

    Args:
        model: POSITION, VELOCITY or PRINTED.
        cos, sin: of theta.
        w_a: [rad/s] yaw rate of A.
        axx, axy, ayy: [m²] covariance of q_A in {A}.
        bxx, bxy, byy: [m²] covariance of q_B in {B}.
        floor: [m²; m²/s²] variance added to both axes.

    Returns:
        (xx, xy, yy): upper triangle.
    """
    a, b = cos * axx + sin * axy, cos * axy + sin * ayy
    c, d = cos * axy - sin * axx, cos * ayy - sin * axy
    xx, xy, yy = a * cos + b * sin + bxx, b * cos - a * sin + bxy, d * cos - c * sin + byy
    if model == POSITION:
        return xx + floor, xy, yy + floor
    ww = w_a * w_a
    return ww * yy + floor, -ww * xy, ww * xx + floor


@inlined
def correct(r_x, r_y, theta, p, y_0, y_1, h_0x, h_0y, h_0t, h_1x, h_1y, h_1t, rxx, rxy, ryy):
    """Kalman update with a measurement of two components, covariance in Joseph form.

    S = H P H^T + R, K = P H^T S^-1, xi += K y (angle wrapped), P = (I - K H) P (I - K H)^T + K R K^T.

    Args:
        r_x, r_y, theta: [m, m, rad] pose.
        p: six numbers, its covariance.
        y_0, y_1: innovation.
        h_0x, h_0y, h_0t, h_1x, h_1y, h_1t: rows of H.
        rxx, rxy, ryy: covariance of the measurement; positive definite. Where S is so long and narrow that its
            determinant is up to `SINGULAR` of the product of its diagonal, it is passed over: the pose stays.

    Returns:
        (r_x, r_y, theta, pxx, pxy, pxt, pyy, pyt, ptt) after the update.
    """
    pxx, pxy, pxt, pyy, pyt, ptt = p
    # C = P H^T
    c_x0, c_x1 = pxx * h_0x + pxy * h_0y + pxt * h_0t, pxx * h_1x + pxy * h_1y + pxt * h_1t
    c_y0, c_y1 = pxy * h_0x + pyy * h_0y + pyt * h_0t, pxy * h_1x + pyy * h_1y + pyt * h_1t
    c_t0, c_t1 = pxt * h_0x + pyt * h_0y + ptt * h_0t, pxt * h_1x + pyt * h_1y + ptt * h_1t
    s_00 = h_0x * c_x0 + h_0y * c_y0 + h_0t * c_t0 + rxx
    s_01 = h_0x * c_x1 + h_0y * c_y1 + h_0t * c_t1 + rxy
    s_11 = h_1x * c_x1 + h_1y * c_y1 + h_1t * c_t1 + ryy
    determinant = s_00 * s_11 - s_01 * s_01
    scale = 1.0 / determinant if determinant > SINGULAR * s_00 * s_11 else 0.0
    i_00, i_01, i_11 = s_11 * scale, -s_01 * scale, s_00 * scale
    k_x0, k_x1 = c_x0 * i_00 + c_x1 * i_01, c_x0 * i_01 + c_x1 * i_11
    k_y0, k_y1 = c_y0 * i_00 + c_y1 * i_01, c_y0 * i_01 + c_y1 * i_11
    k_t0, k_t1 = c_t0 * i_00 + c_t1 * i_01, c_t0 * i_01 + c_t1 * i_11
    # A = (I - K H) P
    a_xx, a_xy, a_xt = pxx - k_x0 * c_x0 - k_x1 * c_x1, pxy - k_x0 * c_y0 - k_x1 * c_y1, pxt - k_x0 * c_t0 - k_x1 * c_t1
    a_yx, a_yy, a_yt = pxy - k_y0 * c_x0 - k_y1 * c_x1, pyy - k_y0 * c_y0 - k_y1 * c_y1, pyt - k_y0 * c_t0 - k_y1 * c_t1
    a_tx, a_ty, a_tt = pxt - k_t0 * c_x0 - k_t1 * c_x1, pyt - k_t0 * c_y0 - k_t1 * c_y1, ptt - k_t0 * c_t0 - k_t1 * c_t1
    # G = K R - A H^T, so that A (I - K H)^T + K R K^T = A + G K^T
    g_x0 = k_x0 * rxx + k_x1 * rxy - (a_xx * h_0x + a_xy * h_0y + a_xt * h_0t)
    g_x1 = k_x0 * rxy + k_x1 * ryy - (a_xx * h_1x + a_xy * h_1y + a_xt * h_1t)
    g_y0 = k_y0 * rxx + k_y1 * rxy - (a_yx * h_0x + a_yy * h_0y + a_yt * h_0t)
    g_y1 = k_y0 * rxy + k_y1 * ryy - (a_yx * h_1x + a_yy * h_1y + a_yt * h_1t)
    g_t0 = k_t0 * rxx + k_t1 * rxy - (a_tx * h_0x + a_ty * h_0y + a_tt * h_0t)
    g_t1 = k_t0 * rxy + k_t1 * ryy - (a_tx * h_1x + a_ty * h_1y + a_tt * h_1t)
    return (
        r_x + k_x0 * y_0 + k_x1 * y_1,
        r_y + k_y0 * y_0 + k_y1 * y_1,
        wrap_angle(theta + k_t0 * y_0 + k_t1 * y_1),
        a_xx + g_x0 * k_x0 + g_x1 * k_x1,
        a_xy + g_x0 * k_y0 + g_x1 * k_y1,
        a_xt + g_x0 * k_t0 + g_x1 * k_t1,
        a_yy + g_y0 * k_y0 + g_y1 * k_y1,
        a_yt + g_y0 * k_t0 + g_y1 * k_t1,
        a_tt + g_t0 * k_t0 + g_t1 * k_t1,
    )
