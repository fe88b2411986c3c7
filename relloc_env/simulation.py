"""The physical side, whole: world, cameras and network of N environments, sample by sample.

`Simulation` knows the truth and hands out what robots measure (`Samples`). It knows nothing of estimators or rewards.
"""

import math
import numbers
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relloc_env.config import ConfigError, EnvConfig, hint
from relloc_env.kernels import driving as dr
from relloc_env.kernels import sensing as se
from relloc_env.kernels._compile import inlined, inner, kernel
from relloc_env.kernels.lanes import W
from relloc_env.kernels.placement import place
from relloc_env.kernels.streams import ACTUATOR, PURPOSES, SCENARIO, fill_normals, seed_streams
from relloc_env.kernels.world import Truth, World, settle_contact
from relloc_env.parameters import pack_obstacles, pack_parameters, pack_robots
from relloc_env.samples import Float, Prior, Rows, Samples, empty_samples, ordered_pairs
from relloc_env.world import ContactSolver

OPTIONS = ("poses", "points")
"""What `options` of a reset may fix."""


@kernel
def _begin(
    params_, robots, obstacles, pairs, rows,
    pose, velocity, wheels, pending, command, points, visible, contact, collided, blocked, tick, position, deliver,
    streams, fixed_poses, fixed_points, guess_depth, guess_pose,
    s_period, s_odometry, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Start new episodes and take their first sample; returns how many could not be placed."""
    params, targets, count, none = params_[0], points.shape[1], 0, np.int64(0)
    sights = (robots.shape[0] * dr.ROBOT + 3 * targets) * W
    t = np.zeros(sights + robots.shape[0] * targets * se.SIGHT * W)
    for row in rows:
        n = np.uint64(row)  # an index without a sign needs no test whether it counts from the end
        if not place(
            pose[n], points[n], fixed_poses[n], fixed_points[n], guess_depth[n], guess_pose[n], streams[n, SCENARIO],
            params, robots, obstacles, pairs,
        ):  # fmt: skip
            count += 1
            continue
        tick[n] = 0
        position[n] = params.samples_per_action
        deliver[n] = -1
        velocity[n] = 0.0
        wheels[n] = 0.0
        pending[n] = 0.0
        command[n] = 0.0
        contact[n] = False
        collided[n] = False
        blocked[n] = 0
        s_odometry[n, 0] = 0.0
        _load(t, none, n, pose, velocity, wheels, command, points, blocked)
        se.draw(t, none, streams, n, sights, targets, params, robots.shape[0])
        _look(t, sights, targets, robots, obstacles, params.width)
        _store(
            t, none, n, none, 0.0 * params.dt, sights, params, robots, pairs, pose, velocity, visible, tick, deliver,
            streams, s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
        )  # fmt: skip
    return count


@inner
def _look(t, sights, targets, robots, obstacles, width):
    """What all cameras see, in all lanes."""
    se.look(t, robots.shape[0] * dr.ROBOT * W, sights, targets, robots, obstacles, width)
    for r in range(robots.shape[0]):
        se.detect(t, sights + r * targets * se.SIGHT * W, robots[r], targets, width)


@inner
def _store(
    t, lane, n, k, dt, sights, params, robots, pairs, pose, velocity, visible, tick, deliver, streams,
    s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Write what was measured in sample k of environment n, and the truth beside it; send its messages."""
    targets = visible.shape[2]
    s_period[n, k] = dt
    for r in range(robots.shape[0]):
        for j in range(3):
            t_pose[n, k, r, j] = pose[n, r, j]
            t_velocity[n, k, r, j] = velocity[n, r, j]
        frame = se.frame_due(tick[n], robots[r].frames_per_sample)
        for i in range(targets):
            s = lane + sights + (r * targets + i) * se.SIGHT * W
            visible[n, r, i] = t[s + se.VISIBLE] != 0.0
            seen = frame and t[s + se.MEASURED] != 0.0
            s_seen[n, k, r, i] = seen
            t_visible[n, k, r, i] = seen
            s_image[n, k, r, i, 0] = t[s + se.X] if seen else 0.0
            s_image[n, k, r, i, 1] = t[s + se.Y] if seen else 0.0
    se.exchange(deliver, streams, s_arrived, tick[n], n, k, params, pairs)


@kernel
def _advance(
    actions, params_, robots, obstacles, pairs, rows, waiting, resumed,
    pose, velocity, wheels, pending, command, points, visible, contact, collided, blocked, tick, position, deliver,
    streams, s_period, s_odometry, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Go on with the action, sample by sample, until it is done or a contact has to be solved.

    Args:
        actions: [-] (N, R, 2) shares of the limits, taken up unless `resumed`.
        params_, robots, obstacles, pairs: records and constants.
        rows: environments to work on.
        waiting: written: environments that wait for the contact solver.
        resumed: whether the contact solver has just moved the robots of `rows`.
        pose, ..., t_visible: fields of `World`, of `Samples` and of `Truth`.

    Returns:
        How many environments wait.
    """
    params, targets, count = params_[0], points.shape[1], 0
    sights = (robots.shape[0] * dr.ROBOT + 3 * targets) * W
    t = np.zeros(sights + robots.shape[0] * targets * se.SIGHT * W)
    live = np.zeros(W, np.bool_)
    for begin in range(0, rows.shape[0], W):
        lanes = min(W, rows.shape[0] - begin)
        for lane in range(lanes):
            n = np.uint64(rows[begin + lane])
            live[lane] = True
            if not resumed:
                _take_up(actions, n, robots, command, collided, blocked, position)
            _load(t, lane, n, pose, velocity, wheels, command, points, blocked)
        running, moved = lanes, resumed
        while running > 0:
            if not moved:
                for lane in range(lanes):
                    if live[lane] and params.actuator_noise:
                        for r in range(robots.shape[0]):
                            fill_normals(
                                streams, rows[begin + lane], ACTUATOR, t, r * dr.ROBOT * W + dr.NOISE + lane, W, 2
                            )
                dr.drive(t, robots.shape[0] * dr.ROBOT * W, targets, params, robots, obstacles, params.width)
                for lane in range(lanes):
                    if live[lane] and _touches(t, lane, robots.shape[0]):
                        n = np.uint64(rows[begin + lane])
                        _leave(t, lane, n, wheels, blocked, pending)
                        waiting[count] = n
                        count += 1
                        live[lane] = False
                        running -= 1
                dr.settle(t, robots.shape[0], params.width)
            for lane in range(lanes):
                if live[lane]:
                    n = np.uint64(rows[begin + lane])
                    se.draw(t, lane, streams, n, sights, targets, params, robots.shape[0])
                    if not moved:
                        _settle(t, lane, n, pose, velocity, contact)
            moved = False
            _look(t, sights, targets, robots, obstacles, params.width)
            for lane in range(lanes):
                if live[lane]:
                    n = np.uint64(rows[begin + lane])
                    k = position[n]
                    tick[n] += 1
                    position[n] = k + 1
                    _store(
                        t, lane, n, k, params.dt, sights, params, robots, pairs, pose, velocity, visible, tick, deliver,
                        streams, s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
                    )  # fmt: skip
                    _measure_motion(t, lane, n, k, robots, velocity, s_odometry)
                    if k + 1 == params.samples_per_action:
                        _finish(t, lane, n, wheels, blocked)
                        live[lane] = False
                        running -= 1
    return count


@inlined
def _take_up(actions, n, robots, command, collided, blocked, position):
    """Take up a new action."""
    position[n] = 0
    for r in range(robots.shape[0]):
        command[n, r, 0] = dr.speed_of(actions[n, r, 0], robots[r].min_speed, robots[r].max_speed)
        command[n, r, 1] = dr.yaw_rate_of(actions[n, r, 1], robots[r].max_yaw_rate)
        collided[n, r] = False
        blocked[n, r] = 0


@inlined
def _load(t, lane, n, pose, velocity, wheels, command, points, blocked):
    """Put the world of environment n into a lane."""
    count = pose.shape[1]
    for r in range(count):
        i = lane + r * dr.ROBOT * W
        for j in range(3):
            t[i + dr.POSE + j * W] = pose[n, r, j]
            t[i + dr.VELOCITY + j * W] = velocity[n, r, j]
        for j in range(2):
            t[i + dr.WHEELS + j * W] = wheels[n, r, j]
            t[i + dr.COMMAND + j * W] = command[n, r, j]
        t[i + dr.BLOCKED] = blocked[n, r]
    for m in range(points.shape[1]):
        for j in range(3):
            t[lane + (count * dr.ROBOT + 3 * m + j) * W] = points[n, m, j]


@inlined
def _touches(t, lane, count):
    """Whether any robot touches something."""
    touched = 0.0
    for r in range(count):
        touched += t[lane + r * dr.ROBOT * W + dr.TOUCHES]
    return touched > 0.0


@inlined
def _finish(t, lane, n, wheels, blocked):
    """Keep what the next action starts from."""
    for r in range(wheels.shape[1]):
        i = lane + r * dr.ROBOT * W
        wheels[n, r, 0], wheels[n, r, 1] = t[i + dr.WHEELS], t[i + dr.WHEELS + W]
        blocked[n, r] = np.int64(t[i + dr.BLOCKED])


@inlined
def _leave(t, lane, n, wheels, blocked, pending):
    """Hand a lane over to the contact solver."""
    _finish(t, lane, n, wheels, blocked)
    for r in range(wheels.shape[1]):
        i = lane + r * dr.ROBOT * W
        for j in range(3):
            pending[n, r, j] = t[i + dr.END + j * W]


@inlined
def _settle(t, lane, n, pose, velocity, contact):
    """The motion of a lane that touched nothing is the truth now."""
    for r in range(pose.shape[1]):
        i = lane + r * dr.ROBOT * W
        for j in range(3):
            pose[n, r, j] = t[i + dr.POSE + j * W]
            velocity[n, r, j] = t[i + dr.VELOCITY + j * W]
        contact[n, r] = False


@inlined
def _measure_motion(t, lane, n, k, robots, velocity, odometry):
    """Odometry: the true mean velocity with noise. Wheels measure speed and yaw rate; a slide goes unnoticed."""
    for r in range(robots.shape[0]):
        i = lane + r * dr.ROBOT * W + dr.NOISE
        odometry[n, k, r, 0] = velocity[n, r, 0] + robots[r].odometry_v * t[i]
        odometry[n, k, r, 1] = 0.0
        odometry[n, k, r, 2] = velocity[n, r, 2] + robots[r].odometry_w * t[i + W]


@kernel
def _after_contact(pose, pending, velocity, contact, collided, params_, robots, obstacles, rows):
    """Take over what the contact solver found."""
    for n in rows:
        settle_contact(pose, pending, velocity, contact, collided, n, params_[0], robots, obstacles)


class Simulation:
    """N environments of one configuration: reset, step, and what the robots measured meanwhile.

    Attributes:
        world: state, live arrays (N first).
        samples: what was measured in the last step, K samples each.
        first: the one sample that a reset takes; the same arrays as `samples` where an action has one sample.
        truth, first_truth: what really happened then.
    """

    def __init__(self, config: EnvConfig, num_envs: int = 1, threads: int = 1) -> None:
        n, k, r, m = num_envs, config.samples_per_action, config.robots, config.targets
        self.config, self.num_envs = config, n
        self.pairs = ordered_pairs(r)
        p, window = len(self.pairs), config.message_window
        self.parameters, self.robots = pack_parameters(config, n), pack_robots(config)
        self.obstacles = pack_obstacles(config.obstacles)
        self.world = World(
            pose=np.zeros((n, r, 3)),
            velocity=np.zeros((n, r, 3)),
            wheels=np.zeros((n, r, 2)),
            pending=np.zeros((n, r, 3)),
            command=np.zeros((n, r, 2)),
            points=np.zeros((n, m, 3)),
            fixed_poses=np.full((n, r, 3), np.nan),
            fixed_points=np.full((n, m, 3), np.nan),
            guess_depth=np.ones((n, r, m)),
            guess_pose=np.zeros((n, p, 3)),
            visible=np.zeros((n, r, m), np.bool_),
            contact=np.zeros((n, r), np.bool_),
            collided=np.zeros((n, r), np.bool_),
            blocked=np.zeros((n, r), np.int64),
            tick=np.zeros(n, np.int64),
            position=np.zeros(n, np.int64),
            deliver=np.full((n, p, window), -1, np.int64),
            streams=np.zeros((n, PURPOSES, 2), np.uint64),
        )
        self.samples, self.truth = _blocks(n, k, r, m, p)
        self.first, self.first_truth = (self.samples, self.truth) if k == 1 else _blocks(n, 1, r, m, p)
        self.fix(np.arange(n), {})
        self._solvers: list[ContactSolver | None] = [None] * threads
        self._constants = (self.parameters, self.robots, self.obstacles, self.pairs)
        self._arrays = (*(getattr(self.world, name) for name in _MOVED), *self.samples, *self.truth)
        self._begun = (*(getattr(self.world, name) for name in _MOVED + _DRAWN), *self.first, *self.first_truth)
        self.seed(np.arange(n), [int(seed) for seed in np.random.SeedSequence().generate_state(n, np.uint64)])

    def seed(self, rows: Rows, seeds: Sequence[int]) -> None:
        """Start the random streams of the environments `rows` from one seed each."""
        if len(rows) != len(seeds):
            raise ValueError(
                f"Argument `seeds` must have one for each of {len(rows)} environments, but has {len(seeds)}"
            )
        seed_streams(self.world.streams, rows, np.array([_fold(seed) for seed in seeds], np.uint64))

    def reset(self, rows: Rows, options: Mapping[str, Any] | None = None) -> None:
        """Start new episodes in the environments `rows`; their first sample is in `first`.

        Args:
            rows: indices of the environments.
            options: as for `fix`, which is called first.

        Raises:
            ConfigError: options that cannot be, or a start that could not be found.
        """
        self.fix(rows, options)
        failed = _begin(*self._constants, rows, *self._begun)
        if failed:
            raise ConfigError(
                "No start was found that meets the conditions of `start` (distances, separation, all targets in view): "
                "make the arena larger, the conditions wider, or fix `poses` and `points`"
            )

    def fix(self, rows: Rows, options: Mapping[str, Any] | None) -> None:
        """Set which poses and points the environments `rows` start from, until told otherwise.

        Args:
            rows: indices of the environments.
            options: `poses` [m, m, rad] (R, 3) and `points` [m] (M, 3); an empty mapping draws them again (or takes the
                configuration's); None leaves that as it is.

        Raises:
            ConfigError: options that cannot be.
        """
        if options is None:
            return
        for name in options:
            if name not in OPTIONS:
                raise ConfigError(f"Unknown option `{name}` of reset{hint(name, OPTIONS)}")
        config = self.config
        poses = _fixed("poses", options.get("poses", config.poses), config.robots)
        points = _fixed("points", options.get("points", config.points), config.targets)
        if options.get("poses") is not None:
            try:
                config.check_poses(tuple((float(x), float(y), float(a)) for x, y, a in poses))
            except ValueError as error:
                raise ConfigError(f"Argument `options` {error}") from None
        self.world.fixed_poses[rows] = poses
        self.world.fixed_points[rows] = points

    def step(self, actions: NDArray[np.float64], rows: Rows, thread: int = 0) -> None:
        """Hold `actions` for the samples of one action; what was measured is in `samples`.

        Args:
            actions: [-] (N, R, 2) speed and yaw rate as shares of their limits, clipped to [-1, 1].
            rows: indices of the environments that move.
            thread: number of the calling thread, where several work on parts of the batch at once.
        """
        waiting, resumed, world = np.empty(len(rows), np.int64), False, self.world
        while True:
            count = _advance(actions, *self._constants, rows, waiting, resumed, *self._arrays)
            if count == 0:
                return
            rows, resumed = waiting[:count].copy(), True
            self._solver(thread).solve_many(self.world, rows)
            _after_contact(
                world.pose, world.pending, world.velocity, world.contact, world.collided,
                self.parameters, self.robots, self.obstacles, rows,
            )  # fmt: skip

    def _solver(self, thread: int) -> ContactSolver:
        """The contact solver of a thread."""
        solver = self._solvers[thread]
        if solver is None:
            solver = self._solvers[thread] = ContactSolver(self.config)
        return solver

    @property
    def prior(self) -> Prior:
        """What the robots are told at the start."""
        guess = self.config.guess
        sd = np.array([guess.position_sd, guess.position_sd, math.radians(guess.heading_sd)])
        return Prior(self.world.guess_depth, self.world.guess_pose, guess.depth_sd, sd)

    def get_state(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """Copies of the world's state of the environments `rows`, random streams included."""
        return {name: getattr(self.world, name)[rows].copy() for name in World._fields}

    def set_state(self, state: Mapping[str, NDArray[Any]], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
        for name in World._fields:
            getattr(self.world, name)[rows] = state[name]


_MOVED = (
    "pose", "velocity", "wheels", "pending", "command", "points", "visible", "contact", "collided", "blocked", "tick",
    "position", "deliver", "streams",
)  # fmt: skip
"""Fields of `World` that `_advance` takes one by one (quicker to hand over than a tuple)."""
_DRAWN = ("fixed_poses", "fixed_points", "guess_depth", "guess_pose")
"""Those that `_begin` takes as well."""


def _blocks(n: int, k: int, r: int, m: int, p: int) -> tuple[Samples, Truth]:
    """Empty arrays for K samples."""
    samples = empty_samples(n, k, r, m, p)
    truth = Truth(np.zeros((n, k, r, 3)), np.zeros((n, k, r, 3)), np.zeros((n, k, r, m), np.bool_))
    return samples, truth


def _fold(seed: int) -> int:
    """A seed as 64 bits; larger ones are hashed."""
    return seed if seed < 1 << 64 else int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


def _fixed(name: str, value: ArrayLike | None, count: int) -> Float:
    """(count, 3) finite numbers, or NaN where nothing is fixed."""
    if value is None:
        return np.full((count, 3), np.nan)
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"Argument `{name}` must be numbers of shape ({count}, 3), but is {value!r}") from None
    if array.shape != (count, 3):
        raise ConfigError(f"Argument `{name}` must have shape ({count}, 3), but has {array.shape}")
    if not np.isfinite(array).all():
        raise ConfigError(f"Argument `{name}` must be finite, but is {array.tolist()}")
    return array


def check_seed(seed: object) -> int:
    """Return a seed as an int, or raise where it is not a non-negative integer."""
    if isinstance(seed, bool) or not isinstance(seed, numbers.Integral) or int(seed) < 0:
        raise ValueError(f"Argument `seed` must be a non-negative integer, but is {seed!r}")
    return int(seed)
