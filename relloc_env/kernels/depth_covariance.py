"""Covariance of the depth observer's error, and of a remembered point: the discrete Lyapunov equation.

docs/equations.md, section 3. Covariances are six numbers, upper triangle by rows: (aa, ab, ac, bb, bc, cc).
"""

from relloc_env.kernels._compile import kernel


@kernel
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


@kernel
def covariance_step(p, x, y, chi, v, lateral, w, dt, h, alpha_lambda, mode, var_x, var_y, var_v, var_l, var_w):
    """Covariance of (x, y, chi) - (x_hat, y_hat, chi_hat) after `observer_step`, same discrete transition.

    P <- F L' P L'ᵀ F + …: L the exponential of the linear part, F two half steps of the linearised f_u. Each measured
    sample brings one independent image error n, held over its interval: its response is that of the observer tracking
    s + n. Each interval brings one independent error of v, l and w, through the derivatives of the flow.

    Args:
        p: covariance at the earlier sample, six numbers in (x, y, chi).
        x, y, chi: [-, -, 1/m] mean image coordinates and inverse depth of the interval.
        v, lateral, w, dt: velocity [m/s, m/s, rad/s] and length [s] of it.
        h, alpha_lambda, mode: gains, and what `modes` gives for them.
        var_x, var_y: [-] variance of a measured image coordinate.
        var_v, var_l, var_w: variance of the interval's mean velocity.
    """
    s_0, s, i = mode
    o_x, o_y = v * x + lateral, v * y
    sigma2 = o_x * o_x + o_y * o_y
    a, k = h * dt, alpha_lambda * sigma2 * dt * dt
    decay, decay_o = 1.0 - a * s_0, 1.0 - a * s - k * i
    inverse = 1.0 / sigma2 if sigma2 > 0.0 else 0.0
    u = (v * chi + 0.5 * w * x) * dt
    flow = 1.0 + u * (1.0 + 0.5 * u)
    m = inverse * (decay_o - decay)
    t_x, t_y = dt * s * o_x, dt * s * o_y
    p11, p12, p13, p22, p23, p33 = congruence(
        decay + m * o_x * o_x,
        m * o_x * o_y,
        t_x,
        m * o_x * o_y,
        decay + m * o_y * o_y,
        t_y,
        -alpha_lambda * t_x,
        -alpha_lambda * t_y,
        1.0 - k * i,
        p[0],
        p[1],
        p[2] * flow,
        p[3],
        p[4] * flow,
        p[5] * flow * flow,
    )
    # image noise: columns of the response to an error of x and of y
    m = inverse * (decay - decay_o)
    n_xx, n_xy, n_yy = 1.0 - decay + m * o_x * o_x, m * o_x * o_y, 1.0 - decay + m * o_y * o_y
    n_xc, n_yc = alpha_lambda * t_x, alpha_lambda * t_y
    p11 += var_x * n_xx * n_xx + var_y * n_xy * n_xy
    p12 += var_x * n_xx * n_xy + var_y * n_xy * n_yy
    p13 += var_x * n_xx * n_xc + var_y * n_xy * n_yc
    p22 += var_x * n_xy * n_xy + var_y * n_yy * n_yy
    p23 += var_x * n_xy * n_xc + var_y * n_yy * n_yc
    p33 += var_x * n_xc * n_xc + var_y * n_yc * n_yc
    # odometry: derivatives of the flow with respect to v, l and w, through the integral of the exponential
    across, along, back = dt * s_0, dt * inverse * (s - s_0), dt * dt * i
    mean_c = dt * (s + a * i)
    for b_x, b_y, b_c, var in (
        (x * chi, y * chi, chi * chi, var_v),
        (chi, 0.0, 0.0, var_l),
        (1.0 + x * x, x * y, x * chi, var_w),
    ):
        b_o = o_x * b_x + o_y * b_y
        r = along * b_o + back * b_c
        r_x, r_y, r_c = across * b_x + o_x * r, across * b_y + o_y * r, mean_c * b_c - alpha_lambda * back * b_o
        p11 += var * r_x * r_x
        p12 += var * r_x * r_y
        p13 += var * r_x * r_c
        p22 += var * r_y * r_y
        p23 += var * r_y * r_c
        p33 += var * r_c * r_c
    return p11, p12, p13 * flow, p22, p23 * flow, p33 * flow * flow


@kernel
def image_to_body(x, y, chi, p):
    """Covariance of (q_x, q_y, height) of a point from that of (x, y, chi), first order."""
    z = 1.0 / chi
    zz = z * z
    return congruence(0.0, 0.0, -zz, -z, 0.0, x * zz, 0.0, -z, y * zz, p[0], p[1], p[2], p[3], p[4], p[5])


@kernel
def body_to_image(q_x, q_y, height, p):
    """Covariance of (x, y, chi) of a point from that of (q_x, q_y, height), first order; q_x > 0."""
    c = 1.0 / q_x
    cc = c * c
    return congruence(q_y * cc, -c, 0.0, height * cc, 0.0, -c, -cc, 0.0, 0.0, p[0], p[1], p[2], p[3], p[4], p[5])


@kernel
def body_to_polar(q_x, q_y, height, p):
    """Covariance of (beta, eta, rho) of a point (see `camera.to_polar`) from that of (q_x, q_y, height)."""
    rho2 = 1.0 / (q_x * q_x + q_y * q_y)
    rho = rho2**0.5
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


@kernel
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
    p11, p12, p13, p22, p23, p33 = congruence(
        cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0, p[0], p[1], p[2], p[3], p[4], p[5]
    )
    t = dt * dt
    return (
        p11 + t * (var_v + var_w * q_y * q_y),
        p12 - t * var_w * q_x * q_y,
        p13,
        p22 + t * (var_l + var_w * q_x * q_x),
        p23,
        p33,
    )
