"""Contacts, solved by Chipmunk (pymunk). Free motion never comes here: it is the exact arc.

An environment whose robots would touch something in a sample is loaded into a space, stepped through the sample with
the velocities that its free motion has, and read back. Robots are discs that the wheels set in motion at those
velocities; walls and obstacles stand still.

A space remembers contacts, pairs that were near, and the order in which things moved. So that a sample depends on the
environment alone, the robots wait far off between environments: one step there empties all of that, and wherever they
go next they enter the space in the same order.

A contact takes some ten calls of Chipmunk of about a microsecond each. Python would take longer to make them than they
last, so that they are made from a compiled loop, which knows Chipmunk's functions by their addresses, and writes into
arrays that pymunk keeps to itself. Where pymunk has them otherwise, the same loop runs in Python, on pymunk's calls.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
import pymunk
from numba import types
from numpy.typing import NDArray

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import wrap_angle

if TYPE_CHECKING:
    from collections.abc import Callable

    from relloc_env.config import EnvConfig
    from relloc_env.kernels.world import World

WALL = 1.0
"""[m] thickness of the walls: more than a robot moves in a step of the space."""
SUBSTEPS = 8
"""Least steps of the space in a sample. Chipmunk moves first and solves after: a robot enters a wall by a step."""
STRIDE = 0.25
"""[-] longest way in such a step, in radii of the smallest robot: nothing is passed through, however thin."""
FRICTION = 0.3
FAR = 1e9
"""[m] where the robots wait between environments."""
_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


_LAYOUT = {
    "pmFloatArray": [("num", "int", 0), ("max", "int", 4), ("arr", "double *", 8)],
    "pmBatchedData": [
        ("intArray", "struct pmIntArray *", 0),
        ("floatArray", "struct pmFloatArray *", 8),
        ("fields", "enum pmBatchableBodyFields", 16),
    ],
}
"""Structures of pymunk, and (name, type, offset) of each field."""


def _fits() -> bool:
    """Whether pymunk's inside is what the compiled loop goes by: two bodies are written and read."""
    try:
        laid = {name: [(k, f.type.cname, f.offset) for k, f in ffi.typeof(name).fields] for name in _LAYOUT}
        if laid != _LAYOUT:
            return False
        space, written = pymunk.Space(), np.arange(18.0).reshape(3, 6)  # the third body is the space's own
        bodies = [pymunk.Body(1.0, 1.0) for _ in range(2)]
        space.add(*bodies)
        floats, batch = _open_batch(written)
        lib.cpSpaceEachBody(space._space, lib.pmSpaceBodySetIteratorFuncBatched, batch)  # noqa: SLF001 (as pymunk does)
        found = [[*body.position, body.angle, *body.velocity, body.angular_velocity] for body in bodies]
        floats.num, written[:] = 0, -1.0
        lib.cpSpaceEachBody(space._space, lib.pmSpaceBodyGetIteratorFuncBatched, batch)  # noqa: SLF001 (as pymunk does)
    except Exception:  # noqa: BLE001 (whatever changed, and however it shows)
        return False
    return bool(found == written[:2].tolist() == np.arange(12.0).reshape(2, 6).tolist())


def _open_batch(bodies: NDArray[np.float64]) -> tuple[Any, Any]:
    """What pymunk's batch functions write bodies from and read them into, and their argument; to be kept."""
    floats = ffi.new("pmFloatArray *")
    floats.arr = ffi.cast("cpFloat *", bodies.ctypes.data)
    floats.max = bodies.size + 2  # never reached, so that pymunk never moves the array
    batch = ffi.new("pmBatchedData *")
    batch.floatArray = floats
    batch.fields = lib.POSITION | lib.ANGLE | lib.VELOCITY | lib.ANGULAR_VELOCITY
    return floats, batch


def _address(name: str) -> int:
    """Address of one of Chipmunk's functions."""
    return int(ffi.cast("uintptr_t", ffi.addressof(lib, name)))


def _function(name: str, signature: Any) -> Any:
    """One of Chipmunk's functions, to be called from a kernel."""
    llvm.add_symbol(f"relloc_env_{name}", _address(name))
    return types.ExternalFunction(f"relloc_env_{name}", signature)


