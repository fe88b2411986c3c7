"""One row of a `VecEnv` of Stable-Baselines3: what `get_attr`, `set_attr` and `env_method` work on."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec

from relloc_env.config import TASKS
from relloc_env.envs.core import ROBOT_NAMES
from relloc_env.envs.door import check_state
from relloc_env.envs.fixed import Fixed
from relloc_env.samples import Float32

if TYPE_CHECKING:
    from relloc_env.envs.sb3 import RellocVecEnv


class Row(Fixed):
    """One row of a `RellocVecEnv`: an environment, or a robot of it.

    Attributes:
        index: of the environment.
        robot: name of the robot; None where a row is a whole environment.
        config, field_slices, observation_space, action_space, metadata, render_mode: as of the `RellocVecEnv`.
    """

    MAY_BE_SET = frozenset[str]()

    def __init__(self, env: "RellocVecEnv", index: int, robot: int) -> None:
        self._env = env
        self.index = index
        self.robot = ROBOT_NAMES[robot] if env.decentralised else None
        self.config, self.field_slices = env.config, env.field_slices
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self.metadata, self.render_mode = env.metadata, env.render_mode
        self._fix()

    @property
    def unwrapped(self) -> "Row":
        """The row itself."""
        return self

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium makes such an environment; None where a row is a robot."""
        if self.robot is not None:
            return None
        name = {count: name for name, count in TASKS.items()}[self.config.robots]
        options = {"config": self.config.to_dict()}
        return replace(gym.spec(name), max_episode_steps=self.config.max_cycles, kwargs=options)

    def refusal(self, name: str) -> str:
        """As of the whole `RellocVecEnv`."""
        return self._env.refusal(name)

    @property
    def own(self) -> dict[str, Any]:
        """What callers have set."""
        return {name: value for name, value in vars(self).items() if not (name in self._fixed or name.startswith("_"))}

    def render(self) -> Any:
        """The picture of the environment, an RGB array (H, W, 3); None without a `render_mode`."""
        return self._env.render_row(self.index)

    def state(self) -> Float32:
        """The truth and every observation of the environment as one vector, for centralised critics."""
        return self._env.state_of(self.index)

    def get_state(self) -> dict[str, Any]:
        """Everything the environment remembers, to be put back with `set_state`."""
        return self._env.core.get_state(np.array([self.index]))

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from a state of an environment of the same configuration, bit for bit.

        Raises:
            ValueError: what no environment of this configuration gave.
        """
        core = self._env.core
        check_state("state", state, core.get_state(np.zeros(0, np.int64)), 1)
        core.observation = core.observation.copy()
        core.set_state(state, np.array([self.index]))
