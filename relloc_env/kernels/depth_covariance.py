"""Covariance of the depth observer's error, and of a remembered point: the discrete Lyapunov equation.

docs/equations.md, section 3. Covariances are six numbers, upper triangle by rows: (aa, ab, ac, bb, bc, cc).
"""

import numpy as np

from relloc_env.kernels._compile import inlined

NOTHING_KNOWN = 1e60
"""Variance at which covariances stop growing: steps far off the axis would multiply them until they overflow."""


@inlined
def congruence(l11, l12, l13, l21, l22, l23, l31, l32, l33, p11, p12, p13, p22, p23, p33):
    """L P Lᵀ (upper triangle) of a 3 by 3 matrix L and a symmetric P."""
    a1, a2, a3 = l11 * p11 + l12 * p12 + l13 * p13, l11 * p12 + l12 * p22 + l13 * p23, l11 * p13 + l12 * p23 + l13 * p33
    b1, b2, b3 = l21 * p11 + l22 * p12 + l23 * p13, l21 * p12 + l22 * p22 + l23 * p23, l21 * p13 + l22 * p23 + l23 * p33
    c1, c2, c3 = l31 * p11 + l32 * p12 + l33 * p13, l31 * p12 + l32 * p22 + l33 * p23, l31 * p13 + l32 * p23 + l33 * p33
    return (
        a1 * l11 + a2 * l12 + a3 * l13,
        a1 * l21 + a2 * l22 + a3 * l23,
        a1 * l31 + a2 * l32 + a3 * l33,
        b1 * l21 + b2 * l22 + b3 * l23,
        b1 * l31 + b2 * l32 + b3 * l33,
        c1 * l31 + c2 * l32 + c3 * l33,
    )


@inlined
def covariance_step(p, x, y, chi, v, lateral, w, dt, h, alpha_lambda, mode, var, var_y, var_v, var_l, var_w):
    """Covariance of (x, y, chi) - (x_hat, y_hat, chi_hat) after `depth_observer.correct`, by the same transition.

    P <- F (L (F P F + U) Lᵀ + U + N) F: F half a step of f_u, linearised; L the exponential of the linear part,

        L = [[D I + m Omega Omegaᵀ, t Omega], [-alpha Lambda t Omegaᵀ, e]]

    (D across Omega, D + m sigma² along it). Each measured sample brings one independent image error n, held over its
    interval: its response, in N, is that of the observer tracking s + n. Each interval brings independent errors of v,
    l and w, held over it: they enter through the derivatives of the flow, half of their covariance (U) before L.

    Args:
        p: covariance at the earlier sample, six numbers in (x, y, chi).
        x, y, chi: [-, -, 1/m] mean image coordinates and inverse depth of the interval.
        v, lateral, w, dt: velocity [m/s, m/s, rad/s] and length [s] of it.
        h, alpha_lambda, mode: [1/s, 1/m²] gains, and what `modes` gives for them.
        var, var_y: [-] variance of a measured image coordinate; var_y = 0 (and y = 0) where only x is measured.
        var_v, var_l, var_w: variance of the interval's mean velocity.
    """
    s_0, s, i = mode
    o_x, o_y = v * x + lateral, v * y
    sigma2 = o_x * o_x + o_y * o_y
    a, k = h * dt, alpha_lambda * sigma2 * dt * dt
    d, d_o, e = 1.0 - a * s_0, 1.0 - a * s - k * i, 1.0 - k * i
    inverse = 1.0 / sigma2 if sigma2 > 0.0 else 0.0
    m, t = inverse * (d_o - d), dt * s
    kt = alpha_lambda * t
    u = (v * chi + 0.5 * w * x) * dt
    flow = 1.0 + u * (1.0 + 0.5 * u)
    # odometry: the errors move (x, y, chi) by chi (x, y, chi), chi (1, 0, 0) and (1 + x², x y, x chi) per second
    half = 0.5 * dt * dt
    r_v, r_l, r_w = half * var_v * chi * chi, half * var_l * chi * chi, half * var_w
    xx = 1.0 + x * x
    both, turn = r_v + r_w * xx, r_v + r_w * x * x
    o11, o12, o13 = r_v * x * x + r_l + r_w * xx * xx, both * x * y, both * x * chi
    o22, o23, o33 = turn * y * y, turn * y * chi, turn * chi * chi
    # L P Lᵀ
    p11, p12, p22 = p[0] + o11, p[1] + o12, p[3] + o22
    c_x, c_y, p33 = p[2] * flow + o13, p[4] * flow + o23, p[5] * flow * flow + o33
    q_x, q_y = p11 * o_x + p12 * o_y, p12 * o_x + p22 * o_y
    oo, oc = o_x * q_x + o_y * q_y, o_x * c_x + o_y * c_y
    common = 0.5 * (m * m * oo + 2.0 * m * t * oc + t * t * p33)
    f_x, f_y = d * (m * q_x + t * c_x) + common * o_x, d * (m * q_y + t * c_y) + common * o_y
    g_x, g_y = e * c_x - kt * q_x, e * c_y - kt * q_y
    g = m * (e * oc - kt * oo) + t * (e * p33 - kt * oc)
    # the image's noise
    across, along = (1.0 - d) * (1.0 - d), (1.0 - d_o) * (1.0 - d_o)
    n = var * inverse * (along - across)
    n_c = var * (1.0 - d_o) * kt
    p11, p12, p13, p22, p23, p33 = (
        d * d * p11 + 2.0 * f_x * o_x + var * across + n * o_x * o_x + o11,
        d * d * p12 + f_x * o_y + f_y * o_x + n * o_x * o_y + o12,
        (d * g_x + o_x * (g + n_c) + o13) * flow,
        d * d * p22 + 2.0 * f_y * o_y + var_y * across + n * o_y * o_y + o22,
        (d * g_y + o_y * (g + n_c) + o23) * flow,
        (kt * kt * (oo + var * sigma2) - 2.0 * kt * e * oc + e * e * p33 + o33) * flow * flow,
    )
    kept = NOTHING_KNOWN / max(NOTHING_KNOWN, p11 + p22 + p33)
    return kept * p11, kept * p12, kept * p13, kept * p22, kept * p23, kept * p33


