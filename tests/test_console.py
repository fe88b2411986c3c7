"""Consoles that have no letters but ASCII's: commands print what they can, and end well."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer

from agents.__main__ import app as agents
from benchmarks.__main__ import app as benchmarks
from docs.figures.__main__ import main as figures
from relloc_env.__main__ import app as relloc_env
from relloc_env.envs.centralised import RellocEnv
from relloc_env.wrappers import RecordLog
from train.__main__ import app as train

ROOT = Path(__file__).parents[1]
CONSOLES = {
    "ascii": {"PYTHONIOENCODING": "ascii"},
    "C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
}
drawing = typer.Typer()
drawing.command()(figures)
COMMANDS = [
    [module, *name]
    for module, app in {
        "agents": agents, "benchmarks": benchmarks, "relloc_env": relloc_env, "train": train, "docs.figures": drawing,
    }.items()
    for name in [[], *([name] for name in getattr(typer.main.get_command(app), "commands", ()))]
]  # fmt: skip


def run(console: str, *words: str | Path) -> str:
    """What a command prints that ends well; typer itself writes UTF-8 where it takes a console to be set wrongly."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONIOENCODING", "PYTHONUTF8")}
    command = [sys.executable, "-m", *map(str, words)]
    done = subprocess.run(command, cwd=ROOT, env=kept | CONSOLES[console], capture_output=True, check=False)
    told = (done.stdout + done.stderr).decode("utf-8", "replace")
    assert done.returncode == 0, told
    return told


@pytest.mark.parametrize("console", CONSOLES)
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_is_shown(command: list[str], console: str) -> None:
    assert "Usage" in run(console, *command, "--help")


@pytest.mark.parametrize("console", CONSOLES)
def test_results_are_told(console: str, tmp_path: Path) -> None:
    """Of a folder with a letter of its own, which is in what is printed; tables have dashes and degrees."""
    out = tmp_path / "Zür–ich °"
    words = ["--suite", "open-field", "--agents", "straight,circle", "--estimators", "cascade"]
    run(console, "agents", "benchmark", *words, "--episodes", "2", "--cores", "1", "--out", out)
    assert "| straight" in run(console, "agents", "tables", out).replace("`", "")
    assert "report.html" in run(console, "agents", "report", out, "--no-animations")
    run(console, "benchmarks", "profile", "--num-envs", "2", "--seconds", "0", "--out", out)
    with contextlib.closing(RecordLog(RellocEnv(max_cycles=4), out)) as env:
        env.reset(seed=3)
        for _ in range(4):
            env.step(np.array([1.0, 0.1, 1.0, -0.1], np.float32))
    assert "cascade" in run(console, "relloc_env", "replay", out / "episode_000", "--out", out / "replay")
