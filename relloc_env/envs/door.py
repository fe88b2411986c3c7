"""What the doors share: how a core is built from what the user gave, and how arguments are checked."""

import math
import numbers
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from relloc_env.config import ConfigError, EnvConfig, load_config
from relloc_env.envs.core import STATE_BOUND, Core
from relloc_env.envs.specification import take_horizon
from relloc_env.estimators.config import OwnConfig
from relloc_env.estimators.own import is_estimator
from relloc_env.estimators.protocol import Estimator
from relloc_env.quoting import quote
from relloc_env.samples import Float
from relloc_env.simulation import OPTIONS, check_seed, integer


def open_core(
    config: EnvConfig | Mapping[str, Any] | str | Path | None,
    num_envs: int,
    estimator: Any,
    options: Mapping[str, Any],
    threads: int | None = None,
) -> Core:
    """Build the core of a door; `estimator` "default" leaves the choice to the configuration."""
    if isinstance(num_envs, bool) or not isinstance(num_envs, numbers.Integral) or num_envs < 1:
        raise ConfigError(f"Argument `num_envs` must be a positive integer, but is {num_envs!r}")
    options = take_horizon(options)
    if isinstance(estimator, str) and estimator == "default":
        return _core(load_config(config, **options), num_envs, threads)
    if not is_estimator(estimator):
        known = estimator is None or isinstance(estimator, str | Mapping) or hasattr(estimator, "model_dump")
        if not (known or callable(estimator)):
            raise ConfigError(
                "Argument `estimator` must be a name, a configuration, a class or function that makes an estimator, "
                f"None, or follow `relloc_env.estimators.Estimator`, but is {type(estimator).__name__}"
            )
        return _core(load_config(config, **options, estimator=estimator), num_envs, threads)
    own: Estimator = estimator
    complete = load_config(config, **options)
    if complete.estimator is None:  # the observation is laid out for an estimator where the configuration names one
        complete = load_config(complete, estimator="cascade")
    return Core(complete, num_envs, own)


def _core(config: EnvConfig, num_envs: int, threads: int | None) -> Core:
    """A core whose estimator, if it is the user's own, is called from one thread alone: it may not stand several."""
    return Core(config, num_envs, threads=1 if isinstance(config.estimator, OwnConfig) else threads)


def check_render_mode(mode: str | None, known: tuple[str, ...] = ("human", "rgb_array")) -> str | None:
    """Return a render mode, or raise where there is none of that name."""
    if mode is not None and mode not in known:
        names = " or ".join(", ".join(["None", *map(repr, known)]).rsplit(", ", 1))
        raise ConfigError(f"Argument `render_mode` must be {names}, but is {mode!r}")
    return mode


def check_seeds(seed: Any, count: int) -> list[int | None]:
    """Return a seed for each of `count` environments, None to go on: of one integer it and the next ones."""
    if seed is None:
        return [None] * count
    if integer(seed) is not None:
        first = check_seed(seed)
        return [first + n for n in range(count)]
    several = isinstance(seed, Sequence) and not isinstance(seed, str | bytes)
    if not (several or (isinstance(seed, np.ndarray) and seed.ndim == 1)) or len(seed) != count:
        raise ValueError(f"Argument `seed` must be one integer or {count} of them, but is {quote(seed)}")
    return [None if each is None else check_seed(each) for each in seed]


def fresh_seeds(seed: Any, count: int) -> list[int]:
    """Return a seed for each of `count` environments, as `check_seeds`, but None draws from the operating system."""
    drawn = np.random.SeedSequence().generate_state(count, np.uint64).tolist()
    return [new if given is None else given for given, new in zip(check_seeds(seed, count), drawn, strict=True)]


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


_FLOATS = "efd"
"""Types of floats whose values are those of a double."""


def check_actions(name: str, action: Any, out: Float) -> None:
    """Write an action into `out`, or raise where it is not finite numbers of that shape; nothing else has happened.

    Integers and floats of any width will do, as arrays or lists; truth values, text, times, complex numbers, objects,
    records and masked arrays are none of an action's numbers.
    """
    plain = type(action) is np.ndarray and action.dtype.char in _FLOATS
    array = action if plain else _numbers(name, action, out.shape)
    if array.shape != out.shape:
        raise ValueError(f"Argument `{name}` must have shape {out.shape}, but has {array.shape}")
    out[...] = array
    if out.ndim == 1:
        if not all(map(math.isfinite, out.tolist())):
            raise ValueError(f"Argument `{name}` must be finite, but is {array.tolist()}")
    elif not np.isfinite(out).all():
        n = int(np.flatnonzero(~np.isfinite(out).all(axis=1))[0])
        raise ValueError(f"Argument `{name}` must be finite, but is {array[n].tolist()} in row {n}")


def take_action(action: Any, out: Float, agent: str) -> None:
    """`check_actions` of one robot, quick where all is well."""
    if type(action) is np.ndarray and action.shape == out.shape == (2,) and action.dtype.char in _FLOATS:
        v, w = action.tolist()
        if math.isfinite(v + w):
            out[0], out[1] = v, w
            return
    check_actions(f"actions[{agent!r}]", action, out)


def _numbers(name: str, action: Any, shape: tuple[int, ...]) -> Float:
    """An action of any other form as floats."""
    inside = action if isinstance(action, list | tuple) else ()
    masked = any(isinstance(part, np.ma.MaskedArray) for part in (action, *inside))
    try:
        array = np.asarray(action)
    except (TypeError, ValueError):  # lists of unlike lengths, arrays on other devices
        array = np.empty(0, np.object_)
    if masked or array.dtype.kind not in "iuf":
        form = f"an array of {array.dtype}" if isinstance(action, np.ndarray) else quote(action)
        given = "masked" if masked else form
        raise ValueError(f"Argument `{name}` must be numbers of shape {shape}, but is {given}")
    with np.errstate(over="ignore"):  # what is too large for a float becomes infinite, which is refused
        return array.astype(np.float64)


def check_state(name: str, state: Any, like: Any, count: int) -> None:
    """Raise where a state of `count` environments has not the form of `like`, a state of no environment.

    The form: the same names all the way down, arrays of the same types, and of the same shapes but for the first axis.
    """
    if isinstance(like, Mapping):
        if not isinstance(state, Mapping) or state.keys() != like.keys():
            given = sorted(map(str, state)) if isinstance(state, Mapping) else type(state).__name__
            raise ValueError(f"Argument `{name}` must have the entries {sorted(like)}, but has {given}")
        for key, part in like.items():
            check_state(f"{name}[{key!r}]", state[key], part, count)
    elif isinstance(like, np.ndarray):
        shape = (count, *like.shape[1:])
        if not isinstance(state, np.ndarray) or (state.shape, state.dtype) != (shape, like.dtype):
            given = f"{state.shape}, {state.dtype}" if isinstance(state, np.ndarray) else type(state).__name__
            raise ValueError(f"Argument `{name}` must be an array of {shape}, {like.dtype}, but is {given}")