@inlined
def image_to_body(x, y, chi, p):
    """Covariance of (q_x, q_y, height) = [1, -x, -y]/chi of a point from that of (x, y, chi), first order."""
    z = 1.0 / chi
    zz = z * z
    c_x, c_y, cc = zz * z * p[2], zz * z * p[4], zz * zz * p[5]
    d_x, d_y = x * cc - c_x, y * cc - c_y
    return (
        cc,
        -d_x,
        -d_y,
        zz * p[0] + x * (d_x - c_x),
        zz * p[1] + y * d_x - x * c_y,
        zz * p[3] + y * (d_y - c_y),
    )


@inlined
def body_to_image(q_x, q_y, height, p):
    """Covariance of (x, y, chi) of a point from that of (q_x, q_y, height), first order; q_x > 0."""
    c = 1.0 / q_x
    cc = c * c
    return congruence(q_y * cc, -c, 0.0, height * cc, 0.0, -c, -cc, 0.0, 0.0, p[0], p[1], p[2], p[3], p[4], p[5])


@inlined
def body_to_polar(q_x, q_y, height, p):
    """Covariance of (beta, eta, rho) of a point (see `camera.to_polar`) from that of (q_x, q_y, height)."""
    rho2 = 1.0 / (q_x * q_x + q_y * q_y)
    rho = np.sqrt(rho2)
    rho3 = rho * rho2
    return congruence(
        -q_y * rho2,
        q_x * rho2,
        0.0,
        -height * q_x * rho3,
        -height * q_y * rho3,
        rho,
        -q_x * rho3,
        -q_y * rho3,
        0.0,
        p[0],
        p[1],
        p[2],
        p[3],
        p[4],
        p[5],
    )


@inlined
def move_covariance(p, q_x, q_y, cos, sin, dt, var_v, var_l, var_w):
    """Covariance of a remembered point (q_x, q_y, height) in the body frame after the body moved.

    q <- R(-delta)(q - c) is linear in q: P <- R(-delta) P R(-delta)ᵀ, plus odometry errors held over the step, which
    move the point by -dt e_1, -dt e_2 and -dt J q (first order in dt).

    Args:
        p: covariance before the step, six numbers.
        q_x, q_y: [m] the point after the step.
        cos, sin: of the turn delta.
        dt: [s] length of the step.
        var_v, var_l, var_w: variance of the measured velocity of the step.
    """
    f_11, f_12 = cos * p[0] + sin * p[1], cos * p[1] + sin * p[3]
    f_21, f_22 = cos * p[1] - sin * p[0], cos * p[3] - sin * p[1]
    t = dt * dt
    return (
        cos * f_11 + sin * f_12 + t * (var_v + var_w * q_y * q_y),
        cos * f_12 - sin * f_11 - t * var_w * q_x * q_y,
        cos * p[2] + sin * p[4],
        cos * f_22 - sin * f_21 + t * (var_l + var_w * q_x * q_x),
        cos * p[4] - sin * p[2],
        p[5],
    )