try:
    from pymunk._chipmunk_cffi import ffi, lib
except ImportError:
    COMPILED = False
else:
    COMPILED = _fits()
"""Whether contacts are solved from a compiled loop."""

if COMPILED:
    _step = _function("cpSpaceStep", types.void(types.intp, types.float64))
    _each_body = _function("cpSpaceEachBody", types.void(types.intp, types.intp, types.intp))
else:

    def _step(space: pymunk.Space, dt: float) -> None:
        space.step(dt)

    def _each_body(_: pymunk.Space, act: Callable[[NDArray[np.float64]], None], bodies: NDArray[np.float64]) -> None:
        act(bodies)


class Chipmunk(NamedTuple):
    """A space, as a kernel uses it; objects of Python instead of their addresses, where that is not compiled."""

    space: Any
    """Address of it."""
    put: Any
    """Address of what writes bodies, `take` of what reads them, `batch` of their argument."""
    take: Any
    batch: Any
    cursor: NDArray[np.int32]
    """(1,) how much of `bodies` they have gone through."""
    bodies: NDArray[np.float64]
    """(R + 1, 6) position, angle, velocity, rate of the robots, and of the body that walls belong to."""
    far: NDArray[np.float64]
    """(R + 1, 6) the same, where the robots wait."""
    dt: float
    """[s] duration of a sample."""
    stride: float
    """[m] longest way in a substep."""


def _solve(
    chipmunk: Chipmunk,
    pose: NDArray[np.float64],
    pending: NDArray[np.float64],
    collided: NDArray[np.bool_],
    rows: NDArray[np.int64],
) -> None:
    """Solve the contacts of the environments `rows`, one after the other.

    Args:
        chipmunk: the space.
        pose, pending: [m, m, rad] (N, R, 3) where the robots are, and where free motion leads.
        collided: (N, R) set where a robot touches something.
        rows: indices of the environments.
    """
    space, cursor, bodies, dt = chipmunk.space, chipmunk.cursor, chipmunk.bodies, chipmunk.dt
    robots = pose.shape[1]
    before = np.empty((robots, 3))
    for n in rows:
        longest = 0.0
        for r in range(robots):
            d_x, d_y = pending[n, r, 0] - pose[n, r, 0], pending[n, r, 1] - pose[n, r, 1]
            longest = max(longest, math.hypot(d_x, d_y))
            before[r, 0], before[r, 1] = d_x / dt, d_y / dt
            before[r, 2] = wrap_angle(pending[n, r, 2] - pose[n, r, 2]) / dt
            bodies[r, :3] = pose[n, r]
            bodies[r, 3:] = before[r]
        cursor[0] = 0
        _each_body(space, chipmunk.put, chipmunk.batch)
        steps = max(SUBSTEPS, math.ceil(longest / chipmunk.stride))
        for _ in range(steps):
            _step(space, dt / steps)
        cursor[0] = 0
        _each_body(space, chipmunk.take, chipmunk.batch)
        for r in range(robots):
            if bodies[r, 3] != before[r, 0] or bodies[r, 4] != before[r, 1] or bodies[r, 5] != before[r, 2]:
                pending[n, r, 0] = bodies[r, 0]
                pending[n, r, 1] = bodies[r, 1]
                pending[n, r, 2] = wrap_angle(bodies[r, 2])
                collided[n, r] = True
        bodies[:] = chipmunk.far
        cursor[0] = 0
        _each_body(space, chipmunk.put, chipmunk.batch)
        _step(space, dt / SUBSTEPS)


_solve = kernel(_solve) if COMPILED else _solve


