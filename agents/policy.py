"""What a policy is: observations in, actions out, for any number of environments at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.envs.observation import slices
from relloc_env.envs.onboard import POINT
from relloc_env.samples import Float, Float32

SEEN, IMAGE_X, IMAGE_Y, SINE, COSINE, ELEVATION, INVERSE_RANGE, LOG_SD = range(POINT)
"""Places within a point of the field `points`."""


class Policy(Protocol):
    """A way to move N environments of one task.

    It is built with a `Task`. An episode may start at any call: a row whose field `progress` is 0 begins anew.
    """

    def reset(self, n: int, seed: int) -> None:
        """Make ready for `n` environments; `seed` starts whatever is random."""
        ...

    def act(self, observations: Float32) -> Float:
        """Choose actions.

        Args:
            observations: [-] (N, R, D) one flat row per robot, in whose fields `Task.slices` finds its way.

        Returns:
            [-] (N, R, 2) speed and yaw rate as shares of each robot's limits, in [-1, 1].
        """
        ...


@dataclass(frozen=True)
class Task:
    """What a robot knows of itself and of its observation: the same for all N environments."""

    config: EnvConfig
    slices: Mapping[str, slice]
    """Where each named field is in a robot's row."""

    @classmethod
    def of(cls, env: Any) -> "Task":
        """Task of an environment, through any of its doors, with or without wrappers; or of a configuration."""
        config = env if isinstance(env, EnvConfig) else env.unwrapped.config
        if config.observation == "dict":
            raise ValueError('Argument `env` must have `observation="flat"` or "image" for a policy, but has "dict"')
        return cls(config, slices(config))

    @property
    def robots(self) -> int:
        """Number R of robots."""
        return self.config.robots

    @property
    def targets(self) -> int:
        """Number M of points."""
        return self.config.targets

    @property
    def size(self) -> int:
        """Numbers in a robot's row."""
        return max(int(part.stop) for part in self.slices.values())

    @property
    def action_period(self) -> float:
        """Time that an action is held [s]."""
        return self.config.samples_per_action * self.config.sample_period

    @property
    def limits(self) -> Float:
        """Greatest speed and yaw rate of each robot, [m/s, rad/s] (R, 2)."""
        robots = [self.config.robot_of(r) for r in range(self.robots)]
        return np.array([(robot.max_speed, robot.max_yaw_rate) for robot in robots])

    @property
    def half_view(self) -> Float:
        """Half the horizontal field of view of each camera, [rad] (R,)."""
        return np.array([self.config.camera_of(r).half_view for r in range(self.robots)])

    @property
    def half_height(self) -> Float:
        """Half the height of each camera's normalised image, [-] (R,); infinite for an image without borders."""
        cameras = [self.config.camera_of(r) for r in range(self.robots)]
        return np.array([0.5 * c.height / c.focal_length if c.limited else np.inf for c in cameras])

    def field(self, observations: Float32, name: str) -> Float:
        """One named field of all rows, (N, R, size) in float64."""
        if name not in self.slices:
            raise ValueError(f"The observation must have the field `{name}`, but has {', '.join(self.slices)}")
        return observations[..., self.slices[name]].astype(np.float64)

    def time(self, observations: Float32) -> Float:
        """Time since the start of each environment's episode, [s] (N,)."""
        share = self.field(observations, "progress")[:, 0, 0]
        return np.rint(share * self.config.max_cycles) * self.action_period

    def rows(self, observations: Any) -> Float32:
        """What a door gives as rows (N, R, D): {robot: row} of PettingZoo, or joint arrays (..., R D) of Gymnasium."""
        if isinstance(observations, Mapping):
            observations = np.stack(list(observations.values()))
        array: Float32 = np.asarray(observations, np.float32).reshape(-1, self.robots, self.size)
        return array

    def shares(self, speed: Float, yaw_rate: Float) -> Float:
        """Actions (N, R, 2) for speeds [m/s] and yaw rates [rad/s] (N, R), cut at the limits."""
        return np.clip(np.stack([speed, yaw_rate], axis=-1) / self.limits, -1.0, 1.0)
