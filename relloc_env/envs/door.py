"""What the doors share: how a core is built from what the user gave, and how arguments are checked."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from relloc_env.config import ConfigError, EnvConfig, load_config
from relloc_env.envs.core import Core
from relloc_env.estimators.protocol import Estimator
from relloc_env.samples import Float
from relloc_env.simulation import OPTIONS

STATE_BOUND = 1000.0
"""Bound of every entry of `state()` [m, rad, -]."""


def open_core(
    config: EnvConfig | Mapping[str, Any] | str | Path | None,
    num_envs: int,
    estimator: Any,
    options: Mapping[str, Any],
) -> Core:
    """Build the core of a door; `estimator` "default" leaves the choice to the configuration."""
    if isinstance(estimator, str) and estimator == "default":
        return Core(load_config(config, **options), num_envs)
    if estimator is None or isinstance(estimator, str | Mapping) or hasattr(estimator, "model_dump"):
        return Core(load_config(config, **options, estimator=estimator), num_envs)
    if not all(hasattr(estimator, name) for name in ("reset", "update", "estimate")):
        raise ConfigError(
            "Argument `estimator` must be a name, a configuration, None, or follow `relloc_env.estimators.Estimator`, "
            f"but is {type(estimator).__name__}"
        )
    own: Estimator = estimator
    complete = load_config(config, **options)
    if complete.estimator is None:  # the observation is laid out for an estimator where the configuration names one
        complete = load_config(complete, estimator="cascade")
    return Core(complete, num_envs, own)


def check_render_mode(mode: str | None) -> str | None:
    """Return a render mode, or raise where there is none of that name."""
    if mode not in (None, "human", "rgb_array"):
        raise ConfigError(f"Argument `render_mode` must be None, 'human' or 'rgb_array', but is {mode!r}")
    return mode


def frames_per_second(core: Core) -> int:
    """Rate of frames (one an action) at which a recording runs in real time."""
    return max(1, round(core.config.sample_rate / core.config.samples_per_action))


def state_space(core: Core) -> spaces.Box:
    """Space of the state for centralised critics."""
    return spaces.Box(-STATE_BOUND, STATE_BOUND, (core.state_size,), np.float32)


def check_options(options: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the options of a reset that are ours; others are named in a warning, since wrappers pass theirs on."""
    if options is None:
        return None
    if not isinstance(options, Mapping):
        raise ConfigError(f"Argument `options` must be a mapping, but is {type(options).__name__}")
    unknown = [name for name in options if name not in OPTIONS]
    if unknown:
        gym.logger.warn(
            f"Unknown options of reset, ignored: {', '.join(map(str, unknown))}; known: {', '.join(OPTIONS)}"
        )
    ours = {name: value for name, value in options.items() if name in OPTIONS}
    return ours if ours or not options else None


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


def check_state(name: str, state: Any, like: Any) -> None:
    """Raise where a state has not the form of `like`: the same names all the way down, the same shapes and types."""
    if isinstance(like, Mapping):
        if not isinstance(state, Mapping) or state.keys() != like.keys():
            given = sorted(map(str, state)) if isinstance(state, Mapping) else type(state).__name__
            raise ValueError(f"Argument `{name}` must have the entries {sorted(like)}, but has {given}")
        for key, part in like.items():
            check_state(f"{name}[{key!r}]", state[key], part)
    elif isinstance(like, np.ndarray) and (
        not isinstance(state, np.ndarray) or (state.shape, state.dtype) != (like.shape, like.dtype)
    ):
        given = f"{state.shape}, {state.dtype}" if isinstance(state, np.ndarray) else type(state).__name__
        raise ValueError(f"Argument `{name}` must be an array of {like.shape}, {like.dtype}, but is {given}")