class ContactSolver:
    """A pymunk space for one configuration, into which environments are loaded one at a time; for one thread."""

    def __init__(self, config: EnvConfig) -> None:
        self._config, self._dt = config, config.sample_period
        self._space = pymunk.Space()
        self._space.collision_slop = 1e-4
        self._space.collision_bias = 1e-40  # of an overlap, 44 % is undone in each substep of a 20 Hz sample
        self._space.collision_persistence = 1  # the step far off forgets all contacts
        if config.arena is not None:
            self._add_walls(0.5 * config.arena[0], 0.5 * config.arena[1])
        for obstacle in config.obstacles:
            if obstacle.shape == "disc":
                self._add(pymunk.Circle(self._space.static_body, obstacle.radius, obstacle.position))
            else:
                length, width = obstacle.size
                self._add(self._box(*obstacle.position, 0.5 * length, 0.5 * width, obstacle.angle))
        self._far = np.zeros((config.robots + 1, 6))
        self._robots = []
        for r in range(config.robots):
            robot = config.robot_of(r)
            body = pymunk.Body(robot.mass, pymunk.moment_for_circle(robot.mass, 0.0, robot.radius))
            body.position = (FAR * (r + 1), FAR)
            self._far[r, :2] = body.position
            self._space.add(body)
            self._robots.append(body)
            self._add(pymunk.Circle(body, robot.radius))
        self._open()

    def __reduce__(self) -> tuple[type[ContactSolver], tuple[EnvConfig]]:
        return ContactSolver, (self._config,)  # nothing of what was solved is left: a copy is a new one

    def _add(self, shape: pymunk.Shape) -> None:
        shape.friction = FRICTION
        self._space.add(shape)

    def _add_walls(self, half_x: float, half_y: float) -> None:
        for x, y, a, b in (
            (half_x + 0.5 * WALL, 0.0, 0.5 * WALL, half_y + WALL),
            (-half_x - 0.5 * WALL, 0.0, 0.5 * WALL, half_y + WALL),
            (0.0, half_y + 0.5 * WALL, half_x + WALL, 0.5 * WALL),
            (0.0, -half_y - 0.5 * WALL, half_x + WALL, 0.5 * WALL),
        ):
            self._add(self._box(x, y, a, b, 0.0))

    def _box(self, x: float, y: float, a: float, b: float, angle: float) -> pymunk.Shape:
        cos, sin = math.cos(angle), math.sin(angle)
        corners = [(x + i * a * cos - j * b * sin, y + i * a * sin + j * b * cos) for i, j in _CORNERS]
        return pymunk.Poly(self._space.static_body, corners)

    def _open(self) -> None:
        """Set up what writes the bodies and reads them."""
        self._bodies = self._far.copy()
        least = min(self._config.robot_of(r).radius for r in range(self._config.robots))
        space: Any
        put: Any
        take: Any
        batch: Any
        if COMPILED:
            self._floats, self._batch = _open_batch(self._bodies)
            cursor = np.frombuffer(ffi.buffer(self._floats), np.int32, 1)
            space, put, take, batch = (
                int(ffi.cast("uintptr_t", self._space._space)),  # noqa: SLF001 (as pymunk's batch functions do)
                _address("pmSpaceBodySetIteratorFuncBatched"),
                _address("pmSpaceBodyGetIteratorFuncBatched"),
                int(ffi.cast("uintptr_t", self._batch)),
            )
        else:
            cursor = np.zeros(1, np.int32)
            space, put, take, batch = (self._space, self._put, self._take, self._bodies)
        self._chipmunk = Chipmunk(space, put, take, batch, cursor, self._bodies, self._far, self._dt, STRIDE * least)

    def _put(self, bodies: NDArray[np.float64]) -> None:
        """Give the robots the positions, angles, velocities and rates of the rows."""
        for body, row in zip(self._robots, bodies.tolist(), strict=False):
            body.position, body.angle, body.velocity, body.angular_velocity = row[:2], row[2], row[3:5], row[5]

    def _take(self, bodies: NDArray[np.float64]) -> None:
        """Read them."""
        for n, body in enumerate(self._robots):
            bodies[n] = (*body.position, body.angle, *body.velocity, body.angular_velocity)

    def solve_many(self, world: World, rows: NDArray[np.int64]) -> None:
        """Replace the pending poses of the environments `rows` by those that contacts allow.

        A robot that touches nothing keeps its pending pose to the last bit.
        """
        _solve(self._chipmunk, world.pose, world.pending, world.collided, rows)
