"""The main job: the paper's experiment, a handful of motions on one scenario, recorded robots; a folder of results."""

import csv
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Self

import numpy as np
from numba.core.event import Event, Listener, install_listener
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

import relloc_env
from agents import demo_figures as figures
from agents.policy import Task
from agents.registry import make
from agents.rollout import Episode, rollout
from relloc_env.config import load_config
from relloc_env.envs.core import ROBOT_NAMES
from relloc_env.logs import LogError
from relloc_env.metrics import convergence_time
from relloc_env.replay import open_logs, replay

ROOT = Path(__file__).resolve().parents[1]
MOTIONS = ("stationary", "straight", "back-and-forth", "circle", "sinusoid", "random", "edge-near")
ANIMATED = ("straight", "edge-near")
FASTER = 2.5
"""The animation runs faster than the robots by this."""
SEED = 4
PAPER = "paper-experiment"
LOGS: Mapping[str, Mapping[str, Any]] = {
    "mrclam/MRCLAM_Dataset7": {"robots": (2, 3), "start": 440.0, "stop": 510.0},
    "starloc/zigzag_s4": {"start": 0.0, "stop": 60.0},
}
"""Recorded logs that are looked for, and the stretch that is replayed."""
DEPTH_SETTLED = 0.1
"""[m] a depth has converged once its error stays below this."""
WHERE = """No recorded log at hand. The authors publish them at
  MR.CLAM   http://asrl.utias.utoronto.ca/datasets/mrclam/  (unpack MRCLAM_Dataset7)
  STAR-loc  https://github.com/utiasASRL/starloc  (sequence zigzag_s4)
Then: python -m agents demo --log PATH, or RELLOC_DATA=FOLDER with mrclam/ and starloc/ in it."""


Tell = Callable[..., None]
"""Called with the part of a step that is done, and more words where there are any."""


class Steps:
    """Says what is being done: a bar on a terminal, one line for each step elsewhere."""

    def __init__(self, console: Console, total: int) -> None:
        self._console, self._total, self._done = console, total, 0
        self._bar: Progress | None = None
        if console.is_terminal:
            self._bar = Progress(
                SpinnerColumn(), BarColumn(bar_width=28), TextColumn("{task.description}"), TimeElapsedColumn(),
                console=console, transient=True,
            )  # fmt: skip
            self._task = self._bar.add_task("", total=total)

    def __enter__(self) -> Self:
        """Show the bar."""
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()

    @contextmanager
    def step(self, words: str) -> Iterator[Tell]:
        """One of the steps; call what this yields with the part that is done, and more words."""
        if self._bar is None:
            self._console.print(f"[{self._done + 1}/{self._total}] {words}", markup=False, highlight=False)

        def tell(part: float, more: str = "") -> None:
            if self._bar is not None:
                self._bar.update(
                    self._task, completed=self._done + min(part, 1.0), description=f"{words} {more}".strip()
                )

        tell(0.0)
        with install_listener("numba:compile", _Compilation(tell)):
            yield tell
        self._done += 1
        tell(0.0)


class _Compilation(Listener):
    """Tells which kernel is being compiled: that takes most of the first run."""

    USUAL = 110
    """Kernels that a first run compiles, about."""

    def __init__(self, tell: Tell) -> None:
        self._tell, self._count = tell, 0

    def on_start(self, event: Event) -> None:
        """Say so."""
        self._count += 1
        self._tell(self._count / self.USUAL, f"({self._count}: {event.data['dispatcher'].__name__})")

    def on_end(self, event: Event) -> None:
        """The next step or kernel says what comes."""


@dataclass(frozen=True)
class Found:
    """A log and the stretch of it to replay."""

    path: Path
    options: Mapping[str, Any]


def find_logs(path: Path | None) -> list[Found]:
    """Return the logs to replay: the given one, or those of RELLOC_DATA or ../shared/data beside the project."""
    if path is not None:
        for name, options in LOGS.items():
            if path.name == Path(name).name:
                return [Found(path, options)]
        return [Found(path, {"robots": (1, 2)} if any(path.glob("Robot*_Odometry.dat")) else {})]
    given = os.environ.get("RELLOC_DATA")
    data = Path(given) if given else ROOT.parent / "shared" / "data"
    return [Found(data / name, options) for name, options in LOGS.items() if (data / name).is_dir()]


