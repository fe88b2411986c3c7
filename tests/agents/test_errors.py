"""What agents of users' own raise: told with the agent, the file and the line, and never as a traceback."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agents.__main__ import app
from agents.benchmark import benchmark
from agents.film import scenes
from agents.jobs import Asked
from agents.registry import agent
from relloc_env.config import load_config

ROOT = Path(__file__).parents[2]
AGENT = """import numpy as np

class Mine:
    def __init__(self, task):
        self.task = task{build}
    def reset(self, n, seed):
        {reset}
    def act(self, observations):
        return {act}
"""
RIGHT = {"build": "", "reset": "pass", "act": "np.zeros((len(observations), 2, 2))"}
WRONG = {
    "it raises as it is made": ({"build": "; 1 / 0"}, "line 5: ZeroDivisionError: division by zero"),
    "it raises in `reset`": ({"reset": "raise KeyError(n)"}, "line 7: KeyError: 1"),
    "it raises in `act`": ({"act": "self.absent"}, "line 9: AttributeError: 'Mine' object has no attribute 'absent'"),
    "a library raises": ({"act": "np.zeros(3).reshape(2, 2)"}, "line 9: ValueError: cannot reshape array"),
    "this project raises": (
        {"act": "self.task.field(observations, 'depth')"},
        "line 9: ValueError: The observation",
    ),
    "actions of another shape": ({"act": "np.zeros((1, 2))"}, "line 3: ValueError: `act` must give (1, 2, 2) finite"),
    "actions that are not finite": ({"act": "np.full((1, 2, 2), np.nan)"}, "line 3: ValueError: `act` must give"),
    "actions that are none": ({"act": "None"}, "line 3: "),
    "a class of another form": ({"build": "\n    def __new__(cls): return 3"}, "line 3: TypeError: "),
}
"""What may be wrong with an agent, and how its message ends."""


def _write(folder: Path, parts: dict[str, str]) -> Path:
    path = folder / "mine.py"
    path.write_text(AGENT.format(**{**RIGHT, **parts}), "utf-8")
    return path


@pytest.mark.parametrize("wrong", WRONG)
def test_the_film_of_an_agent_that_fails_says_where(tmp_path: Path, wrong: str) -> None:
    parts, ending = WRONG[wrong]
    path = _write(tmp_path, parts)
    words = ["film", "--motion", f"{path}:Mine", "--out", str(tmp_path / "film.gif"), "--set", "max_cycles=4"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 1
    assert done.output.startswith(f"Error: The agent `Mine` failed in {path}, {ending}"), done.output
    assert len(done.output.splitlines()) == 1
    assert not (tmp_path / "film.gif").exists()


@pytest.mark.parametrize("wrong", ["it raises as it is made", "it raises in `act`"])
@pytest.mark.usefixtures("tiny_suites")
def test_the_benchmark_names_the_line_too(tmp_path: Path, wrong: str) -> None:
    path = _write(tmp_path, WRONG[wrong][0])
    asked = Asked(
        env="relloc_env/RelativePose-v0", suites=("tiny",), agents=(f"{path}:Mine",), estimators=("cascade",),
        episodes=2, seeds="validation",
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"mine\.py(:Mine)?.*line \d"):
        benchmark(asked, tmp_path / "results", cores=1)


def test_errors_of_the_projects_own_agents_stay_as_they_are() -> None:
    """A policy of one robot in the world of two."""
    with pytest.raises(ValueError, match="made for a task of 1 robot"):
        scenes(load_config(max_cycles=4), agent("learned:active-depth"), 0, "learned")


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_demonstration_that_is_stopped_says_so_and_leaves_no_process(tmp_path: Path) -> None:
    """Ctrl-C goes to all processes of the group."""
    begun = subprocess.Popen(
        [sys.executable, "-m", "agents", "demo", "--out", str(tmp_path / "demo")],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    limit = time.monotonic() + 120.0
    while not (tmp_path / "demo").is_dir() and time.monotonic() < limit:
        time.sleep(0.05)
    time.sleep(2.0)
    os.killpg(begun.pid, signal.SIGINT)
    words, _ = begun.communicate(timeout=60.0)
    assert begun.returncode == 130
    assert "Error: Stopped" in words
    assert "Traceback" not in words
    limit = time.monotonic() + 30.0
    while _are_there(begun.pid):
        assert time.monotonic() < limit
        time.sleep(0.1)


def _are_there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
