"""Every figure of the tables as plain data: what summary.json holds and the page shows."""

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from agents.jobs import Asked
from agents.registry import group
from agents.report.columns import EVERY, J_10, J_END, POSE_SIZE, Figure, figures, shown
from agents.results import Failure, Result, of
from agents.statistics import mean_difference
from relloc_env.config import TASKS
from relloc_env.metrics import nees_band
from relloc_env.scenarios import suite

NEVER = "never"
"""Infinity, in JSON."""


def summarise(asked: Asked, results: Sequence[Result], failed: Sequence[Failure], out: Path) -> dict[str, Any]:
    """Put together all figures of a folder's results.

    Args:
        asked: what the folder was asked for.
        results: what is there.
        failed: what is not, since it raised.
        out: the folder.
    """
    suites: dict[str, Any] = {}
    for name in asked.suites:
        within = of(results, suite=name)
        parts = {
            e: _part(of(within, estimator=e), TASKS[asked.env]) for e in asked.estimators if of(within, estimator=e)
        }
        if parts:
            suites[name] = {"about": suite(name).about, "moves_alike": _alike(within), "estimators": parts}
    ranking, over = _ranking(suites)
    return {
        "command": command(asked, out),
        **asdict(asked),
        "robots": TASKS[asked.env],
        "columns": _columns(TASKS[asked.env]),
        "jobs": len(list(asked.jobs())),
        "done": len(results),
        "failed": [asdict(failure) for failure in failed],
        "nees_band_of_the_mean": nees_band(POSE_SIZE, asked.episodes),
        "ranking": ranking,
        "ranking_over": over,
        "parts": sum(len(part["estimators"]) for part in suites.values()),
        "suites": suites,
    }


def command(asked: Asked, out: Path) -> str:
    """The command that makes the results."""
    options = {
        "env": asked.env,
        "suite": ",".join(asked.suites),
        "agents": ",".join(asked.agents),
        "estimators": ",".join(asked.estimators),
        "episodes": str(asked.episodes),
        "seeds": asked.seeds,
        "out": str(out),
    }
    lines = [f"--{name} {shlex.quote(value)}" for name, value in options.items()]
    lines += [f"--set {shlex.quote(text)}" for text in asked.options]
    return " \\\n  ".join(["python -m agents benchmark", *lines])


def plain(data: Any) -> Any:
    """The same without NaN and infinity, which JSON has not: null and "never"."""
    if isinstance(data, Figure):
        return {k: plain(v) for k, v in asdict(data).items() if k == "value" or not math.isnan(v)}
    if isinstance(data, Mapping):
        return {key: plain(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [plain(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None if math.isnan(data) else NEVER
    return data


def _columns(robots: int) -> dict[str, dict[str, Any]]:
    """What the page calls each figure, in what unit, and by what it multiplies it."""
    found = {}
    for column in shown(EVERY, robots):
        found[column.key] = {
            "head": column.name(robots), "unit": column.unit, "about": column.about(robots), "scale": column.scale,
        }  # fmt: skip
    return found


def _part(results: list[Result], robots: int) -> dict[str, Any]:
    """Figures of the agents of one suite with one estimator, the most informative first."""
    agents: dict[str, Any] = {}
    against = {column.key: _reference(results, column.score) for column in (J_END, J_10)}
    for result in sorted(results, key=lambda r: -float(np.median(r.scores[J_END.score]))):
        found = figures(result, robots)
        for key, other in against.items():
            if other is not None:
                found[f"{key}_difference"] = Figure(*mean_difference(result.scores[key], other.scores[key]))
        agents[result.job.agent] = {
            "group": group(result.job.agent),
            "action_ms": 1e3 * result.act_seconds,
            "figures": found,
        }
    references = {key: other.job.agent for key, other in against.items() if other is not None}
    return {"references": references, "agents": agents}


def _reference(results: list[Result], score: str) -> Result | None:
    """The scripted agent with the greatest mean of a score, if there is one."""
    scripted = [r for r in results if group(r.job.agent) == "scripted"]
    return max(scripted, key=lambda r: float(np.mean(r.scores[score])), default=None)


def _alike(results: list[Result]) -> list[str]:
    """Agents that moved alike under all estimators: those that do not read the estimate."""
    ways: dict[str, list[Any]] = {}
    for result in results:
        ways.setdefault(result.job.agent, []).append(result.ways)
    return [name for name, all_of in ways.items() if all(np.array_equal(all_of[0], one) for one in all_of[1:])]


def _ranking(suites: Mapping[str, Any]) -> tuple[list[str], list[dict[str, str]]]:
    """Agents by their median J at the end, mean over the suites and estimators that all of them have.

    Where all have none in common, mean over what each has.

    Returns:
        The agents' names, the most informative first, and the pairs of suite and estimator that the order is over.
    """
    found: dict[str, dict[tuple[str, str], float]] = {}
    for where, part in suites.items():
        for estimator, one in part["estimators"].items():
            for name, about in one["agents"].items():
                found.setdefault(name, {})[where, estimator] = about["figures"][J_END.key].value
    first = next(iter(found.values()))
    over = [place for place in first if all(place in values for values in found.values())]
    means = {name: float(np.mean([values[k] for k in over or values])) for name, values in found.items()}
    ranked = sorted(means, key=lambda name: -means[name])
    return ranked, [{"suite": place, "estimator": estimator} for place, estimator in over]
