"""Learning curves of runs, and a table of what their policies are worth: for the eye, and for a page."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from agents.learned import read_card
from relloc_env.extras import extra
from relloc_env.files import whole
from relloc_env.folders import open_file
from train.config import TrainConfig, load
from train.evaluation import Journal
from train.folder import CONFIG, EVALUATION, POLICY

with extra("train"):
    import matplotlib as mpl
    from matplotlib.figure import Figure


COLOUR, MUTED = "#0072B2", "#70757a"
FIRST = 0.1
"""Part of all evaluations that may be below the picture: before anything is learned, scores are far off."""
HEADS = {"information_end": "J at the end [nats]", "information_10s": "J after 10 s", "information_mean": "J, mean"}
"""Columns of the table."""
FLAT = 1e-3
"""Least part of the axis above and below, where all evaluations are the same."""
NONE = "-"
"""In the table, what a card does not say."""


def curves(runs: Sequence[Path], out: Path) -> None:
    """Draw the score of each run over its steps, runs of one configuration in one panel; the median is thick.

    Args:
        runs: folders.
        out: picture to write, in any format that matplotlib has.

    Raises:
        ValueError: a folder without evaluations.
    """
    out = open_file(out)
    found = sorted(((load(run / CONFIG, trust=True), _read(run)) for run in runs), key=lambda each: each[0].name)
    panels = [(name, list(group)) for name, group in groupby(found, key=lambda each: each[0].name)]
    with mpl.rc_context(
        {"font.size": 9.5, "svg.hashsalt": "relloc_env", "axes.spines.top": False, "axes.spines.right": False}
    ):
        columns = min(len(panels), 3)
        rows = -(-len(panels) // columns)
        figure = Figure(figsize=(3.4 * columns, 2.7 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        for axis, (name, group) in zip(axes, panels, strict=False):
            _panel(axis, name, group)
        with whole(out) as partial:
            figure.savefig(partial, metadata={"Date": None} if out.suffix == ".svg" else None)


def _panel(axis: Any, name: str, group: Sequence[tuple[TrainConfig, list[dict[str, Any]]]]) -> None:
    """The runs of one configuration."""
    steps = [np.array([line["steps"] for line in lines]) / 1e6 for _, lines in group]
    scores = [np.array([_number(line["score"]) for line in lines]) for _, lines in group]
    for x, y in zip(steps, scores, strict=True):
        axis.plot(x, y, color=COLOUR, lw=0.8, alpha=0.6)
    length = min(map(len, scores))
    together = np.stack([y[:length] for y in scores])
    axis.fill_between(steps[0][:length], together.min(0), together.max(0), color=COLOUR, alpha=0.15, lw=0.0)
    axis.plot(steps[0][:length], np.median(together, axis=0), color=COLOUR, lw=2.0)
    axis.set(title=name, xlabel="steps [millions]", ylabel=group[0][0].evaluation.score.replace("_", " "))
    last = group[0][1][-1]
    script = _number(last["script_score"])
    if np.isfinite(script):
        axis.axhline(script, color=MUTED, ls="--", lw=1.0)
        axis.annotate(last["script"], (0.99, script), xycoords=("axes fraction", "data"), ha="right",
                      va="bottom", color=MUTED)  # fmt: skip
    everything = np.array([each for each in (*np.concatenate(scores), script) if np.isfinite(each)])
    if len(everything):
        low, high = np.quantile(everything, FIRST), everything.max()
        axis.set_ylim(low - 0.05 * (high - low) - FLAT, high + 0.1 * (high - low) + FLAT)
    axis.grid(color="#e4e6e5")


def table(runs: Sequence[Path]) -> str:
    """Markdown: each run's policy on its test episodes, and paired differences to the best script, with intervals."""
    heads = ["run", *HEADS.values(), "over", *(f"{head}, over it" for head in HEADS.values())]
    lines = [heads, ["---"] * len(heads)]
    for run in runs:
        metrics = read_card(run / POLICY).get("metrics", {})
        scores, over = metrics.get("scores", {}), metrics.get("over_script", {})
        script = f"`{metrics['script']}`" if metrics.get("script") else NONE
        lines.append([
            f"`{run.name}`", *(_interval(scores.get(name)) for name in HEADS),
            script, *(_interval(over.get(name)) for name in HEADS),
        ])  # fmt: skip
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _interval(found: Mapping[str, float | None] | None) -> str:
    """A figure with its interval, as far as there is one."""
    value, low, high = ((found or {}).get(name) for name in ("value", "low", "high"))
    if value is None:
        return NONE
    return f"{value:.2f}" if low is None or high is None else f"{value:.2f} [{low:.2f}, {high:.2f}]"


def _number(value: float | None) -> float:
    """A score of a line; NaN where it was not finite, or there was no script."""
    return float("nan") if value is None else value


def _read(run: Path) -> list[dict[str, Any]]:
    """The evaluations of a run."""
    path = run / EVALUATION
    lines = Journal(path).lines()
    if not lines:
        raise ValueError(f"Argument `runs` must be folders of runs that were evaluated, but {run} is none")
    return lines
