"""Policies that Stable-Baselines3 has saved, of one robot or of all robots together."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy import Task
from relloc_env.samples import Float, Float32

PREFIX = "learned:"
"""Begins the name of a learned agent: `learned:path/to/policy.zip`."""
NORMALISATION = "normalisation.pkl"
"""Statistics of `VecNormalize` that are taken up where they lie beside the policy."""


class Learned:
    """What a saved policy does without exploring.

    A policy whose observations are those of one robot moves each robot by its own; one that was trained on all robots'
    moves all.

    Args:
        task: what the robots know of themselves.
        path: file that a Stable-Baselines3 algorithm saved. It holds pickled Python: loading one runs what is in it.
    """

    def __init__(self, task: Task, path: str | Path) -> None:
        self._task, self._path = task, Path(path)
        if not self._path.is_file():
            raise ValueError(f"Argument `agents` must lead to a saved policy, but there is no file {str(path)!r}")
        warnings.warn(
            f"{path} is loaded with pickle, which runs whatever code is in it: load files of people you trust alone",
            stacklevel=2,
        )
        self._policy = _load(self._path)
        self._mean, self._scale, self._clip = _statistics(self._path.with_name(NORMALISATION))
        size = max(part.stop for part in task.slices.values())
        (given,) = self._policy.observation_space.shape
        if given not in (size, size * task.robots):
            raise ValueError(
                f"Argument `agents` must lead to a policy for this task, of {size} numbers for a robot or "
                f"{size * task.robots} for all, but {str(path)!r} takes {given}"
            )
        self._joint = given != size

    def reset(self, n: int, seed: int) -> None:
        """Nothing is remembered."""

    def act(self, observations: Float32) -> Float:
        """Ask the policy."""
        n, robots = observations.shape[:2]
        rows = observations.reshape(n if self._joint else n * robots, -1)
        rows = np.clip((rows - self._mean) / self._scale, -self._clip, self._clip).astype(np.float32)
        actions, _ = self._policy.predict(rows, deterministic=True)
        chosen: Float = np.asarray(actions, np.float64).reshape(n, robots, 2)
        return chosen


def _load(path: Path) -> Any:
    """The policy network in a file of any of Stable-Baselines3's algorithms for continuous actions."""
    import stable_baselines3 as sb3
    from stable_baselines3.common.save_util import load_from_zip_file

    data, _, _ = load_from_zip_file(path, device="cpu")
    module = data["policy_class"].__module__ if data else ""
    name = {"sac": "SAC", "td3": "TD3"}.get(module.split(".")[1] if "." in module else "", "PPO")
    policy = getattr(sb3, name).load(path, device="cpu").policy
    policy.set_training_mode(False)
    return policy


def _statistics(path: Path) -> tuple[Any, Any, float]:
    """Mean, scale and clipping of observations; those that change nothing where there is no file."""
    if not path.is_file():
        return 0.0, 1.0, np.inf
    import pickle

    with path.open("rb") as file:
        normaliser = pickle.load(file)  # noqa: S301 - said in the docs, and by the warning above
    if not normaliser.norm_obs:
        return 0.0, 1.0, np.inf
    seen = normaliser.obs_rms
    return seen.mean, np.sqrt(seen.var + normaliser.epsilon), float(normaliser.clip_obs)
