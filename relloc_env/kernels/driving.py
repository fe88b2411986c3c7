"""How robots move in one sample until something is touched, in lanes (`kernels.lanes`).

Actuators, limits and the shield; where the command leads; and whether that touches something, which is for the contact
solver (`relloc_env.world`) to mend.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.lanes import W, natural
from relloc_env.kernels.motion import advance, wrap_angle
from relloc_env.kernels.world import DISC, to_box, to_disc, to_walls

POSE, WHEELS, COMMAND, END, VELOCITY = 0 * W, 3 * W, 5 * W, 7 * W, 10 * W
"""[m, m, rad], [m/s, rad/s] twice, [m, m, rad], [m/s, m/s, rad/s]: as in `World`; `END` is where the sample leads."""
NOISE = 13 * W
"""Two standard normals: of the actuators first, then of the odometry."""
BLOCKED = 15 * W
"""Samples of this action in which the shield held the robot."""
TOUCHES = 16 * W
"""1 where the motion ends against something, else 0."""
COS, SIN = 17 * W, 18 * W
"""Of the heading."""
_FREE_X, _FREE_Y, _FREE_V, _STOP, _GAP, _GAP_END = 19 * W, 20 * W, 21 * W, 22 * W, 23 * W, 24 * W
FAST = 0.5
"""[-] path in a sample, in radii, from which on a robot may have touched something before its motion ends. Below it a
robot that clips a corner unnoticed goes 3 % of its radius into it."""
ROBOT = 25
"""Numbers of a robot in the workspace, from place r ROBOT W on."""


@kernel
def drive(t, points, targets, params, robots, obstacles, width):
    """Where the commands lead: first-order actuators, then noise, then limits, then the shield; and what is touched.

    wheels += (command - wheels)(1 - exp(-dt/lag)).

    Args:
        t: workspace; robots come first.
        points: place of the first of the targets, (x, y, z) each; targets: how many.
        params, robots: records (`relloc_env.parameters`).
        obstacles: (O, 7), see `kernels.world`.
        width: lanes of a block.
    """
    count = robots.shape[0]
    half_x, half_y = params.half_x, params.half_y
    for r in range(count):
        p = r * ROBOT * W
        _propose(t, p, params.dt, robots[r], width)
        if params.shield:
            _gap(t, p + POSE, p + _GAP, half_x, half_y, obstacles, width)
            _gap(t, p + END, p + _GAP_END, half_x, half_y, obstacles, width)
            _shield(t, p, params.shield_wall, width)
            for i in range(targets):
                _shield_target(t, p, points + 3 * i * W, params.shield_target, width)
            _hold(t, p, width)
    if params.shield:
        for a in range(count):
            for b in range(a):
                _keep_apart(t, a * ROBOT * W, b * ROBOT * W, params.shield_robot, width)
                _hold(t, a * ROBOT * W, width)
                _hold(t, b * ROBOT * W, width)
        for r in range(count):
            _count(t, r * ROBOT * W, width)
    for r in range(count):
        p = r * ROBOT * W
        _gap(t, p + END, p + _GAP_END, half_x, half_y, obstacles, width)
        _touch(t, p, robots[r].radius, width)
        if params.fast:
            _gap(t, p + POSE, p + _GAP, half_x, half_y, obstacles, width)
            _touch_on_the_way(t, p, params.dt, robots[r].radius, width)
        for other in range(r):
            q, reach = other * ROBOT * W, robots[r].radius + robots[other].radius
            _touch_robot(t, p, q, reach, width)
            if params.fast:
                _touch_robot_on_the_way(t, p, q, params.dt, reach, width)


@kernel
def _propose(t, p, dt, robot, width):
    """Velocity and end of the sample of one robot, were there nothing in the way."""
    p = natural(p)
    gain_v, gain_w, noise_v, noise_w = robot.gain_v, robot.gain_w, robot.actuator_v, robot.actuator_w
    least, most, turn = robot.min_speed, robot.max_speed, robot.max_yaw_rate
    for i in range(width):
        v, w = t[p + i + WHEELS], t[p + i + WHEELS + W]
        v += (t[p + i + COMMAND] - v) * gain_v + noise_v * t[p + i + NOISE]
        w += (t[p + i + COMMAND + W] - w) * gain_w + noise_w * t[p + i + NOISE + W]
        v, w = min(max(v, least), most), min(max(w, -turn), turn)
        x, y, theta = advance(t[p + i + POSE], t[p + i + POSE + W], t[p + i + POSE + 2 * W], v, 0.0, w, dt)
        t[p + i + WHEELS], t[p + i + WHEELS + W] = v, w
        t[p + i + VELOCITY], t[p + i + VELOCITY + W], t[p + i + VELOCITY + 2 * W] = v, 0.0, w
        t[p + i + END], t[p + i + END + W], t[p + i + END + 2 * W] = x, y, wrap_angle(theta)
        t[p + i + _FREE_X], t[p + i + _FREE_Y], t[p + i + _FREE_V], t[p + i + _STOP] = x, y, v, 0.0


@kernel
def _gap(t, place, result, half_x, half_y, obstacles, width):
    """Clearance [m] of a place, see `world.clearance`."""
    p, gap = natural(place), natural(result)
    for i in range(width):
        t[gap + i] = to_walls(t[p + i], t[p + i + W], half_x, half_y)
    for o in range(obstacles.shape[0]):
        c_x, c_y, a, b = obstacles[o, 1], obstacles[o, 2], obstacles[o, 3], obstacles[o, 4]
        if obstacles[o, 0] == DISC:
            for i in range(width):
                t[gap + i] = min(t[gap + i], to_disc(t[p + i], t[p + i + W], c_x, c_y, a))
        else:
            cos, sin = math.cos(obstacles[o, 5]), math.sin(obstacles[o, 5])
            for i in range(width):
                t[gap + i] = min(t[gap + i], to_box(t[p + i], t[p + i + W], c_x, c_y, a, b, cos, sin))


@kernel
def _shield(t, p, least, width):
    """Stop a robot that comes closer to a wall or an obstacle than the shield allows."""
    p = natural(p)
    for i in range(width):
        t[p + i + _STOP] = 1.0 if (t[p + i + _GAP_END] < least) & (t[p + i + _GAP_END] < t[p + i + _GAP]) else 0.0


@kernel
def _shield_target(t, p, q, least, width):
    """Stop a robot that comes closer to a target than the shield allows."""
    p, q = natural(p), natural(q)
    for i in range(width):
        x, y = t[q + i], t[q + i + W]
        end, now = _distance2(t, p + i + END, x, y), _distance2(t, p + i + POSE, x, y)
        t[p + i + _STOP] = max(t[p + i + _STOP], 1.0 if (end < least * least) & (end < now) else 0.0)


@inlined
def _distance2(t, i, x, y):
    """Squared distance [m²] from the place at `i` to (x, y)."""
    d_x, d_y = t[i] - x, t[i + W] - y
    return d_x * d_x + d_y * d_y


@kernel
def _hold(t, p, width):
    """Let a robot that is to stop turn on the spot."""
    p = natural(p)
    for i in range(width):
        stop = t[p + i + _STOP] != 0.0
        t[p + i + END], t[p + i + END + W] = (
            t[p + i + POSE] if stop else t[p + i + _FREE_X],
            t[p + i + POSE + W] if stop else t[p + i + _FREE_Y],
        )
        t[p + i + WHEELS] = 0.0 if stop else t[p + i + _FREE_V]
        t[p + i + VELOCITY] = 0.0 if stop else t[p + i + _FREE_V]


@kernel
def _count(t, p, width):
    """Count the samples in which a robot was held."""
    p = natural(p)
    for i in range(width):
        t[p + i + BLOCKED] += t[p + i + _STOP]


@kernel
def _keep_apart(t, p, q, least, width):
    """Stop the robots that approach each other within the shield's distance."""
    p, q = natural(p), natural(q)
    for i in range(width):
        x, y, o_x, o_y = t[p + i + POSE], t[p + i + POSE + W], t[q + i + POSE], t[q + i + POSE + W]
        now = _distance2(t, p + i + POSE, o_x, o_y)
        end = _distance2(t, p + i + END, t[q + i + END], t[q + i + END + W])
        near = (end < least * least) & (end < now)
        t_nearer, o_nearer = _distance2(t, p + i + END, o_x, o_y) < now, _distance2(t, q + i + END, x, y) < now
        neither = (not t_nearer) & (not o_nearer)  # abreast: each alone would get ahead of the other, both close in
        t[p + i + _STOP] = max(t[p + i + _STOP], 1.0 if near & (t_nearer | neither) else 0.0)
        t[q + i + _STOP] = max(t[q + i + _STOP], 1.0 if near & (o_nearer | neither) else 0.0)


