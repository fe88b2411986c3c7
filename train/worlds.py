"""The environments of a training run: several variants of a task side by side, as one `VecEnv`."""

from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from agents.layout import Layout
from agents.policy import Task
from relloc_env.envs.sb3 import RellocVecEnv, Row
from relloc_env.samples import Float32
from relloc_env.scenarios import SEEDS
from train.config import EnvironmentConfig


class Worlds(VecEnv):
    """Variants of a task, dealt out among the environments; their observations in one layout.

    Args:
        config: which.
        num_envs: environments; one row each, or decentralised one for each robot.
        threads: as for `RellocVecEnv`.

    Attributes:
        layout: of the observations.
        episode_return: mean return of an episode, as the rewards since `clear` say.
    """

    def __init__(self, config: EnvironmentConfig, num_envs: int, threads: int | None = 1) -> None:
        self.config = config
        count = len(config.configs)
        sizes = [num_envs // count + (k < num_envs % count) for k in range(count)]
        self.parts = [
            RellocVecEnv(n, each, decentralised=config.decentralised, threads=threads)
            for n, each in zip(sizes, config.configs, strict=True)
        ]
        self.layout = layout_of(config)
        self._fits = [self.layout.fit(Task.of(each)) for each in config.configs]
        self._ends = np.cumsum([part.num_envs for part in self.parts])
        self._first_seed = 0
        self.clear()
        seen = spaces.Box(-np.inf, np.inf, (self.layout.size,), np.float32)
        super().__init__(int(self._ends[-1]), seen, self.parts[0].action_space)

    def clear(self) -> None:
        """Begin to add up rewards anew."""
        self._rewards, self._steps = 0.0, 0

    @property
    def episode_return(self) -> float:
        """See above; NaN where nothing was done."""
        length = float(np.mean([config.max_cycles for config in self.config.configs]))
        return length * self._rewards / self._steps if self._steps else float("nan")

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next `reset`: runs of neighbouring seeds have no start in common."""
        total = sum(part.core.num_envs for part in self.parts)
        room = len(SEEDS["train"]) - total
        first = self._first_seed = int(np.random.SeedSequence(seed).generate_state(1)[0] % room)
        found: list[int | None] = []
        for part in self.parts:
            found += part.seed(first)
            first += part.core.num_envs
        return found

    def reset(self) -> Float32:
        """Start an episode everywhere, the first ones in mid-time where the configuration says so."""
        shown = [part.reset() for part in self.parts]
        if self.config.random_phase:
            stream = np.random.default_rng(self._first_seed)
            for part in self.parts:
                part.core.elapsed[:] = stream.integers(0, part.config.max_cycles, part.core.num_envs)
        return self._show(shown)

    def step_async(self, actions: Any) -> None:
        """Take in one action [-] per row."""
        self._actions = np.split(np.clip(actions, -1.0, 1.0), self._ends[:-1])
        for part, share in zip(self.parts, self._actions, strict=True):
            part.step_async(share)

    def step_wait(self) -> VecEnvStepReturn:
        """Hold the actions; what is over starts anew."""
        found = [self._step(k) for k in range(len(self.parts))]
        rewards = np.concatenate([each[1] for each in found])
        self._rewards += float(rewards.mean())
        self._steps += 1
        infos = [info for each in found for info in each[3]]
        return self._show([each[0] for each in found]), rewards, np.concatenate([each[2] for each in found]), infos

    def _step(self, k: int) -> VecEnvStepReturn:
        """Step one part, and make its rewards and ends those that are learned from."""
        part, config = self.parts[k], self.config
        elapsed, before = part.core.elapsed + 1, part.core.last_action.copy()
        observations, rewards, over, infos = part.step_wait()
        each = part.rows_each
        if config.change:
            change = np.abs(self._actions[k].reshape(before.shape) - before)
            change[elapsed == 1] = 0.0
            rewards -= np.float32(config.change) * change.reshape(len(rewards), -1).mean(axis=1).astype(np.float32)
        if config.silent:
            rewards[np.repeat(elapsed <= config.silent, each)] = 0.0
        for n in np.flatnonzero(over).tolist():
            infos[n]["terminal_observation"] = self._rows_of(k, infos[n]["terminal_observation"])
            if config.finite:
                infos[n]["TimeLimit.truncated"] = False
        return observations, rewards, over, infos

    def _rows_of(self, k: int, rows: Float32) -> Float32:
        """Rows of a part in the layout."""
        robots = self.layout.robots if self.layout.joint else 1
        apart = rows.reshape(*rows.shape[:-1], robots, -1)
        return self._fits[k](apart).reshape(*rows.shape[:-1], self.layout.size)

    def _show(self, shown: list[Any]) -> Float32:
        rows = [self._rows_of(k, each) for k, each in enumerate(shown)]
        return rows[0] if len(rows) == 1 else np.concatenate(rows)

    def get_state(self) -> list[Any]:
        """Everything that the environments remember."""
        return [part.core.get_state(part.core.everyone) for part in self.parts]

    def set_state(self, state: Sequence[Any]) -> None:
        """Go on from what `get_state` gave, after a `reset`, bit for bit."""
        for part, each in zip(self.parts, state, strict=True):
            part.core.observation = part.core.observation.copy()
            part.core.set_state(each, part.core.everyone)

    def _chosen(self, indices: VecEnvIndices) -> Iterator[Row]:
        for index in self._get_indices(indices):
            part = int(np.searchsorted(self._ends, index, side="right"))
            yield self.parts[part].row(int(index) - (int(self._ends[part - 1]) if part else 0))

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of some rows; see `relloc_env.envs.sb3.Row`."""
        if attr_name == "render_mode":  # asked for before there are rows
            return [None] * int(self._ends[-1])
        return [getattr(row, attr_name) for row in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of some rows."""
        for row in self._chosen(indices):
            setattr(row, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of some rows."""
        return [getattr(row, method_name)(*method_args, **method_kwargs) for row in self._chosen(indices)]

    def env_is_wrapped(
        self,
        wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]],  # noqa: ARG002 - Stable-Baselines3's form
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        """Whether rows are wrapped, one by one: they are not."""
        return [False for _ in self._get_indices(indices)]

    def close(self) -> None:
        """Let go of what the parts need."""
        for part in self.parts:
            part.close()


def layout_of(config: EnvironmentConfig) -> Layout:
    """The observation that a policy for these variants takes."""
    widest = max(config.configs, key=lambda each: each.targets)
    return Layout.of(
        Task.of(widest),
        joint=config.robots > 1 and not config.decentralised,
        fewest=min(each.targets for each in config.configs),
        nearest_first=config.nearest_first,
        without=config.without,
    )
