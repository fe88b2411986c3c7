"""The depth observer of one point: gains, and the step between two measured samples.

After [RMDA19] (equations for s-hat and chi-hat) and Spica & Robuffo Giordano, CDC 2013; docs/equations.md, section 3:

    ds_hat/dt   = f_m(s, u) + Omega chi_hat + H (s - s_hat),      Omega = [v x + l, v y]
    dchi_hat/dt = f_u(s, u, chi_hat) + alpha Lambda Omega (s - s_hat)

with f_m = w [1 + x², x y] and f_u = v chi_hat² + w x chi_hat. The lateral speed l (to the left) is 0 for a
differential drive: it moves the image like l [1, 0] chi, so it stands beside v x in Omega and nowhere else.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel

STEEPEST = 50.0
"""[-] greatest exponent of the inverse depth's growth in a step; the depth is at its limit long before."""


@inlined
def gains(v, lateral, x, y, h, alpha_lambda, critical, floor):
    """Observer gain H [1/s]: as given, or critically damped for the present excitation.

    Linearised, the error of chi obeys r² + H r + alpha Lambda sigma² = 0, sigma² = |Omega|² = (v x + l)² + (v y)²:
    critical damping is H = 2 sqrt(alpha Lambda) sigma (docs/equations.md, section 3).

    Args:
        v, lateral: [m/s] velocity of the camera, forward and to the left.
        x, y: [-] measured image coordinates (y may be NaN: a bearing without a height).
        h: [1/s] fixed gain.
        alpha_lambda: [1/m²] product of the gains alpha and Lambda.
        critical: whether H follows the excitation.
        floor: [1/s] smallest H when it does.
    """
    o_x = v * x + lateral
    o_y = 0.0 if math.isnan(y) else v * y
    follow = max(floor, 2.0 * np.sqrt(alpha_lambda * (o_x * o_x + o_y * o_y)))
    return follow if critical else h


@inlined
def slow_mean_decay(u):
    """`mean_decay` by its series near zero (error below 2e-13 for |u| < 0.2)."""
    high = 1 / 120 + u * (-1 / 720 + u * (1 / 5040 + u * (-1 / 40320 + u * (1 / 362880))))
    return 1.0 + u * (-1 / 2 + u * (1 / 6 + u * (-1 / 24 + u * high)))


@kernel
def mean_decay(u):
    """Mean of exp(-u t) over t in [0, 1]: (1 - exp(-u))/u, by its series near zero (error below 2e-13).

    Below -`STEEPEST`, where a point far off the axis sweeps through the image, it is taken there: it stays finite.
    """
    u = max(u, -STEEPEST)
    return slow_mean_decay(u) if abs(u) < 0.2 else -math.expm1(-u) / u


@inlined
def is_slow(a, k, u):
    """Whether the power series of `slow_modes` and `slow_mean_decay` cover a step."""
    return (a < 0.2) & (k < 0.04) & (abs(u) < 0.2)


@inlined
def slow_modes(a, k):
    """`modes` of a slow step, as a power series; a = H dt, k = stiffness dt²."""
    s_0 = slow_mean_decay(a)
    s_1 = 1 / 6 + a * (-1 / 12 + a * (1 / 40 + a * (-1 / 180 + a * (1 / 1008 - a * (1 / 6720)))))
    s_2 = 1 / 120 + a * (-1 / 240 + a * (1 / 840 - a * (1 / 4032)))
    i_0 = 1 / 2 + a * (-1 / 6 + a * (1 / 24 + a * (-1 / 120 + a * (1 / 720 + a * (-1 / 5040 + a * (1 / 40320))))))
    i_1 = 1 / 24 + a * (-1 / 60 + a * (1 / 240 + a * (-1 / 1260 + a * (1 / 8064))))
    i_2 = 1 / 720 + a * (-1 / 1680 + a * (1 / 6720))
    s = s_0 - k * (s_1 - k * (s_2 - k * (1 / 5040 - a * (1 / 10080))))
    return s_0, s, i_0 - k * (i_1 - k * (i_2 - k * (1 / 40320)))


@kernel
def modes(h, stiffness, dt):
    """Closed form of the linear error dynamics over a step, for M = dt [[-H, -sigma], [alpha Lambda sigma, 0]].

    exp(M) follows from two numbers, s and i, that have no singular point: with a = H dt and k = stiffness dt²,

        exp(M) = [[1 - a s - k i, -sigma dt s], [alpha Lambda sigma dt s, 1 - k i]]

    s is the unit impulse response of r'' + a r' + k r at time 1, i its integral. Over-damped, under-damped and nearly
    critical cases have their own formula; slow steps (the usual case) a power series that covers all three.

    Args:
        h: [1/s] gain H.
        stiffness: [1/s²] alpha Lambda sigma².
        dt: [s] length of the step.

    Returns:
        (s_0, s, i): [-] s without stiffness (the part of the image error across Omega), s and i.
    """
    a, k = h * dt, stiffness * dt * dt
    s_0 = mean_decay(a)
    if is_slow(a, k, 0.0):
        return slow_modes(a, k)
    a_half = 0.5 * a
    u = a_half * a_half - k
    if u > 0.01:
        root = math.sqrt(u)
        fast = a_half + root
        slow = k / fast
        mean_slow, mean_fast = mean_decay(slow), mean_decay(fast)
        return s_0, (fast * mean_fast - slow * mean_slow) / (2.0 * root), (mean_slow - mean_fast) / (2.0 * root)
    if u < -0.5:
        root = math.sqrt(-u)
        even, odd = math.cos(root), math.sin(root) / root
    else:
        even = 1.0 + u * (
            1 / 2 + u * (1 / 24 + u * (1 / 720 + u * (1 / 40320 + u * (1 / 3628800 + u * (1 / 479001600)))))
        )
        odd = 1.0 + u * (
            1 / 6 + u * (1 / 120 + u * (1 / 5040 + u * (1 / 362880 + u * (1 / 39916800 + u * (1 / 6227020800)))))
        )
    decay = math.exp(-a_half)
    return s_0, decay * odd, (1.0 - decay * (even + a_half * odd)) / k