@kernel
def _touch(t, p, radius, width):
    """Whether a robot ends against a wall or an obstacle."""
    p = natural(p)
    for i in range(width):
        t[p + i + TOUCHES] = 1.0 if t[p + i + _GAP_END] < radius else 0.0


@kernel
def _touch_robot(t, p, q, reach, width):
    """Whether two robots end against each other."""
    p, q = natural(p), natural(q)
    for i in range(width):
        end = _distance2(t, p + i + END, t[q + i + END], t[q + i + END + W])
        t[p + i + TOUCHES] = max(t[p + i + TOUCHES], 1.0 if end < reach * reach else 0.0)


@kernel
def _touch_on_the_way(t, p, dt, radius, width):
    """Whether a fast robot may touch a wall or an obstacle before its motion ends.

    The distance to them changes by no more than the path, so that on the way it is at least half of what both ends
    have together, less half the path. Where that does not rule a touch out, the contact solver finds out.
    """
    p = natural(p)
    for i in range(width):
        path = abs(t[p + i + VELOCITY]) * dt
        least = 0.5 * (t[p + i + _GAP] + t[p + i + _GAP_END] - path)
        may = (path > FAST * radius) & (least < radius)
        t[p + i + TOUCHES] = max(t[p + i + TOUCHES], 1.0 if may else 0.0)


