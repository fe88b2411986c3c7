"""Stable-Baselines3's `VecEnv` over configurations that differ: curricula, and options drawn at random."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from relloc_env.config import ConfigError, EnvConfig, load_config
from relloc_env.envs.door import check_actions, check_render_mode
from relloc_env.envs.fixed import Fixed
from relloc_env.envs.observation import places, slices
from relloc_env.envs.row import Row
from relloc_env.envs.sb3 import RellocVecEnv
from relloc_env.envs.spaces import joint_action_space, joint_slices, joint_space, robot_action_space, robot_space
from relloc_env.envs.specification import take_horizon
from relloc_env.envs.variation import Stage, Variation
from relloc_env.extras import extra
from relloc_env.samples import Float32
from relloc_env.simulation import check_seed

with extra("train"):
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn


class VariedVecEnv(Fixed, VecEnv):
    """N environments in K groups, each group a `RellocVecEnv` of a configuration of its own.

    A group has a life of `max_cycles` actions: one whole episode of each of its environments, where nothing ends
    episodes early. Then its next configuration is drawn, from the stage that is on, and all its environments start anew
    (those in mid-episode are truncated). What is drawn depends on the seed of the group's first environment and on how
    many lives came before. Random streams of the environments go on from life to life.

    Rows, infos and ends are those of `RellocVecEnv`. Where configurations differ in the number of targets, observations
    and actions are laid out for the greatest: the others' points read as points that were never seen, and what an
    action would do with them is left.

    Args:
        num_envs: number N of environments.
        config, options: as for `RellocEnv`: what all configurations have in common.
        stages: of the curriculum (`relloc_env.envs.variation.Stage`), as objects or plain data.
        groups: number K of groups.
        decentralised: whether each robot is a row.
        staggered: whether the first lives of the groups end one after the other: they begin as if some time had passed.
        info: entries of `relloc_env.envs.information.ENTRIES` for every row's info, which is slow; () for none.
        render_mode: None or "rgb_array".

    Attributes:
        timesteps: rows that were stepped so far, as Stable-Baselines3 counts; set it to go on elsewhere in a
            curriculum.

    Raises:
        ConfigError: an unknown option, or a value that cannot be.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
        *,
        stages: Sequence[Stage | Mapping[str, Any]] = ({},),
        groups: int = 8,
        decentralised: bool = False,
        staggered: bool = False,
        info: Sequence[str] = (),
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if not 1 <= groups <= num_envs:
            raise ConfigError(f"Argument `groups` must be from 1 to `num_envs` ({num_envs}), but is {groups!r}")
        self.variation = Variation(load_config(config, **take_horizon(options)), stages)
        layout = self.config
        if layout.observation != "flat":
            raise ConfigError(f'Argument `observation` must be "flat" here, but is {layout.observation!r}')
        self.decentralised, self.staggered, self.timesteps = decentralised, staggered, 0
        self.rows_each = layout.robots if decentralised else 1
        self._mode = check_render_mode(render_mode, ("rgb_array",))
        self._options_of_groups = {"decentralised": decentralised, "info": info, "render_mode": render_mode}
        firsts = np.linspace(0, num_envs, groups + 1).astype(int).tolist()
        self._groups = [
            _Group(self.variation, k, first, last - first, self._options_of_groups)
            for k, (first, last) in enumerate(itertools.pairwise(firsts))
        ]
        super().__init__(
            num_envs * self.rows_each,
            robot_space(layout) if decentralised else joint_space(layout),
            robot_action_space(layout) if decentralised else joint_action_space(layout),
        )
        assert self.action_space.shape is not None
        self._actions = np.zeros((self.num_envs, *self.action_space.shape))
        self.metadata = self._groups[0].env.metadata
        self._fix()

    @property
    def config(self) -> EnvConfig:
        """The configuration that observations and actions are laid out for: that of the first stage, most targets."""
        return self.variation.layout

    @property
    def configs(self) -> list[EnvConfig]:
        """The configuration of each group now."""
        return [group.env.config for group in self._groups]

    @property
    def stage(self) -> int:
        """Index of the stage that the next lives are drawn from."""
        return self.variation.curriculum.at(self.timesteps)

    @property
    def field_slices(self) -> dict[str, slice]:
        """Where each named field is in a row."""
        return slices(self.config) if self.decentralised else joint_slices(self.config)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next `reset`; as `RellocVecEnv.seed`."""
        first = super().seed(None if seed is None else check_seed(seed))[0]
        assert first is not None
        self._seeds = [first + row // self.rows_each for row in range(self.num_envs)]
        return self._seeds

    def reset(self) -> Float32:
        """Draw a configuration for every group, and start its episodes.

        Raises:
            ConfigError: where options were set.
        """
        if any(self._options):
            raise ConfigError("Options of resets cannot be set here: state them in `stages`")
        seeds = self._seeds[:: self.rows_each]
        lines = [self._show(group, group.begin(self.stage, seeds[group.first])) for group in self._groups]
        if self.staggered:
            for k, group in enumerate(self._groups):
                group.age = k * group.env.config.max_cycles // len(self._groups)
                group.env.core.elapsed[:] = group.age
        self.reset_infos = [info for group in self._groups for info in group.env.reset_infos]
        self._reset_seeds()
        return np.concatenate(lines)

    def step_async(self, actions: Any) -> None:
        """Take in one action [-] per row.

        Raises:
            ValueError: actions of another shape, or that are not finite.
        """
        check_actions("actions", actions, self._actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Hold the actions; groups whose life is over start another."""
        self.timesteps += self.num_envs
        lines, rewards, ends, infos = [], [], [], []
        for group in self._groups:
            line, reward, end, info = group.env.step(group.actions(self._actions, self.config))
            for row in np.flatnonzero(end).tolist():
                info[row]["terminal_observation"] = self._show(group, info[row]["terminal_observation"][None])[0]
            line = self._show(group, line)
            group.age += 1
            if group.age >= group.env.config.max_cycles:
                for row in np.flatnonzero(~end).tolist():
                    info[row] |= {"TimeLimit.truncated": True, "terminal_observation": line[row]}
                end = np.ones_like(end)
                line = self._show(group, group.begin(self.stage, None))
                first = group.first * self.rows_each
                self.reset_infos[first : first + len(end)] = group.env.reset_infos
            lines.append(line)
            rewards.append(reward)
            ends.append(end)
            infos += info
        return np.concatenate(lines), np.concatenate(rewards), np.concatenate(ends), infos

    def _show(self, group: "_Group", rows: Any) -> Float32:
        """A group's rows as they are laid out for most targets."""
        if group.env.config.targets == self.config.targets:
            return rows  # type: ignore[no-any-return]
        robots = 1 if self.decentralised else self.config.robots
        wide = np.zeros((len(rows), robots, self.observation_space.shape[0] // robots), np.float32)  # type: ignore[index]
        wide[..., places(group.env.config, self.config.targets)] = rows.reshape(len(rows), robots, -1)
        return wide.reshape(len(rows), -1)

    def get_state(self) -> dict[str, Any]:
        """Everything that is remembered, to be put back with `set_state`."""
        return {"timesteps": self.timesteps, "groups": [group.get_state() for group in self._groups]}

    def set_state(self, state: Mapping[str, Any]) -> Float32:
        """Go on from a state of an environment that was built alike, bit for bit; returns what rows show.

        Raises:
            ValueError: a state of another number of groups.
        """
        if len(state["groups"]) != len(self._groups):
            raise ValueError(f"Argument `state` must have {len(self._groups)} groups, but has {len(state['groups'])}")
        self.timesteps = state["timesteps"]
        lines = [
            self._show(group, group.set_state(part)) for group, part in zip(self._groups, state["groups"], strict=True)
        ]
        return np.concatenate(lines)

    def row(self, index: int) -> Row:
        """One row as an object, until the life of its group is over."""
        index = range(self.num_envs)[index]
        group = next(each for each in reversed(self._groups) if each.first * self.rows_each <= index)
        return group.env.row(index - group.first * self.rows_each)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of some rows; see `relloc_env.envs.row.Row`."""
        if attr_name == "render_mode":  # asked for before there are rows
            count = sum(group.count for group in self._groups) * self.rows_each
            return [self._mode] * (count if indices is None else len(list(self._get_indices(indices))))
        return [getattr(self.row(int(index)), attr_name) for index in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of a name of the caller's own on some rows; errors as of `RellocVecEnv.set_attr`."""
        for index in self._get_indices(indices):
            setattr(self.row(int(index)), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of some rows; see `relloc_env.envs.row.Row`."""
        rows = [self.row(int(index)) for index in self._get_indices(indices)]
        return [getattr(row, method_name)(*method_args, **method_kwargs) for row in rows]

    def env_is_wrapped(
        self,
        wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]],  # noqa: ARG002 - Stable-Baselines3's form
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        """Whether rows are wrapped, one by one: they are not."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[Any]:
        """The pictures of now, one RGB array (H, W, 3) per environment."""
        return [picture for group in self._groups for picture in group.env.get_images()]

    def close(self) -> None:
        """Let go of the groups."""
        for group in self._groups:
            group.env.close()


class _Group:
    """Some environments of one configuration, life after life.

    Attributes:
        first, count: which of all environments they are.
        env: the group in its present life.
        age: actions in this life.
    """

    def __init__(self, variation: Variation, index: int, first: int, count: int, options: Mapping[str, Any]) -> None:
        self.first, self.count, self.age = first, count, 0
        self._variation, self._index, self._options = variation, index, options
        self._seed, self._lives = int(np.random.SeedSequence().generate_state(1)[0]), 0
        self.env = self._open(0)

    def _open(self, stage: int) -> RellocVecEnv:
        """Draw the next configuration."""
        rng = np.random.default_rng((self._seed, self._lives))
        self._lives += 1
        return RellocVecEnv(self.count, self._variation.draw(stage, self._index, rng), **self._options)

    def begin(self, stage: int, seed: int | None) -> Any:
        """Start a life in a stage, where `seed` is given with new streams; returns what is seen."""
        streams = self.env.core.simulation.world.streams
        if seed is not None:
            self._seed, self._lives = seed, 0
        last = self.env
        last.close()
        self.env, self.age = self._open(stage), 0
        self.env.carry_over(last.rows)
        if seed is None:
            self.env.core.simulation.world.streams[:] = streams
        else:
            self.env.seed(seed)
        return self.env.reset()

    def actions(self, actions: Any, layout: EnvConfig) -> Any:
        """What is this group's of the actions of all rows (N rows, A)."""
        each, config = self.env.rows_each, self.env.config
        rows = actions[self.first * each : (self.first + self.count) * each]
        if config.action_size == layout.action_size:
            return rows
        return rows.reshape(len(rows), -1, layout.action_size)[..., : config.action_size].reshape(len(rows), -1)

    def get_state(self) -> dict[str, Any]:
        """Everything that is remembered."""
        core = self.env.core
        return {
            "seed": self._seed,
            "lives": self._lives,
            "age": self.age,
            "config": core.config.to_dict(),
            "core": core.get_state(core.everyone),
        }

    def set_state(self, state: Mapping[str, Any]) -> Any:
        """Put back what `get_state` gave; returns what is seen."""
        self._seed, self._lives, self.age = state["seed"], state["lives"], state["age"]
        last = self.env
        last.close()
        self.env = RellocVecEnv(self.count, load_config(state["config"]), **self._options)
        self.env.carry_over(last.rows)
        self.env.reset()
        core = self.env.core
        core.set_state(state["core"], core.everyone)
        block = core.observation.copy()
        return block.reshape(-1, block.shape[-1]) if self.env.decentralised else block.reshape(self.count, -1)