def run(out: Path, *, seed: int = SEED, log: Path | None = None, console: Console | None = None) -> dict[str, Any]:
    """Run everything, write the folder `out`, print the tables, and return what results.json holds.

    Args:
        out: a folder, made where it is missing; files of an earlier run are written over.
        seed: of the random scenario.
        log: folder of a recorded log to replay, instead of those at hand.
        console: where to print.

    Raises:
        LogError: the given log cannot be read.
    """
    console, began = console or Console(), time.perf_counter()
    logs = find_logs(log)
    if log is not None:
        open_logs(logs[0].path, **logs[0].options)
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"version": relloc_env.__version__, "seed": seed}
    # The replays have kernels of their own: they compile and run beside the rest.
    with ProcessPoolExecutor(1, get_context("spawn")) as beside, Steps(console, 4 + len(MOTIONS) + len(logs)) as steps:
        replays = [beside.submit(_replay, found, out) for found in logs]
        with steps.step("Compiling the kernels (once; a minute or two)"):
            warm = relloc_env.parallel_env()
            warm.reset(seed=seed)
            warm.step({agent: np.zeros(2) for agent in warm.agents})
        with steps.step("The paper's experiment") as tell:
            experiment = _paper(tell)
        results["paper_experiment"] = _paper_results(experiment)
        episodes = {}
        for name in MOTIONS:
            with steps.step(f"Motion: {name}") as tell:
                episodes[name] = _motion(name, seed, tell)
        results["motions"] = {name: episode.summary(figures.SUCCESS) for name, episode in episodes.items()}
        with steps.step("Figures"):
            figures.paper_experiment(experiment, load_config(PAPER), out / "paper-experiment.png")
            figures.motions(episodes, load_config(), out / "motions.png")
            figures.information(episodes, out / "information.png")
        with steps.step("Animation"):
            above, below = (episodes[name] for name in ANIMATED)
            rate = FASTER / (above.time[1] - above.time[0])
            figures.animation(above.frames, below.frames, ANIMATED, out / "straight-and-edge.gif", rate)
        results["replays"] = []
        for found, replayed in zip(logs, replays, strict=True):
            with steps.step(f"Recorded robots: {found.path.name}"):
                results["replays"].append(replayed.result())
    results["seconds"] = round(time.perf_counter() - began, 1)
    _write(results, out)
    _print(results, out, console, logs)
    return results


def _paper(tell: Tell) -> Episode:
    env = relloc_env.parallel_env(PAPER)
    return rollout(env, make("paper", Task.of(env)), 0, progress=tell)


def _motion(name: str, seed: int, tell: Tell) -> Episode:
    drawn = name in ANIMATED
    env = relloc_env.parallel_env(render_mode="rgb_array" if drawn else None)
    episode = rollout(env, make(name, Task.of(env)), seed, frames=drawn, progress=tell)
    env.close()
    return episode


def _paper_results(episode: Episode) -> dict[str, Any]:
    """When each robot's depths and the poses settled, beside the paper's times."""
    depth = np.abs(episode.depth_error).max(axis=2)
    return {
        "depth_settled_s": {
            name: _finite(convergence_time(episode.time, depth[:, r], DEPTH_SETTLED))
            for r, name in enumerate(ROBOT_NAMES)
        },
        "depth_settled_paper_s": dict(zip(ROBOT_NAMES, figures.PAPER_TIMES, strict=True)),
        "depth_error_end_m": dict(zip(ROBOT_NAMES, depth[-1].tolist(), strict=True)),
        "position_error_end_m": dict(zip(ROBOT_NAMES, episode.pose_error[-1, :, 0].tolist(), strict=True)),
        "heading_error_end_deg": dict(zip(ROBOT_NAMES, np.degrees(episode.pose_error[-1, :, 1]).tolist(), strict=True)),
    }


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _replay(found: Found, out: Path) -> dict[str, Any]:
    """Replay a stretch of a log into a folder of its own."""
    folder = out / f"replay-{found.path.name}"
    try:
        result = replay(found.path, **found.options, out=folder)
    except (LogError, ValueError) as error:
        return {"path": str(found.path), "error": str(error)}
    heads, rows = result.table()
    shown = [k for k, head in enumerate(heads) if head in REPLAY_HEADS]
    return {
        "path": str(found.path),
        "folder": folder.name,
        "options": result.options,
        "heads": [REPLAY_HEADS[heads[k]] for k in shown],
        "rows": [[row[k] for k in shown] for row in rows],
    }