@kernel
def _touch_robot_on_the_way(t, p, q, dt, reach, width):
    """The same for two robots; `reach` [m] is the sum of their radii."""
    p, q = natural(p), natural(q)
    for i in range(width):
        path = (abs(t[p + i + VELOCITY]) + abs(t[q + i + VELOCITY])) * dt
        now = np.sqrt(_distance2(t, p + i + POSE, t[q + i + POSE], t[q + i + POSE + W]))
        end = np.sqrt(_distance2(t, p + i + END, t[q + i + END], t[q + i + END + W]))
        may = (path > FAST * reach) & (0.5 * (now + end - path) < reach)
        t[p + i + TOUCHES] = max(t[p + i + TOUCHES], 1.0 if may else 0.0)


@kernel
def settle(t, count, width):
    """The ends become the poses."""
    for r in range(count):
        p = natural(r * ROBOT * W)
        for i in range(width):
            for j in range(3):
                t[p + i + POSE + j * W] = t[p + i + END + j * W]


@inlined
def speed_of(share, least, most):
    """Command [m/s] for a share in [-1, 1] of the speed; a robot without reverse maps it to [0, most]."""
    share = min(max(share, -1.0), 1.0)
    return share * most if least < 0.0 else 0.5 * (share + 1.0) * most


@inlined
def yaw_rate_of(share, most):
    """Command [rad/s] for a share in [-1, 1] of the yaw rate."""
    return np.minimum(np.maximum(share, -1.0), 1.0) * most
