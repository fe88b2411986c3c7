"""The composed environment for N worlds at once: simulation, estimator, rewards, observations. Doors drive this."""

import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.bound import carry_bound, pack_known, start_bound
from relloc_env.config import ConfigError, EnvConfig, load_config
from relloc_env.ends import pack_ends
from relloc_env.envs.observation import Field, bounds, fields, observe, slices
from relloc_env.envs.onboard import Onboard
from relloc_env.envs.precompile import compile_kernels
from relloc_env.envs.threads import LEAST, check_threads, parts, run
from relloc_env.estimators.protocol import Estimator
from relloc_env.kernels.lanes import flat, width_of
from relloc_env.kernels.world import World
from relloc_env.rewards import BOUND_FIELDS, make_score, score_action, weights
from relloc_env.samples import Bool, Float, Float32, Rows, Sharing, copy_sample
from relloc_env.simulation import Simulation

if TYPE_CHECKING:
    from relloc_env.vision.sensor import Pictures

ROBOT_NAMES = ("robot_a", "robot_b")
"""Names of the agents, as in the paper."""
STATE_BOUND = 1000.0
"""Bound of every entry of `state()` [m, rad, -]; what is beyond is clipped."""


class Core(Sharing):
    """N environments: actions in, observations, rewards and ends out.

    Attributes:
        config: the configuration of all environments.
        simulation: the physical side, with the truth.
        onboard: what the robots make of it: estimator, dead reckoning, messages.
        observation: [-] float32 (N, R, D), or uint8 (N, R, 3, H, W) pictures; refreshed in place, or in the array that
            a caller put there.
        reward: (N, R) weighted sum of the terms.
        joint_reward: (N,) mean over the robots.
        terminated: (N,) whether the last action ended the episode, by what the configuration says.
        truncated: (N,) whether the episode is at its horizon.
        score: what the truth says: errors, bound, terms of the reward.
        elapsed: (N,) actions since the start.
        everyone: (N,) the indices of all environments.
        threads: on which a large batch runs; what comes out does not depend on it.
        restored: how many times `set_state` was called.
        own_estimator: whether the estimator is an object of the user's own.
    """

    def __init__(
        self, config: EnvConfig, num_envs: int = 1, estimator: Estimator | None = None, threads: int | None = None
    ) -> None:
        n, r = num_envs, config.robots
        self.config, self.num_envs = config, num_envs
        self.everyone: Rows = np.arange(n)
        # an estimator of the user's own may not stand being called from several threads
        self.threads = 1 if estimator is not None else check_threads(threads, n)
        self._everyone = parts(self.everyone, self.threads)
        self.simulation = Simulation(config, n, self.threads)
        self.onboard = Onboard(config, n, estimator)
        self.bare = self.onboard.bare
        self.own_estimator = estimator is not None
        self.score = make_score(config, n)
        self.low, self.high = bounds(config)
        self._pictures = _open_pictures(config, self.threads)
        shape, kind = ((self.low.size,), np.float32) if self._pictures is None else (self.fields[0].shape, np.uint8)
        self.observation: Any = np.zeros((n, r, *shape), kind)
        self.reward: Float = np.zeros((n, r))
        self.joint_reward: Float = np.zeros(n)
        self.terminated: Bool = np.zeros(n, np.bool_)
        self.truncated: Bool = np.zeros(n, np.bool_)
        self.last_action: Float = np.zeros((n, r, 2))
        self.elapsed: NDArray[np.int64] = np.zeros(n, np.int64)
        self._weights = weights(config)
        self._known, self._tracks_bound = pack_known(config), config.tracks_bound
        self._ends = pack_ends(config)
        self._limits = np.array([config.max_cycles, config.sample_period])
        self.restored = 0
        self._motion: Float | None = np.zeros((n, r, 2)) if config.gain_names else None
        self._width = width_of(n)
        self._share()
        compile_kernels(self)

    @property
    def fields(self) -> list[Field]:
        """Fields of one robot's observation, in order."""
        return fields(self.config)

    @property
    def slices(self) -> dict[str, slice]:
        """Where each field is in one robot's observation."""
        return slices(self.config)

    def reset(self, rows: Rows, seeds: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start new episodes; see `Simulation.reset` for `options`. `seeds` start the random streams anew."""
        simulation = self.simulation
        if seeds is not None:
            simulation.seed(rows, seeds)
        simulation.fix(rows, options)
        run(self._reset, self._parts(rows))

    def _reset(self, rows: Rows, part: int) -> None:
        """Start the episodes of one part of the batch."""
        simulation = self.simulation
        simulation.reset(rows, thread=part)
        for array in (self.elapsed, self.last_action, self.reward, self.joint_reward, self.terminated, self.truncated):
            array[rows] = 0
        self.onboard.reset(simulation.prior, simulation.first, rows)
        self._judge_start(rows)
        copy_sample(simulation.first, 0, simulation.samples, -1, rows)
        self._observe(rows, part)

    def _judge_start(self, rows: Rows) -> None:
        """What the truth says at the start."""
        if self._tracks_bound:
            start_bound(*self._bound, *self._first_sight, *self._known, rows)
        score_action(*self._scored_first, self.last_action.reshape(-1), *self._scored_by, 1, rows, True)

    def step(self, actions: NDArray[np.float64], rows: Rows) -> None:
        """Hold `actions` (N, R, A) in [-1, 1] for one action in the environments `rows`."""
        if self.threads == 1:
            self._step(actions, rows, 0)
        else:
            run(functools.partial(self._step, actions), self._parts(rows))

    def _parts(self, rows: Rows) -> list[Rows]:
        """What each thread works on."""
        return self._everyone if rows is self.everyone else parts(rows, min(self.threads, 1 + len(rows) // LEAST))

    def _step(self, actions: NDArray[np.float64], rows: Rows, part: int) -> None:
        """Step one part of the batch."""
        simulation = self.simulation
        if self._motion is not None:
            self.onboard.tune(actions, rows)
            self._motion[rows] = actions[rows, :, :2]
            actions = self._motion
        simulation.step(actions, rows, part)
        self.onboard.update(simulation.samples, rows)
        self._judge(actions, rows)
        self._observe(rows, part)

    def _judge(self, actions: NDArray[np.float64], rows: Rows) -> None:
        """What the truth says about an action."""
        if self._tracks_bound:
            carry_bound(
                *self._bound, *self._sight, *self._known, rows, self.score.terms, self.simulation.truth.velocity,
                self.config.sample_period,
            )  # fmt: skip
        score_action(*self._scored, actions.reshape(-1), *self._scored_by, self.config.samples_per_action, rows, False)

    def compile_most(self) -> None:
        """Compile most kernels but those of the estimator and of the motion: let them work on no environment."""
        none: Rows = self.everyone[:0]
        self.simulation.reset(none)
        self.onboard.tell(self.simulation.first, none, first=True)
        self._judge_start(none)
        self._judge(self.last_action, none)
        if self._pictures is None:
            self._observe(none, 0)

    def _observe(self, rows: Rows, part: int) -> None:
        if self._pictures is None:
            observe(self.observation, *self._observed, rows, self.bare, self._width)
        else:
            self._pictures.take(self.observation, self.simulation.world, rows, part)

    def _share(self) -> None:
        """Put together once what kernels are given at every step: live arrays."""
        simulation, world, score = self.simulation, self.simulation.world, self.score
        estimate = self.onboard.estimate
        self._bound = score[:BOUND_FIELDS]
        self._sight = (world.pose, world.points, world.origin, simulation.truth.pose, simulation.truth.visible)
        first = simulation.first_truth
        self._first_sight = (world.points, world.origin, first.pose, first.visible)
        written = (score.terms, score.depth_error, score.pose_error, score.believed, self.reward, self.last_action)
        truth = (world.points, world.collided, world.blocked)
        believed, heights = (estimate.points, estimate.known, estimate.pose), self._known.camera_heights
        ended = (self.joint_reward, score.worst_sd, self.elapsed, self.terminated, self.truncated)
        self._scored, self._scored_first = (
            (*flat((*written, *truth, samples.seen, happened.pose, happened.velocity, heights, *ended)), *believed)
            for samples, happened in (
                (simulation.samples, simulation.truth),
                (simulation.first, simulation.first_truth),
            )
        )
        self._scored_by = (self._weights, self._ends, simulation.parameters, simulation.pairs)
        self._observed = (
            *simulation.samples, estimate.pose, estimate.pose_covariance,
            *self.onboard.messages,
            *flat((world.collided, world.blocked, self.last_action, self.elapsed)), self.onboard.gains,
            simulation.pairs, self._limits,
        )  # fmt: skip

    def states(self) -> Float32:
        """All that matters, the truth included, as one vector (N, S) per environment; for centralised critics.

        Poses and points are about `World.origin`, so that float32 holds their digits.
        """
        world = self.simulation.world
        parts = (*_local(world, slice(None)), world.visible, self.observation)
        found = np.concatenate([part.reshape(self.num_envs, -1) for part in parts], axis=1, dtype=np.float32)
        return found.clip(-STATE_BOUND, STATE_BOUND, out=found)

    def state(self, n: int) -> Float32:
        """The line of `states` of environment n."""
        world = self.simulation.world
        parts = (*_local(world, n), world.visible[n], self.observation[n])
        found = np.concatenate([np.asarray(part, np.float32).ravel() for part in parts])
        return found.clip(-STATE_BOUND, STATE_BOUND, out=found)

    @property
    def state_size(self) -> int:
        """Length S of a state."""
        r, m = self.config.robots, self.config.targets
        return 6 * r + 3 * m + r * m + r * len(self.low)

    def get_state(self, rows: Rows) -> dict[str, Any]:
        """Copies of everything the environments `rows` remember, random streams included."""
        return {
            "world": self.simulation.get_state(rows),
            "samples": {name: value[rows].copy() for name, value in self.simulation.samples._asdict().items()},
            "onboard": self.onboard.get_state(rows),
            "score": {name: value[rows].copy() for name, value in self.score._asdict().items()},
            "episode": {name: getattr(self, name)[rows].copy() for name in _EPISODE},
        }

    def set_state(self, state: Mapping[str, Any], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows of an environment of the same configuration, bit for bit."""
        self.restored += 1
        self.simulation.set_state(state["world"], rows)
        self.onboard.set_state(state["onboard"], rows)
        for key, part in (("samples", self.simulation.samples), ("score", self.score)):
            for name, value in part._asdict().items():
                value[rows] = state[key][name]
        for name in _EPISODE:
            getattr(self, name)[rows] = state["episode"][name]

    def seed(self, rows: Rows, seeds: Sequence[int]) -> None:
        """Start the random streams of the environments `rows` anew, in mid-episode."""
        self.simulation.seed(rows, seeds)

    def set_horizon(self, max_cycles: int) -> None:
        """Let episodes be truncated after another number of actions."""
        self.config = load_config(self.config, max_cycles=max_cycles)
        self._limits[0] = self._ends[0] = max_cycles

    def check_clonable(self) -> None:
        """Raise where the estimator is an object of the user's own: it was made for this number of environments."""
        if self.own_estimator:
            raise ConfigError("An environment with an estimator object of one's own cannot be cloned: give its name")


def _local(world: World, which: int | slice) -> tuple[Float, Float, Float]:
    """Poses, velocities and points of some environments, places about the local origin."""
    pose, points, origin = world.pose[which].copy(), world.points[which].copy(), world.origin[which][..., None, :]
    pose[..., :2] -= origin
    points[..., :2] -= origin
    return pose, world.velocity[which], points


def _open_pictures(config: EnvConfig, threads: int) -> "Pictures | None":
    """What takes the pictures that policies see, if they do."""
    if config.observation != "image":
        return None
    from relloc_env.vision.sensor import Pictures

    return Pictures(config, threads)


_EPISODE = ("observation", "reward", "last_action", "elapsed", "terminated", "truncated")
