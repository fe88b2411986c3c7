"""The pinhole camera of a ground robot: projection, image flow, what hides a point.

Camera frame: z forward (body x), x right (body -y), y down. s = (x, y) are normalised image coordinates, chi = 1/z the
inverse depth. `height` is the height of a point above the camera.
"""

import math

from relloc_env.kernels._compile import kernel


@kernel
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


@kernel
def crosses_disc(a_x, a_y, b_x, b_y, c_x, c_y, radius):
    """Where the segment a-b first lies within a disc: fraction in [0, 1], or -1 where it does not."""
    d_x, d_y = b_x - a_x, b_y - a_y
    f_x, f_y = a_x - c_x, a_y - c_y
    dd = d_x * d_x + d_y * d_y
    df = d_x * f_x + d_y * f_y
    ff = f_x * f_x + f_y * f_y - radius * radius
    if ff <= 0.0:
        return 0.0
    disc = df * df - dd * ff
    if disc < 0.0 or df >= 0.0:
        return -1.0
    t = (-df - math.sqrt(disc)) / dd
    return t if t <= 1.0 else -1.0


@kernel
def crosses_box(a_x, a_y, b_x, b_y, c_x, c_y, half_x, half_y, angle):
    """Where the segment a-b first lies within a rotated box: fraction in [0, 1], or -1 where it does not."""
    cos, sin = math.cos(angle), math.sin(angle)
    a0, a1 = cos * (a_x - c_x) + sin * (a_y - c_y), -sin * (a_x - c_x) + cos * (a_y - c_y)
    d0, d1 = cos * (b_x - a_x) + sin * (b_y - a_y), -sin * (b_x - a_x) + cos * (b_y - a_y)
    low, high = 0.0, 1.0
    for start, step, half in ((a0, d0, half_x), (a1, d1, half_y)):
        if step == 0.0:
            if abs(start) > half:
                return -1.0
        else:
            t0, t1 = (-half - start) / step, (half - start) / step
            low = max(low, min(t0, t1))
            high = min(high, max(t0, t1))
    return low if low <= high else -1.0
