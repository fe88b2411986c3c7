"""What motion and images tell: excitation, information about the pose, and the information J of the rewards."""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.bound import indices

RANGE_UNIT = 0.1
"""[m] standard deviation of the range at which the information of a point is zero."""


@kernel
def excitation(x, y, v, lateral):
    """Excitation of the depth of a point, sigma² = ‖Omega‖² = (v x + l)² + (v y)² (docs/equations.md, section 3).

    Args:
        x, y: [-] normalised image coordinates.
        v, lateral: [m/s] velocity of the camera, forward and to the left.

    Returns:
        [m²/s²] sigma². Its integral over a window is the point's Gramian.
    """
    along, across = v * x + lateral, v * y
    return along * along + across * across


@kernel
def pose_gramian(points, theta, sd, out):
    """Information about xi = (r, theta) from points with known q_A and noisy q_B: sum of Hᵀ H / sd².

    H = [-Rᵀ, -J q_B] is the Jacobian of the model `position`, h(xi) = R(theta)ᵀ (q_A - r) (docs/equations.md, section
    4). Marginalising r leaves sum ‖q_B - mean q_B‖² / sd² for theta (section 5).

    Args:
        points: [m] (M, 2) the points q_B in the body frame of B.
        theta: [rad] heading of B in {A}.
        sd: [m] standard deviation of each coordinate of q_B.
        out: (3, 3) the information matrix.
    """
    weight = 1.0 / (sd * sd)
    cos, sin = math.cos(theta), math.sin(theta)
    out[:] = 0.0
    for i in range(points.shape[0]):
        q_x, q_y = points[i, 0], points[i, 1]
        out[0, 0] += weight
        out[0, 2] -= weight * (sin * q_x + cos * q_y)
        out[1, 2] += weight * (cos * q_x - sin * q_y)
        out[2, 2] += weight * (q_x * q_x + q_y * q_y)
    out[1, 1], out[2, 0], out[2, 1] = out[0, 0], out[0, 2], out[1, 2]


@kernel
def pose_covariance(covariance, count, poses, a, b, out):
    """Bound of xi, the pose of robot b in {a}.

    To first order the twists of relative poses subtract: R(theta_a) δr = rho_b - rho_a + J r_b theta, theta = theta_b
    - theta_a.

    Args:
        covariance: (D, D) the bound (`relloc_env.kernels.bound`).
        count: number of points M.
        poses: [m, m, rad] (R, 3) true poses, {W}.
        a, b: observer and observed robot.
        out: [m, m, rad] (3, 3) covariance of (r_x, r_y, theta), written.
    """
    out[:] = 0.0
    for k, sign_k in ((a, -1.0), (b, 1.0)):
        for m, sign_m in ((a, -1.0), (b, 1.0)):
            if k > 0 and m > 0:
                for i in range(3):
                    for j in range(3):
                        value = covariance[3 * (count + k - 1) + i, 3 * (count + m - 1) + j]
                        out[i, j] += sign_k * sign_m * value
    cos, sin = math.cos(poses[a, 2]), math.sin(poses[a, 2])
    x, y = poses[b, 0], poses[b, 1]
    for j in range(3):
        d_x, d_y = out[0, j] - y * out[2, j], out[1, j] + x * out[2, j]
        out[0, j], out[1, j] = cos * d_x + sin * d_y, cos * d_y - sin * d_x
    for j in range(3):
        d_x, d_y = out[j, 0] - y * out[j, 2], out[j, 1] + x * out[j, 2]
        out[j, 0], out[j, 1] = cos * d_x + sin * d_y, cos * d_y - sin * d_x


@kernel
def _point_error(covariance, p, t, d, p_x, p_y, j):
    """Covariance with state j of the error of a point relative to a robot, as in `bound`.

    e = δ(point) - rho - J (point) theta, and δh + δd  ([m] three numbers).

    Args:
        covariance: (D, D) the bound.
        p, t, d: first index of the point, and `indices` of the robot.
        p_x, p_y: [m] the point, {W}.
        j: index into the state.
    """
    e_0, e_1, e_2 = covariance[p, j], covariance[p + 1, j], covariance[p + 2, j]
    if t > 0:
        turn = covariance[t + 2, j]
        e_0 += p_y * turn - covariance[t, j]
        e_1 -= p_x * turn + covariance[t + 1, j]
        if d > 0:
            e_2 += covariance[d, j]
    return e_0, e_1, e_2


