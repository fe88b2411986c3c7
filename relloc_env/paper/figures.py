"""The paper's figures, redrawn from the runs."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from relloc_env.config import load_config
from relloc_env.extras import extra
from relloc_env.files import whole
from relloc_env.paper.geometries import PAPER_TIMES, TIME_TOLERANCE
from relloc_env.paper.runs import CONVERGED, PAPER_GAINS, Run
from relloc_env.paper.studies import (
    ALPHA_LAMBDA_STUDY,
    GAINS,
    H_STUDY,
    Studies,
    gain_name,
    settle_times,
    steady_state,
    steady_state_theory,
)

with extra("logs"):
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Wedge


FORMATS = ("png", "svg")
BLACK, ORANGE, SKY, GREEN, BLUE, RED, PINK = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
"""Okabe and Ito's colours, told apart by all; lines differ in their dashes too."""
GREY = "#767676"
STYLE: Any = {
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "svg.hashsalt": "relloc_env",
    "figure.constrained_layout.use": True,
}


def draw_figures(studies: Studies, out: Path) -> list[Path]:
    """Draw all figures into the folder `out`, each as PNG and SVG, and return their paths."""
    paths: list[Path] = []
    for name, size, draw in (
        ("depth-simulation", (7.2, 2.9), _depth_simulation),
        ("two-robot-simulation", (7.2, 2.9), _two_robot_simulation),
        ("experiment", (7.2, 5.2), _experiment),
        ("experiment-geometry", (5.4, 4.2), _geometry),
        ("gains-and-noise", (7.2, 3.1), _gains_and_noise),
    ):
        with _figure(size) as figure:
            draw(figure, studies)
            for suffix in FORMATS:
                paths.append(out / f"{name}.{suffix}")
                with whole(paths[-1]) as partial:
                    figure.savefig(partial, dpi=200, metadata={"Date": None} if suffix == "svg" else None)
    return paths


@contextmanager
def _figure(size: tuple[float, float]) -> Iterator[Figure]:
    with mpl.rc_context(STYLE):
        yield Figure(figsize=size)


def _axes(figure: Figure, place: tuple[int, int, int], title: str, y: str, x: str = "time [s]") -> Axes:
    axes = figure.add_subplot(*place)
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    return axes


def _depth_simulation(figure: Figure, studies: Studies) -> None:
    run = studies.four
    left = _axes(figure, (1, 2, 1), "(a) four points", "depth error [m]")
    for i, (colour, dashes, width) in enumerate(
        ((BLACK, "-", 1.6), (SKY, "-", 3.2), (BLUE, "--", 1.6), (RED, "-.", 1.6))
    ):
        error = run.tracks[gain_name(PAPER_GAINS)].depth[0, :, 0, i]
        place = [f"{c:g}" for c in ((0, 0, 5), (0, 5, 5), (5, 0, 5), (5, 5, 5))[i]]
        left.plot(run.time, error, dashes, color=colour, lw=width, label=f"p{i + 1} = [{', '.join(place)}] m")
    left.legend(loc="center right")
    right = _axes(figure, (1, 2, 2), "(b) p3, other gains", "depth error [m]")
    styles = {
        (2.5, 120.0): (BLACK, "-"),
        (1.0, 120.0): (ORANGE, "--"),
        (5.0, 120.0): (RED, "--"),
        (10.0, 120.0): (PINK, "--"),
        (2.5, 30.0): (SKY, "-."),
        (2.5, 60.0): (BLUE, "-."),
        (2.5, 480.0): (GREEN, "-."),
    }
    for gains, (colour, dashes) in styles.items():
        error = run.tracks[gain_name(gains)].depth[0, :, 0, 2]
        right.plot(run.time, error, dashes, color=colour, label=f"H = {gains[0]:g}, αΛ = {gains[1]:g}")
    right.legend(loc="upper right")
    for axes, end in ((left, 20.0), (right, 20.0)):
        axes.set_xlim(0.0, end)
        axes.axhspan(-CONVERGED, CONVERGED, color="#F0F0F0", zorder=0)
        axes.set_ylim(-0.3, 1.1)


