"""What motion and images tell: excitation, information about the pose, and the information J of the rewards."""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.bound import Bound, Scene, point_error
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.state_layout import height_of, point_of, twist_of

RANGE_UNIT = 0.1
"""[m] standard deviation of the range at which the information of a point is zero."""
LEAST_RANGE = 1e-9
"""[m] of a point that is nearer than this the direction is that of the heading: where a robot stands, there is none."""


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
def _pose_rows(factor, a, b, placed, rows):
    """Write H U (3, D) of the pose H x of robot b in {a}.

    To first order the twists of relative poses subtract: R(theta_a) δr = rho_b - rho_a + J r_b theta, theta = theta_b
    - theta_a.

    Args:
        factor: of `Bound`.
        a, b: `twist_of` observer and observed robot; negative for robot A.
        placed: cosine and sine of the heading of a, place [m] of b about the origin.
        rows: (≥ 3, D) written.
    """
    cos, sin, x, y = placed
    for k in range(factor.shape[0]):
        rows[0, k], rows[1, k], rows[2, k] = 0.0, 0.0, 0.0
    for robot, sign in ((a, -1.0), (b, 1.0)):
        if robot >= 0:
            for i in range(3):
                for k in range(factor.shape[0]):
                    rows[i, k] += sign * factor[robot + i, k]
    for k in range(factor.shape[0]):
        turn = rows[2, k]
        d_x, d_y = rows[0, k] - y * turn, rows[1, k] + x * turn
        rows[0, k], rows[1, k] = cos * d_x + sin * d_y, cos * d_y - sin * d_x


@inlined
def _placed(scene, a, b):
    """Cosine and sine of the heading of robot a, place [m] of robot b about the origin."""
    sin, cos = sin_cos(scene.poses[a, 2])
    return cos, sin, scene.poses[b, 0] - scene.origin[0], scene.poses[b, 1] - scene.origin[1]


@kernel
def _products(variances, rows, out):
    """Covariance out = H P Hᵀ (3, 3) of what has the rows H U (3, D)."""
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for k in range(variances.shape[0]):
                total += variances[k] * rows[i, k] * rows[j, k]
            out[i, j] = out[j, i] = total


@inlined
def pose_covariance(bound, scene, a, b, out):
    """Bound of xi, the pose of robot b in {a}.

    Args:
        bound, scene: `Bound`, `Scene` (`relloc_env.kernels.bound`).
        a, b: observer and observed robot.
        out: [m, m, rad] (3, 3) covariance of (r_x, r_y, theta), written.
    """
    _pose_rows(bound.factor, twist_of(a), twist_of(b), _placed(scene, a, b), bound.work)
    _products(bound.variances, bound.work, out)


@kernel
def point_covariance(bound, scene, robot, i, out):
    """Bound of the point i in the body frame of a robot.

    Args:
        bound, scene: `Bound`, `Scene`.
        robot, i: whose frame, which point.
        out: [m] (3, 3) covariance of (q_x, q_y, height above the camera), written. q_x is the depth.
    """
    factor, work, (robots, count) = bound.factor, bound.work, bound.sighted.shape
    p, t, d = point_of(robots, i), twist_of(robot), height_of(factor.shape[0], robots, count, robot)
    at = (scene.points[i, 0] - scene.origin[0], scene.points[i, 1] - scene.origin[1])
    sin, cos = sin_cos(scene.poses[robot, 2])
    point_error(factor, p, t, d, at, work)
    for k in range(factor.shape[0]):
        x, y = work[0, k], work[1, k]
        work[0, k], work[1, k] = cos * x + sin * y, cos * y - sin * x
    _products(bound.variances, work, out)


@inlined
def range_variances(bound, scene, robot, out):
    """Bound of the horizontal range of every point from a robot.

    Args:
        bound, scene: `Bound`, `Scene`.
        robot: from whom.
        out: [m²] (M,) written.
    """
    factor, variances, rows, poses, points = bound.factor, bound.variances, bound.work, scene.poses, scene.points
    t, o_x, o_y = twist_of(robot), scene.origin[0], scene.origin[1]
    for i in range(points.shape[0]):
        p_x, p_y = points[i, 0], points[i, 1]
        d_x, d_y = p_x - poses[robot, 0], p_y - poses[robot, 1]
        distance = math.sqrt(d_x * d_x + d_y * d_y)
        if distance > LEAST_RANGE:
            u_x, u_y = d_x / distance, d_y / distance
        else:
            u_y, u_x = sin_cos(poses[robot, 2])
        point_error(factor, point_of(poses.shape[0], i), t, 0, (p_x - o_x, p_y - o_y), rows)
        total = 0.0
        for k in range(variances.shape[0]):
            part = u_x * rows[0, k] + u_y * rows[1, k]
            total += variances[k] * part * part
        out[i] = total


@kernel
def all_range_variances(factor, variances, poses, points, origin, out):
    """`range_variances` of N environments and every robot.

    Args:
        factor, variances, poses, points, origin: of `Bound` and `Scene`, N first.
        out: [m²] (N, R, M) written.
    """
    nothing = np.zeros(0, np.bool_).reshape(0, 0)
    for n in range(poses.shape[0]):
        bound = Bound(factor[n], variances[n], nothing, np.zeros((4, variances.shape[1])))
        scene = Scene(poses[n], points[n], variances[n], origin[n])
        for robot in range(poses.shape[1]):
            range_variances(bound, scene, robot, out[n, robot])


@inlined
def pose_information(bound, scene, robot):
    """J of a pair, -1/6 log det P_xi [nat of standard deviation; m and rad], for the pose of `robot` > 0 in {A}.

    det P_xi is the product of the squared norms, weighted by D, that Gram-Schmidt leaves of the rows of xi (C. L.
    Thornton, 1976; Bierman 1977, chapter VI): no difference of products that nearly cancel. It is the same for the
    pose of A in {robot}.
    """
    variances, rows = bound.variances, bound.work
    _pose_rows(bound.factor, twist_of(0), twist_of(robot), _placed(scene, 0, robot), rows)
    return -_log_determinant(variances, rows) / 6.0


@kernel
def _log_determinant(variances, rows):
    """Logarithm of det(H P Hᵀ) of what has the rows H U (3, D), which are undefined afterwards."""
    determinant, size = 1.0, variances.shape[0]
    for i in range(2, -1, -1):
        norm = 0.0
        for k in range(size):
            norm += variances[k] * rows[i, k] * rows[i, k]
        determinant *= norm
        for j in range(i):
            product = 0.0
            for k in range(size):
                product += variances[k] * rows[i, k] * rows[j, k]
            share = product / norm
            for k in range(size):
                rows[j, k] -= share * rows[i, k]
    return math.log(determinant)


@kernel
def depth_information(variances):
    """J of a robot's depths: mean over the points of -log(sd of the range / 0.1 m) [nat].

    Args:
        variances: [m²] (M,) of the range (`range_variances`), which is horizontal, as in `Estimate`.
    """
    total = 0.0
    for i in range(variances.shape[0]):
        total -= 0.5 * math.log(variances[i])
    return total / variances.shape[0] + math.log(RANGE_UNIT)
