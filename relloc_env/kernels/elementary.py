"""Sine, cosine, arc tangent and logarithm without branches, for loops over lanes (`kernels.lanes`).

A call into the C library keeps a loop from being compiled to vector instructions. These are plain arithmetic, so it
is, and they give the same bits on any machine. Each reduces its argument to a small interval and sums the Taylor
series there. Errors stay below 1 unit in the last place (logarithm), 2 (arc tangent; sine and cosine of
angles below 1000 rad) or 2.5 (of angles below 10⁵ rad).
"""

import numpy as np

from relloc_env.kernels._compile import inlined

_HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
"""pi/2 in parts of 33 bits, so that a multiple of the first two is exact (Cody and Waite, 1980)."""
_LN_2 = (0.6931471803691238, 1.9082149292705877e-10)
"""ln 2, the first part with 32 bits."""
_TWO_OVER_PI = 0.6366197723675814
_PI, _PI_2, _ATAN_HALF = np.pi, np.pi / 2.0, 0.4636476090008061
_SHIFT = 6755399441055744.0
"""1.5 2^52: added to a small whole number, it leaves that number in the last bits of the mantissa."""
_SHIFT_BITS, _ROOT_HALF_BITS = np.int64(0x4338000000000000), np.int64(0x3FE6A09E667F3BCD)
_MANTISSA = np.int64(52)


@inlined
def sin_cos(a):
    """(sin a, cos a) of an angle [rad] below 10⁵ in size."""
    n = np.floor(a * _TWO_OVER_PI + 0.5)
    x = ((a - n * _HALF_PI[0]) - n * _HALF_PI[1]) - n * _HALF_PI[2]
    z = x * x
    s = -1 / 6 + z * (1 / 120 + z * (-1 / 5040 + z * (1 / 362880 + z * (-1 / 39916800 + z * (1 / 6227020800)))))
    s += z * z * z * z * z * z * (-1 / 1307674368000 + z * (1 / 355687428096000))
    c = 1 / 24 + z * (-1 / 720 + z * (1 / 40320 + z * (-1 / 3628800 + z * (1 / 479001600))))
    c += z * z * z * z * z * (-1 / 87178291200 + z * (1 / 20922789888000))
    sin, cos = x + x * z * s, 1.0 - (0.5 * z - z * z * c)
    quarter = n - 4.0 * np.floor(0.25 * n)
    odd, negative = (quarter == 1.0) | (quarter == 3.0), quarter >= 2.0
    first, second = (cos if odd else sin), (sin if odd else cos)
    return (-first if negative else first), (-second if (quarter == 1.0) | (quarter == 2.0) else second)


@inlined
def atan2(y, x):
    """Angle [rad] of (x, y), zeros or normal numbers, in (-pi, pi]; 0 at the origin, and zeros have no sign.

    From a ratio of 1/3 on, the angle to the direction (1, 1/2) is what the series gives.
    """
    a, b = abs(x), abs(y)
    steep = b > a
    high, low = (b if steep else a), (a if steep else b)
    far = 3.0 * low > high
    t = (low - 0.5 * high if far else low) / (high + 0.5 * low if far else (high if high > 0.0 else 1.0))
    z = t * t
    p = 1 / 21 + z * (-1 / 23 + z * (1 / 25 + z * (-1 / 27 + z * (1 / 29 + z * (-1 / 31 + z * (1 / 33))))))
    p = 1 / 13 + z * (-1 / 15 + z * (1 / 17 + z * (-1 / 19 + z * p)))
    p = -1 / 3 + z * (1 / 5 + z * (-1 / 7 + z * (1 / 9 + z * (-1 / 11 + z * p))))
    angle = t + t * z * p
    angle = _ATAN_HALF + angle if far else angle
    angle = _PI_2 - angle if steep else angle
    angle = _PI - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@inlined
def log(a):
    """Natural logarithm of a normal number above 0."""
    bits = np.float64(a).view(np.int64)
    n = (bits - _ROOT_HALF_BITS) >> _MANTISSA
    m = np.int64(bits - (n << _MANTISSA)).view(np.float64)
    exponent = np.int64(n + _SHIFT_BITS).view(np.float64) - _SHIFT
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    p = 1 / 13 + z * (1 / 15 + z * (1 / 17 + z * (1 / 19 + z * (1 / 21))))
    p = z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z * (1 / 9 + z * (1 / 11 + z * p)))))
    half = 0.5 * f * f
    return exponent * _LN_2[0] + (f - (half - (s * (half + 2.0 * p) + exponent * _LN_2[1])))