def _two_robot_simulation(figure: Figure, studies: Studies) -> None:
    run, other = studies.simulation, studies.simulation_off_axis
    lines = (
        (run.tracks["position"], "p1 and p4", BLUE, "-"),
        (other.tracks["position"], "p2 and p4", GREEN, "--"),
        (run.tracks["printed"], "p1 and p4, model as printed", RED, "-."),
    )
    left = _axes(figure, (1, 2, 1), "(a) translation", "error of B in {A} [m]")
    right = _axes(figure, (1, 2, 2), "(b) orientation", "error of B in {A} [deg]")
    for track, label, colour, dashes in lines:
        left.plot(run.time, track.position[0, :, 0], dashes, color=colour, label=label)
        right.plot(run.time, track.heading[0, :, 0], dashes, color=colour, label=label)
    right.legend(loc="center right", bbox_to_anchor=(1.0, 0.5))
    for axes in (left, right):
        axes.set_xlim(0.0, 40.0)
        axes.set_ylim(bottom=0.0)


def _experiment(figure: Figure, studies: Studies) -> None:
    run, noisy = studies.experiment, studies.experiment_noisy
    figure.suptitle(
        "Consistent with the paper's times: the targets were placed for them", fontsize=9.0, x=0.01, ha="left"
    )
    for robot, name in enumerate("AB"):
        axes = _axes(figure, (2, 2, robot + 1), f"({'ab'[robot]}) depths of robot {name}", "depth error [m]")
        axes.axhspan(-CONVERGED, CONVERGED, color="#F0F0F0", zorder=0)
        time = PAPER_TIMES[robot]
        axes.axvspan(time - TIME_TOLERANCE, time + TIME_TOLERANCE, color="#FFF1D0", zorder=0)
        axes.axvline(time, color=ORANGE, lw=1.0)
        axes.annotate(f"paper: {time:g} s", (time, 1.0), xytext=(4, 0), textcoords="offset points", va="top")
        for i, (colour, dashes) in enumerate(((RED, "-"), (BLUE, "--"))):
            error = run.tracks["position"].depth[0, :, robot, i]
            axes.plot(run.time, error, dashes, color=colour, label=f"target {i + 1}")
        axes.set_ylim(-0.2, 1.05)
        axes.legend(loc="center right")
    for place, quantity, title, unit in (
        (3, "position", "(c) translation of B in {A}", "error [m]"),
        (4, "heading", "(d) orientation of B in {A}", "error [deg]"),
    ):
        axes = _axes(figure, (2, 2, place), title, unit)
        many = getattr(noisy.tracks["position"], quantity)[:, :, 0]
        low, high = np.quantile(many, (0.1, 0.9), axis=0)
        axes.fill_between(run.time, low, high, color=SKY, alpha=0.45, lw=0.0, label="position, noisy")
        for model, colour, dashes in (("position", BLUE, "-"), ("velocity", GREEN, "--"), ("printed", RED, "-.")):
            axes.plot(run.time, getattr(run.tracks[model], quantity)[0, :, 0], dashes, color=colour, label=model)
        axes.set_yscale("log")
        axes.set_ylim(*((0.01, 20.0) if quantity == "position" else (0.03, 2e3)))
        if quantity == "heading":
            axes.legend(loc="upper right", title="observation model", title_fontsize=8.0, ncols=2)
    for axes in figure.axes:
        axes.set_xlim(0.0, 40.0)


