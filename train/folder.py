"""The folder of a run: its files, and whose it is."""

from pathlib import Path
from typing import Any

import yaml

from agents.learned import POLICIES, read_card
from relloc_env.config import ConfigError
from relloc_env.files import write_json, write_whole
from relloc_env.folders import open_folder
from train.config import TrainConfig, load

CONFIG, CHECKPOINT, EVALUATION, SCRIPTS = "config.yaml", "checkpoint.npz", "evaluation.jsonl", "scripts.json"
POLICY, SAVED, DONE = "policy.onnx", "policy.zip", "done.json"
COMMAND = "command.txt"


def claim(config: TrainConfig, out: Path, command: str = "") -> None:
    """Make the folder a run's, and keep the command that began it.

    Raises:
        ConfigError: it is of another run.
    """
    open_folder(out)
    path = out / CONFIG
    if path.exists():
        differ = sorted(_differing(load(path, trust=True).to_dict(), config.to_dict()))
        if differ:
            raise ConfigError(
                f"Argument `out` must be a folder of its own: the run in {out} has other values of {', '.join(differ)}"
            )
    else:
        write_whole(path, yaml.safe_dump(config.to_dict(), sort_keys=False))
    if command and not (out / COMMAND).exists():
        write_whole(out / COMMAND, command + "\n")


def command_of(out: Path) -> str:
    """The command that began a run; nothing where none was."""
    path = out / COMMAND
    return path.read_text(encoding="utf-8").rstrip("\n") if path.exists() else ""


def _differing(one: Any, other: Any, name: str = "") -> list[str]:
    """Paths of the fields in which two configurations differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        return [
            path
            for key in {**one, **other}
            for path in _differing(one.get(key), other.get(key), f"{name}.{key}" if name else str(key))
        ]
    return [] if one == other else [name]


def ship(out: Path, name: str) -> Path:
    """Copy the policy of a run and its card among those that ship.

    Raises:
        ConfigError: a run that has none.
    """
    if not (out / POLICY).exists():
        raise ConfigError(f"Argument `RUN` must be a run with a {POLICY}, but {out} has none")
    POLICIES.mkdir(exist_ok=True)
    card = read_card(out / POLICY) | {"name": name}
    write_json(POLICIES / f"{name}.json", card)
    write_whole(POLICIES / f"{name}.onnx", (out / POLICY).read_bytes())
    return POLICIES / f"{name}.onnx"
