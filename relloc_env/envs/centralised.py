"""The Gymnasium door: one agent that sees what all robots see and drives them all."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from relloc_env.config import EnvConfig
from relloc_env.envs.door import (
    check_actions,
    check_options,
    check_render_mode,
    check_state,
    frames_per_second,
    open_core,
    state_space,
)
from relloc_env.envs.fixed import Fixed
from relloc_env.envs.information import ENTRIES, Information
from relloc_env.envs.picture import Picture
from relloc_env.envs.spaces import joint_action_space, joint_form, joint_slices, joint_space
from relloc_env.envs.specification import specify
from relloc_env.samples import Float32
from relloc_env.simulation import check_seed

_ROW = np.zeros(1, np.int64)


class RellocEnv(Fixed, gym.Env[Any, Any]):
    """Robots watch static points with their cameras; how they move decides what can be known.

    ## Action space
    `Box(-1, 1, (2 R,), float32)`: speed and yaw rate of each robot as shares of its limits, robot A first. An action is
    held for `samples_per_action` samples. With `action="motion+gains"` the gains of a robot's depth observers follow
    its speed and yaw rate.

    ## Observation space
    A flat float32 `Box`: the fields of robot A, then of robot B; `field_slices` says where each is. With
    `observation="dict"` a flat `Dict` of the same fields. Fields: `relloc_env.envs.observation.fields`.

    ## Rewards
    The mean over the robots of a weighted sum of terms (`relloc_env.rewards.TERMS`); by default information gained,
    3 times the increment of J, less 0.02 for the share of blocked samples. Every term is in `info` as `reward/<name>`.

    ## Starting state
    Drawn as `start` says, or fixed by `poses` and `points` in the configuration or in the options of `reset`.

    ## Episode end
    Truncated after `max_cycles` actions; terminated where `terminate_on_collision` or `terminate_on_success` ask so.

    ## Arguments
    Any option of `relloc_env.config.EnvConfig` as a keyword; `config` takes a mapping, a YAML or JSON file, or the name
    of a scenario; `estimator` a name, a configuration, None (bare), your own as a class, a function or its place
    (`relloc_env.estimators.OwnConfig`), or an object that follows `relloc_env.estimators.Estimator`; `render_mode` is
    None, "rgb_array" or "human"; `info` names the entries of `info` that are wanted
    (`relloc_env.envs.information.ENTRIES`), all by default.

    Raises:
        ConfigError: an unknown option, or a value that cannot be.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 4}  # noqa: RUF012 - the form Gymnasium asks for

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
        self.observation_space = joint_space(self.core.config)
        self.action_space = joint_action_space(self.core.config)
        self._form = joint_form(self.core.config)
        self._action = np.zeros((self.core.config.robots, self.core.config.action_size))
        self._running = self._started = False
        self._information = Information(self.core, info)
        self._spec: EnvSpec | None = None
        self._fix()

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an attribute from a wrapper; what cannot be set here is not set on the wrapper either."""
        return super().set_wrapper_attr(name, value, force=force or name in self._fixed)

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium made this; its `max_episode_steps` is the configuration's, so that wrappers know it."""
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        self._spec = specify(value, self.config)

    @property
    def config(self) -> EnvConfig:
        """The configuration, complete."""
        return self.core.config

    @property
    def field_slices(self) -> dict[str, slice]:
        """Where each named field is in the flat observation."""
        return joint_slices(self.config)

    @property
    def state_space(self) -> spaces.Box:
        """Space of `state()`."""
        return state_space(self.core)

    def state(self) -> Float32:
        """The truth and every observation as one vector, for centralised critics.

        Raises:
            ResetNeeded: before the first `reset`.
        """
        if not self._started:
            raise ResetNeeded("Call `reset` before `state`: there is no episode yet")
        return self.core.state(0)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: starts all random streams anew; None goes on with them.
            options: `poses` [m, m, rad] (R, 3) and `points` [m] (M, 3) fix the start, from now on; {} draws it again.

        Raises:
            ValueError: a seed that is not a non-negative integer.
            ConfigError: options that cannot be.
        """
        super().reset(seed=None if seed is None else check_seed(seed))
        self._running = self._started = False
        self.core.reset(_ROW, None if seed is None else [check_seed(seed)], check_options(options))
        self._running = self._started = True
        self._picture.follow(new=True)
        return self._form(self.core.observation[0].copy()), self._information.one(0)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold an action [-] (R A,) for `samples_per_action` samples.

        Raises:
            ResetNeeded: before the first `reset`, or after the end of an episode.
            ValueError: an action of another shape, or that is not finite.
        """
        if not self._running:
            raise ResetNeeded("Call `reset` before `step`: no episode is running")
        core = self.core
        check_actions("action", action, self._action.reshape(-1))
        core.step(self._action[None], _ROW)
        terminated, truncated = core.terminated.item(0), core.truncated.item(0)
        self._running = not (terminated or truncated)
        self._picture.follow()
        observation = self._form(core.observation[0].copy())
        return observation, core.joint_reward.item(0), terminated, truncated, self._information.one(0)

    def get_state(self) -> dict[str, Any]:
        """Everything the environment remembers, to be put back with `set_state`."""
        return {"core": self.core.get_state(_ROW), "running": self._running, "started": self._started}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from a state of an environment of the same configuration, bit for bit.

        Raises:
            ValueError: what no environment of this configuration gave.
        """
        check_state("state", state, {"core": self.core.get_state(_ROW[:0]), "running": None, "started": None}, 1)
        self.core.set_state(state["core"], _ROW)
        self._running, self._started = state["running"], state["started"]
        self._picture.follow(new=True)

    def render(self) -> Any:
        """The picture of now: an RGB array (H, W, 3), or None for "human" (the window is drawn by reset and step)."""
        return self._picture.render()

    def close(self) -> None:
        """Close the window."""
        self._picture.close()
