"""The pinhole camera of a ground robot: projection, image flow, what hides a point.

Camera frame: z forward (body x), x right (body -y), y down. s = (x, y) are normalised image coordinates, chi = 1/z the
inverse depth. `height` is the height of a point above the camera.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel


@inlined
def project(q_x, q_y, height):
    """Normalised image of a point, s = [-q_y, -height]/q_x, and chi = 1/q_x ([RMDA19] section III-A).

    Args:
        q_x, q_y: [m] the point in the plane of the body frame, q_x > 0.
        height: [m] of the point above the camera.

    Returns:
        (x, y, chi): [-, -, 1/m].
    """
    chi = 1.0 / q_x
    return -q_y * chi, -height * chi, chi


@kernel
def back_project(x, y, chi):
    """Inverse of `project`: (q_x, q_y, height) [m] in the body frame."""
    z = 1.0 / chi
    return z, -x * z, -y * z


@kernel
def image_flow(x, y, chi, v, lateral, w):
    """Time derivative of (x, y, chi) for a static point (docs/equations.md, section 2).

    dx/dt = w (1 + x²) + (v x + l) chi,  dy/dt = w x y + v y chi,  dchi/dt = v chi² + w x chi

    Args:
        x, y: [-] normalised image coordinates.
        chi: [1/m] inverse depth.
        v, lateral, w: [m/s, m/s, rad/s] velocity of the robot; lateral to the left, w counter-clockwise.
    """
    return (
        w * (1.0 + x * x) + (v * x + lateral) * chi,
        w * x * y + v * y * chi,
        v * chi * chi + w * x * chi,
    )


@kernel
def to_polar(x, y, chi):
    """(bearing, elevation, inverse range) of an image point: beta = -atan x, eta = -y cos beta, rho = chi cos beta.

    beta [rad] counter-clockwise from the heading; eta [-] height above the camera over horizontal range; rho [1/m].
    """
    cos = 1.0 / math.sqrt(1.0 + x * x)
    return -math.atan(x), -y * cos, chi * cos


@inlined
def crosses_disc(a_x, a_y, b_x, b_y, c_x, c_y, radius):
    """Where the segment a-b first lies within a disc: fraction in [0, 1], or -1 where it does not."""
    d_x, d_y = b_x - a_x, b_y - a_y
    f_x, f_y = a_x - c_x, a_y - c_y
    dd = d_x * d_x + d_y * d_y
    df = d_x * f_x + d_y * f_y
    ff = f_x * f_x + f_y * f_y - radius * radius
    disc = df * df - dd * ff
    t = (-df - np.sqrt(max(disc, 0.0))) / dd
    hit = (disc >= 0.0) & (df < 0.0) & (t <= 1.0)
    return 0.0 if ff <= 0.0 else (t if hit else -1.0)


@inlined
def crosses_box(a_x, a_y, b_x, b_y, c_x, c_y, half_x, half_y, cos, sin):
    """Where the segment a-b first lies within a box turned by an angle of this cosine and sine, as `crosses_disc`."""
    a0, a1 = cos * (a_x - c_x) + sin * (a_y - c_y), -sin * (a_x - c_x) + cos * (a_y - c_y)
    d0, d1 = cos * (b_x - a_x) + sin * (b_y - a_y), -sin * (b_x - a_x) + cos * (b_y - a_y)
    low_0, high_0 = _slab(a0, d0, half_x)
    low_1, high_1 = _slab(a1, d1, half_y)
    low, high = max(low_0, low_1, 0.0), min(high_0, high_1, 1.0)
    return low if low <= high else -1.0


@inlined
def _slab(start, step, half):
    """Fractions between which start + t step lies within ±half."""
    t_0, t_1 = (-half - start) / step, (half - start) / step
    low, high = min(t_0, t_1), max(t_0, t_1)
    still, inside = step == 0.0, abs(start) <= half
    return (
        ((-np.inf if inside else np.inf) if still else low),
        ((np.inf if inside else -np.inf) if still else high),
    )


@inlined
def view(x, y, cos, sin, height, p_x, p_y, p_z):
    """(depth, x, y) of a point in the image of a camera at (x, y), looking along a heading of this cosine and sine.

    Args:
        x, y, cos, sin: [m, m, -, -] where the camera is and looks, {W}.
        height: [m] of the camera.
        p_x, p_y, p_z: [m] the point, {W}.
    """
    d_x, d_y = p_x - x, p_y - y
    depth = cos * d_x + sin * d_y
    image_x, image_y, _ = project(depth, cos * d_y - sin * d_x, p_z - height)
    return depth, image_x, image_y
