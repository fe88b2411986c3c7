"""The Stable-Baselines3 door: a batch as its `VecEnv`. Imported only by those who train with it."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded

from relloc_env.config import EnvConfig
from relloc_env.envs.door import (
    check_actions,
    check_options,
    check_render_mode,
    frames_per_second,
    open_core,
)
from relloc_env.envs.fixed import Fixed
from relloc_env.envs.information import Information
from relloc_env.envs.picture import Picture
from relloc_env.envs.row import Row
from relloc_env.envs.spaces import (
    joint_action_space,
    joint_form,
    joint_slices,
    joint_space,
    robot_action_space,
    robot_form,
    robot_space,
)
from relloc_env.extras import extra
from relloc_env.samples import Float32, Rows
from relloc_env.simulation import check_seed

with extra("train"):
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn


class RellocVecEnv(Fixed, VecEnv):
    """N environments for Stable-Baselines3: one row each, or one row for each robot.

    Centralised, a row is a `RellocEnv`: both robots' observations, one joint action, the mean reward. Decentralised, a
    row is a robot, row 2 n + r that of robot r of environment n, with its own observation, action and reward: one
    policy, its parameters shared by all robots. Either way an environment that is over starts anew at once; then its
    rows' infos hold `terminal_observation` and `TimeLimit.truncated`, from which algorithms bootstrap.

    Args:
        num_envs: number N of environments.
        config, estimator, options: as for `RellocEnv`.
        decentralised: whether each robot is a row.
        info: entries of `relloc_env.envs.information.ENTRIES` for every row's info, which is slow; () for none.
        render_mode: None or "rgb_array".
        threads: how many a large batch runs on, None for one a core; what comes out does not depend on it.

    Raises:
        ConfigError: an unknown option, or a value that cannot be.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
        *,
        decentralised: bool = False,
        info: Sequence[str] = (),
        estimator: Any = "default",
        render_mode: str | None = None,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        self.core = open_core(config, num_envs, estimator, options, threads)
        robots = self.core.config.robots
        self.decentralised = decentralised
        self.rows_each = robots if decentralised else 1
        self._mode = check_render_mode(render_mode, ("rgb_array",))
        self._form = robot_form(self.config) if decentralised else joint_form(self.config)
        self._information = Information(self.core, info)
        self._actions = np.zeros((num_envs, robots, self.config.action_size))
        self.rows: dict[int, Row] = {}
        self._ready = False
        self._pictures = [Picture(self.core, self._mode, n) for n in range(num_envs if self._mode else 0)]
        super().__init__(
            num_envs * self.rows_each,
            robot_space(self.config) if decentralised else joint_space(self.config),
            robot_action_space(self.config) if decentralised else joint_action_space(self.config),
        )
        self.metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": frames_per_second(self.core)}
        self._fix()

    @property
    def config(self) -> EnvConfig:
        """The configuration of all environments, complete."""
        return self.core.config

    @property
    def field_slices(self) -> dict[str, slice]:
        """Where each named field is in a flat row."""
        return self.core.slices if self.decentralised else joint_slices(self.config)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next `reset`: of environment 0, the others take the next ones; returns each row's.

        Raises:
            ValueError: what is no non-negative integer; None draws one.
        """
        first = super().seed(None if seed is None else check_seed(seed))[0]
        assert first is not None
        self._seeds = [first + row // self.rows_each for row in range(self.num_envs)]
        return self._seeds

    def reset(self) -> Any:
        """Start an episode in every environment, with the seeds and options that were set."""
        core = self.core
        self._ready = False
        core.observation = np.empty_like(core.observation)
        seeds = self._seeds[:: self.rows_each]
        for rows, options in self._grouped_options():
            seeded = [seed for seed in (seeds[n] for n in rows.tolist()) if seed is not None]
            core.reset(rows, seeded or None, check_options(options))
        self._reset_seeds()
        self._reset_options()
        self._ready = True
        self.reset_infos = self._infos(range(core.num_envs))
        for picture in self._pictures:
            picture.follow(new=True)
        return self._show(core.observation)

    def states(self) -> Float32:
        """The truth and every observation of each row's environment, one vector (rows, S) each, for central critics.

        Raises:
            ResetNeeded: before the first `reset`.
        """
        self._check_started("states")
        return np.repeat(self.core.states(), self.rows_each, axis=0)

    def state_of(self, index: int) -> Float32:
        """The state of environment `index`, as `states`."""
        self._check_started("state")
        return self.core.state(index)

    def _check_started(self, call: str) -> None:
        if not self._ready:
            raise ResetNeeded(f"Call `reset` before `{call}`: no episode is running")

    def _grouped_options(self) -> Iterator[tuple[Rows, Mapping[str, Any] | None]]:
        """Environments with the same options, and these; None where nothing was set."""
        groups: dict[int, list[int]] = {}
        given = self._options[:: self.rows_each]
        for n, options in enumerate(given):
            groups.setdefault(id(options) if options else 0, []).append(n)
        for members in groups.values():
            yield np.array(members, np.int64), given[members[0]] or None

    def step_async(self, actions: Any) -> None:
        """Take in one action [-] per row.

        Raises:
            ResetNeeded: before the first `reset`.
            ValueError: actions of another shape, or that are not finite.
        """
        self._check_started("step")
        check_actions("actions", actions, self._actions.reshape(self.num_envs, -1))

    def step_wait(self) -> VecEnvStepReturn:
        """Hold the actions for `samples_per_action` samples; what is over starts anew."""
        self._check_started("step")
        core = self.core
        core.observation = np.empty_like(core.observation)
        core.step(self._actions, core.everyone)
        reward = core.reward.reshape(-1) if self.decentralised else core.joint_reward
        rewards = reward.astype(np.float32)
        over = core.terminated | core.truncated
        infos = self._infos(range(core.num_envs))
        new = np.flatnonzero(over)
        if new.size:
            self._end(new, infos)
        for n, picture in enumerate(self._pictures):
            picture.follow(new=bool(over[n]))
        return self._show(core.observation), rewards, np.repeat(over, self.rows_each), infos

    def _end(self, new: Rows, infos: list[dict[str, Any]]) -> None:
        """Note how episodes ended in their rows' infos, and start the next ones."""
        core, each = self.core, self.rows_each
        last = self._lines(core.observation[new])
        timeouts = (core.truncated & ~core.terminated)[new].tolist()
        for i, n in enumerate(new.tolist()):
            for r in range(each):
                info = infos[n * each + r]
                info["TimeLimit.truncated"] = timeouts[i]
                info["terminal_observation"] = self._form(last[i * each + r])
        self._ready = False
        core.reset(new)
        self._ready = True
        if self._information.entries:
            fresh = self._infos(new.tolist())
            for i, n in enumerate(new.tolist()):
                self.reset_infos[n * each : (n + 1) * each] = fresh[i * each : (i + 1) * each]

    def _lines(self, block: Float32) -> Float32:
        """Observations (N, R, ...) as one per row, in the axes that `_form` wants."""
        return block.reshape(-1, *block.shape[2:]) if self.decentralised else block

    def _show(self, block: Float32) -> Any:
        return self._form(self._lines(block))

    def _infos(self, environments: Sequence[int]) -> list[dict[str, Any]]:
        """The rows' infos of some environments, with what was asked for."""
        if not self._information.entries:
            return [{} for _ in range(len(environments) * self.rows_each)]
        if self.decentralised:
            return [info for n in environments for info in self._information.each(n)]
        return [self._information.one(n) for n in environments]

    def row(self, index: int) -> Row:
        """One row as an object: what `get_attr`, `set_attr` and `env_method` work on."""
        if index not in self.rows:
            self.rows[index] = Row(self, *divmod(range(self.num_envs)[index], self.rows_each))
        return self.rows[index]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of some rows; see `Row`."""
        if attr_name == "render_mode":  # asked for before there are rows
            return [self._mode] * (
                self.core.num_envs * self.rows_each if indices is None else len(self._chosen(indices))
            )
        return [getattr(row, attr_name) for row in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of a name of the caller's own on some rows.

        Raises:
            AttributeError: an option or a part of the environments: these are fixed when they are made.
        """
        for row in self._chosen(indices):
            setattr(row, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of some rows; see `Row`."""
        return [getattr(row, method_name)(*method_args, **method_kwargs) for row in self._chosen(indices)]

    def env_is_wrapped(
        self,
        wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]],  # noqa: ARG002 - Stable-Baselines3's form
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        """Whether rows are wrapped, one by one: they are not."""
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices: VecEnvIndices) -> list[Row]:
        return [self.row(int(index)) for index in self._get_indices(indices)]

    def get_images(self) -> Sequence[Any]:
        """The pictures of now, one RGB array (H, W, 3) per environment."""
        return [picture.render() for picture in self._pictures]

    def render_row(self, index: int) -> Any:
        """The picture of an environment, an RGB array (H, W, 3); None without a `render_mode`."""
        return self._pictures[index].render() if self._pictures else None

    def carry_over(self, rows: Mapping[int, Row]) -> None:
        """Give rows what callers had set on those that had their indices in another environment."""
        for index, row in rows.items():
            for name, value in row.own.items():
                setattr(self.row(index), name, value)

    def close(self) -> None:
        """Let go of what pictures need."""
        for picture in self._pictures:
            picture.close()
