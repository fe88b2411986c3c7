"""The physical side, whole: world, cameras and network of N environments, sample by sample.

`Simulation` knows the truth and hands out what robots measure (`Samples`). It knows nothing of estimators or rewards.
"""

import math
import operator
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relloc_env.config import ConfigError, EnvConfig, hint
from relloc_env.kernels.lanes import flat
from relloc_env.kernels.stepping import advance, after_contact, begin
from relloc_env.kernels.streams import PURPOSES, seed_streams
from relloc_env.kernels.world import Truth, World
from relloc_env.parameters import pack_obstacles, pack_parameters, pack_robots
from relloc_env.quoting import quote
from relloc_env.samples import Float, Prior, Rows, Sharing, empty_samples, ordered_pairs
from relloc_env.world import ContactSolver

if TYPE_CHECKING:
    from relloc_env.vision.eyes import Eyes

OPTIONS = ("poses", "points")
"""What `options` of a reset may fix."""
GRID = 1000.0
"""[m] Origins are multiples of this, so that worlds around (0, 0) keep their own coordinates."""


class Simulation(Sharing):
    """N environments of one configuration: reset, step, and what the robots measured meanwhile.

    Attributes:
        world: state, live arrays (N first).
        samples: what was measured in the last step, K samples each.
        first: the one sample that a reset takes; the same arrays as `samples` where an action has one sample.
        truth, first_truth: what really happened then.
        eyes: the cameras that take pictures, None where all are analytic.
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
            origin=np.zeros((n, 2)),
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
        self.first = empty_samples(n, 1, r, m, p)
        self.samples = self.first if k == 1 else empty_samples(n, k, r, m, p)
        self._kept: Truth | None = None
        if k > 1:
            self._kept = Truth(np.zeros((n, k, r, 3)), np.zeros((n, k, r, 3)), np.zeros((n, k, r, m), np.bool_))
        self.fix(np.arange(n), {})
        self._solvers: list[ContactSolver | None] = [None] * threads
        self._constants = (self.parameters, self.robots, self.obstacles, self.pairs)
        self.eyes = _open_eyes(config, n, threads)
        self._share()
        self.seed(np.arange(n), [int(seed) for seed in np.random.SeedSequence().generate_state(n, np.uint64)])

    def _share(self) -> None:
        """Views of arrays; with one sample, the truth is what `world` has."""
        world = self.world
        self.first_truth = Truth(world.pose[:, None], world.velocity[:, None], self.first.seen)
        self.truth = self._kept or self.first_truth
        self._arrays = flat((*(getattr(world, name) for name in _MOVED), *self.samples, *self.truth))
        self._begun = (*(getattr(world, name) for name in _MOVED + _DRAWN), *self.first, *self.first_truth)

    def seed(self, rows: Rows, seeds: Sequence[int]) -> None:
        """Start the random streams of the environments `rows` from one seed each."""
        if len(rows) != len(seeds):
            raise ValueError(
                f"Argument `seeds` must have one for each of {len(rows)} environments, but has {len(seeds)}"
            )
        seed_streams(self.world.streams, rows, np.array([_fold(seed) for seed in seeds], np.uint64))

    def reset(self, rows: Rows, options: Mapping[str, Any] | None = None, thread: int = 0) -> None:
        """Start new episodes in the environments `rows`; their first sample is in `first`.

        Args:
            rows: indices of the environments.
            options: as for `fix`, which is called first.
            thread: as for `step`.

        Raises:
            ConfigError: options that cannot be, or a start that could not be found.
        """
        self.fix(rows, options)
        failed = begin(*self._constants, rows, *self._begun)
        if failed:
            raise ConfigError(
                "No start was found that meets the conditions of `start` (distances, separation, all targets in view): "
                "make the arena larger, the conditions wider, or fix `poses` and `points`"
            )
        self.world.origin[rows] = GRID * np.round(self.world.pose[rows, 0, :2] / GRID)
        if self.eyes is not None:
            self.eyes.start(self.world, self.first, self.first_truth, rows, thread)

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
        moving, waiting, resumed = rows, np.empty(len(rows), np.int64), False
        while True:
            count = advance(actions.reshape(-1), *self._constants, rows, waiting, resumed, *self._arrays)
            if count == 0:
                break
            rows, resumed = waiting[:count].copy(), True
            self.solve_contacts(rows, thread)
        if self.eyes is not None:
            self.eyes.look(self.world, self.samples, self.truth, moving, thread)

    def solve_contacts(self, rows: Rows, thread: int = 0) -> None:
        """Move the environments `rows`, whose robots would touch something in this sample, as contacts allow."""
        world = self.world
        self._solver(thread).solve_many(world, rows)
        after_contact(
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
        return {name: part[rows].copy() for name, part in self._remembered()}

    def set_state(self, state: Mapping[str, NDArray[Any]], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
        for name, part in self._remembered():
            part[rows] = state[name]

    def _remembered(self) -> list[tuple[str, NDArray[Any]]]:
        """All that the next samples depend on, by name."""
        tracks = {} if self.eyes is None else self.eyes.tracks._asdict()
        return [*self.world._asdict().items(), *((f"track_{name}", part) for name, part in tracks.items())]


_MOVED = (
    "pose", "velocity", "wheels", "pending", "command", "points", "visible", "contact", "collided", "blocked", "tick",
    "position", "deliver", "streams",
)  # fmt: skip
"""Fields of `World` that `advance` takes one by one (quicker to hand over than a tuple)."""
_DRAWN = ("fixed_poses", "fixed_points", "guess_depth", "guess_pose")
"""Those that `begin` takes as well."""


def _open_eyes(config: EnvConfig, num_envs: int, threads: int) -> "Eyes | None":
    """The cameras that take pictures, if any does."""
    if all(config.camera_of(r).kind == "analytic" for r in range(config.robots)):
        return None
    from relloc_env.vision.eyes import Eyes

    return Eyes(config, num_envs, threads)


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
    """Return a seed as an int, or raise where it is not a non-negative integer of Python, NumPy or an array of one."""
    number = integer(seed)
    if number is None or number < 0:
        raise ValueError(f"Argument `seed` must be a non-negative integer, but is {quote(seed)}")
    return number


def integer(value: object) -> int | None:
    """An integer of any kind as an int; None for anything else, truth values too."""
    if isinstance(value, bool) or getattr(value, "dtype", None) == np.bool_:  # NumPy below 2.3 has them as indices
        return None
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        return None
