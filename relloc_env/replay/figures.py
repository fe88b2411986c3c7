"""Figures of a replay, drawn from its results."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from relloc_env.replay import scores
from relloc_env.samples import Float

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from relloc_env.replay.run import ReplayResult, Run

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd")
LONGEST_GAP = 2.0
"""[s] lines are broken at longer gaps between sights."""


def draw(result: "ReplayResult", folder: Path) -> list[Path]:
    """Draw depth errors of all tracks, and per log the pose errors and the NEES; return the files."""
    written = []
    if any(run.tracks for runs in result.runs.values() for run in runs):
        written.append(_save(_depth(result), folder / "depth_error.png"))
    for i, first in enumerate(next(iter(result.runs.values()))):
        if first.poses:
            label = "" if len(result.runs[first.estimator]) == 1 else "_" + "_".join(first.log.robots)
            runs = [runs[i] for runs in result.runs.values()]
            written.append(_save(_pose(runs), folder / f"pose_error{label}.png"))
            written.append(_save(_nees(runs), folder / f"nees{label}.png"))
    return written


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: "Figure", path: Path) -> Path:
    figure.savefig(path, dpi=110)
    return path


def _depth(result: "ReplayResult") -> "Figure":
    figure = _figure(5.5 * len(result.runs), 4.0)
    axes = figure.subplots(1, len(result.runs), sharey=True, squeeze=False)[0]
    for axis, (name, runs) in zip(axes, result.runs.items(), strict=True):
        for run in runs:
            if run.depth is None:
                continue
            error, time = run.depth.error, run.log.time
            for r in range(error.shape[1]):
                for m in range(error.shape[2]):
                    at = np.flatnonzero(np.isfinite(error[:, r, m]))
                    if at.size > 1:
                        since, size = time[at] - time[at[0]], np.abs(error[at, r, m])
                        axis.plot(*_broken(since, size), lw=0.8, alpha=0.7)
        summary = scores.summarise_tracks([track for run in runs for track in run.tracks])
        title = f"{name}: {summary['tracks']} tracks"
        if summary["tracks"]:
            axis.axhline(summary["median_final_error_m"], color="black", ls="--", lw=1.2, label="median at the end")
            axis.legend(loc="upper right")
            title += f", median {summary['median_initial_error_m']:.2f} → {summary['median_final_error_m']:.2f} m"
        axis.set(title=title, xlabel="time since first sight [s]", yscale="log", ylim=(1e-3, 30.0))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("size of the depth error [m]")
    return figure


def _broken(time: Float, value: Float) -> tuple[Float, Float]:
    """Insert NaN where a gap is too long for a line across."""
    gaps = np.flatnonzero(np.diff(time) > LONGEST_GAP) + 1
    return np.insert(time, gaps, np.nan), np.insert(value, gaps, np.nan)


def _pose(runs: "list[Run]") -> "Figure":
    """Errors of the first ordered pair with the claimed 2 sigma, where an estimate exists."""
    figure = _figure(11.0, 6.5)
    axes = figure.subplots(3, 1, sharex=True)
    log = runs[0].log
    limits = (2.0, 2.0, 60.0)
    for colour, run in zip(COLOURS, runs, strict=False):
        errors = run.poses[0]
        at = scores.by_second(log.time)
        time = log.time[at]
        for j, axis in enumerate(axes):
            unit = np.degrees(1.0) if j == 2 else 1.0
            hidden = ~errors.exists[at]
            error = np.where(hidden, np.nan, unit * errors.error[at, j])
            variance = np.where(hidden, 0.0, errors.covariance[at, j, j])
            sd = np.where(hidden, np.nan, unit * np.sqrt(np.maximum(variance, 0.0)))
            axis.fill_between(time, -2.0 * sd, 2.0 * sd, color=colour, alpha=0.15, lw=0)
            axis.plot(time, error, color=colour, lw=1.0, label=run.estimator)
    for axis, name, limit in zip(axes, ("x [m]", "y [m]", "heading [deg]"), limits, strict=True):
        axis.axhline(0.0, color="black", lw=0.6)
        axis.set(ylabel=f"error in {name}", ylim=(-limit, limit))
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", ncols=len(runs))
    axes[0].set_title(f"{log.name}: pose of {log.robots[1]} in the frame of {log.robots[0]}, bands are the claimed 2σ")
    axes[-1].set_xlabel("time [s]")
    return figure


def _nees(runs: "list[Run]") -> "Figure":
    figure = _figure(11.0, 3.5)
    axis = figure.subplots()
    log = runs[0].log
    axis.axhspan(*scores.NEES_BAND, color="grey", alpha=0.2, lw=0, label="95 % of a consistent filter")
    axis.axhline(scores.NEES_MEDIAN, color="grey", ls="--", lw=1.0, label="its median")
    for colour, run in zip(COLOURS, runs, strict=False):
        errors = run.poses[0]
        at = scores.by_second(log.time)
        nees = np.where(errors.exists[at], errors.nees[at], np.nan)
        axis.plot(log.time[at], nees, color=colour, lw=1.0, label=run.estimator)
    axis.set(yscale="log", ylim=(1e-2, 1e8), xlabel="time [s]", ylabel="NEES (3 degrees of freedom)")
    axis.set_title(f"{log.name}: error in units of the claimed covariance")
    axis.grid(alpha=0.3)
    axis.legend(loc="upper right", ncols=2)
    return figure
