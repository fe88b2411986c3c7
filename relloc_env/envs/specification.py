"""What Gymnasium notes of how an environment was made, so that it can be made again with other options."""

from collections.abc import Mapping
from dataclasses import fields, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from relloc_env.config import ConfigError, EnvConfig


class Horizon(int):
    """Length [actions] of episodes that an environment ends by itself, as its specification tells it.

    Gymnasium puts a `TimeLimit` of this number around what it makes of the specification, with whatever other options.
    No count of steps reaches it, so that the horizon of those options holds.
    """

    def __le__(self, other: object) -> bool:  # also `other >= self`, which is what a `TimeLimit` asks
        return False


class Specification(EnvSpec):
    """A specification whose `max_episode_steps` is the shorter of the environment's horizon and of a `TimeLimit`."""

    @property
    def max_episode_steps(self) -> int | None:
        """Length of an episode [actions]."""
        return self._steps

    @max_episode_steps.setter
    def max_episode_steps(self, value: int | None) -> None:
        known: int | None = getattr(self, "_steps", None)
        if known is None or (value is not None and not isinstance(value, Horizon) and value < known):
            self._steps = value

    def to_json(self) -> str:
        """The specification as text; the environment's own horizon follows from the options."""
        plain = EnvSpec(**{f.name: getattr(self, f.name) for f in fields(self) if f.init})
        if isinstance(plain.max_episode_steps, Horizon):
            plain = replace(plain, max_episode_steps=None)
        return plain.to_json()


def specify(value: EnvSpec | None, config: EnvConfig) -> EnvSpec | None:
    """Return Gymnasium's specification with the horizon of the configuration, and with options as plain data."""
    if value is None:
        return None
    options = {name: _plain(option) for name, option in value.kwargs.items()}
    if options.keys() & {"max_episode_steps", "max_cycles"}:
        options.pop("max_episode_steps", None)
        options["max_cycles"] = Horizon(config.max_cycles)  # gives way to another `max_episode_steps`
    made = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    return Specification(**{**made, "kwargs": options, "max_episode_steps": Horizon(config.max_cycles)})


def take_horizon(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options with Gymnasium's `max_episode_steps` as `max_cycles`.

    Raises:
        ConfigError: where both are given and differ.
    """
    rest = dict(options)
    steps = rest.pop("max_episode_steps", None)
    if steps is None or isinstance(steps, Horizon):  # the latter is what the other options say
        return rest
    if isinstance(rest.get("max_cycles"), Horizon):
        del rest["max_cycles"]
    if rest.setdefault("max_cycles", steps) != steps:
        raise ConfigError(
            f"Argument `max_episode_steps` must be `max_cycles` ({rest['max_cycles']!r}) where both are given, "
            f"but is {steps!r}"
        )
    return rest


def _plain(value: Any) -> Any:
    """Paths, arrays, enumerations and configurations as plain data; all else as it is."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, EnvConfig):
        return _stated(value)
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value


def _stated(config: EnvConfig) -> Any:
    """What a configuration states, as plain data; the configuration itself where something in it has no such form."""
    try:
        data = config.to_dict()
    except ConfigError:
        return config
    return {name: value for name, value in data.items() if name in config.model_fields_set}
