"""The posterior Cramér-Rao bound (PCRB) of points and poses, recursively, for one environment.

The bound is the covariance of an extended Kalman filter linearised at the truth (docs/equations.md, section 5). A
smooth change of coordinates leaves it as it is, so it is kept in coordinates in which nothing moves: errors relative
to robot A (index 0), in the axes of the world,

- point i: R(theta_A) δq_i with q_i the point in {A}, and δh_i, its height above A's camera;
- robot k > 0: the twist (rho, theta) of its pose relative to A, R(theta_A) δr_k = rho + J r_k theta with r_k in {W};
- where camera heights are not exact, robot k > 0: δd_k, the height of A's camera above that of k;
- where the scale of the odometry is not exact, every robot: δk_v, δk_w, the scales of its speed and its yaw rate.

The transition is then the identity, whatever the motion, but for errors of scale, which move the poses; odometry noise
adds to the covariance and measurements reduce it. The state is in this order, 3 M + 3 (R - 1) numbers, R - 1 more where
camera heights are not exact and 2 R more where scales are not.

What the bound knows: the depth of a point to `depth_sd` for each robot, from its first sight on (infinite: no such
guess); the pose prior of every robot in {A}; odometry with white noise, and no error of scale or a constant one that is
known to its prior; points that stay where they are and are told apart; every image of every robot at once (perfect
network).
"""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import sinc


@kernel
def _arc_noise(theta, v, lateral, w, dt):
    """Derivatives of the end of an exact arc with respect to v and to w, in the axes of the world.

    e_v = dt sinc(a) m,  e_w = dt²/2 (sinc'(a) (v m + l n) + sinc(a) (v n - l m)),  a = w dt/2; m and n point forward
    and left at mid-heading, `theta` [rad] is the heading at the end.
    """
    a = 0.5 * w * dt
    s = sinc(a)
    slope = -a / 3.0 if abs(a) < 1e-4 else (math.cos(a) - s) / a
    cos, sin = math.cos(theta - a), math.sin(theta - a)
    half = 0.5 * dt * dt
    along, across = half * (slope * v - s * lateral), half * (slope * lateral + s * v)
    return dt * s * cos, dt * s * sin, along * cos - across * sin, along * sin + across * cos


@kernel
def _scales(covariance, robots, count):
    """First index of the scales in the state; 0 where they are exact."""
    size = covariance.shape[0]
    return size - 2 * robots if size - 3 * (count + robots - 1) >= 2 * robots else 0


@kernel
def bound_reset(covariance, sighted, poses, pose_sd, height_sd, unseen_sd, speed_scale_sd=0.0, turn_scale_sd=0.0):
    """Start the bound of one environment, before its first images.

    Args:
        covariance: (D, D) the bound, written; D as above.
        sighted: (R, M) whether a robot has seen a point yet, written.
        poses: [m, m, rad] (R, 3) true poses, {W}.
        pose_sd: [m, m, rad] (3,) prior of the pose of each robot k > 0 in {A}.
        height_sd: [m] prior of each height difference of cameras, where D has room for them.
        unseen_sd: [m] prior of each coordinate of a point before anyone has seen it.
        speed_scale_sd, turn_scale_sd: [-] prior of the scales of the odometry, where D has room for them.
    """
    covariance[:] = 0.0
    sighted[:] = False
    robots, count = sighted.shape
    for i in range(3 * count):
        covariance[i, i] = unseen_sd * unseen_sd
    cos, sin = math.cos(poses[0, 2]), math.sin(poses[0, 2])
    along, across, turn = pose_sd[0] ** 2, pose_sd[1] ** 2, pose_sd[2] ** 2
    for k in range(1, robots):
        t = 3 * (count + k - 1)
        x, y = poses[k, 0], poses[k, 1]
        covariance[t, t] = cos * cos * along + sin * sin * across + y * y * turn
        covariance[t + 1, t + 1] = sin * sin * along + cos * cos * across + x * x * turn
        covariance[t + 2, t + 2] = turn
        covariance[t, t + 1] = covariance[t + 1, t] = cos * sin * (along - across) - x * y * turn
        covariance[t, t + 2] = covariance[t + 2, t] = y * turn
        covariance[t + 1, t + 2] = covariance[t + 2, t + 1] = -x * turn
    for i in range(3 * (count + robots - 1), covariance.shape[0]):
        covariance[i, i] = height_sd * height_sd
    scales = _scales(covariance, robots, count)
    if scales > 0:
        for k in range(robots):
            covariance[scales + 2 * k, scales + 2 * k] = speed_scale_sd * speed_scale_sd
            covariance[scales + 2 * k + 1, scales + 2 * k + 1] = turn_scale_sd * turn_scale_sd


