"""All that a run remembers, in one file that is put in its place whole: what was killed goes on from there."""

import random
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from relloc_env.config import ConfigError
from relloc_env.extras import extra
from relloc_env.places import refuse_code
from train import plain
from train.worlds import Worlds

with extra("train"):
    import torch
    from sb3_contrib.common.recurrent.type_aliases import RNNStates
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.running_mean_std import RunningMeanStd
    from stable_baselines3.common.save_util import recursive_getattr
    from stable_baselines3.common.vec_env import VecNormalize


_KEPT = (
    "num_timesteps", "_n_updates", "_episode_num", "_last_obs", "_last_original_obs", "_last_episode_starts",
    "_last_lstm_states", "_current_progress_remaining",
)  # fmt: skip
"""Attributes of the algorithms that change."""
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def capture(model: BaseAlgorithm) -> dict[str, Any]:
    """Copy everything that training goes on from: networks, optimisers, buffers, statistics, worlds, random streams."""
    _, variables = model._get_torch_save_params()  # noqa: SLF001 - what `save` keeps beside the networks
    return {
        "parameters": model.get_parameters(),
        "variables": {name: recursive_getattr(model, name).detach().clone() for name in variables},
        "kept": {name: getattr(model, name) for name in _KEPT if hasattr(model, name)},
        "normaliser": _normaliser_state(model),
        "buffer": _buffer_state(model),
        "worlds": worlds_of(model).get_state(),
        "streams": {
            "python": random.getstate(),
            "numpy": np.random.get_state(),  # noqa: NPY002 - the one that Stable-Baselines3 draws from
            "torch": torch.get_rng_state(),
            "actions": model.action_space.np_random.bit_generator.state,
        },
    }


def restore(model: BaseAlgorithm, state: dict[str, Any]) -> None:
    """Put back what `capture` gave into a model that was built from the same configuration."""
    env = model.get_env()
    assert env is not None
    env.reset()
    worlds_of(model).set_state(state["worlds"])
    model.set_parameters(state["parameters"], exact_match=True)
    for name, value in state["variables"].items():
        recursive_getattr(model, name).data.copy_(value)
    for name, value in state["kept"].items():
        setattr(model, name, RNNStates(*value) if name == "_last_lstm_states" and value is not None else value)
    if state["normaliser"] is not None:
        for name, value in state["normaliser"].items():
            setattr(_normaliser(model), name, running(value) if isinstance(value, dict) else value)
    if state["buffer"] is not None:
        _fill_buffer(model, state["buffer"])
    streams = state["streams"]
    random.setstate(streams["python"])
    np.random.set_state(streams["numpy"])  # noqa: NPY002 - as above
    torch.set_rng_state(streams["torch"])
    model.action_space.np_random.bit_generator.state = streams["actions"]


def worlds_of(model: BaseAlgorithm) -> Worlds:
    """The `Worlds` inside a model's environment."""
    env: Any = model.get_env()
    while not isinstance(env, Worlds):
        env = env.venv
    return env


def _normaliser(model: BaseAlgorithm) -> VecNormalize | None:
    return model.get_vec_normalize_env()


def _normaliser_state(model: BaseAlgorithm) -> dict[str, Any] | None:
    found = _normaliser(model)
    if found is None:
        return None
    kept = {name: vars(found)[name] for name in ("obs_rms", "ret_rms", "returns", "old_obs", "old_reward")
            if name in vars(found)}  # fmt: skip
    return {name: vars(value) if isinstance(value, RunningMeanStd) else value for name, value in kept.items()}


def running(statistics: Mapping[str, Any]) -> RunningMeanStd:
    """Running statistics of a mean, a variance and a count."""
    found = RunningMeanStd()
    found.mean, found.var, found.count = (statistics[name] for name in ("mean", "var", "count"))
    return found


def _buffer_state(model: BaseAlgorithm) -> dict[str, Any] | None:
    """The filled part of a replay buffer."""
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return None
    filled = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: getattr(buffer, name)[:filled] for name in _BUFFER if hasattr(buffer, name)}
    return {"arrays": arrays, "pos": buffer.pos, "full": buffer.full}


def _fill_buffer(model: BaseAlgorithm, state: dict[str, Any]) -> None:
    buffer: Any = model.replay_buffer  # type: ignore[attr-defined]
    for name, array in state["arrays"].items():
        getattr(buffer, name)[: len(array)] = array
    buffer.pos, buffer.full = state["pos"], state["full"]


def write(path: Path, state: Any) -> None:
    """Write a checkpoint, whole or not at all, also where the power fails."""
    plain.write(path, state)


def read(path: Path, allowed: Collection[str] = ()) -> Any:
    """Read what `write` wrote, which runs nothing.

    Args:
        path: of the file.
        allowed: code that it may name, since the run's configuration does: of an estimator or detector.

    Raises:
        ConfigError: a file that is damaged.
        UntrustedError: one that names other code.
    """
    try:
        state = plain.read(path)
    except ValueError as error:
        raise ConfigError(f"{error}: remove it, and the run begins anew") from error
    refuse_code(state, path, allowed)
    return state
