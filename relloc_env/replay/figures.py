"""Figures of a replay, drawn from its results."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from relloc_env.extras import extra
from relloc_env.files import whole
from relloc_env.rendering.geometry import ellipse
from relloc_env.replay import scores
from relloc_env.samples import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from relloc_env.replay.run import ReplayResult, Run

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b", "#e377c2", "#17becf")
LONGEST_GAP = 2.0
"""[s] lines are broken at longer gaps between sights."""
INSTANTS = 8
"""Number of instants at which the claimed ellipses are drawn."""
AROUND = 1.0
"""[m] shown around the true places."""
LARGEST = (2.0, 2.0, 60.0)
"""[m, m, deg] greatest errors shown."""
FITTED = 0.95
"""Part of the seconds in which the best estimator's errors and claims are within the picture."""


def draw(result: "ReplayResult", folder: Path) -> list[Path]:
    """Draw depth errors of all tracks, and per log pose errors, ellipses, and consistency; return the files."""
    written = []
    if any(run.tracks for runs in result.runs.values() for run in runs):
        written.append(_save(_depth(result), folder / "depth_error.png"))
    for i, first in enumerate(next(iter(result.runs.values()))):
        if first.poses:
            label = "" if len(result.runs[first.estimator]) == 1 else "_" + "_".join(first.log.robots)
            runs = [runs[i] for runs in result.runs.values()]
            written.append(_save(_pose(runs), folder / f"pose_error{label}.png"))
            written.append(_save(_places(runs), folder / f"ellipses{label}.png"))
            written.append(_save(_consistency(runs), folder / f"consistency{label}.png"))
    return written


def _figure(width: float, height: float) -> "Figure":
    with extra("logs"):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: "Figure", path: Path) -> Path:
    with whole(path) as partial:
        figure.savefig(partial, dpi=110)
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
            axis.axhline(summary["median_final_error_m"], color="black", ls="--", lw=1.2)
            title += (
                f"\nmedian {summary['median_initial_error_m']:.2f} → {summary['median_final_error_m']:.2f} m (dashed)"
            )
        axis.set(title=title, xlabel="time since first sight [s]", yscale="log", ylim=(1e-2, 10.0))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("size of the depth error [m]")
    return figure


def _broken(time: Float, value: Float) -> tuple[Float, Float]:
    """Insert NaN where a gap is too long for a line across."""
    gaps = np.flatnonzero(np.diff(time) > LONGEST_GAP) + 1
    return np.insert(time, gaps, np.nan), np.insert(value, gaps, np.nan)


def _pose(runs: "list[Run]") -> "Figure":
    """Errors of the first ordered pair with the claimed 2 sigma, where an estimate exists."""
    figure = _figure(11.0, 7.0)
    axes = figure.subplots(3, 1, sharex=True)
    log = runs[0].log
    at = scores.by_second(log.time)
    unit = np.array([1.0, 1.0, np.degrees(1.0)])
    sizes = []
    for colour, run in zip(COLOURS, runs, strict=False):
        errors = run.poses[0]
        shown = errors.exists[at, None]
        error = np.where(shown, unit * errors.error[at], np.nan)
        variance = np.maximum(np.diagonal(errors.covariance[at], axis1=1, axis2=2), 0.0)
        sd = np.where(shown, unit * np.sqrt(variance), np.nan)
        for j, axis in enumerate(axes):
            axis.fill_between(log.time[at], -2.0 * sd[:, j], 2.0 * sd[:, j], color=colour, alpha=0.15, lw=0)
            axis.plot(log.time[at], error[:, j], color=colour, lw=1.0, label=run.estimator)
        if shown.any():
            reach = np.maximum(np.abs(error), 2.0 * sd)
            sizes.append(np.nanquantile(reach, FITTED, axis=0))
    fitted = np.min(sizes, axis=0) if sizes else np.array(LARGEST)
    for axis, name, size, largest in zip(axes, ("x [m]", "y [m]", "heading [deg]"), fitted, LARGEST, strict=True):
        limit = min(max(1.25 * float(np.nan_to_num(size, nan=largest)), largest / 50.0), largest)
        axis.axhline(0.0, color="black", lw=0.6)
        axis.set(ylabel=f"error in {name}", ylim=(-limit, limit))
        axis.grid(alpha=0.3)
    axes[0].set_title(f"{log.name}: pose of {log.robots[1]} in the frame of {log.robots[0]}")
    axes[-1].set_xlabel("time [s]; bands: claimed ± 2σ; the range fits the best estimator")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _places(runs: "list[Run]") -> "Figure":
    """Where the observer puts the other robot at some instants, with the claimed 2 sigma ellipse, beside the truth."""
    log = runs[0].log
    truth = log.truth
    assert truth is not None
    with extra("logs"):
        from matplotlib import colormaps

    figure = _figure(5.5 * len(runs), 6.0)
    axes = figure.subplots(1, len(runs), sharex=True, sharey=True, squeeze=False)[0]
    way = truth.relative[:, 0, :2]
    some = np.flatnonzero(np.any([run.poses[0].exists for run in runs], axis=0) & np.isfinite(way).all(axis=1))
    chosen = some[np.linspace(0, len(some) - 1, min(INSTANTS, len(some))).round().astype(int)] if len(some) else some
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, max(len(chosen), 1)))
    for axis, run in zip(axes, runs, strict=True):
        axis.plot(*way.T, color="grey", lw=0.8, alpha=0.4, label="truth, whole track")
        for k, colour in zip(chosen, colours, strict=False):
            errors = run.poses[0]
            axis.plot(*way[k], "+", color=colour, ms=9, mew=1.8, label=f"{log.time[k]:.0f} s")
            if errors.exists[k]:
                mean = run.trace.pose[k, 0, :2]
                region = ellipse(mean, errors.covariance[k, :2, :2])
                axis.fill(*region.T, color=colour, alpha=0.12, lw=0)
                axis.plot(*np.concatenate([region, region[:1]]).T, color=colour, lw=1.2)
                axis.plot(*np.stack([mean, way[k]]).T, color=colour, lw=0.8, ls=":")
                axis.plot(*mean, ".", color=colour, ms=6)
        axis.set(title=run.estimator, xlabel=f"ahead of {log.robots[0]} [m]")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(f"left of {log.robots[0]} [m]")
    if len(chosen):
        low, high = np.nanmin(way[chosen], axis=0), np.nanmax(way[chosen], axis=0)
        middle, half = 0.5 * (low + high), 0.5 * float((high - low).max()) + AROUND
        axes[0].set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    for axis in axes:
        axis.set_aspect("equal")
    figure.suptitle(f"{log.name}: where {log.robots[0]} puts {log.robots[1]}\n+ truth, dot and ellipse: estimate, 2σ")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 5), frameon=False)
    return figure


