"""The environments of a training run, in the layout that the policy takes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from agents.layout import Layout
from agents.policy import Task
from relloc_env.envs.sb3 import RellocVecEnv
from relloc_env.envs.varied import VariedVecEnv
from relloc_env.extras import extra
from relloc_env.samples import Float32
from relloc_env.scenarios import SEEDS
from train.config import EnvironmentConfig

with extra("train"):
    from stable_baselines3.common.vec_env import VecEnvWrapper
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn


class Worlds(VecEnvWrapper):
    """Environments whose observations are in a policy's layout.

    Args:
        config: which.
        num_envs: environments; one row each, or decentralised one for each robot.
        threads: as for `RellocVecEnv`.

    Attributes:
        layout: of the observations.
    """

    def __init__(self, config: EnvironmentConfig, num_envs: int, threads: int | None = 1) -> None:
        self.config, self._num_envs = config, num_envs
        self._inner: RellocVecEnv | VariedVecEnv
        if config.varied:
            self._inner = VariedVecEnv(
                num_envs, config.shared, stages=config.stages, groups=min(config.groups, num_envs),
                decentralised=config.decentralised, staggered=config.random_phase,
            )  # fmt: skip
        else:
            self._inner = RellocVecEnv(
                num_envs, config.layout, decentralised=config.decentralised, threads=threads
            )  # fmt: skip
        self.layout = layout_of(config)
        self._fit = self.layout.fit(Task.of(self._inner.config))
        flat = spaces.Box(-np.inf, np.inf, (self.layout.size,), np.float32)
        space: Any = self._inner.observation_space if config.pictures else flat
        self._first_seed = 0
        self.clear()
        super().__init__(self._inner, observation_space=space)

    def clear(self) -> None:
        """Begin to add up rewards anew."""
        self._rewards, self._steps = 0.0, 0

    @property
    def episode_return(self) -> float:
        """Mean return of an episode, as the rewards since `clear` say; NaN where nothing was done."""
        return self._inner.config.max_cycles * self._rewards / self._steps if self._steps else float("nan")

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next `reset`: those of other runs are far away."""
        room = len(SEEDS["train"]) - self._num_envs
        self._first_seed = int(np.random.SeedSequence(seed).generate_state(1)[0] % room)
        return self._inner.seed(self._first_seed)

    def reset(self) -> Float32:
        """Start an episode everywhere, the first ones in mid-time where the configuration says so."""
        shown = self._inner.reset()
        if self.config.random_phase and isinstance(self._inner, RellocVecEnv):
            core = self._inner.core
            core.elapsed[:] = np.random.default_rng(self._first_seed).integers(
                0, core.config.max_cycles, len(core.elapsed)
            )
        return self._rows(shown)

    def step_wait(self) -> VecEnvStepReturn:
        """Hold the actions; what is over starts anew."""
        observations, rewards, over, infos = self._inner.step_wait()
        for n in np.flatnonzero(over).tolist():
            infos[n]["terminal_observation"] = self._rows(infos[n]["terminal_observation"])
            if self.config.finite:
                infos[n]["TimeLimit.truncated"] = False
        self._rewards += float(rewards.mean())
        self._steps += 1
        return self._rows(observations), rewards, over, infos

    def _rows(self, rows: Any) -> Float32:
        """Rows of the environments in the layout; pictures as they are."""
        if self.config.pictures:
            return rows  # type: ignore[no-any-return]
        robots = self.layout.robots if self.layout.joint else 1
        apart = rows.reshape(*rows.shape[:-1], robots, -1)
        return self._fit(apart).reshape(*rows.shape[:-1], self.layout.size)

    def get_state(self) -> Any:
        """Everything that the environments remember."""
        inner = self._inner
        return inner.get_state() if isinstance(inner, VariedVecEnv) else inner.core.get_state(inner.core.everyone)

    def set_state(self, state: Any) -> None:
        """Go on from what `get_state` gave, after a `reset`, bit for bit."""
        inner = self._inner
        if isinstance(inner, VariedVecEnv):
            inner.set_state(state)
        else:
            inner.core.set_state(state, inner.core.everyone)


def layout_of(config: EnvironmentConfig) -> Layout:
    """The observation that a policy for these environments takes."""
    return Layout.of(
        Task.of(config.layout),
        joint=config.robots > 1 and not config.decentralised,
        fewest=config.fewest,
        nearest_first=config.nearest_first,
        without=config.without,
    )
