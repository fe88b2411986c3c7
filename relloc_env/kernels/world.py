"""The physical state of N environments, and how robots move in it until something is touched.

Contacts are not solved here: `touches` says that a step needs the contact solver (`relloc_env.world`).
"""

import math
from typing import Any, NamedTuple

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import advance, sinc, wrap_angle
from relloc_env.kernels.streams import ACTUATOR, normal

DISC, BOX = 0.0, 1.0
"""Kinds of obstacles: the first column of `World.obstacles`."""
NEAR_CONTACT = 1e-3
"""[m] gap under which robots count as touching after a contact was solved."""


class World(NamedTuple):
    """State of N environments with R robots, M targets, O obstacles, P ordered pairs; C-contiguous arrays."""

    pose: Any
    """[m, m, rad] (N, R, 3) true poses."""
    velocity: Any
    """[m/s, m/s, rad/s] (N, R, 3) true mean velocity over the last sample: forward, left, yaw rate."""
    wheels: Any
    """[m/s, rad/s] (N, R, 2) state of the actuators."""
    pending: Any
    """[m, m, rad] (N, R, 3) where this sample's motion leads."""
    command: Any
    """[m/s, rad/s] (N, R, 2)"""
    points: Any
    """[m] (N, M, 3) targets in the world, z above the floor."""
    obstacles: Any
    """(N, O, 7) kind, x, y [m], radius or half length [m], half width [m], angle [rad], height [m]."""
    fixed_poses: Any
    """(N, R, 3) starts that are not drawn; NaN where they are."""
    fixed_points: Any
    """(N, M, 3) targets that are not drawn; NaN where they are."""
    guess_depth: Any
    """[m] (N, R, M) what each robot is told about depths at the start."""
    guess_pose: Any
    """[m, m, rad] (N, P, 3) what each observer is told about the observed robot's pose."""
    visible: Any
    """(N, R, M) whether the target is truly in view."""
    contact: Any
    """(N, R) whether the robot touches something in this sample."""
    collided: Any
    """(N, R) the same, at any sample of this action."""
    blocked: Any
    """(N, R) samples of this action in which the shield held the robot."""
    tick: Any
    """(N,) samples since the start."""
    position: Any
    """(N,) samples of this action already done."""
    moved: Any
    """(N,) whether this sample's motion is settled and its measurements are still to come."""
    deliver: Any
    """(N, P, W) tick at which the message of a tick (modulo W) arrives; -1 for never."""
    streams: Any
    """uint64 (N, S, 2) random streams by purpose."""


class Truth(NamedTuple):
    """What really happened in K samples; for rewards, metrics and `info`, never for estimators."""

    pose: Any
    """[m, m, rad] (N, K, R, 3) at the end of the sample, world frame."""
    velocity: Any
    """[m/s, m/s, rad/s] (N, K, R, 3) mean over the sample: forward, left, yaw rate."""
    visible: Any
    """(N, K, R, M) whether the camera measured the target in this sample (in view, a frame taken, not missed)."""


@kernel
def clearance(x, y, half_x, half_y, obstacles):
    """Distance [m] from a place to the nearest wall or obstacle; negative beyond a wall, 0 inside an obstacle.

    Args:
        x, y: [m] place in the world.
        half_x, half_y: [m] half the size of the arena; infinite for an open floor.
        obstacles: (O, 7) as in `World.obstacles`.
    """
    least = min(half_x - abs(x), half_y - abs(y))
    for o in range(obstacles.shape[0]):
        d_x, d_y = x - obstacles[o, 1], y - obstacles[o, 2]
        if obstacles[o, 0] == DISC:
            distance = math.sqrt(d_x * d_x + d_y * d_y) - obstacles[o, 3]
        else:
            cos, sin = math.cos(obstacles[o, 5]), math.sin(obstacles[o, 5])
            a = max(abs(cos * d_x + sin * d_y) - obstacles[o, 3], 0.0)
            b = max(abs(cos * d_y - sin * d_x) - obstacles[o, 4], 0.0)
            distance = math.sqrt(a * a + b * b)
        least = min(least, distance)
    return max(least, 0.0) if least < 0.0 and abs(x) <= half_x and abs(y) <= half_y else least


@kernel
def drive(world, n, params, robots):
    """Where the command leads each robot in one sample: actuators, limits, shield. Fills `pending` and `velocity`.

    First-order actuators: wheels += (command - wheels)(1 - exp(-dt/lag)), then noise, then limits.
    """
    dt = params.dt
    for r in range(robots.shape[0]):
        robot = robots[r]
        v = world.wheels[n, r, 0] + (world.command[n, r, 0] - world.wheels[n, r, 0]) * robot.gain_v
        w = world.wheels[n, r, 1] + (world.command[n, r, 1] - world.wheels[n, r, 1]) * robot.gain_w
        if robot.actuator_v > 0.0:
            v += robot.actuator_v * normal(world.streams[n, ACTUATOR])
        if robot.actuator_w > 0.0:
            w += robot.actuator_w * normal(world.streams[n, ACTUATOR])
        v = min(max(v, robot.min_speed), robot.max_speed)
        w = min(max(w, -robot.max_yaw_rate), robot.max_yaw_rate)
        if params.shield and _too_close(world, n, r, v, w, params):
            v = 0.0
            world.blocked[n, r] += 1
        _propose(world, n, r, v, w, dt)
    if params.shield:
        for a in range(robots.shape[0]):
            for b in range(a):
                _keep_apart(world, n, a, b, params)