def _consistency(runs: "list[Run]") -> "Figure":
    """NEES with its band, and where there is a bound the whitened error with its own."""
    log = runs[0].log
    ratios = [run.poses[0].ratio for run in runs]
    bounded = all(ratio is not None for ratio in ratios)
    figure = _figure(11.0, 6.0 if bounded else 3.8)
    axes = figure.subplots(2 if bounded else 1, 1, sharex=True, squeeze=False)[:, 0]
    at = scores.by_second(log.time)
    for colour, run, ratio in zip(COLOURS, runs, ratios, strict=False):
        errors = run.poses[0]
        _strip(axes[0], log.time[at], np.where(errors.exists[at], errors.nees[at], np.nan), colour, run.estimator, 1e3)
        if ratio is not None and bounded:
            shown = np.where(errors.exists[at], ratio[at], np.nan)
            _strip(axes[1], log.time[at], shown, colour, run.estimator, 1e2)
    for axis, band, middle, name in zip(
        axes,
        (scores.NEES_BAND, scores.RATIO_BAND),
        (scores.NEES_MEDIAN, np.sqrt(scores.NEES_MEDIAN / 3.0)),
        ("NEES (error over claim)", "error over bound"),
        strict=False,
    ):
        axis.axhspan(*band, color="grey", alpha=0.2, lw=0, label="95 % where all is right")
        axis.axhline(middle, color="grey", ls="--", lw=1.0, label="its median")
        axis.set(yscale="log", ylabel=name)
        axis.grid(alpha=0.3)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    axes[-1].set_xlabel("time [s]" if bounded else "time [s]\nno error over bound: the noise is not stated")
    figure.suptitle(f"{log.name}: pose of {log.robots[1]} in the frame of {log.robots[0]}")
    return figure


def _strip(axis: "Axes", time: Float, value: Float, colour: str, name: str, top: float) -> None:
    """One line on a logarithmic axis that ends at `top`; what is above lies on the edge, and its median is told."""
    known = value[np.isfinite(value)]
    median = float(np.median(known)) if known.size else 0.0
    words = f"{name}, median {median:,.0f}" if median >= 100.0 else f"{name}, median {median:.2g}"
    words = words if known.size else f"{name}: none"
    beyond = float(np.mean(known > top)) if known.size else 0.0
    if beyond > 0.0:
        words += f"\n({100.0 * beyond:.0f} % above {top:.0f})"
    axis.plot(time, np.minimum(value, 0.8 * top), color=colour, lw=1.0, label=words)
    axis.set_ylim(1e-2, top)
