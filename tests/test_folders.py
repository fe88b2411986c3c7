"""Where results go is tried before the work: everything that writes says at once that it cannot."""

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from relloc_env.config import load_config

ROOT = Path(__file__).parents[1]


def _reproduce(out: Path) -> None:
    from relloc_env.paper import reproduce

    reproduce(out)


def _replay(out: Path) -> None:
    from relloc_env.replay import replay

    replay(_log(out.parents[1]), estimator="cascade", out=out)


def _log(folder: Path) -> Path:
    from relloc_env.wrappers import RecordLog

    env = RecordLog(gym.make("relloc_env:relloc_env/RelativePose-v0", estimator=None), folder / "logs")
    env.reset(seed=1)
    env.step(np.zeros(4))
    env.close()
    return folder / "logs" / "episode_000"


def _session(out: Path) -> None:
    from relloc_env.play import Session

    Session(estimator="cascade", logs=out)


def _record(out: Path) -> None:
    from relloc_env.wrappers import RecordLog

    RecordLog(gym.make("relloc_env:relloc_env/RelativePose-v0"), out)


def _animation(out: Path) -> None:
    from relloc_env.rendering import save_animation

    save_animation([np.zeros((8, 8, 3), np.uint8)], out / "a.gif")


def _rerun(out: Path) -> None:
    pytest.importorskip("rerun")
    from relloc_env.rendering.rerun_file import RerunFile

    RerunFile(out / "a.rrd")


def _film(out: Path) -> None:
    from agents.film import film

    film(out / "a.gif", load_config(max_cycles=4), {"never": _never}, seed=0)


def _film_rerun(out: Path) -> None:
    from agents.film import film

    film(out.parents[1] / "a.gif", load_config(max_cycles=4), {"never": _never}, seed=0, rerun=out / "a.rrd")


def _benchmark(out: Path) -> None:
    from agents.benchmark import benchmark
    from agents.jobs import Asked

    asked = Asked(
        env="relloc_env/RelativePose-v0", suites=("open-field",), agents=("edge",), estimators=("cascade",),
        episodes=2, seeds="validation",
    )  # fmt: skip
    benchmark(asked, out)


def _demo(out: Path) -> None:
    from agents.demo import run

    run(out)


def _train(out: Path) -> None:
    from train.config import load
    from train.run import train

    train(load("active-depth"), out)


def _tune(out: Path) -> None:
    from train.config import load
    from train.tune import tune

    tune(load("active-depth", ["search={seed: {choices: [1, 2]}}"]), 1, out, tell=_never)


def _curves(out: Path) -> None:
    from train.curves import curves

    curves([out.parents[1]], out / "a.svg")


def _speed(out: Path) -> None:
    from benchmarks.report import run

    run(out)


def _consistency(out: Path) -> None:
    from benchmarks.consistency import run

    run(out, tell=_silent)


def _estimators(out: Path) -> None:
    from benchmarks.estimators import run

    run(out)


def _vision(out: Path) -> None:
    from benchmarks.vision import run

    run(out, tell=_silent)


def _silent(*_: Any) -> None:
    """Told nothing."""


def _never(task: Any) -> Any:
    raise AssertionError("the work has begun")


WRITERS = [
    _reproduce, _replay, _session, _record, _animation, _rerun, _film, _film_rerun, _benchmark, _demo, _train, _tune,
    _curves, _speed, _consistency, _estimators, _vision,
]  # fmt: skip


@pytest.mark.parametrize("write", WRITERS)
def test_a_folder_that_cannot_be_is_told_before_the_work(write: Callable[[Path], None], tmp_path: Path) -> None:
    """It lies below a file; the work that would follow takes from seconds to hours."""
    (tmp_path / "file").write_text("mine", "utf-8")
    with pytest.raises(OSError, match=r"Argument `\w+` must be a folder, but .*file is a file"):
        write(tmp_path / "file" / "below")
    assert (tmp_path / "file").read_text("utf-8") == "mine"


def test_folders_for_results_are_made_in_one_place() -> None:
    files = [path for name in ("relloc_env", "agents", "train", "benchmarks") for path in (ROOT / name).rglob("*.py")]
    found = {
        path.relative_to(ROOT).as_posix()
        for path in files
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Attribute) and node.attr in {"mkdir", "makedirs"}
    }
    # A log is a folder of its own in one of these; `train/folder.py` has the project's own policies.
    assert found == {"relloc_env/folders.py", "relloc_env/logs/episode.py", "train/folder.py"}
