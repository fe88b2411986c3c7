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
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.placement import place
from relloc_env.kernels.sensing import exchange, look, measure_motion
from relloc_env.kernels.streams import PURPOSES, seed_stream
from relloc_env.kernels.world import Truth, World, drive, settle, settle_contact, touches
from relloc_env.parameters import pack_obstacles, pack_parameters, pack_robots
from relloc_env.samples import Float, Prior, Rows, Samples, empty_samples, ordered_pairs
from relloc_env.world import ContactSolver

OPTIONS = ("poses", "points")
"""What `options` of a reset may fix."""


@kernel
def _sense(world, samples, truth, n, k, params, robots, pairs):
    """Take sample k of environment n."""
    look(world, samples, n, k, robots)
    exchange(world, samples, n, k, params, pairs)
    for r in range(robots.shape[0]):
        for j in range(3):
            truth.pose[n, k, r, j] = world.pose[n, r, j]
            truth.velocity[n, k, r, j] = world.velocity[n, r, j]
        for i in range(world.points.shape[1]):
            truth.visible[n, k, r, i] = samples.seen[n, k, r, i]


@kernel
def _begin(world_, samples_, truth_, params_, robots, pairs, rows, failed):
    """Start new episodes and take their first sample; returns how many could not be placed (listed in `failed`)."""
    world, samples, truth, params = World(*world_), Samples(*samples_), Truth(*truth_), params_[0]
    count = 0
    for row in rows:
        if not place(world, row, params, robots, pairs):
            failed[count] = row
            count += 1
            continue
        world.tick[row] = 0
        world.position[row] = params.samples_per_action
        world.moved[row] = False
        world.deliver[row] = -1
        world.velocity[row] = 0.0
        world.wheels[row] = 0.0
        world.command[row] = 0.0
        world.contact[row] = False
        world.collided[row] = False
        world.blocked[row] = 0
        samples.period[row, 0] = 0.0
        samples.odometry[row, 0] = 0.0
        _sense(world, samples, truth, row, 0, params, robots, pairs)
    return count


@kernel
def _advance(world_, samples_, truth_, params_, robots, pairs, rows, waiting):
    """Go on with the action, sample by sample, until it is done or a contact has to be solved.

    Returns how many environments wait for the contact solver (listed in `waiting`).
    """
    world, samples, truth, params = World(*world_), Samples(*samples_), Truth(*truth_), params_[0]
    count = 0
    for n in rows:
        while world.position[n] < params.samples_per_action:
            if not world.moved[n]:
                drive(world, n, params, robots)
                if touches(world, n, params, robots):
                    waiting[count] = n
                    count += 1
                    break
                settle(world, n)
            world.moved[n] = False
            k = world.position[n]
            world.tick[n] += 1
            samples.period[n, k] = params.dt
            measure_motion(world, samples, n, k, robots)
            _sense(world, samples, truth, n, k, params, robots, pairs)
            world.position[n] = k + 1
    return count


@kernel
def _after_contact(world_, params_, robots, rows):
    """Take over what the contact solver found."""
    world, params = World(*world_), params_[0]
    for n in rows:
        settle_contact(world, n, params, robots)
        world.moved[n] = True


@kernel
def _command(world_, robots, actions, rows):
    """Scale actions in [-1, 1] to commands; a robot without reverse maps [-1, 1] to [0, max_speed]."""
    world = World(*world_)
    for n in rows:
        world.position[n] = 0
        for r in range(robots.shape[0]):
            v, w = min(max(actions[n, r, 0], -1.0), 1.0), min(max(actions[n, r, 1], -1.0), 1.0)
            if robots[r].min_speed < 0.0:
                world.command[n, r, 0] = v * robots[r].max_speed
            else:
                world.command[n, r, 0] = 0.5 * (v + 1.0) * robots[r].max_speed
            world.command[n, r, 1] = w * robots[r].max_yaw_rate
            world.collided[n, r] = False
            world.blocked[n, r] = 0


