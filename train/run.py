"""One training run in a folder of its own: it goes on from its last checkpoint, however it was stopped."""

import time
from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from agents.alone import alone
from agents.learned import NORMALISATION
from agents.policy import Policy, Task
from relloc_env.config import ConfigError
from relloc_env.extras import MissingExtraError, extra
from relloc_env.files import read_json, whole, write_json
from relloc_env.places import code_in
from relloc_env.scenarios import SEEDS
from train import checkpoints, export
from train.config import TrainConfig
from train.evaluation import (
    Journal,
    compare,
    differences,
    evaluate,
    finite,
    intervals,
    means,
    play_script,
    policy_of,
    value,
)
from train.folder import CHECKPOINT, DONE, EVALUATION, POLICY, SAVED, SCRIPTS, claim, command_of
from train.models import build, sound
from train.progress import Show

with extra("train"):
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
    from torch.utils.tensorboard import SummaryWriter


SCORED = ("information_10s", "information_mean", "information_end", "change_speed", "change_yaw_rate")
"""Scores that are drawn in TensorBoard."""


class DivergedError(RuntimeError):
    """A run whose weights are no numbers any more, or absurd."""


def train(config: TrainConfig, out: Path, *, command: str = "") -> Path:
    """Train, from the beginning or from the last checkpoint in the folder, and write what was learned.

    A run that is over is left as it is.

    Args:
        config: of the run.
        out: its folder, made where it is missing.
        command: that was given, for the card; that of the beginning stays.

    Returns:
        The best policy's file, ONNX or where there can be none Stable-Baselines3's.

    Raises:
        ConfigError: the folder is of another run, or has a file that is damaged.
        ValueError: another process works on it.
        DivergedError: the weights are no numbers any more; the last checkpoint stays.
    """
    with alone(out):
        claim(config, out, command)
        if (out / DONE).exists():
            return out / _policy_of(out / DONE)
        with Show(config.steps, config.evaluation.score) as show:
            run = Run(config, out, show=show)
            run.learn()
            policy = run.finish()
            write_json(out / DONE, {"steps": run.steps, "policy": policy.name})
    return policy


def _policy_of(path: Path) -> str:
    """Name of the policy of a run that is over."""
    try:
        return next(name for name in (POLICY, SAVED) if name == read_json(path)["policy"])
    except (ValueError, TypeError, KeyError, StopIteration):
        raise ConfigError(f"{path} is damaged: remove it, and the same command ends the run again") from None