HEADS = {
    "information_10s_nats": "J, 10 s",
    "information_end_nats": "J, end",
    "bound_reached_s": "bound [s]",
    "position_error_end_m": "position [m]",
    "heading_error_end_deg": "heading [°]",
    "worst_depth_error_end_m": "depth [m]",
    "all_seen_by_all": "in view [%]",
    "path_m": "path [m]",
}
"""Columns of the table of motions, by the names of `Episode.summary`."""
EXPLAINED = """J: information about the relative pose [nats]. bound: when an ideal estimate is within 5 cm and 1.5°.
position, heading, depth: errors at the end, the worst of both robots. More in motions.csv."""
DIGITS = {"bound_reached_s": 1, "position_error_end_m": 3, "worst_depth_error_end_m": 3, "path_m": 1}
REPLAY_HEADS = {
    "estimator": "estimator",
    "tracks": "tracks",
    "initial depth error [m]": "depth, first [m]",
    "final [m]": "last [m]",
    "position [m]": "position [m]",
    "heading [deg]": "heading [°]",
    "NEES": "NEES",
}
"""Columns of a replay that are shown, by their names in replay.json's table."""


def _cell(name: str, value: float | None) -> str:
    if value is None:
        return "never" if name.endswith("_s") else "–"
    return f"{100.0 * value:.0f}" if name == "all_seen_by_all" else f"{value:.{DIGITS.get(name, 2)}f}"


Content = tuple[str, Sequence[str], Sequence[Sequence[str]]]
"""Title, heads and rows of a table."""


def _tables(results: Mapping[str, Any]) -> list[Content]:
    """What is printed, and written to tables.md."""
    paper = results["paper_experiment"]
    rows = [
        [
            name.replace("_", " "),
            _cell("settled_s", paper["depth_settled_s"][name]),
            f"{paper['depth_settled_paper_s'][name]:.0f}",
            f"{paper['depth_error_end_m'][name]:.3f}",
            f"{paper['position_error_end_m'][name]:.3f}",
            f"{paper['heading_error_end_deg'][name]:.2f}",
        ]
        for name in ROBOT_NAMES
    ]
    heads = ["", "depths known [s]", "paper [s]", "depth [m]", "other robot [m]", "heading [°]"]
    tables: list[Content] = [("The paper's experiment", heads, rows)]
    motions = sorted(results["motions"].items(), key=lambda item: -item[1]["information_end_nats"])
    rows = [[name, *(_cell(key, scores[key]) for key in HEADS)] for name, scores in motions]
    tables.append((f"Motions on one scenario (seed {results['seed']})", ["motion", *HEADS.values()], rows))
    for part in results["replays"]:
        title = f"Recorded robots: {Path(part['path']).name}"
        if "error" in part:
            tables.append((title, ["error"], [[part["error"]]]))
        else:
            tables.append((title, part["heads"], part["rows"]))
    return tables


def _write(results: Mapping[str, Any], out: Path) -> None:
    """Write results.json, motions.csv and tables.md."""
    (out / "results.json").write_text(json.dumps(results, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with (out / "motions.csv").open("w", encoding="utf-8", newline="") as file:
        scores = next(iter(results["motions"].values()))
        writer = csv.DictWriter(file, ["motion", *scores])
        writer.writeheader()
        writer.writerows({"motion": name, **row} for name, row in results["motions"].items())
    text = "# What the demonstration found\n"
    for title, heads, rows in _tables(results):
        lines = [heads, ["---"] * len(heads), *rows]
        text += f"\n## {title}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in lines)
    (out / "tables.md").write_text(text, encoding="utf-8")


FILES = {
    "tables.md": "the tables above",
    "paper-experiment.png": "the paper's two robots: paths, depths, poses",
    "motions.png": "paths of each motion over the arena, errors with the bound",
    "information.png": "what each motion tells of the pose",
    "straight-and-edge.gif": "the world and both cameras, two motions from one start",
    "results.json": "everything as data (motions.csv: the scores of the motions)",
}


def _print(results: Mapping[str, Any], out: Path, console: Console, logs: Sequence[Found]) -> None:
    for title, heads, rows in _tables(results):
        table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
        for k, head in enumerate(heads):
            table.add_column(escape(head), justify="left" if k == 0 else "right", no_wrap=k == 0)
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)
        if rows and heads[0] == "motion":
            console.print(EXPLAINED + "\n", style="dim", highlight=False)
    if not logs:
        console.print(WHERE, markup=False, highlight=False)
    console.print(f"\nDone in {results['seconds']:.0f} s. Where to look: {out}/", markup=False, highlight=False)
    replays = {
        f"{part['folder']}/": "errors of the replay over time" for part in results["replays"] if "folder" in part
    }
    for name, words in {**FILES, **replays}.items():
        console.print(f"  {name:<26} {words}", markup=False, highlight=False, soft_wrap=True)