@kernel
def _twist(work, poses, points, k, v_x, v_y, w_x, w_y, turn):
    """Write what two errors of the motion of robot k, at its place, do to the state into the rows of `work`.

    Args:
        work: (2, D) scratch, written from `begin` to `end`.
        poses, points: as of `bound_move`.
        k: the robot.
        v_x, v_y: [m] displacement by the first error, {W}; it does not turn.
        w_x, w_y, turn: [m, m, rad] displacement and turn by the second.

    Returns:
        (begin, end): the part of the state that is moved.
    """
    count, robots = points.shape[0], poses.shape[0]
    begin = 0 if k == 0 else 3 * (count + k - 1)
    end = 3 * (count + robots - 1) if k == 0 else begin + 3
    w_x, w_y = w_x + turn * poses[k, 1], w_y - turn * poses[k, 0]
    for i in range(begin, end, 3):
        work[0, i], work[0, i + 1], work[0, i + 2] = v_x, v_y, 0.0
        work[1, i], work[1, i + 1], work[1, i + 2] = w_x, w_y, turn
    if k == 0:
        for i in range(count):
            work[1, 3 * i] -= turn * points[i, 1]
            work[1, 3 * i + 1] += turn * points[i, 0]
            work[1, 3 * i + 2] = 0.0
    return begin, end


@kernel
def _move_by_scales(covariance, work, poses, points, velocity, dt, scales):
    """Move the poses by the errors of scale, P = F P Fᵀ; `scales` is their first index, the rest as of `bound_move`."""
    for k in range(poses.shape[0]):
        v, lateral, w = velocity[k, 0], velocity[k, 1], velocity[k, 2]
        e_x, e_y, w_x, w_y = _arc_noise(poses[k, 2], v, lateral, w, dt)
        c_x, c_y = v * e_x - lateral * e_y, v * e_y + lateral * e_x
        begin, end = _twist(work, poses, points, k, c_x, c_y, w * w_x, w * w_y, w * dt)
        at = scales + 2 * k
        for i in range(begin, end):
            for j in range(covariance.shape[0]):
                covariance[i, j] += work[0, i] * covariance[at, j] + work[1, i] * covariance[at + 1, j]
        for i in range(begin, end):
            for j in range(covariance.shape[0]):
                covariance[j, i] += work[0, i] * covariance[j, at] + work[1, i] * covariance[j, at + 1]


@kernel
def bound_move(covariance, work, poses, points, velocity, dt, speed_sd, turn_sd):
    """Add the odometry noise of one sample: P += G diag(speed_sd², turn_sd²) Gᵀ for each robot.

    Before that, where the state has scales, P = F P Fᵀ with F = 1 + G [v, w] [δk_v, δk_w].
    Noise moves the estimated end of the arc by a twist. That of robot k > 0 adds to its own twist; that of A, with
    the sign reversed, to everything, as everything is told relative to A.

    Args:
        covariance: (D, D) the bound, changed.
        work: (2, D) scratch.
        poses: [m, m, rad] (R, 3) true poses at the end of the sample, {W}.
        points: [m] (M, 3) true points, {W}.
        velocity: [m/s, m/s, rad/s] (R, 3) true forward, lateral (left) and yaw rate over the sample.
        dt: [s] length of the sample.
        speed_sd, turn_sd: [m/s, rad/s] (R,) noise of the odometry of each sample.
    """
    count, robots = points.shape[0], poses.shape[0]
    scales = _scales(covariance, robots, count)
    if scales > 0:
        _move_by_scales(covariance, work, poses, points, velocity, dt, scales)
    for k in range(robots):
        turn = turn_sd[k] * dt
        v_x, v_y, w_x, w_y = _arc_noise(poses[k, 2], velocity[k, 0], velocity[k, 1], velocity[k, 2], dt)
        v_x, v_y, w_x, w_y = speed_sd[k] * v_x, speed_sd[k] * v_y, turn_sd[k] * w_x, turn_sd[k] * w_y
        begin, end = _twist(work, poses, points, k, v_x, v_y, w_x, w_y, turn)
        for i in range(begin, end):
            a, b = work[0, i], work[1, i]
            for j in range(begin, end):
                covariance[i, j] += a * work[0, j] + b * work[1, j]


@kernel
def indices(covariance, robots, count, robot):
    """First index of a robot's twist and that of its height difference in the state; 0 where it has none."""
    if robot == 0:
        return 0, 0
    end = 3 * (count + robots - 1)
    heights = (covariance.shape[0] - end) % (2 * robots) > 0
    return 3 * (count + robot - 1), (end + robot - 1 if heights else 0)