class Run:
    """A model, and what is written about it at pauses between rollouts.

    Attributes:
        model: of Stable-Baselines3.
        best: the best policy so far: `score`, `steps`, `policy`, `statistics`.
    """

    def __init__(
        self,
        config: TrainConfig,
        out: Path,
        *,
        show: Show | None = None,
        scripts: bool = True,
        evaluated: Callable[[Mapping[str, Any]], None] = lambda _: None,
    ) -> None:
        self.config, self._out = config, out
        self._show = show or Show(config.steps, config.evaluation.score, quiet=True)
        self._tell = evaluated
        self.model: BaseAlgorithm = build(config)
        self.best: dict[str, Any] = {"score": -np.inf}
        self._evaluated = self._saved = -1
        self._seconds, self._since = 0.0, time.monotonic()
        self._journal = Journal(out / EVALUATION)
        path = out / CHECKPOINT
        if path.exists():
            state = checkpoints.read(path, code_in(config.to_dict()))
            checkpoints.restore(self.model, state["model"])
            self.best, self._evaluated, self._saved = state["best"], state["evaluated"], state["saved"]
            self._seconds = state["seconds"]
            self._show.line(f"Goes on from the checkpoint at {self.steps:,} steps")
        self._scripts = self._compare() if scripts else {}

    @property
    def steps(self) -> int:
        """Steps so far."""
        return self.model.num_timesteps

    def _compare(self) -> dict[str, dict[str, float]]:
        """Scores of the scripts, played once for the folder."""
        path = self._out / SCRIPTS
        try:
            return TypeAdapter(dict[str, dict[str, float]]).validate_python(read_json(path))
        except (FileNotFoundError, ValueError):  # not there, or damaged
            played = compare(self.config, tell=lambda name: self._show.doing(f"plays {name}"))
            found = {name: means(each) for name, each in played.items()}
            write_json(path, found, indent=None)
            return found

    @property
    def script(self) -> str:
        """Name of the best script."""
        score = self.config.evaluation.score
        return max(self._scripts, key=lambda name: value(self._scripts[name], score), default="")

    def learn(self) -> None:
        """Train to the end; what was written after the checkpoint is taken back."""
        self._journal.rewind(self.steps if (self._out / CHECKPOINT).exists() else -1)
        board = _Board(self._out / "tensorboard", self.steps + 1)
        self.model.set_logger(Logger(str(self._out), [board]))
        if self.steps < self.config.steps:
            try:
                self.model.learn(
                    self.config.steps - self.steps, callback=_Pauses(self, self._show), reset_num_timesteps=False
                )
            except ValueError as error:
                if not sound(self.model):
                    raise self._diverged() from error
                raise
        board.close()

    def _diverged(self) -> DivergedError:
        return DivergedError(
            f"The run diverged after {self.steps:,} steps: its weights are not finite, or absurd. The checkpoint at "
            f"{self._saved:,} steps stays, its best policy too (python -m train export {self._out}). A lower "
            "`algorithm.learning_rate` may help, in another folder"
        )

    def pause(self, *, last: bool = False) -> None:
        """Between rollouts: evaluate and save, where it is time."""
        evaluation, steps = self.config.evaluation, self.steps
        evaluates = last or _due(steps, self._evaluated, evaluation.every)
        if not (evaluates or _due(steps, self._saved, self.config.checkpoint)):
            return
        if not sound(self.model):
            raise self._diverged()
        line = self._evaluate() if evaluates and steps > self._evaluated else None
        self.model.logger.dump(steps)
        self._saved = steps
        seconds = self._seconds + time.monotonic() - self._since
        state = {
            "model": checkpoints.capture(self.model), "best": self.best, "evaluated": self._evaluated,
            "saved": self._saved, "seconds": seconds,
        }  # fmt: skip
        checkpoints.write(self._out / CHECKPOINT, state)
        if line is not None:
            self._tell(line)

    def _evaluate(self) -> dict[str, Any]:
        """Play the validation episodes, keep the policy where it is the best, and write the line."""
        evaluation = self.config.evaluation
        found = means(evaluate(self.config, self._policy(), episodes=evaluation.episodes))
        score = value(found, evaluation.score)
        if "policy" not in self.best or score > self.best["score"]:  # a time of what never happens is -inf
            normaliser = self.model.get_vec_normalize_env()
            statistics = deepcopy(vars(normaliser.obs_rms)) if normaliser is not None else None
            policy = {name: value.clone() for name, value in self.model.policy.state_dict().items()}
            self.best = {"score": score, "steps": self.steps, "policy": policy, "statistics": statistics}
        script = self.script
        line = {
            "steps": self.steps, "score": score, "best": self.best["score"], "script": script,
            "script_score": value(self._scripts[script], evaluation.score) if script else None, **found,
        }  # fmt: skip
        for name in SCORED:
            if name in found:
                self.model.logger.record(f"evaluation/{name}", found[name])
        self.model.logger.record("rollout/episode_return", checkpoints.worlds_of(self.model).episode_return)
        checkpoints.worlds_of(self.model).clear()
        self._journal.add(line)
        self._evaluated = self.steps
        self._show.evaluated(line)
        return line

    def take_best(self) -> None:
        """Make the model's policy the best one."""
        if "policy" not in self.best:
            raise ConfigError(f"Argument `out` must be a folder of a run, but {self._out} has no checkpoint yet")
        self.model.policy.load_state_dict(self.best["policy"])
        normaliser = self.model.get_vec_normalize_env()
        if normaliser is not None:
            statistics: Any = checkpoints.running(self.best["statistics"])
            normaliser.obs_rms = statistics

    def finish(self) -> Path:
        """Write the best policy: as Stable-Baselines3's files, as ONNX with its card, and as a film."""
        self.take_best()
        out = self._out
        normaliser = self.model.get_vec_normalize_env()
        if normaliser is not None:
            with whole(out / NORMALISATION) as partial:
                normaliser.save(str(partial))
        self._film()
        seconds = self._seconds + time.monotonic() - self._since
        about = export.card(
            self.config, self.model, command=command_of(out), steps=self.best["steps"], seconds=round(seconds),
            validation_score=finite(self.best["score"]), metrics=self._metrics(),
        )  # fmt: skip
        try:
            export.save(self.model, about, out / POLICY)
        except export.NoOnnxError as error:
            self._show.line(f"{error}: the policy is {out / SAVED}")
        with whole(out / SAVED) as partial:
            self.model.save(partial)
        return out / (POLICY if (out / POLICY).exists() else SAVED)

    def _metrics(self) -> dict[str, Any]:
        """Scores on test seeds with intervals, and what they are above the best script's, plain data."""
        evaluation = self.config.evaluation
        if not evaluation.test:
            return {}
        self._show.doing("plays the test episodes")
        found = evaluate(self.config, self._policy(), episodes=evaluation.test, which="test")
        metrics: dict[str, Any] = {"seeds": "test", "episodes": evaluation.test, "scores": intervals(found)}
        if self.script:
            others = play_script(self.config, self.script, episodes=evaluation.test, which="test")
            metrics |= {"script": self.script, "over_script": differences(found, others)}
        return metrics

    def _film(self) -> None:
        config = self.config
        if not config.film:
            return
        self._show.doing("draws the film")
        from agents.film import film

        policy, file = {self._out.name: self._policy()}, self._out / f"film.{config.film}"
        try:
            film(file, config.played[0], policy, seed=SEEDS["validation"][0])
        except MissingExtraError as error:
            self._show.line(f"No film. {error}")

    def _policy(self) -> Callable[[Task], Policy]:
        return policy_of(self.model, checkpoints.worlds_of(self.model).layout)


def _due(steps: int, last: int, every: int) -> bool:
    """Whether a multiple of `every` lies behind `steps` and not behind `last`."""
    return steps // every > last // every


class _Pauses(BaseCallback):
    """Hands over to the run between rollouts."""

    def __init__(self, run: Run, show: Show) -> None:
        super().__init__()
        self._run, self._show = run, show

    def _on_rollout_start(self) -> None:
        self._show.at(self.num_timesteps)
        self._run.pause()

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self._show.at(self.num_timesteps)
        self._run.pause(last=True)


class _Board(TensorBoardOutputFormat):
    """TensorBoard's files; what was written after the checkpoint that a run goes on from is taken back."""

    def __init__(self, folder: Path, purge_step: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=purge_step)
        self._is_closed = False