def _geometry(figure: Figure, studies: Studies) -> None:
    run, config = studies.experiment, load_config("paper-experiment")
    axes = _axes(figure, (1, 1, 1), "Experiment: paths, views (start solid, end dashed)", "y [m]", "x [m]")
    half = math.degrees(config.camera_of(0).half_view)
    for robot, (name, colour) in enumerate((("A", BLUE), ("B", RED))):
        path = run.robots[0, :, robot]
        axes.plot(path[:, 0], path[:, 1], color=colour)
        for k, dashes in ((0, "-"), (-1, "--")):
            x, y, angle = (float(number) for number in path[k])
            middle = math.degrees(angle)
            if k == 0:
                axes.add_patch(Wedge((x, y), 20.0, middle - half, middle + half, color=colour, alpha=0.1, lw=0.0))
            for side in (-half, half):
                edge = math.radians(middle + side)
                ends = (x + 20.0 * math.cos(edge), y + 20.0 * math.sin(edge))
                axes.plot((x, ends[0]), (y, ends[1]), dashes, color=colour, lw=0.7)
            nose = (x + 0.7 * math.cos(angle), y + 0.7 * math.sin(angle))
            axes.plot(x, y, "o", color=colour, ms=6.0)
            axes.annotate("", nose, (x, y), arrowprops={"arrowstyle": "-|>", "color": colour, "shrinkA": 0.0})
        axes.annotate(
            name, (path[0, 0], path[0, 1]), xytext=(-14, -10), textcoords="offset points", color=colour, weight="bold"
        )
    mount = config.camera_of(0).mount_height
    for i, (x, y, z) in enumerate(run.targets):
        axes.plot(x, y, "*", color=BLACK, ms=11.0)
        axes.annotate(f"target {i + 1}\n{z - mount:+.1f} m", (x, y), xytext=(9, -16), textcoords="offset points")
    axes.set_aspect("equal")
    axes.set_xlim(-1.5, 11.5)
    axes.set_ylim(-2.0, 7.5)


def _gains_and_noise(figure: Figure, studies: Studies) -> None:
    left = _axes(
        figure, (1, 2, 1), "(a) speed against noise, p3", "noise of the depth, 20-25 s [m]", "settling time [s]"
    )
    for pairs, colour, marker, label in (
        (tuple((2.5, al) for al in ALPHA_LAMBDA_STUDY), BLUE, "o", "αΛ = 30 … 480, H = 2.5"),
        (tuple((h, 120.0) for h in H_STUDY), RED, "s", "H = 1 … 10, αΛ = 120"),
    ):
        times = [settle_times(studies.four, gain_name(pair))[2] for pair in pairs]
        noise = [steady_state(studies.four_noisy, gain_name(pair), 2) for pair in pairs]
        left.plot(times, noise, marker, ls="-", color=colour, ms=5.0, label=label)
        for pair, time, value in zip(pairs, times, noise, strict=True):
            if pair != PAPER_GAINS:
                text = f"{pair[1]:g}" if marker == "o" else f"H {pair[0]:g}"
                left.annotate(
                    text, (time, value), xytext=(5, 4), textcoords="offset points", fontsize=8.0, color=colour
                )
    theory = [steady_state_theory(studies.four_noisy, pair, 2) for pair in GAINS]
    times = [settle_times(studies.four, gain_name(pair))[2] for pair in GAINS]
    left.plot(times, theory, "x", color=GREY, ms=6.0, label="linear theory")
    left.set_xscale("log")
    left.set_yscale("log")
    left.set_xticks([1, 2, 5, 10], ["1", "2", "5", "10"])
    left.set_xticks([], minor=True)
    left.set_yticks([0.01, 0.03, 0.1], ["0.01", "0.03", "0.1"])
    left.set_yticks([], minor=True)
    left.set_ylim(0.006, 0.2)
    left.legend(loc="upper right")
    right = _axes(figure, (1, 2, 2), "(b) p3, noise in the image, three runs", "depth error [m]")
    for al, colour in ((480.0, ORANGE), (120.0, BLUE), (30.0, BLACK)):
        _runs(right, studies.four_noisy, (2.5, al), colour)
    right.legend(loc="upper right")
    right.set_xlim(0.0, 30.0)
    right.set_ylim(-0.5, 1.1)


def _runs(axes: Axes, run: Run, gains: tuple[float, float], colour: str) -> None:
    """Three noisy runs."""
    for n in range(3):
        error = run.tracks[gain_name(gains)].depth[n, :, 0, 2]
        axes.plot(run.time, error, color=colour, lw=0.9, label=f"αΛ = {gains[1]:g}" if n == 0 else None)
