"""Observation and action spaces of a configuration, and an observation in the form its space has."""

from typing import Any

import numpy as np
from gymnasium import spaces

from relloc_env.config import EnvConfig
from relloc_env.envs.core import ROBOT_NAMES, Core
from relloc_env.envs.observation import bounds, fields, slices
from relloc_env.samples import Float32


def robot_space(config: EnvConfig) -> spaces.Space[Any]:
    """Space of one robot's observation: a flat `Box`, or a `Dict` of its fields, each a vector."""
    if config.observation == "flat":
        return spaces.Box(*bounds(config), dtype=np.float32)
    return spaces.Dict({f.name: spaces.Box(f.low, f.high, (f.size,), np.float32) for f in fields(config)})


def joint_space(config: EnvConfig) -> spaces.Space[Any]:
    """Space of all robots' observations: one flat `Box`, or a flat `Dict` with keys `robot_a/field`."""
    robots = config.robots
    if config.observation == "flat":
        low, high = bounds(config)
        return spaces.Box(np.tile(low, robots), np.tile(high, robots), dtype=np.float32)
    return spaces.Dict(
        {
            _key(config, r, f.name): spaces.Box(f.low, f.high, (f.size,), np.float32)
            for r in range(robots)
            for f in fields(config)
        }
    )


def robot_observation(core: Core, n: int, r: int) -> Float32 | dict[str, Float32]:
    """A fresh copy of what robot r of environment n observes."""
    line: Float32 = core.observation[n, r].copy()
    if core.config.observation == "flat":
        return line
    where = core.slices
    return {f.name: line[where[f.name]] for f in core.fields}


def joint_observation(core: Core, n: int) -> Float32 | dict[str, Float32]:
    """A fresh copy of what all robots of environment n observe."""
    if core.config.observation == "flat":
        line: Float32 = core.observation[n].flatten()
        return line
    lines, where = core.observation[n].copy(), core.slices
    return {
        _key(core.config, r, f.name): lines[r, where[f.name]] for r in range(core.config.robots) for f in core.fields
    }


def joint_slices(config: EnvConfig) -> dict[str, slice]:
    """Where each field is in the flat joint observation, by the keys of the joint `Dict`."""
    where = slices(config)
    size = max(part.stop for part in where.values())
    return {
        _key(config, r, name): slice(r * size + part.start, r * size + part.stop)
        for r in range(config.robots)
        for name, part in where.items()
    }


def _key(config: EnvConfig, r: int, name: str) -> str:
    """A field's name in the joint observation; one robot alone needs no prefix."""
    return name if config.robots == 1 else f"{ROBOT_NAMES[r]}/{name}"
