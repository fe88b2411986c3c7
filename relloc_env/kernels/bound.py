"""The posterior Cramér-Rao bound (PCRB) of points and poses, recursively, for one environment.

The bound is the covariance of an extended Kalman filter linearised at the truth (docs/equations.md, section 5). A
smooth change of coordinates leaves it as it is, so it is kept in coordinates in which nothing moves: errors relative
to robot A (index 0), in the axes of the world, about a local origin,

- robot k > 0: the twist (rho, theta) of its pose relative to A, R(theta_A) δr_k = rho + J r_k theta with r_k in {W};
- point i: R(theta_A) δq_i with q_i the point in {A}, and δh_i, its height above A's camera;
- where camera heights are not exact, robot k > 0: δd_k, the height of A's camera above that of k;
- where the scale of the odometry is not exact, every robot: δk_v, δk_w, the scales of its speed and its yaw rate.

The transition is then the identity, whatever the motion, but for errors of scale, which move the poses; odometry noise
adds to the covariance and measurements reduce it. The state is in this order, 3 (R - 1) + 3 M numbers, R - 1 more where
camera heights are not exact and 2 R more where scales are not.

The covariance is kept as factors, P = U D Uᵀ with U unit upper triangular and D diagonal (G. J. Bierman, Factorization
Methods for Discrete Sequential Estimation, Academic Press 1977, chapters III and V). Measurements shrink D by factors
and noise adds to it, so that it stays positive; the variance of h x is the sum over k of d_k (Uᵀ h)_k², which keeps its
digits where those of P itself cancel.

What the bound knows: the depth of a point to `depth_sd` for each robot, from its first sight on (infinite: no such
guess); the pose prior of every robot in {A}; odometry with white noise, and no error of scale or a constant one that is
known to its prior; points that stay where they are and are told apart; every image of every robot at once (perfect
network).
"""

import math
from typing import Any, NamedTuple

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.factors import add, correct
from relloc_env.kernels.state_layout import height_of, point_of, scales_of, twist_of

LEAST_DEPTH = 1e-3
"""[m] depth of a point that is nearer than this, for the bound: at a depth of 0 an image has no place."""


class Bound(NamedTuple):
    """The bound of one environment, changed in place."""

    factor: Any
    """(D, D) U: unit upper triangular, ones and zeros written out."""
    variances: Any
    """(D,) the diagonal of D."""
    sighted: Any
    """(R, M) whether a robot has seen a point yet."""
    work: Any
    """(4, D) scratch."""


class Scene(NamedTuple):
    """Where everything really is."""

    poses: Any
    """[m, m, rad] (R, 3) of the robots, {W}."""
    points: Any
    """[m] (M, 3) {W}."""
    camera_heights: Any
    """[m] (R,) {W}."""
    origin: Any
    """[m] (2,) a place within some kilometres that the bound's twists are about, the same at each call, {W}."""


class Noise(NamedTuple):
    """What the bound is told about measurements."""

    speed_sd: Any
    """[m/s] (R,) of the odometry of each sample."""
    turn_sd: Any
    """[rad/s] (R,)"""
    image_sd: Any
    """[-] (R,) of each image coordinate; above 0."""
    depth_sd: Any
    """[m] (R,) of each robot's guess of a depth at first sight; infinite: none."""


class Prior(NamedTuple):
    """What the bound is told at the start."""

    pose_sd: Any
    """[m, m, rad] (3,) of the pose of each robot k > 0 in {A}."""
    unseen_sd: float
    """[m] of each coordinate of a point before anyone has seen it."""
    height_sd: float = 0.0
    """[m] of each height difference of cameras, where the state has room for them."""
    speed_scale_sd: float = 0.0
    """[-] of the scales of the odometry, where the state has room for them."""
    turn_scale_sd: float = 0.0
    """[-]"""


@kernel
def bound_reset(bound, scene, prior):
    """Start the bound of one environment, before its first images.

    With rho = R δr - J r theta (R = R(theta_A)), the last column of U for a twist is [-J r, 1]; the others are those of
    the two variances of δr, turned by R.

    Args:
        bound: `Bound`, written.
        scene: `Scene`.
        prior: `Prior`.
    """
    factor, variances, (robots, count), size = bound.factor, bound.variances, bound.sighted.shape, bound.factor.shape[0]
    factor[:] = 0.0
    bound.sighted[:] = False
    for i in range(size):
        factor[i, i] = 1.0
        variances[i] = prior.unseen_sd * prior.unseen_sd
    sin, cos = sin_cos(scene.poses[0, 2])
    along, across, turn = prior.pose_sd[0] ** 2, prior.pose_sd[1] ** 2, prior.pose_sd[2] ** 2
    for k in range(1, robots):
        t = twist_of(k)
        x, y = scene.poses[k, 0] - scene.origin[0], scene.poses[k, 1] - scene.origin[1]
        variances[t + 1] = sin * sin * along + cos * cos * across
        variances[t] = along * across / variances[t + 1]
        variances[t + 2] = turn
        factor[t, t + 1] = cos * sin * (along - across) / variances[t + 1]
        factor[t, t + 2], factor[t + 1, t + 2] = y, -x
        d = height_of(size, robots, count, k)
        if d > 0:
            variances[d] = prior.height_sd * prior.height_sd
    for k in range(robots):
        s = scales_of(size, robots, count, k)
        if s > 0:
            variances[s] = prior.speed_scale_sd * prior.speed_scale_sd
            variances[s + 1] = prior.turn_scale_sd * prior.turn_scale_sd


