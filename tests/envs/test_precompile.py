"""A second process that compiles: what it does, and when there is one."""

import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from relloc_env.__main__ import app
from relloc_env.config import load_config
from relloc_env.envs import precompile
from relloc_env.envs.core import Core
from relloc_env.envs.threads import cores
from relloc_env.kernels._compile import QUIET


class _Started:
    """Stands in for the other process."""

    found: list["_Started"]

    def __init__(self, command: list[str], env: dict[str, str], **_: Any) -> None:
        self.command, self.env, self.stdin, self.ended = command, env, _Kept(), False
        _Started.found.append(self)

    def wait(self, timeout: float | None = None) -> None:
        self.ended = True

    def kill(self) -> None:
        pass


class _Kept(io.StringIO):
    """What was written."""

    told = ""

    def close(self) -> None:
        self.told = self.getvalue()


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[_Started]:
    """The processes that were started, where nothing was compiled before."""
    _Started.found = []
    monkeypatch.setattr(subprocess, "Popen", _Started)
    monkeypatch.setattr(precompile, "is_awaited", lambda _: True)
    monkeypatch.setattr(precompile, "cores", lambda: 2)
    monkeypatch.setattr(precompile, "_begun", threading.Lock())
    monkeypatch.delenv(precompile.ALONE, raising=False)
    return _Started.found


RUN = """
import relloc_env
from relloc_env.kernels.stepping import advance, begin

env = relloc_env.parallel_env(estimator=None, reward={"excitation": 1.0})
env.reset(seed=0)
env.step({name: [0.5, 0.1] for name in env.agents})
for stats in (advance.stats, begin.stats):
    print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def test_what_the_other_process_compiles_is_loaded_here(tmp_path: Path) -> None:
    """Into an empty cache: the motion is loaded, the starts of episodes were compiled here, and nothing twice."""
    environment = {key: value for key, value in os.environ.items() if key != precompile.ALONE}
    environment["NUMBA_CACHE_DIR"] = str(tmp_path)
    if cores() < 2:
        pytest.skip("one core")
    done = subprocess.run([sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "0", "0", "1"], done.stderr


@pytest.mark.parametrize("estimator", ["cascade", "inverse-depth", "map-alignment", None])
def test_neither_half_needs_an_environment_that_was_reset(estimator: str | None) -> None:
    config = load_config({"estimator": estimator, "reward": {"excitation": 1.0}})
    precompile.help_out(json.loads(json.dumps(config.to_dict())))
    Core(config).compile_most()


def test_there_is_one_for_a_process_and_it_is_waited_for(started: list[_Started]) -> None:
    Core(load_config({"estimator": "cascade"}))
    Core(load_config({"estimator": "cascade"}))
    (other,) = started
    assert other.ended
    assert other.env[precompile.ALONE] == "1"  # it starts no other
    assert json.loads(other.stdin.told)["config"]["estimator"]["kind"] == "cascade"


def test_a_process_that_cannot_be_started_is_no_error(started: list[_Started], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError("no more processes")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    Core(load_config({"estimator": "cascade"}))


class _Blind:
    """A detector of one's own."""

    def __init__(self, view: Any) -> None:
        self.fits = None

    def detect(self, picture: Any) -> None:
        """Find nothing."""


def test_there_is_none_where_that_is_not_wanted_or_no_help(
    started: list[_Started], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setenv(precompile.ALONE, "1")
        Core(load_config({"estimator": "cascade"}))
    with monkeypatch.context() as patch:
        patch.setattr(precompile, "cores", lambda: 1)
        Core(load_config({"estimator": "cascade"}))
    with monkeypatch.context() as patch:
        patch.setattr(precompile, "is_awaited", lambda _: False)
        Core(load_config({"estimator": "cascade"}))
        own = Core(load_config({"estimator": "cascade"}), 1).onboard.estimator
    Core(load_config({"estimator": "cascade"}), 1, own)
    Core(load_config({"camera": {"kind": "image", "image": {"detector": _Blind}}}))
    assert not started


EVERYTHING = """
import gymnasium as gym, numpy as np, relloc_env

for name in ("ActiveDepth", "RelativePose"):
    env = gym.make(f"relloc_env/{name}-v0")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    many = gym.make_vec(f"relloc_env/{name}-v0", 3)
    many.reset(seed=0)
    for _ in range(130):  # to the wall, and over the end of an episode
        many.step(np.ones(many.action_space.shape, np.float32) * 0.9)
    near = {"poses": [(4.0, r, 0.0) for r in range(many.config.robots)], "points": [(9.0, 0.1, 0.5), (9.0, 0.8, 0.5)]}
    env = relloc_env.parallel_env(task=f"relloc_env/{name}-v0", shield=None, **near)
    env.reset(seed=0)
    for _ in range(20):
        *_, info = env.step({robot: [1.0, 0.0] for robot in env.agents})
    assert env.unwrapped.state() is not None

from relloc_env.envs.precompile import _kernels
print(sorted(f"{kernel.__name__}{signature}" for kernel in _kernels() for signature in kernel.signatures))
"""
FILLED = """
from relloc_env.config import load_config
from relloc_env.envs.precompile import _kernels, fill_cache

for task in ("relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0"):
    fill_cache(load_config(task=task))
print(sorted(f"{kernel.__name__}{signature}" for kernel in _kernels() for signature in kernel.signatures))
"""


def test_the_command_compiles_all_that_environments_need() -> None:
    """After it, the ids say nothing of compiling, in a fresh process, alone or side by side, in contact too."""
    done = CliRunner().invoke(app, ["compile"])
    assert done.exit_code == 0, done.output
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == [
        "relloc_env/ActiveDepth-v0",
        "relloc_env/RelativePose-v0",
    ]
    environment = {key: value for key, value in os.environ.items() if key != QUIET}
    after, filled = (
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        for code in (EVERYTHING, FILLED)
    )
    assert after.stderr == ""
    assert after.stdout == filled.stdout  # whatever the cache held before
    again = CliRunner().invoke(app, ["compile", "--config", "paper-simulation", "--estimator", "cascade"])
    assert again.output.startswith("paper-simulation, cascade: ")
    again = CliRunner().invoke(app, ["compile"])
    assert again.output.count("nothing was missing") == 2


def test_the_command_says_where_nothing_can_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precompile, "_kernels", set)
    done = CliRunner().invoke(app, ["compile"])
    assert done.exit_code == 2
    assert "NUMBA_CACHE_DIR" in done.output
    assert CliRunner().invoke(app, ["compile", "--estimator", "cascad"]).exit_code == 2
