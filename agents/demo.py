"""The main job: the paper's experiment, a handful of motions on random scenes, recorded robots; a folder of results."""

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console

import relloc_env
from agents import demo_figures as figures
from agents.demo_figures import Curves
from agents.demo_progress import Steps, Tell
from agents.demo_tables import show, write
from agents.playing import SCORES, play
from agents.policy import Task
from agents.registry import make
from agents.rollout import Episode, rollout
from agents.workers import pool
from relloc_env.config import load_config
from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.core import ROBOT_NAMES
from relloc_env.folders import open_folder
from relloc_env.logs import LogError
from relloc_env.metrics import convergence_time
from relloc_env.replay import open_logs, replay
from relloc_env.samples import Float
from relloc_env.wrappers import RecordLog

SCRIPT, POLICY = "edge-two", "learned"
"""The strongest law without learning, and the policy that ships: what is animated, side by side."""
MOTIONS = {
    **{name: name for name in ("stationary", "straight", "back-and-forth", "circle", "sinusoid", "random", SCRIPT)},
    POLICY: "learned:relative-pose",
}
"""Agents that are played, by what they are called."""
ESTIMATORS = ("map-alignment", "cascade")
"""The best of the project's, and the paper's beside it."""
SIMULATED = "simulated"
"""Name of the log that stands in where none is at hand."""
NOISE: Mapping[str, Any] = {"camera": {"pixel_noise": 0.75}, "robot": {"odometry_noise": (0.005, 0.005)}}
"""[px; m/s, rad/s] of a sample, of the log that stands in: that of the paper's experiment reproduced has none."""
EPISODES = 24
"""Starts over which medians are taken."""
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
WHERE = """
No log of real robots was at hand: the replay above is of a simulated one. The authors publish theirs at
  MR.CLAM   http://asrl.utias.utoronto.ca/datasets/mrclam/  (unpack MRCLAM_Dataset7)
  STAR-loc  https://github.com/utiasASRL/starloc  (sequence zigzag_s4)
Then: python -m agents demo --log PATH, or RELLOC_DATA=FOLDER with mrclam/ and starloc/ in it."""


@dataclass(frozen=True)
class Found:
    """A log and the stretch of it to replay."""

    path: Path
    options: Mapping[str, Any]


def find_logs(path: Path | None) -> list[Found]:
    """Return the logs to replay: the given one, or those in the folder RELLOC_DATA."""
    if path is not None:
        for name, options in LOGS.items():
            if path.name == Path(name).name:
                return [Found(path, options)]
        return [Found(path, {"robots": (1, 2)} if any(path.glob("Robot*_Odometry.dat")) else {})]
    given = os.environ.get("RELLOC_DATA")
    if not given:
        return []
    data = Path(given)
    return [Found(data / name, options) for name, options in LOGS.items() if (data / name).is_dir()]


def run(out: Path, *, seed: int = SEED, log: Path | None = None, console: Console | None = None) -> dict[str, Any]:
    """Run everything, write the folder `out`, print the tables, and return what results.json holds.

    Args:
        out: a folder, made where it is missing; files of an earlier run are written over.
        seed: of the first of the random scenes.
        log: folder of a recorded log to replay, instead of those at hand.
        console: where to print.

    Raises:
        LogError: the given log cannot be read.
    """
    console, began = console or Console(), time.perf_counter()
    logs = find_logs(log)
    at_hand = bool(logs)
    if log is not None:
        open_logs(logs[0].path, **logs[0].options)
    out = open_folder(out)
    seeds = range(seed, seed + EPISODES)
    results: dict[str, Any] = {"version": relloc_env.__version__, "seeds": list(seeds), "scores": dict(SCORES)}
    # Replays have kernels of their own: they compile and run beside the rest.
    with (
        TemporaryDirectory() as scratch,
        pool(1) as beside,
        Steps(console, 4 + len(MOTIONS) + (len(logs) or 2)) as steps,
    ):
        replays = [beside.submit(_replay, found, out) for found in logs]
        with steps.step("Compiling the kernels (once; a minute or two)"):
            for estimator in ESTIMATORS:
                warm = relloc_env.parallel_env(estimator=estimator)
                warm.reset(seed=seed)
                warm.step({agent: np.zeros(2) for agent in warm.agents})
        with steps.step("The paper's experiment") as tell:
            experiment = _paper(tell)
        results["paper_experiment"] = _paper_results(experiment)
        if not at_hand:
            with steps.step("Recording a log"):
                logs = [_simulated_log(Path(scratch))]
                replays = [beside.submit(_replay, logs[0], out)]
        curves: dict[str, dict[str, Curves]] = {name: {} for name in MOTIONS}
        results["motions"] = {name: {} for name in MOTIONS}
        for name in MOTIONS:
            with steps.step(f"Motion: {name}") as tell:
                for estimator in ESTIMATORS:
                    scores, curves[name][estimator] = _motion(name, estimator, seeds, tell)
                    results["motions"][name][estimator] = {key: _median(value) for key, value in scores.items()}
        with steps.step("Figures"):
            figures.paper_experiment(experiment, load_config(PAPER), out / "paper-experiment.png")
            figures.motions(curves, load_config(), out / "motions.png")
            figures.information({name: both[ESTIMATORS[0]] for name, both in curves.items()}, out / "information.png")
        with steps.step("Animation") as tell:
            above, below = (_filmed(name, seed, tell) for name in (SCRIPT, POLICY))
            rate = FASTER / (above.time[1] - above.time[0])
            figures.animation(above.frames, below.frames, (SCRIPT, POLICY), out / "script-and-policy.mp4", rate)
        results["replays"] = []
        for found, replayed in zip(logs, replays, strict=True):
            with steps.step(f"Replay of a log: {found.path.name}"):
                results["replays"].append(replayed.result())
    results["seconds"] = round(time.perf_counter() - began, 1)
    write(results, out)
    show(results, out, console)
    if not at_hand:
        console.print(WHERE, markup=False, highlight=False, soft_wrap=True)
    return results


def _paper(tell: Tell) -> Episode:
    env = relloc_env.parallel_env(PAPER)
    return rollout(env, make("paper", Task.of(env)), 0, progress=tell)


def _motion(name: str, estimator: str, seeds: Sequence[int], tell: Tell) -> tuple[dict[str, Float], Curves]:
    return play(load_config(estimator=estimator), lambda task: make(MOTIONS[name], task), seeds, progress=tell)


def _median(values: Float) -> float | None:
    """Over the episodes; None for a time that did not come in half of them."""
    return _finite(np.median(values))


def _filmed(name: str, seed: int, tell: Tell) -> Episode:
    env = relloc_env.parallel_env(estimator=ESTIMATORS[0], render_mode="rgb_array")
    episode = rollout(env, make(MOTIONS[name], Task.of(env)), seed, frames=True, progress=tell)
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
    return {"path": str(found.path), "folder": folder.name, "options": result.options, "heads": heads, "rows": rows}


def _simulated_log(folder: Path) -> Found:
    """Record the paper's experiment, with noise, as a log."""
    env = RecordLog(RellocEnv(PAPER, **NOISE), folder)
    task = Task.of(env)
    policy = make("paper", task)
    policy.reset(1, 0)
    observation, _ = env.reset(seed=0)
    ended = False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(policy.act(task.rows(observation)).ravel())
        ended = terminated or truncated
    env.close()
    return Found((folder / "episode_000").rename(folder / SIMULATED), {})