@kernel
def point_covariance(covariance, poses, points, robot, i, out):
    """Bound of the point i in the body frame of a robot.

    Args:
        covariance: (D, D) the bound.
        poses: [m, m, rad] (R, 3) true poses, {W}.
        points: [m] (M, 3) true points, {W}.
        robot, i: whose frame, which point.
        out: [m] (3, 3) covariance of (q_x, q_y, height above the camera), written. q_x is the depth.
    """
    p_x, p_y = points[i, 0], points[i, 1]
    t, d = indices(covariance, poses.shape[0], points.shape[0], robot)
    for j in range(3):
        out[0, j], out[1, j], out[2, j] = _point_error(covariance, 3 * i, t, d, p_x, p_y, 3 * i + j)
    if t > 0:
        along = _point_error(covariance, 3 * i, t, d, p_x, p_y, t)
        across = _point_error(covariance, 3 * i, t, d, p_x, p_y, t + 1)
        turn = _point_error(covariance, 3 * i, t, d, p_x, p_y, t + 2)
        for k in range(3):
            out[k, 0] += p_y * turn[k] - along[k]
            out[k, 1] -= p_x * turn[k] + across[k]
        if d > 0:
            e = _point_error(covariance, 3 * i, t, d, p_x, p_y, d)
            for k in range(3):
                out[k, 2] += e[k]
    cos, sin = math.cos(poses[robot, 2]), math.sin(poses[robot, 2])
    for j in range(3):
        out[0, j], out[1, j] = cos * out[0, j] + sin * out[1, j], cos * out[1, j] - sin * out[0, j]
    for j in range(3):
        out[j, 0], out[j, 1] = cos * out[j, 0] + sin * out[j, 1], cos * out[j, 1] - sin * out[j, 0]


@kernel
def range_variance(covariance, poses, points, robot, i):
    """Bound of the horizontal range of the point i from a robot, [m²]; arguments as of `point_covariance`."""
    p_x, p_y = points[i, 0], points[i, 1]
    d_x, d_y = p_x - poses[robot, 0], p_y - poses[robot, 1]
    scale = 1.0 / math.sqrt(d_x * d_x + d_y * d_y)
    u_x, u_y = scale * d_x, scale * d_y
    t, d = indices(covariance, poses.shape[0], points.shape[0], robot)
    total = 0.0
    for j, weight in ((3 * i, u_x), (3 * i + 1, u_y)):
        e_0, e_1, _ = _point_error(covariance, 3 * i, t, d, p_x, p_y, j)
        total += weight * (u_x * e_0 + u_y * e_1)
    if t > 0:
        for j, weight in ((t, -u_x), (t + 1, -u_y), (t + 2, u_x * p_y - u_y * p_x)):
            e_0, e_1, _ = _point_error(covariance, 3 * i, t, d, p_x, p_y, j)
            total += weight * (u_x * e_0 + u_y * e_1)
    return total


@kernel
def pose_information(covariance, count, robot):
    """J of a pair, -1/6 log det P_xi [nat of standard deviation; m and rad], for the pose of `robot` > 0 in {A}.

    The change from a twist to xi has determinant 1, so the block of the bound serves as it is. det is the same for
    the pose of A in {robot}.
    """
    t = 3 * (count + robot - 1)
    a, b, c = covariance[t, t], covariance[t, t + 1], covariance[t, t + 2]
    d, e, f = covariance[t + 1, t + 1], covariance[t + 1, t + 2], covariance[t + 2, t + 2]
    return -math.log(a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)) / 6.0


@kernel
def depth_information(covariance, poses, points, robot):
    """J of a robot's depths: mean over the points of -log(sd of the range / 0.1 m) [nat].

    The range is horizontal (as in `Estimate`); arguments as of `point_covariance`.
    """
    total = 0.0
    for i in range(points.shape[0]):
        total -= 0.5 * math.log(range_variance(covariance, poses, points, robot, i))
    return total / points.shape[0] + math.log(RANGE_UNIT)
