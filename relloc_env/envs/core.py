"""The composed environment for N worlds at once: simulation, estimator, rewards, observations. Doors drive this."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig
from relloc_env.envs.observation import Field, bounds, fields, observe, slices
from relloc_env.envs.onboard import Onboard
from relloc_env.estimators.protocol import Estimator
from relloc_env.rewards import TERMS, make_score, pack_known, score_action, start_score, weights
from relloc_env.samples import Float, Float32, Rows, copy_sample
from relloc_env.simulation import Simulation

ROBOT_NAMES = ("robot_a", "robot_b")
"""Names of the agents, as in the paper."""


class Core:
    """N environments: actions in, observations, rewards and ends out.

    Attributes:
        config: the configuration of all environments.
        simulation: the physical side, with the truth.
        onboard: what the robots make of it: estimator, dead reckoning, messages.
        observation: [-] float32 (N, R, D), refreshed in place.
        reward: (N, R) weighted sum of the terms.
        score: what the truth says: errors, bound, terms of the reward.
        elapsed: (N,) actions since the start.
    """

    def __init__(self, config: EnvConfig, num_envs: int = 1, estimator: Estimator | None = None) -> None:
        n, r = num_envs, config.robots
        self.config, self.num_envs = config, num_envs
        self.simulation = Simulation(config, n)
        self.onboard = Onboard(config, n, estimator)
        self.bare = self.onboard.bare
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
        self._world_, self._samples_ = tuple(self.simulation.world), tuple(self.simulation.samples)
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

    def reset(self, rows: Rows, seeds: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start new episodes; see `Simulation.reset` for `options`. `seeds` start the random streams anew."""
        simulation = self.simulation
        if seeds is not None:
            simulation.seed(rows, seeds)
        simulation.reset(rows, options)
        self.elapsed[rows] = 0
        self.last_action[rows] = 0.0
        self.reward[rows] = 0.0
        self.onboard.reset(simulation.prior, simulation.first, rows)
        start_score(
            self._score_, self._world_, self._first_truth_, self.onboard.estimate_, self._known_, simulation.pairs,
            self._work, rows,
        )  # fmt: skip
        copy_sample(simulation.first, 0, simulation.samples, -1, rows)
        self._observe(rows)

    def step(self, actions: NDArray[np.float64], rows: Rows) -> None:
        """Hold `actions` (N, R, 2) in [-1, 1] for one action in the environments `rows`."""
        simulation = self.simulation
        simulation.step(actions, rows)
        self.onboard.update(simulation.samples, rows)
        self.elapsed[rows] += 1
        self.last_action[rows] = np.clip(actions[rows], -1.0, 1.0)
        score_action(
            self._score_, self._world_, self._samples_, self._truth_, self.onboard.estimate_, self._known_,
            self.last_action, self._weights, self.reward, simulation.parameters, simulation.robots, simulation.pairs,
            self._work, rows,
        )  # fmt: skip
        self._observe(rows)

    def _observe(self, rows: Rows) -> None:
        world, onboard = self.simulation.world, self.onboard
        observe(
            self.observation, self._samples_, onboard.estimate_, onboard.memory_, world.collided, world.blocked,
            onboard.pairs, self.last_action, self.elapsed, self._limits, rows, self.bare,
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
        self.simulation.set_state(state["world"], rows)
        self.onboard.set_state(state["onboard"], rows)
        for key, part in (("samples", self.simulation.samples), ("score", self.score)):
            for name, value in part._asdict().items():
                value[rows] = state[key][name]
        for name in _EPISODE:
            getattr(self, name)[rows] = state["episode"][name]


_EPISODE = ("observation", "reward", "last_action", "elapsed")
