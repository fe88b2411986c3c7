"""The PettingZoo door: each robot is an agent."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from relloc_env.config import EnvConfig, load_config
from relloc_env.envs.core import ROBOT_NAMES
from relloc_env.envs.door import (
    check_options,
    check_render_mode,
    check_state,
    frames_per_second,
    open_core,
    state_space,
    take_action,
)
from relloc_env.envs.fixed import Fixed
from relloc_env.envs.information import ENTRIES, Information
from relloc_env.envs.picture import Picture
from relloc_env.envs.spaces import robot_action_space, robot_form, robot_space
from relloc_env.samples import Float32
from relloc_env.simulation import check_seed

_ROW = np.zeros(1, np.int64)


class RellocParallelEnv(Fixed, ParallelEnv[str, Any, Any]):
    """Robots `robot_a` and `robot_b` act at once, each on what it sees and was told.

    Action of a robot: `Box(-1, 1, (2,), float32)`, speed and yaw rate as shares of its limits (and gains, with
    `action="motion+gains"`). Observation, rewards, ends and arguments as in `relloc_env.envs.centralised.RellocEnv`,
    robot by robot; `infos[robot]` holds the truth. `max_cycles` may be set, as PettingZoo's own tests do, and holds
    from the next `reset` on; other options cannot.
    """

    MAY_BE_SET = Fixed.MAY_BE_SET | {"max_cycles"}

    metadata = {  # noqa: RUF012 - the form PettingZoo asks for
        "render_modes": ["human", "rgb_array"],
        "name": "relloc_v0",
        "is_parallelizable": True,
        "render_fps": 4,
    }

    def __init__(
        self,
        config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
        *,
        render_mode: str | None = None,
        estimator: Any = "default",
        info: Sequence[str] = ENTRIES,
        **options: Any,
    ) -> None:
        self.core = open_core(config, 1, estimator, options)
        self.render_mode = check_render_mode(render_mode)
        self._picture = Picture(self.core, self.render_mode)
        self.metadata = {**self.metadata, "render_fps": frames_per_second(self.core)}
        self.possible_agents = list(ROBOT_NAMES[: self.core.config.robots])
        self.agents: list[str] = []
        self._started = False
        self._np_random: np.random.Generator | None = None
        space = robot_space(self.core.config)
        self.observation_spaces = dict.fromkeys(self.possible_agents, space)
        self.action_spaces = {agent: robot_action_space(self.core.config) for agent in self.possible_agents}
        self.state_space = state_space(self.core)
        self._information = Information(self.core, info)
        self._form = robot_form(self.core.config)
        self._horizon = self.core.config.max_cycles
        self._names = set(self.possible_agents)
        self._actions = np.zeros((1, self.core.config.robots, self.core.config.action_size))
        self._fix()

    @property
    def config(self) -> EnvConfig:
        """The configuration, complete."""
        return self.core.config

    @property
    def max_cycles(self) -> int:
        """Actions after which episodes are truncated, those that begin from now on."""
        return self._horizon

    @max_cycles.setter
    def max_cycles(self, value: int) -> None:
        self._horizon = load_config(self.config, max_cycles=value).max_cycles

    @property
    def field_slices(self) -> dict[str, slice]:
        """Where each named field is in a robot's flat observation."""
        return self.core.slices

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Space of a robot's observation, the same object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Space of a robot's action, the same object at each call."""
        return self.action_spaces[agent]

    def state(self) -> Float32:
        """The truth and every observation as one vector, for centralised critics.

        Raises:
            ResetNeeded: before the first `reset`.
        """
        if not self._started:
            raise ResetNeeded("Call `reset` before `state`: there is no episode yet")
        return self.core.state(0)

    @property
    def np_random(self) -> np.random.Generator:
        """For wrappers to draw from, seeded by `reset`; the environment itself draws from streams of its own."""
        if self._np_random is None:
            self._np_random, _ = seeding.np_random()
        return self._np_random

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode; arguments and errors as in `RellocEnv.reset`."""
        self.agents, self._started = [], False
        if self._horizon != self.core.config.max_cycles:
            self.core.set_horizon(self._horizon)
        self.core.reset(_ROW, None if seed is None else [check_seed(seed)], check_options(options))
        self.agents, self._started = self.possible_agents[:], True
        if seed is not None:
            self._np_random, _ = seeding.np_random(check_seed(seed))
        self._picture.follow(new=True)
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Hold one action [-] (A,) of each robot for `samples_per_action` samples.

        After the end of an episode no robot is left to act: then {} is taken, and five empty dictionaries returned.

        Raises:
            ResetNeeded: before the first `reset`, or after the end of an episode.
            ValueError: a missing or unknown robot, an action of another shape, or that is not finite.
        """
        agents, core = self.agents, self.core
        if not agents:
            if self._started and isinstance(actions, Mapping) and not actions:
                return {}, {}, {}, {}, {}
            raise ResetNeeded("Call `reset` before `step`: no episode is running")
        mapping = type(actions) is dict or isinstance(actions, Mapping)  # the former is what it nearly always is
        if not mapping or actions.keys() != self._names:
            given = sorted(map(str, actions)) if mapping else type(actions).__name__
            raise ValueError(f"Argument `actions` must have one action for each of {agents}, but has {given}")
        for agent, line in zip(agents, self._actions[0], strict=True):
            take_action(actions[agent], line, agent)
        core.step(self._actions, _ROW)
        terminated, truncated = core.terminated.item(0), core.truncated.item(0)
        result = (
            self._observations(),
            dict(zip(agents, core.reward[0].tolist(), strict=True)),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            self._infos(),
        )
        if terminated or truncated:
            self.agents = []
        self._picture.follow()
        return result

    def _observations(self) -> dict[str, Any]:
        form = self._form
        return {agent: form(line) for agent, line in zip(self.agents, self.core.observation[0].copy(), strict=True)}

    def _infos(self) -> dict[str, dict[str, Any]]:
        return dict(zip(self.agents, self._information.each(0), strict=True))

    def get_state(self) -> dict[str, Any]:
        """Everything the environment remembers, to be put back with `set_state`."""
        return {"core": self.core.get_state(_ROW), "agents": self.agents[:], "started": self._started}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from a state, bit for bit; as `RellocEnv.set_state`."""
        check_state("state", state, {"core": self.core.get_state(_ROW[:0]), "agents": None, "started": None}, 1)
        self.core.set_state(state["core"], _ROW)
        self.agents, self._started = list(state["agents"]), state["started"]
        self._picture.follow(new=True)

    def render(self) -> Any:
        """The picture of now: an RGB array (H, W, 3), or None for "human" (the window is drawn by reset and step)."""
        return self._picture.render()

    def close(self) -> None:
        """Close the window."""
        self._picture.close()


def parallel_env(
    config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
    *,
    render_mode: str | None = None,
    estimator: Any = "default",
    info: Sequence[str] = ENTRIES,
    **options: Any,
) -> RellocParallelEnv:
    """Build the PettingZoo Parallel environment; arguments as in `relloc_env.envs.centralised.RellocEnv`."""
    return RellocParallelEnv(config, render_mode=render_mode, estimator=estimator, info=info, **options)
