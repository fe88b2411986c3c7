"""Contacts, solved by Chipmunk (pymunk). Free motion never comes here: it is the exact arc.

An environment whose robots would touch something in a sample is loaded into a space, stepped through the sample with
the velocities that its free motion has, and read back. Robots are discs that the wheels set in motion at those
velocities; walls and obstacles stand still. Robots are added anew each time (which empties the cache of contacts), so
that a step depends on the environment alone and nothing of an earlier one is left.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pymunk

from relloc_env.kernels.world import DISC

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from relloc_env.config import EnvConfig
    from relloc_env.kernels.world import World

WALL = 1.0
"""[m] thickness of the walls: more than a robot moves in a sample."""
SUBSTEPS = 8
"""Steps of the space in a sample. Chipmunk moves first and solves after: a robot enters a wall by a step at most."""
FRICTION = 0.3
_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


class ContactSolver:
    """A pymunk space for one configuration, into which environments are loaded one at a time."""

    def __init__(self, config: EnvConfig) -> None:
        self._dt = config.sample_period
        self._robots = [(robot.mass, robot.radius) for robot in map(config.robot_of, range(config.robots))]
        self._space = pymunk.Space()
        self._space.collision_slop = 1e-4
        self._space.collision_bias = 1e-40  # of an overlap, 44 % is undone in each substep of a 20 Hz sample
        self._obstacles: list[pymunk.Shape] = []
        self._loaded = b""
        if config.arena is not None:
            self._add_walls(0.5 * config.arena[0], 0.5 * config.arena[1])

    def _add_walls(self, half_x: float, half_y: float) -> None:
        for x, y, a, b in (
            (half_x + 0.5 * WALL, 0.0, 0.5 * WALL, half_y + WALL),
            (-half_x - 0.5 * WALL, 0.0, 0.5 * WALL, half_y + WALL),
            (0.0, half_y + 0.5 * WALL, half_x + WALL, 0.5 * WALL),
            (0.0, -half_y - 0.5 * WALL, half_x + WALL, 0.5 * WALL),
        ):
            self._space.add(self._box(x, y, a, b, 0.0))

    def _box(self, x: float, y: float, a: float, b: float, angle: float) -> pymunk.Shape:
        cos, sin = math.cos(angle), math.sin(angle)
        corners = [(x + i * a * cos - j * b * sin, y + i * a * sin + j * b * cos) for i, j in _CORNERS]
        shape = pymunk.Poly(self._space.static_body, corners)
        shape.friction = FRICTION
        return shape

    def _load_obstacles(self, rows: NDArray[np.float64]) -> None:
        """Put an environment's obstacles into the space, unless they are there."""
        key = rows.tobytes()
        if key == self._loaded:
            return
        self._space.remove(*self._obstacles)
        self._obstacles = []
        for kind, x, y, a, b, angle, _ in rows.tolist():
            if kind == DISC:
                shape: pymunk.Shape = pymunk.Circle(self._space.static_body, a, (x, y))
                shape.friction = FRICTION
            else:
                shape = self._box(x, y, a, b, angle)
            self._obstacles.append(shape)
        self._space.add(*self._obstacles)
        self._loaded = key

    def solve(self, world: World, n: int) -> None:
        """Replace the pending poses of environment n by those that contacts allow.

        A robot that touches nothing keeps its pending pose to the last bit.
        """
        space, dt = self._space, self._dt
        self._load_obstacles(world.obstacles[n])
        bodies: list[pymunk.Body] = []
        for r, (mass, radius) in enumerate(self._robots):
            x, y, theta = world.pose[n, r].tolist()
            end_x, end_y, end_theta = world.pending[n, r].tolist()
            body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0.0, radius))
            body.position = (x, y)
            body.angle = theta
            body.velocity = ((end_x - x) / dt, (end_y - y) / dt)
            body.angular_velocity = math.remainder(end_theta - theta, 2.0 * math.pi) / dt
            shape = pymunk.Circle(body, radius)
            shape.friction = FRICTION
            space.add(body, shape)
            bodies.append(body)
        before = [(body.velocity, body.angular_velocity) for body in bodies]
        for _ in range(SUBSTEPS):
            space.step(dt / SUBSTEPS)
        for r, body in enumerate(bodies):
            if (body.velocity, body.angular_velocity) != before[r]:
                theta = math.remainder(body.angle, 2.0 * math.pi)
                world.pending[n, r] = (body.position.x, body.position.y, theta)
            space.remove(body, *body.shapes)
