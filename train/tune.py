"""Search for hyper-parameters with Optuna, in a folder that it goes on in however it was stopped."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from agents.alone import alone
from relloc_env.config import ConfigError, put
from relloc_env.extras import extra
from relloc_env.files import write_whole
from train.config import TrainConfig, load
from train.folder import claim
from train.run import DivergedError, Run

with extra("train"):
    import optuna
    from optuna.trial import FrozenTrial, TrialState


STUDY, BEST, FOLDER = "study.db", "best.yaml", "folder"
Tell = Callable[[str], None]


def tune(config: TrainConfig, trials: int, out: Path, tell: Tell) -> Path:
    """Train with values that Optuna proposes, until so many trials are over; write the best configuration.

    A trial whose score lies below the median of the others' at the same steps is given up. A trial that was stopped
    goes on from its checkpoint.

    Args:
        config: of every trial but for what `search` names; the seed is also the search's.
        trials: how many, those of earlier calls included.
        out: folder of the study.
        tell: called with a line about each trial.

    Returns:
        The file of the best configuration.

    Raises:
        ConfigError: nothing to search, or a folder of another study.
        ValueError: another process works on it.
    """
    if not config.search:
        raise ConfigError("Argument `search` must name what to search, but is empty")
    with alone(out):
        return _tune(config, trials, out, tell)


def _tune(config: TrainConfig, trials: int, out: Path, tell: Tell) -> Path:
    """As `tune`, in a folder that nobody else works on."""
    claim(config, out)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        storage=f"sqlite:///{out / STUDY}", study_name=config.name, direction="maximize", load_if_exists=True,
        pruner=optuna.pruners.MedianPruner(n_startup_trials=4, n_warmup_steps=config.steps // 4),
    )  # fmt: skip
    for stopped in study.get_trials(states=(TrialState.RUNNING,)):
        study.tell(stopped.number, state=TrialState.FAIL)
        study.enqueue_trial(stopped.params, user_attrs={FOLDER: stopped.user_attrs.get(FOLDER, _folder(stopped))})
    # what is drawn next depends on the trials that there are: a search that goes on does not draw the same again
    study.sampler = optuna.samplers.TPESampler(seed=config.seed + len(study.trials), n_startup_trials=5)
    while (over := len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED)))) < trials:
        trial = _one(study, config, out)
        value = "given up" if trial.state is TrialState.PRUNED else f"{config.evaluation.score} {trial.value:.3f}"
        tell(f"Trial {over + 1} of {trials}: {value}, {trial.params}")
    best = study.best_trial
    found = _with(config, {name: each.draw(best, name) for name, each in config.search.items()}).to_dict()
    path = out / BEST
    write_whole(path, yaml.safe_dump(found, sort_keys=False))
    return path


def _with(config: TrainConfig, values: Mapping[str, Any]) -> TrainConfig:
    """The configuration with other values at some `path.to.field`, and nothing left to search."""
    data = config.to_dict() | {"search": {}}
    for name, value in values.items():
        put(data, name, value)
    return load(data)


def _folder(trial: Any) -> str:
    return f"trial-{trial.number:04d}"


def _one(study: optuna.Study, config: TrainConfig, out: Path) -> FrozenTrial:
    """Play the next trial; one that is stopped from outside stays under way in the study."""
    trial = study.ask()
    try:
        return study.tell(trial, _play(trial, config, out))
    except optuna.TrialPruned:
        return study.tell(trial, state=TrialState.PRUNED)
    except Exception:
        study.tell(trial, state=TrialState.FAIL)
        raise


def _play(trial: optuna.Trial, config: TrainConfig, out: Path) -> float:
    """One trial: the best score on the validation episodes."""
    values = {name: each.draw(trial, name) for name, each in config.search.items()}
    folder = Path(trial.user_attrs.get(FOLDER, _folder(trial))).name  # within the study, whatever its file says
    trial.set_user_attr(FOLDER, folder)
    chosen = _with(config, values)
    claim(chosen, out / folder)

    def evaluated(line: Mapping[str, Any]) -> None:
        trial.report(line["score"], line["steps"])
        if trial.should_prune():
            raise optuna.TrialPruned

    run = Run(chosen, out / folder, scripts=False, evaluated=evaluated)
    try:
        run.learn()
    except DivergedError:
        raise optuna.TrialPruned from None
    return float(run.best["score"])
