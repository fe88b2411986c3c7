"""The composed environment for N worlds at once: simulation, estimator, rewards, observations. Every door drives this."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig, load_config
from relloc_env.envs.observation import (
    BARE_POINT,
    MOTION,
    POINT,
    Field,
    Mail,
    bounds,
    exchange_mail,
    fields,
    observe,
    slices,
)
from relloc_env.estimators.config import CascadeConfig, MapAlignmentConfig
from relloc_env.estimators.protocol import Estimator
from relloc_env.estimators.registry import make
from relloc_env.rewards import TERMS, make_score, pack_known, score_action, start_score, weights
from relloc_env.samples import Bool, Estimate, Float, Float32, Rows, Samples
from relloc_env.simulation import Simulation

ROBOT_NAMES = ("robot_a", "robot_b")
"""Names of the agents, as in the paper."""


class Core:
    """N environments: actions in, observations, rewards and ends out.

    Attributes:
        config: the configuration of all environments.
        simulation: the physical side, with the truth.
        estimator: what the robots make of it; None for the bare environment.
        observation: [-] float32 (N, R, D), refreshed in place.
        reward: (N, R) weighted sum of the terms.
        score: what the truth says: errors, bound, terms of the reward.
        elapsed: (N,) actions since the start.
    """

    def __init__(self, config: EnvConfig, num_envs: int = 1, estimator: Estimator | None = None) -> None:
        n, r, m = num_envs, config.robots, config.targets
        self.config, self.num_envs = config, num_envs
        self.simulation = Simulation(config, n)
        window, pairs = config.message_window, self.simulation.pairs
        if estimator is None and config.estimator is not None:
            estimator = make(_informed(config), n, r, m, message_window=window)
        self.estimator = estimator
        self.bare = estimator is None
        self.estimate = estimator.estimate if estimator is not None else _nothing(n, r, m, len(pairs))
        told = m * (BARE_POINT if self.bare else POINT) + MOTION
        self._mail = Mail(
            outbox=np.zeros((n, r, window, told)),
            inbox=np.zeros((n, len(pairs), told)),
            inbox_tick=np.full((n, len(pairs)), -1, np.int64),
        )
        self.score = make_score(config, n)
        self.low, self.high = bounds(config)
        self.observation: Float32 = np.zeros((n, r, self.low.size), np.float32)
        self.reward: Float = np.zeros((n, r))
        self.last_action: Float = np.zeros((n, r, 2))
        self.elapsed: NDArray[np.int64] = np.zeros(n, np.int64)
        self._weights = weights(config)
        self._known_ = tuple(pack_known(config))
        self._limits = np.array([config.max_cycles, config.sample_period])
        self._work = np.zeros((2, self.score.bound.shape[1]))
        self._one = _one_sample(self.simulation.first) if not config.network.perfect else None
        self._tuples = tuple(
            tuple(part)
            for part in (self.simulation.world, self.simulation.samples, self.simulation.first, self.estimate, self._mail)
        )
        self._score_, self._truth_ = tuple(self.score), tuple(self.simulation.truth)
        self._first_truth_ = tuple(self.simulation.first_truth)

    @property
    def fields(self) -> list[Field]:
        """Fields of one robot's observation, in order."""
        return fields(self.config)

    @property
    def slices(self) -> dict[str, slice]:
        """Where each field is in one robot's observation."""
        return slices(self.config)

    def reset(
        self, rows: Rows, seeds: Sequence[int] | None = None, options: Mapping[str, Any] | None = None
    ) -> None:
        """Start new episodes; see `Simulation.reset` for `options`. `seeds` start the random streams anew."""
        simulation = self.simulation
        if seeds is not None:
            simulation.seed(rows, seeds)
        simulation.reset(rows, options)
        self.elapsed[rows] = 0
        self.last_action[rows] = 0.0
        self.reward[rows] = 0.0
        if self.estimator is not None:
            self.estimator.reset(simulation.prior, rows)
            self.estimator.update(simulation.first, rows)
        world_, _, first_, estimate_, mail_ = self._tuples
        exchange_mail(world_, first_, estimate_, mail_, simulation.pairs, rows, 0, self.bare)
        start_score(
            self._score_, world_, self._first_truth_, estimate_, self._known_, simulation.pairs, self._work, rows,
        )  # fmt: skip
        for block, first in zip(simulation.samples, simulation.first, strict=True):
            block[rows, -1] = first[rows, 0]
        self._observe(rows)

    def step(self, actions: NDArray[np.float64], rows: Rows) -> None:
        """Hold `actions` (N, R, 2) in [-1, 1] for one action in the environments `rows`."""
        simulation = self.simulation
        simulation.step(actions, rows)
        world_, samples_, _, estimate_, mail_ = self._tuples
        if self._one is None:
            if self.estimator is not None:
                self.estimator.update(simulation.samples, rows)
            last = self.config.samples_per_action - 1
            exchange_mail(world_, samples_, estimate_, mail_, simulation.pairs, rows, last, self.bare)
        else:
            self._sample_by_sample(rows)
        self.elapsed[rows] += 1
        self.last_action[rows] = np.clip(actions[rows], -1.0, 1.0)
        score_action(
            self._score_, world_, samples_, self._truth_, estimate_, self._known_, self.last_action, self._weights,
            self.reward, simulation.parameters, simulation.robots, simulation.pairs, self._work, rows,
        )  # fmt: skip
        self._observe(rows)

    def _sample_by_sample(self, rows: Rows) -> None:
        """Estimate after each sample, so that a late message tells what its robot knew when it was made."""
        assert self._one is not None
        simulation = self.simulation
        world_, _, _, estimate_, mail_ = self._tuples
        now = simulation.world.tick[rows].copy()
        for k in range(self.config.samples_per_action):
            for one, block in zip(self._one, simulation.samples, strict=True):
                one[rows, 0] = block[rows, k]
            if self.estimator is not None:
                self.estimator.update(self._one, rows)
            simulation.world.tick[rows] = now - self.config.samples_per_action + 1 + k
            exchange_mail(world_, tuple(self._one), estimate_, mail_, simulation.pairs, rows, 0, self.bare)

    def _observe(self, rows: Rows) -> None:
        world_, samples_, _, estimate_, mail_ = self._tuples
        observe(
            self.observation, world_, samples_, estimate_, mail_, self.simulation.pairs, self.last_action, self.elapsed,
            self._limits, rows, self.bare,
        )  # fmt: skip

    def terminated(self, n: int) -> bool:
        """Whether the episode of environment n ended by what the configuration says."""
        config = self.config
        if config.terminate_on_collision and self.simulation.world.collided[n].any():
            return True
        if config.terminate_on_success:
            length, angle = self.score.worst_sd[n]
            return bool(length <= config.success[0] and angle <= math.radians(config.success[1]))
        return False

    def truncated(self, n: int) -> bool:
        """Whether environment n is at its horizon."""
        return bool(self.elapsed[n] >= self.config.max_cycles)

    def information(self, n: int, robot: int | None = None) -> dict[str, Any]:
        """The truth about environment n: for `info`, never for a policy. Fresh arrays each time.

        Args:
            n: index of the environment.
            robot: index of the robot whose terms of the reward are wanted; the mean over robots by default.
        """
        world, found = self.simulation.world, self.score
        terms = found.terms[n].mean(axis=0) if robot is None else found.terms[n, robot]
        info: dict[str, Any] = {f"reward/{name}": value for name, value in zip(TERMS, terms.tolist(), strict=True)}
        info["truth"] = {"poses": world.pose[n].copy(), "points": world.points[n].copy()}
        if not self.bare:
            info["errors"] = {"range": found.depth_error[n].copy(), "pose": found.pose_error[n].copy()}
        info["information"] = {"depth": found.depth_information[n].copy(), "pose": float(found.pose_information[n])}
        info["bound_sd"] = found.worst_sd[n].copy()
        return info

    def prior(self, n: int) -> dict[str, Any]:
        """What the robots of environment n were told at the start, with its standard deviations."""
        prior = self.simulation.prior
        return {
            "depth": prior.depth[n].copy(),
            "pose": prior.pose[n].copy(),
            "depth_sd": prior.depth_sd,
            "pose_sd": prior.pose_sd.copy(),
        }

    def state(self, n: int) -> Float32:
        """All that matters about environment n, the truth included, as one vector; for centralised critics."""
        world = self.simulation.world
        parts = (world.pose[n], world.velocity[n], world.points[n], world.visible[n], self.observation[n])
        return np.concatenate([np.asarray(part, np.float32).ravel() for part in parts])

    @property
    def state_size(self) -> int:
        """Length of `state`."""
        r, m = self.config.robots, self.config.targets
        return 6 * r + 3 * m + r * m + r * self.low.size

    def get_state(self, rows: Rows) -> dict[str, Any]:
        """Copies of everything the environments `rows` remember, random streams included."""
        return {
            "world": self.simulation.get_state(rows),
            "samples": {name: value[rows].copy() for name, value in self.simulation.samples._asdict().items()},
            "estimator": self.estimator.get_state(rows) if self.estimator is not None else {},
            "mail": {name: value[rows].copy() for name, value in self._mail._asdict().items()},
            "score": {name: value[rows].copy() for name, value in self.score._asdict().items()},
            "episode": {name: getattr(self, name)[rows].copy() for name in _EPISODE},
        }

    def set_state(self, state: Mapping[str, Any], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows of an environment of the same configuration, bit for bit."""
        self.simulation.set_state(state["world"], rows)
        if self.estimator is not None:
            self.estimator.set_state(state["estimator"], rows)
        for key, part in (("samples", self.simulation.samples), ("mail", self._mail), ("score", self.score)):
            for name, value in part._asdict().items():
                value[rows] = state[key][name]
        for name in _EPISODE:
            getattr(self, name)[rows] = state["episode"][name]


def _informed(config: EnvConfig) -> CascadeConfig | MapAlignmentConfig:
    """The estimator's configuration, which takes the noise of the robots' sensors where it does not state its own."""
    assert config.estimator is not None
    noise = {
        "image_noise": max(config.camera_of(r).image_noise for r in range(config.robots)),
        "odometry_noise": tuple(max(config.robot_of(r).odometry_noise[j] for r in range(config.robots)) for j in (0, 1)),
    }
    chosen = config.estimator
    unstated = {name: value for name, value in noise.items() if name not in chosen.model_fields_set}
    return chosen.model_copy(update=unstated)


_EPISODE = ("observation", "reward", "last_action", "elapsed")


def build_core(
    config: EnvConfig | Mapping[str, Any] | str | Path | None,
    num_envs: int,
    options: Mapping[str, Any],
    estimator: Estimator | None = None,
) -> Core:
    """Build the core of a door from what the user gave it."""
    return Core(load_config(config, **options), num_envs, estimator)


def check_actions(name: str, action: Any, shape: tuple[int, ...]) -> Float:
    """Return an action as float64, or raise where it has another shape or is not finite."""
    try:
        array = np.asarray(action, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"Argument `{name}` must be numbers of shape {shape}, but is {action!r}") from None
    if array.shape != shape:
        raise ValueError(f"Argument `{name}` must have shape {shape}, but has {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"Argument `{name}` must be finite, but is {array.tolist()}")
    return array


def _one_sample(like: Samples) -> Samples:
    """Empty arrays for one sample of every environment."""
    return Samples(*(np.zeros_like(value) for value in like))


def _nothing(n: int, r: int, m: int, p: int) -> Estimate:
    """The estimate of a bare environment: nothing is known."""
    known: Bool = np.zeros((n, r, m), np.bool_)
    return Estimate(
        np.zeros((n, r, m, 3)), np.zeros((n, r, m, 3, 3)), known, np.zeros((n, p, 3)), np.zeros((n, p, 3, 3))
    )