@kernel
def _propose(world, n, r, v, w, dt):
    """Set wheels, velocity and pending pose of one robot."""
    world.wheels[n, r, 0] = v
    world.wheels[n, r, 1] = w
    world.velocity[n, r, 0] = v
    world.velocity[n, r, 1] = 0.0
    world.velocity[n, r, 2] = w
    x, y, theta = advance(world.pose[n, r, 0], world.pose[n, r, 1], world.pose[n, r, 2], v, 0.0, w, dt)
    world.pending[n, r, 0] = x
    world.pending[n, r, 1] = y
    world.pending[n, r, 2] = wrap_angle(theta)


@kernel
def _too_close(world, n, r, v, w, params):
    """Whether this motion comes closer to a target, a wall or an obstacle than the shield allows."""
    x, y = world.pose[n, r, 0], world.pose[n, r, 1]
    e_x, e_y, _ = advance(x, y, world.pose[n, r, 2], v, 0.0, w, params.dt)
    for i in range(world.points.shape[1]):
        p_x, p_y = world.points[n, i, 0], world.points[n, i, 1]
        end = (e_x - p_x) * (e_x - p_x) + (e_y - p_y) * (e_y - p_y)
        now = (x - p_x) * (x - p_x) + (y - p_y) * (y - p_y)
        if end < params.shield_target * params.shield_target and end < now:
            return True
    end = clearance(e_x, e_y, params.half_x, params.half_y, world.obstacles[n])
    return end < params.shield_wall and end < clearance(x, y, params.half_x, params.half_y, world.obstacles[n])


@kernel
def _distance2(x, y, u, v):
    """Squared distance of two places."""
    return (x - u) * (x - u) + (y - v) * (y - v)


@kernel
def _keep_apart(world, n, a, b, params):
    """Hold the robots that approach each other within the shield's distance."""
    pose, pending = world.pose, world.pending
    now = _distance2(pose[n, a, 0], pose[n, a, 1], pose[n, b, 0], pose[n, b, 1])
    end = _distance2(pending[n, a, 0], pending[n, a, 1], pending[n, b, 0], pending[n, b, 1])
    if end >= params.shield_robot * params.shield_robot or end >= now:
        return
    a_nearer = _distance2(pending[n, a, 0], pending[n, a, 1], pose[n, b, 0], pose[n, b, 1]) < now
    b_nearer = _distance2(pose[n, a, 0], pose[n, a, 1], pending[n, b, 0], pending[n, b, 1]) < now
    if not a_nearer and not b_nearer:  # abreast: each alone would get ahead of the other, both together close in
        a_nearer = b_nearer = True
    if a_nearer:
        world.blocked[n, a] += 1
        _propose(world, n, a, 0.0, world.wheels[n, a, 1], params.dt)
    if b_nearer:
        world.blocked[n, b] += 1
        _propose(world, n, b, 0.0, world.wheels[n, b, 1], params.dt)


@kernel
def touches(world, n, params, robots):
    """Whether the pending motion ends with a robot against a wall, an obstacle or another robot."""
    for r in range(robots.shape[0]):
        x, y = world.pending[n, r, 0], world.pending[n, r, 1]
        if clearance(x, y, params.half_x, params.half_y, world.obstacles[n]) < robots[r].radius:
            return True
        for other in range(r):
            reach = robots[r].radius + robots[other].radius
            if _distance2(x, y, world.pending[n, other, 0], world.pending[n, other, 1]) < reach * reach:
                return True
    return False


@kernel
def settle(world, n):
    """The pending motion becomes the pose: nothing was touched."""
    for r in range(world.pose.shape[1]):
        world.contact[n, r] = False
        for k in range(3):
            world.pose[n, r, k] = world.pending[n, r, k]


@kernel
def settle_contact(world, n, params, robots):
    """The pending poses, as the contact solver left them, become the poses; velocities follow from the displacement.

    The mean velocity over the sample is the one whose exact arc leads from the old pose to the new one.
    """
    dt = params.dt
    for r in range(robots.shape[0]):
        turn = wrap_angle(world.pending[n, r, 2] - world.pose[n, r, 2])
        heading = world.pose[n, r, 2] + 0.5 * turn
        cos, sin = math.cos(heading), math.sin(heading)
        d_x = world.pending[n, r, 0] - world.pose[n, r, 0]
        d_y = world.pending[n, r, 1] - world.pose[n, r, 1]
        scale = 1.0 / (dt * sinc(0.5 * turn))
        world.velocity[n, r, 0] = scale * (cos * d_x + sin * d_y)
        world.velocity[n, r, 1] = scale * (cos * d_y - sin * d_x)
        world.velocity[n, r, 2] = turn / dt
    settle(world, n)
    for r in range(robots.shape[0]):
        x, y = world.pose[n, r, 0], world.pose[n, r, 1]
        gap = clearance(x, y, params.half_x, params.half_y, world.obstacles[n]) - robots[r].radius
        for other in range(robots.shape[0]):
            if other != r:
                distance = math.sqrt(_distance2(x, y, world.pose[n, other, 0], world.pose[n, other, 1]))
                gap = min(gap, distance - robots[r].radius - robots[other].radius)
        world.contact[n, r] = gap < NEAR_CONTACT
        world.collided[n, r] |= gap < NEAR_CONTACT