@kernel
def _arc_noise(theta, v, lateral, w, dt):
    """Derivatives of the end of an exact arc with respect to v and to w, in the axes of the world.

    e_v = dt sinc(a) m,  e_w = dt²/2 (sinc'(a) (v m + l n) + sinc(a) (v n - l m)),  a = w dt/2; m and n point forward
    and left at mid-heading, `theta` [rad] is the heading at the end.
    """
    a = 0.5 * w * dt
    sin_a, cos_a = sin_cos(a)
    s = 1.0 - a * a / 6.0 if abs(a) < 1e-4 else sin_a / a
    slope = -a / 3.0 if abs(a) < 1e-4 else (cos_a - s) / a
    sin, cos = sin_cos(theta - a)
    half = 0.5 * dt * dt
    along, across = half * (slope * v - s * lateral), half * (slope * lateral + s * v)
    return dt * s * cos, dt * s * sin, along * cos - across * sin, along * sin + across * cos


@kernel
def _twist(points, robots, robot, origin, moved, out):
    """Write what an error of the motion of a robot does to the state.

    That of robot k > 0 is a change of its own twist; that of A, with the sign reversed, of everything, as everything is
    told relative to A.

    Args:
        points: of `Scene`.
        robots: R.
        robot: index k, place [m] (x, y) {W}.
        origin: [m] (x, y) {W}
        moved: [m, m, rad] displacement, {W}, and turn.
        out: (D,) written.
    """
    (k, x, y), (d_x, d_y, turn), (o_x, o_y) = robot, moved, origin
    rho_x, rho_y = d_x + turn * (y - o_y), d_y - turn * (x - o_x)
    for i in range(out.shape[0]):
        out[i] = 0.0
    for other in range(1, robots):
        if k in (0, other):
            t = twist_of(other)
            out[t], out[t + 1], out[t + 2] = rho_x, rho_y, turn
    if k == 0:
        for i in range(points.shape[0]):
            p = point_of(robots, i)
            out[p], out[p + 1] = rho_x - turn * (points[i, 1] - o_y), rho_y + turn * (points[i, 0] - o_x)


@kernel
def _move_by_scales(bound, scene, velocity, dt):
    """Move the poses by the errors of scale, P = F P Fᵀ with F = 1 + G [v, w] [δk_v, δk_w]; as of `bound_move`.

    The scales come last in the state, so that F U is as triangular as U.
    """
    factor, work, points, (robots, count) = bound.factor, bound.work, scene.points, bound.sighted.shape
    origin, first = (scene.origin[0], scene.origin[1]), scales_of(factor.shape[0], robots, count, 0)
    for k in range(robots):
        at, robot = scales_of(factor.shape[0], robots, count, k), (k, scene.poses[k, 0], scene.poses[k, 1])
        v, lateral, w = velocity[k, 0], velocity[k, 1], velocity[k, 2]
        e_x, e_y, w_x, w_y = _arc_noise(scene.poses[k, 2], v, lateral, w, dt)
        along = (v * e_x - lateral * e_y, v * e_y + lateral * e_x, 0.0)
        _twist(points, robots, robot, origin, along, work[0])
        _twist(points, robots, robot, origin, (w * w_x, w * w_y, w * dt), work[1])
        for i in range(first):
            for j in range(at, factor.shape[0]):
                factor[i, j] += work[0, i] * factor[at, j] + work[1, i] * factor[at + 1, j]


