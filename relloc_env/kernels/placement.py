"""Drawing the start of an episode: targets, poses, and what the robots are told about them."""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import relative, wrap_angle
from relloc_env.kernels.sensing import in_view
from relloc_env.kernels.streams import integer, normal, uniform
from relloc_env.kernels.world import clearance

FIXED, POSITIVE, GAUSSIAN = range(3)
"""Kinds of errors of what the robots are told."""
TRIES = 20_000
"""Attempts at a whole start before `place` gives up."""
ROBOT_TRIES = 60
"""Attempts at one robot's pose among given targets."""


@kernel
def _between(low, high, stream):
    """Uniform in [low, high)."""
    return low + (high - low) * uniform(stream)


@kernel
def _draw_points(points, fixed_points, stream, params, robots, obstacles):
    """Draw the targets that are not fixed: the first anywhere, the others around it. Returns whether they fit."""
    half_x, half_y = min(params.half_x, 20.0) - params.margin, min(params.half_y, 20.0) - params.margin
    for i in range(points.shape[0]):
        if fixed_points[i, 0] == fixed_points[i, 0]:
            for k in range(3):
                points[i, k] = fixed_points[i, k]
            continue
        if i == 0:
            x, y = _between(-half_x, half_x, stream), _between(-half_y, half_y, stream)
        else:
            reach = _between(params.separation_min, params.separation_max, stream)
            angle = _between(-math.pi, math.pi, stream)
            x, y = points[0, 0] + reach * math.cos(angle), points[0, 1] + reach * math.sin(angle)
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = robots[0].mount_height + _between(params.height_min, params.height_max, stream)
        if abs(x) > half_x or abs(y) > half_y:
            return False
        if clearance(x, y, params.half_x, params.half_y, obstacles) <= 0.0:
            return False
        for j in range(i):
            distance = math.hypot(x - points[j, 0], y - points[j, 1])
            if distance < params.separation_min or distance > params.separation_max:
                return False
    return True


@kernel
def _within_reach(points, x, y, params):
    """Whether every target is within the limits of distance from a place."""
    for j in range(points.shape[0]):
        distance = math.hypot(points[j, 0] - x, points[j, 1] - y)
        if distance < params.distance_min or distance > params.distance_max:
            return False
    return True


@kernel
def _draw_robot(pose, points, stream, r, params, robots, obstacles):
    """Draw one robot's pose around the targets. Returns whether it meets the conditions."""
    count = points.shape[0]
    i = integer(stream, count)
    reach, angle = _between(params.distance_min, params.distance_max, stream), _between(-math.pi, math.pi, stream)
    x, y = points[i, 0] + reach * math.cos(angle), points[i, 1] + reach * math.sin(angle)
    error = params.heading_error * _between(-1.0, 1.0, stream)
    room = max(params.margin, robots[r].radius)
    if clearance(x, y, params.half_x, params.half_y, obstacles) < room:
        return False
    if not _within_reach(points, x, y, params):
        return False
    c_x, c_y = 0.0, 0.0
    for j in range(count):
        c_x += points[j, 0] / count
        c_y += points[j, 1] / count
    for other in range(r):
        if math.hypot(x - pose[other, 0], y - pose[other, 1]) < params.robot_distance:
            return False
    pose[r, 0] = x
    pose[r, 1] = y
    pose[r, 2] = wrap_angle(math.atan2(c_y - y, c_x - x) + error)
    return True


@kernel
def _all_in_view(pose, points, r, robots, others, obstacles):
    """Whether robot r sees every target past the robots before `others`."""
    seen = 0
    for i in range(points.shape[0]):
        seen += in_view(pose, points, r, i, robots, others, obstacles)
    return seen == points.shape[0]


@kernel
def _try_place(pose, points, fixed_poses, fixed_points, stream, params, robots, obstacles):
    """One attempt at targets and poses."""
    if not _draw_points(points, fixed_points, stream, params, robots, obstacles):
        return False
    drawn = fixed_points[0, 0] != fixed_points[0, 0]
    for r in range(robots.shape[0]):
        if fixed_poses[r, 0] == fixed_poses[r, 0]:
            for k in range(3):
                pose[r, k] = fixed_poses[r, k]
            if drawn and not _within_reach(points, pose[r, 0], pose[r, 1], params):
                return False
            continue
        placed = False
        for _ in range(ROBOT_TRIES):
            placed = _draw_robot(pose, points, stream, r, params, robots, obstacles) and (
                not params.start_in_view
                or _all_in_view(pose, points, r, robots, r, obstacles)  # the others are not placed yet
            )
            if placed:
                break
        if not placed:
            return False
    drawn = drawn or fixed_poses[0, 0] != fixed_poses[0, 0]
    if drawn and params.start_in_view:  # a robot placed later may hide a target from an earlier one
        for r in range(robots.shape[0]):
            if not _all_in_view(pose, points, r, robots, robots.shape[0], obstacles):
                return False
    return True


@kernel
def _error(size, kind, stream):
    """An error of this size: of random sign, always positive, or Gaussian."""
    if kind == GAUSSIAN:
        return size * normal(stream)
    negative = uniform(stream) < 0.5
    return -size if negative and kind != POSITIVE else size


@kernel
def _draw_guesses(pose, points, guess_depth, guess_pose, stream, params, robots, pairs):
    """What the robots are told: true depths and relative poses with errors."""
    for r in range(robots.shape[0]):
        cos, sin = math.cos(pose[r, 2]), math.sin(pose[r, 2])
        for i in range(points.shape[0]):
            d_x = points[i, 0] - pose[r, 0]
            d_y = points[i, 1] - pose[r, 1]
            depth = cos * d_x + sin * d_y
            if depth < robots[r].near or depth <= 0.0:
                depth = math.hypot(d_x, d_y)
            depth += _error(params.guess_depth, params.guess_kind, stream)
            guess_depth[r, i] = max(depth, 0.3)
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        x, y, theta = relative(
            pose[a, 0],
            pose[a, 1],
            pose[a, 2],
            pose[b, 0],
            pose[b, 1],
            pose[b, 2],
        )
        guess_pose[p, 0] = x + _error(params.guess_position, params.guess_kind, stream)
        guess_pose[p, 1] = y + _error(params.guess_position, params.guess_kind, stream)
        guess_pose[p, 2] = wrap_angle(theta + _error(params.guess_heading, params.guess_kind, stream))


@kernel
def place(pose, points, fixed_poses, fixed_points, guess_depth, guess_pose, stream, params, robots, obstacles, pairs):
    """Draw an episode's start.

    Args:
        pose, points, guess_depth, guess_pose: of `World`, of one environment; written.
        fixed_poses, fixed_points: of `World`, of one environment.
        stream: uint64 (2,) to draw from.
        params, robots: records.
        obstacles: (O, 7), see `kernels.world`.
        pairs: (P, 2) ordered pairs.

    Returns:
        Whether a start was found that meets the conditions.
    """
    found = False
    for _ in range(TRIES):
        if _try_place(pose, points, fixed_poses, fixed_points, stream, params, robots, obstacles):
            found = True
            break
    _draw_guesses(pose, points, guess_depth, guess_pose, stream, params, robots, pairs)
    return found
