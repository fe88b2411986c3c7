"""The physical state of N environments, distances in it, and what follows from a solved contact."""

import math
from typing import Any, NamedTuple

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.motion import sinc, wrap_angle

DISC, BOX = 0.0, 1.0
"""Kinds of obstacles. An obstacle is a row of 7 numbers: its kind; x, y [m]; radius or half length [m]; half width [m];
angle [rad]; height [m]."""
NEAR_CONTACT = 1e-3
"""[m] gap under which robots count as touching after a contact was solved."""


class World(NamedTuple):
    """State of N environments with R robots, M targets, P ordered pairs; C-contiguous arrays."""

    pose: Any
    """[m, m, rad] (N, R, 3) true poses."""
    velocity: Any
    """[m/s, m/s, rad/s] (N, R, 3) true mean velocity over the last sample: forward, left, yaw rate."""
    wheels: Any
    """[m/s, rad/s] (N, R, 2) state of the actuators."""
    pending: Any
    """[m, m, rad] (N, R, 3) where this sample's motion leads, for the contact solver."""
    command: Any
    """[m/s, rad/s] (N, R, 2)"""
    points: Any
    """[m] (N, M, 3) targets in the world, z above the floor."""
    origin: Any
    """[m] (N, 2) whole kilometres nearest to robot A's start: where coordinates are told from that keep few digits."""
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
    deliver: Any
    """(N, P, W) tick at which the message of a tick (modulo W) arrives; -1 for never. Not used where messages
    always come at once."""
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


@inlined
def to_walls(x, y, half_x, half_y):
    """Distance [m] to the nearest wall; negative beyond it."""
    return min(half_x - abs(x), half_y - abs(y))


@inlined
def to_disc(x, y, c_x, c_y, radius):
    """Distance [m] to a disc; negative inside it."""
    d_x, d_y = x - c_x, y - c_y
    return np.sqrt(d_x * d_x + d_y * d_y) - radius


@inlined
def to_box(x, y, c_x, c_y, half_x, half_y, cos, sin):
    """Distance [m] to a box turned by an angle of this cosine and sine; 0 inside it."""
    d_x, d_y = x - c_x, y - c_y
    a = max(abs(cos * d_x + sin * d_y) - half_x, 0.0)
    b = max(abs(cos * d_y - sin * d_x) - half_y, 0.0)
    return np.sqrt(a * a + b * b)


@kernel
def clearance(x, y, half_x, half_y, obstacles):
    """Distance [m] from a place to the nearest wall or obstacle; not above 0 inside one.

    Args:
        x, y: [m] place in the world.
        half_x, half_y: [m] half the size of the arena; infinite for an open floor.
        obstacles: (O, 7) see `BOX`.
    """
    least = to_walls(x, y, half_x, half_y)
    for o in range(obstacles.shape[0]):
        c_x, c_y, a, b = obstacles[o, 1], obstacles[o, 2], obstacles[o, 3], obstacles[o, 4]
        if obstacles[o, 0] == DISC:
            least = min(least, to_disc(x, y, c_x, c_y, a))
        else:
            least = min(least, to_box(x, y, c_x, c_y, a, b, math.cos(obstacles[o, 5]), math.sin(obstacles[o, 5])))
    return least


@kernel
def settle_contact(pose, pending, velocity, contact, collided, n, params, robots, obstacles):
    """The pending poses, as the contact solver left them, become the poses; velocities follow from the displacement.

    The mean velocity over the sample is the one whose exact arc leads from the old pose to the new one.
    """
    dt = params.dt
    for r in range(robots.shape[0]):
        turn = wrap_angle(pending[n, r, 2] - pose[n, r, 2])
        heading = pose[n, r, 2] + 0.5 * turn
        cos, sin = math.cos(heading), math.sin(heading)
        d_x = pending[n, r, 0] - pose[n, r, 0]
        d_y = pending[n, r, 1] - pose[n, r, 1]
        scale = 1.0 / (dt * sinc(0.5 * turn))
        velocity[n, r, 0] = scale * (cos * d_x + sin * d_y)
        velocity[n, r, 1] = scale * (cos * d_y - sin * d_x)
        velocity[n, r, 2] = turn / dt
        for k in range(3):
            pose[n, r, k] = pending[n, r, k]
    for r in range(robots.shape[0]):
        x, y = pose[n, r, 0], pose[n, r, 1]
        gap = clearance(x, y, params.half_x, params.half_y, obstacles) - robots[r].radius
        for other in range(robots.shape[0]):
            if other != r:
                distance = math.hypot(x - pose[n, other, 0], y - pose[n, other, 1])
                gap = min(gap, distance - robots[r].radius - robots[other].radius)
        contact[n, r] = gap < NEAR_CONTACT
        collided[n, r] |= gap < NEAR_CONTACT