@inlined
def bound_move(bound, scene, noise, velocity, dt):
    """Add the odometry noise of one sample: P += G diag(speed_sd², turn_sd²) Gᵀ for each robot.

    Before that, where the state has scales, the errors of scale move the poses. Noise moves the estimated end of the
    arc by a twist.

    Args:
        bound: `Bound`, changed.
        scene: `Scene` at the end of the sample.
        noise: `Noise`.
        velocity: [m/s, m/s, rad/s] (R, 3) true forward, lateral (left) and yaw rate over the sample.
        dt: [s] length of the sample.
    """
    if dt == 0.0:
        return
    factor, variances, work, (robots, count) = bound.factor, bound.variances, bound.work, bound.sighted.shape
    if scales_of(factor.shape[0], robots, count, 0) > 0:
        _move_by_scales(bound, scene, velocity, dt)
    poses, points, origin = scene.poses, scene.points, (scene.origin[0], scene.origin[1])
    speed_sd, turn_sd = noise.speed_sd, noise.turn_sd
    for k in range(robots):
        robot = (k, poses[k, 0], poses[k, 1])
        v_x, v_y, w_x, w_y = _arc_noise(poses[k, 2], velocity[k, 0], velocity[k, 1], velocity[k, 2], dt)
        _twist(points, robots, robot, origin, (v_x, v_y, 0.0), work[0])
        _twist(points, robots, robot, origin, (w_x, w_y, dt), work[1])
        end = point_of(robots, count) if k == 0 else twist_of(k + 1)
        add(factor, variances, work, end, speed_sd[k] * speed_sd[k], turn_sd[k] * turn_sd[k])


@kernel
def point_error(factor, p, t, d, at, out):
    """Write E U for the error e = E x of a point relative to a robot, in the axes of the world.

    e = δ(point) - rho - J (point) theta, and δh + δd. The covariance of e is out D outᵀ.

    Args:
        factor: of `Bound`.
        p, t, d: `point_of`, `twist_of`, `height_of`; the robot has no twist where t < 0, no height where d = 0.
        at: [m] (x, y) of the point about the origin.
        out: (≥ 3, D) written.
    """
    x, y = at
    for k in range(factor.shape[0]):
        out[0, k], out[1, k], out[2, k] = factor[p, k], factor[p + 1, k], factor[p + 2, k]
    if t >= 0:
        for k in range(factor.shape[0]):
            out[0, k] += y * factor[t + 2, k] - factor[t, k]
            out[1, k] -= x * factor[t + 2, k] + factor[t + 1, k]
    if d > 0:
        for k in range(factor.shape[0]):
            out[2, k] += factor[d, k]


@inlined
def bound_measure(bound, scene, noise, visible, vertical):
    """Take in one sample of images, and the depth guess of every point that a robot sees for the first time.

    x = -q_y/q_x and y = -h/q_x give the rows -chi (left + x forward) and -chi (y forward, up).

    Args:
        bound: `Bound`, changed.
        scene: `Scene` at the sample.
        noise: `Noise`.
        visible: (R, M) whether the robot has the image of the point in this sample; the point is then ahead of it.
        vertical: whether the image has its second coordinate.
    """
    factor, variances, work, sighted = bound.factor, bound.variances, bound.work, bound.sighted
    poses, points, heights, (o_x, o_y) = (
        scene.poses,
        scene.points,
        scene.camera_heights,
        (scene.origin[0], scene.origin[1]),
    )
    depth_sd, image_sd, (robots, count), nothing = noise.depth_sd, noise.image_sd, sighted.shape, (0.0, 0.0, 0.0)
    for k in range(robots):
        variance, guess = image_sd[k] * image_sd[k], depth_sd[k] * depth_sd[k]
        t, d = twist_of(k), height_of(factor.shape[0], robots, count, k)
        for i in range(count):
            if not visible[k, i]:
                continue
            sin, cos = sin_cos(poses[k, 2])
            p, at = point_of(robots, i), (points[i, 0] - o_x, points[i, 1] - o_y)
            begin = t if t >= 0 else p
            d_x, d_y = points[i, 0] - poses[k, 0], points[i, 1] - poses[k, 1]
            if not sighted[k, i]:
                sighted[k, i] = True
                if not math.isinf(guess):
                    point_error(factor, p, t, d, at, work)
                    correct(factor, variances, work, begin, (cos, sin, 0.0), nothing, guess, 1.0)
            chi = 1.0 / max(cos * d_x + sin * d_y, LEAST_DEPTH)
            x, y = (sin * d_x - cos * d_y) * chi, (heights[k] - points[i, 2]) * chi
            row_x = (chi * (sin - x * cos), -chi * (cos + x * sin), 0.0)
            row_y = (-chi * y * cos, -chi * y * sin, -chi) if vertical else nothing
            point_error(factor, p, t, d, at, work)
            correct(factor, variances, work, begin, row_x, row_y, variance, variance)


@kernel
def bound_step(bound, scene, noise, visible, velocity, dt, vertical):
    """`bound_move`, then `bound_measure`: one whole sample. With dt = 0 it is the first sample of an episode."""
    bound_move(bound, scene, noise, velocity, dt)
    bound_measure(bound, scene, noise, visible, vertical)