@kernel
def _correct(covariance, work, p, t, d, p_x, p_y, a_0, a_1, variance_a, b_0, b_1, b_2, variance_b):
    """Take in two measurements with rows (a_0, a_1, 0) and (b_0, b_1, b_2) on the error of a point seen by a robot.

    That error is e = δ(point) - rho - J (point) theta and δh + δd, in the axes of the world. With W = P Hᵀ L⁻ᵀ and
    L Lᵀ = H P Hᵀ + diag(variance_a, variance_b), P -= W Wᵀ, which keeps P symmetric to the bit.

    Args:
        covariance, work: (D, D) the bound, changed; (2, D) scratch.
        p, t, d: first index of the point, and `indices` of the robot.
        p_x, p_y: [m] the point, {W}.
        a_0, ..., variance_b: rows and variances of the two measurements.
    """
    size = covariance.shape[0]
    for j in range(size):
        e_0, e_1, e_2 = covariance[p, j], covariance[p + 1, j], covariance[p + 2, j]
        if t > 0:
            turn = covariance[t + 2, j]
            e_0 += p_y * turn - covariance[t, j]
            e_1 -= p_x * turn + covariance[t + 1, j]
            if d > 0:
                e_2 += covariance[d, j]
        work[0, j] = a_0 * e_0 + a_1 * e_1
        work[1, j] = b_0 * e_0 + b_1 * e_1 + b_2 * e_2
    u_0, u_1 = work[0, p], work[0, p + 1]
    w_0, w_1, w_2 = work[1, p], work[1, p + 1], work[1, p + 2]
    if t > 0:
        u_0 += p_y * work[0, t + 2] - work[0, t]
        u_1 -= p_x * work[0, t + 2] + work[0, t + 1]
        w_0 += p_y * work[1, t + 2] - work[1, t]
        w_1 -= p_x * work[1, t + 2] + work[1, t + 1]
        if d > 0:
            w_2 += work[1, d]
    aa = a_0 * u_0 + a_1 * u_1 + variance_a
    ab = a_0 * w_0 + a_1 * w_1
    bb = b_0 * w_0 + b_1 * w_1 + b_2 * w_2 + variance_b
    ratio = ab / aa
    scale_a, scale_b = 1.0 / math.sqrt(aa), 1.0 / math.sqrt(bb - ratio * ab)
    for j in range(size):
        work[1, j] = scale_b * (work[1, j] - ratio * work[0, j])
        work[0, j] = scale_a * work[0, j]
    for i in range(size):
        a, b = work[0, i], work[1, i]
        for j in range(size):
            covariance[i, j] -= a * work[0, j] + b * work[1, j]


@kernel
def bound_measure(covariance, work, sighted, poses, points, camera_heights, visible, image_sd, depth_sd, vertical):
    """Take in one sample of images, and the depth guess of every point that a robot sees for the first time.

    x = -q_y/q_x and y = -h/q_x give the rows -chi (left + x forward) and -chi (y forward, up).

    Args:
        covariance: (D, D) the bound, changed.
        work: (2, D) scratch.
        sighted: (R, M) whether a robot has seen a point yet, updated.
        poses: [m, m, rad] (R, 3) true poses, {W}.
        points: [m] (M, 3) true points, {W}.
        camera_heights: [m] (R,) of the cameras, {W}.
        visible: (R, M) whether the robot has the image of the point in this sample; the point is then ahead of it.
        image_sd: [-] (R,) noise of each image coordinate.
        depth_sd: [m] (R,) of each robot's guess of a depth at first sight; infinite: none.
        vertical: whether the image has its second coordinate.
    """
    count, robots = points.shape[0], poses.shape[0]
    for k in range(robots):
        variance = image_sd[k] * image_sd[k]
        cos, sin = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        t, d = indices(covariance, robots, count, k)
        for i in range(count):
            if not visible[k, i]:
                continue
            p_x, p_y = points[i, 0], points[i, 1]
            d_x, d_y = p_x - poses[k, 0], p_y - poses[k, 1]
            if not sighted[k, i]:
                sighted[k, i] = True
                guess = depth_sd[k] * depth_sd[k]
                _correct(covariance, work, 3 * i, t, d, p_x, p_y, cos, sin, guess, 0.0, 0.0, 0.0, 1.0)
            chi = 1.0 / (cos * d_x + sin * d_y)
            x = (sin * d_x - cos * d_y) * chi
            a_0, a_1 = chi * (sin - x * cos), -chi * (cos + x * sin)
            b_2 = -chi if vertical else 0.0
            y = (camera_heights[k] - points[i, 2]) * chi
            b_0, b_1 = b_2 * y * cos, b_2 * y * sin
            _correct(covariance, work, 3 * i, t, d, p_x, p_y, a_0, a_1, variance, b_0, b_1, b_2, variance)


@kernel
def bound_step(
    covariance,
    work,
    sighted,
    poses,
    points,
    camera_heights,
    visible,
    velocity,
    dt,
    speed_sd,
    turn_sd,
    image_sd,
    depth_sd,
    vertical,
):
    """`bound_move`, then `bound_measure`: one whole sample. With dt = 0 it is the first sample of an episode."""
    bound_move(covariance, work, poses, points, velocity, dt, speed_sd, turn_sd)
    bound_measure(covariance, work, sighted, poses, points, camera_heights, visible, image_sd, depth_sd, vertical)
