"""Policies on episodes that training never sees, beside scripts on the same ones."""

import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.layout import Layout
from agents.learned import Acting
from agents.playing import LATE, SCORES, play
from agents.policy import Policy, Task
from agents.registry import agent
from agents.statistics import Interval, mean, mean_difference, median
from relloc_env.config import ConfigError, load_config
from relloc_env.extras import extra
from relloc_env.files import write_whole
from relloc_env.samples import Bool, Float, Float32
from relloc_env.scenarios import seeds
from train.config import TrainConfig

with extra("train"):
    from stable_baselines3.common.base_class import BaseAlgorithm


Scores = dict[str, Float]
"""Of every episode, (N,) each."""


def policy_of(model: BaseAlgorithm, layout: Layout) -> Callable[[Task], Policy]:
    """What a model does without exploring, as it is now."""
    normaliser = model.get_vec_normalize_env()

    def build(task: Task) -> Policy:
        memory: Any = None

        def decide(rows: Float32, new: Bool) -> Float:
            nonlocal memory
            space = model.observation_space
            seen: Any = rows.astype(space.dtype).reshape(-1, *(space.shape or ()))
            if normaliser is not None:
                seen = normaliser.normalize_obs(seen)
            actions, memory = model.predict(seen, memory, new, deterministic=True)
            return np.asarray(actions, np.float64)

        return Acting(task, layout, decide)

    return build


def evaluate(
    config: TrainConfig,
    build: Callable[[Task], Policy],
    *,
    episodes: int,
    which: str = "validation",
    options: Mapping[str, Any] | None = None,
) -> Scores:
    """Scores of one episode for each of the first seeds of a set, dealt out to the variants in turn.

    Args:
        config: of the run.
        build: makes the policy from a task.
        episodes: how many in all.
        which: set of seeds, see `relloc_env.scenarios.SEEDS`.
        options: of the environment, on top of those of the run.
    """
    variants = [load_config(each, **(options or {})) for each in config.played]
    chosen = seeds(which, max(episodes, len(variants)))
    found: list[Scores] = []
    for k, each in enumerate(variants):
        scores, _ = play(each, build, chosen[k :: len(variants)], threads=config.threads)
        found.append(scores)
    return {name: np.concatenate([each[name] for each in found]) for name in SCORES}


def compare(config: TrainConfig, *, tell: Callable[[str], None]) -> dict[str, Scores]:
    """Scores of the agents to compare with, on the validation episodes."""
    found = {}
    for name in config.evaluation.agents:
        tell(name)
        found[name] = play_script(config, name, episodes=config.evaluation.episodes)
    return found


def play_script(config: TrainConfig, name: str, *, episodes: int, which: str = "validation") -> Scores:
    """Scores of an agent to compare with, which sees numbers."""
    options = {"observation": "flat", **config.evaluation.script_options}
    return evaluate(config, agent(name), episodes=episodes, which=which, options=options)


def value(found: Mapping[str, float], score: str) -> float:
    """A score of `means` for which more is better: a minus before its name turns it."""
    sign = -1.0 if score.startswith("-") else 1.0
    return sign * found[score.removeprefix("-")]


def means(scores: Scores) -> dict[str, float]:
    """One number for each score that there is: medians of times, means of others, and the shares that got there."""
    found = {}
    for name, values in scores.items():
        if not np.isnan(values).all():
            late = name.startswith(LATE)
            found[name] = float(np.median(values) if late else np.mean(values))
            if late:
                found[f"{name}_share"] = float(np.isfinite(values).mean())
    return found


def intervals(scores: Scores) -> dict[str, dict[str, float | None]]:
    """As `means`, with 95 % intervals, as plain data; None for "never". Medians also where a score is infinite."""
    found: dict[str, dict[str, float | None]] = {}
    for name, values in scores.items():
        if not np.isnan(values).all():
            late = name.startswith(LATE)
            found[name] = plain(median(values) if late or np.isinf(values).any() else mean(values))
            if late:
                found[f"{name}_share"] = plain(mean(np.isfinite(values).astype(np.float64)))
    return found


def differences(scores: Scores, others: Scores) -> dict[str, dict[str, float | None]]:
    """Mean paired differences with 95 % intervals, of the scores that are finite everywhere."""
    return {
        name: plain(mean_difference(values, others[name]))
        for name, values in scores.items()
        if np.isfinite(values).all() and np.isfinite(others[name]).all()
    }


def plain(interval: Interval) -> dict[str, float | None]:
    """An interval as JSON has it."""
    return {name: finite(value) for name, value in interval._asdict().items()}


def finite(value: Any) -> Any:
    """A value as JSON has it: None for a number that is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Journal:
    """`evaluation.jsonl`: a line for each evaluation, none of them twice."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def lines(self) -> list[dict[str, Any]]:
        """What there is; a line that was not finished is none."""
        if not self._path.exists():
            return []
        whole = self._path.read_text(encoding="utf-8").split("\n")[:-1]
        try:
            return [{"steps": line["steps"]} | line for line in map(json.loads, whole)]
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise ConfigError(f"{self._path} is damaged, remove it: {error}") from None

    def rewind(self, steps: int) -> None:
        """Forget what came after a checkpoint at `steps`."""
        kept = [line for line in self.lines() if line["steps"] <= steps]
        write_whole(self._path, "".join(json.dumps(line) + "\n" for line in kept))

    def add(self, line: Mapping[str, Any]) -> None:
        """Write one more."""
        text = {name: finite(each) for name, each in line.items()}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(text) + "\n")
            file.flush()
            os.fsync(file.fileno())
