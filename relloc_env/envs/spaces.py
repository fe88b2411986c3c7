"""Observation and action spaces of a configuration, and an observation in the form its space has."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from relloc_env.config import EnvConfig
from relloc_env.envs.core import ROBOT_NAMES
from relloc_env.envs.observation import bounds, fields, slices
from relloc_env.samples import Float32


def robot_space(config: EnvConfig) -> spaces.Space[Any]:
    """Space of one robot's observation: a flat `Box`, a `Dict` of its fields, each a vector, or a picture."""
    if config.observation == "flat":
        return spaces.Box(*bounds(config), dtype=np.float32)
    if config.observation == "image":
        return _picture_space(config, 1)
    return spaces.Dict({f.name: spaces.Box(f.low, f.high, (f.size,), np.float32) for f in fields(config)})


def joint_space(config: EnvConfig) -> spaces.Space[Any]:
    """Space of all robots' observations: a flat `Box`, a flat `Dict` with keys `robot_a/field`, or their pictures."""
    robots = config.robots
    if config.observation == "flat":
        low, high = bounds(config)
        return spaces.Box(np.tile(low, robots), np.tile(high, robots), dtype=np.float32)
    if config.observation == "image":
        return _picture_space(config, robots)
    return spaces.Dict(
        {
            _key(config, r, f.name): spaces.Box(f.low, f.high, (f.size,), np.float32)
            for r in range(robots)
            for f in fields(config)
        }
    )


def robot_action_space(config: EnvConfig) -> spaces.Box:
    """Space of one robot's action: speed, yaw rate, and the gains that the configuration lets it set."""
    return spaces.Box(-1.0, 1.0, (config.action_size,), np.float32)


def joint_action_space(config: EnvConfig) -> spaces.Box:
    """Space of all robots' actions, one after the other."""
    return spaces.Box(-1.0, 1.0, (config.robots * config.action_size,), np.float32)


def _picture_space(config: EnvConfig, pictures: int) -> spaces.Box:
    """Space of pictures whose channels stand one after the other: what convolutional policies take."""
    width, height = config.image_size
    return spaces.Box(0, 255, (3 * pictures, height, width), np.uint8)


def many(space: spaces.Space[Any], num_envs: int) -> spaces.Space[Any]:
    """Space of a batch: Gymnasium's, but the bounds are held once instead of once for each environment."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: many(part, num_envs) for name, part in space.spaces.items()})
    assert isinstance(space, spaces.Box)
    batch: Any = batch_space(space, 1)
    shape = (num_envs, *space.shape)
    batch._shape = shape  # noqa: SLF001 - Gymnasium's constructor would make arrays of this shape
    for name in ("low", "high", "bounded_below", "bounded_above"):
        setattr(batch, name, np.broadcast_to(getattr(space, name), shape))
    return batch  # type: ignore[no-any-return]


Form = Callable[[Float32], Any]
"""Gives a block of numbers the form of an observation, without a copy."""


def robot_form(config: EnvConfig) -> Form:
    """How numbers (..., D), or pictures (..., 3, H, W), of one robot become its observation; leading axes stay."""
    if config.observation in ("flat", "image"):
        return _as_it_is
    return partial(_named_fields, [(name, part) for name, part in slices(config).items()])


def joint_form(config: EnvConfig) -> Form:
    """How numbers (..., R, D), or pictures (..., R, 3, H, W), of all robots become the joint observation."""
    if config.observation == "flat":
        return _joined
    if config.observation == "image":
        return _joined_pictures
    where = slices(config).items()
    keys = [(_key(config, r, name), r, part) for r in range(config.robots) for name, part in where]
    return partial(_named_joint_fields, keys)


def _as_it_is(block: Float32) -> Float32:
    return block


def _joined(block: Float32) -> Float32:
    return block.reshape(*block.shape[:-2], -1)


def _joined_pictures(block: Float32) -> Float32:
    return block.reshape(*block.shape[:-4], -1, *block.shape[-2:])


def _named_fields(keys: list[tuple[str, slice]], block: Float32) -> dict[str, Float32]:
    return {key: block[..., part] for key, part in keys}


def _named_joint_fields(keys: list[tuple[str, int, slice]], block: Float32) -> dict[str, Float32]:
    return {key: block[..., r, part] for key, r, part in keys}


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