@inlined
def interval_means(x0, y0, x1, y1, chi, v, w, dt):
    """Means of x, y, x² and x y over the interval between two samples (Simpson's rule, fourth order).

    The middle is that of the cubic through both samples with the slopes of the image flow at them; noise is averaged.

    Args:
        x0, y0, x1, y1: [-] image coordinates at both ends.
        chi: [1/m] inverse depth between them (an estimate will do: it bends the path by v chi dt only).
        v, w: [m/s, rad/s] forward speed, yaw rate (a lateral speed adds the same slope at both ends).
        dt: [s] length of the interval.
    """
    x_m = 0.5 * (x0 + x1) - 0.125 * dt * (x1 - x0) * (w * (x0 + x1) + v * chi)
    y_m = 0.5 * (y0 + y1) - 0.125 * dt * (w * (x1 * y1 - x0 * y0) + v * chi * (y1 - y0))
    return (
        1 / 6 * (x0 + x1) + 2 / 3 * x_m,
        1 / 6 * (y0 + y1) + 2 / 3 * y_m,
        1 / 6 * (x0 * x0 + x1 * x1) + 2 / 3 * x_m * x_m,
        1 / 6 * (x0 * y0 + x1 * y1) + 2 / 3 * x_m * y_m,
    )


@inlined
def inverse_depth_flow(chi, stretch, advance, chi_min, z_min):
    """The flow of f_u with x constant, exact: dz/dt = -v - w x z is linear in z = 1/chi, so z <- stretch z - advance.

    stretch = exp(-w x dt), advance = v dt times its mean over the step.

    Args:
        chi: [1/m] inverse depth.
        stretch, advance: [-, m] coefficients of the step.
        chi_min, z_min: [1/m, m] least inverse depth and least depth of the result.
    """
    return max(chi / max(stretch - advance * chi, chi * z_min), chi_min)


@inlined
def correct(x0, y0, x1, y1, means, xh, yh, chi, v, lateral, w, dt, h, alpha_lambda, mode, decay, chi_min, chi_max):
    """The observer's state at the later of two measured samples, from that at the earlier one.

    In e = s - s_hat the observer is linear but for f_u: de/dt = (ds/dt - f_m) - Omega chi_hat - H e,
    dchi_hat/dt = f_u + alpha Lambda Omega e. Strang splitting: half a step of f_u (exact in 1/chi), the exact
    exponential of the linear part with Omega and f_m averaged over the interval, half a step of f_u. Second order in
    dt; bounded for any gain and dt, since the exponential contracts e and chi is clamped.

    Args:
        x0, y0, x1, y1: [-] measured image coordinates at both ends.
        means: `interval_means` of them.
        xh, yh, chi: [-, -, 1/m] the observer's state at the earlier sample.
        v, lateral, w: [m/s, m/s, rad/s] mean velocity between them.
        dt: [s] time between them, above 0.
        h, alpha_lambda: [1/s, 1/m²] gains.
        mode: `modes` for them, with Omega at the mean x and y.
        decay: `mean_decay` of w x dt/2 at the mean x.
        chi_min, chi_max: [1/m] bounds of chi.

    Returns:
        (xh, yh, chi) at the later sample.
    """
    x, y, xx, xy = means
    s_0, s, i = mode
    o_x, o_y = v * x + lateral, v * y
    sigma2 = o_x * o_x + o_y * o_y
    a, k = h * dt, alpha_lambda * sigma2 * dt * dt
    z_min = 1.0 / chi_max
    stretch, advance = 1.0 - 0.5 * dt * w * x * decay, 0.5 * dt * v * decay
    e_x, e_y = x0 - xh, y0 - yh
    g_x, g_y = x1 - x0 - w * dt * (1.0 + xx), y1 - y0 - w * dt * xy
    e_o, g_o = o_x * e_x + o_y * e_y, o_x * g_x + o_y * g_y
    chi = inverse_depth_flow(chi, stretch, advance, chi_min, z_min)
    across = ((a * (s_0 - s) - k * i) * e_o + (s - s_0) * g_o) / sigma2
    along = -dt * s * chi + (across if sigma2 > 0.0 else 0.0)
    decay = 1.0 - a * s_0
    xh = x1 - (decay * e_x + s_0 * g_x + o_x * along)
    yh = y1 - (decay * e_y + s_0 * g_y + o_y * along)
    chi = (1.0 - k * i) * chi + alpha_lambda * dt * (s * e_o + i * g_o)
    chi = inverse_depth_flow(min(max(chi, chi_min), chi_max), stretch, advance, chi_min, z_min)
    return xh, yh, chi