class Simulation:
    """N environments of one configuration: reset, step, and what the robots measured meanwhile.

    Attributes:
        world: state, live arrays (N first).
        samples: what was measured in the last step, K samples each.
        first: the one sample that a reset takes.
        truth, first_truth: what really happened then.
    """

    def __init__(self, config: EnvConfig, num_envs: int = 1) -> None:
        n, k, r, m = num_envs, config.samples_per_action, config.robots, config.targets
        self.config, self.num_envs = config, n
        self.pairs = ordered_pairs(r)
        p, window = len(self.pairs), config.message_window
        self.parameters, self.robots = pack_parameters(config), pack_robots(config)
        obstacles = pack_obstacles(config.obstacles)
        self.world = World(
            pose=np.zeros((n, r, 3)),
            velocity=np.zeros((n, r, 3)),
            wheels=np.zeros((n, r, 2)),
            pending=np.zeros((n, r, 3)),
            command=np.zeros((n, r, 2)),
            points=np.zeros((n, m, 3)),
            obstacles=np.tile(obstacles, (n, 1, 1)),
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
            moved=np.zeros(n, np.bool_),
            deliver=np.full((n, p, window), -1, np.int64),
            streams=np.zeros((n, PURPOSES, 2), np.uint64),
        )
        self.samples, self.truth = _blocks(n, k, r, m, p)
        self.first, self.first_truth = _blocks(n, 1, r, m, p)
        self._fix(np.arange(n), {})
        self._waiting = np.zeros(n, np.int64)
        self._solver: ContactSolver | None = None
        self._world_, self._samples_, self._truth_ = tuple(self.world), tuple(self.samples), tuple(self.truth)
        self._first_, self._first_truth_ = tuple(self.first), tuple(self.first_truth)
        self.seed(np.arange(n), [int(seed) for seed in np.random.SeedSequence().generate_state(n, np.uint64)])

    def seed(self, rows: Rows, seeds: Sequence[int]) -> None:
        """Start the random streams of the environments `rows` from one seed each."""
        for row, seed in zip(rows, seeds, strict=True):
            for purpose in range(PURPOSES):
                seed_stream(self.world.streams[row, purpose], np.uint64(_fold(seed)), purpose)

    def reset(self, rows: Rows, options: Mapping[str, Any] | None = None) -> None:
        """Start new episodes in the environments `rows`; their first sample is in `first`.

        Args:
            rows: indices of the environments.
            options: `poses` [m, m, rad] (R, 3) and `points` [m] (M, 3), fixed from now on, also for the episodes after
                this one; an empty mapping draws them again (or takes the configuration's); None leaves that as it is.

        Raises:
            ConfigError: options that cannot be, or a start that could not be found.
        """
        if options is not None:
            self._fix(rows, options)
        failed = _begin(
            self._world_,
            self._first_,
            self._first_truth_,
            self.parameters,
            self.robots,
            self.pairs,
            rows,
            self._waiting,
        )
        if failed:
            raise ConfigError(
                "No start was found that meets the conditions of `start` (distances, separation, all targets in view): "
                "make the arena larger, the conditions wider, or fix `poses` and `points`"
            )

    def _fix(self, rows: Rows, options: Mapping[str, Any]) -> None:
        """Set which poses and points the environments `rows` start from."""
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

    def step(self, actions: NDArray[np.float64], rows: Rows) -> None:
        """Hold `actions` for the samples of one action; what was measured is in `samples`.

        Args:
            actions: [-] (N, R, 2) speed and yaw rate as shares of their limits, clipped to [-1, 1].
            rows: indices of the environments that move.
        """
        _command(self._world_, self.robots, actions, rows)
        while True:
            count = _advance(
                self._world_,
                self._samples_,
                self._truth_,
                self.parameters,
                self.robots,
                self.pairs,
                rows,
                self._waiting,
            )
            if count == 0:
                return
            rows = self._waiting[:count].copy()
            if self._solver is None:
                self._solver = ContactSolver(self.config)
            for n in rows:
                self._solver.solve(self.world, int(n))
            _after_contact(self._world_, self.parameters, self.robots, rows)

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
