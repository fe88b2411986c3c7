"""Figures of the demonstration, drawn from its episodes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.playing import POSE, quartiles
from agents.rollout import Episode, Frame
from relloc_env.config import EnvConfig
from relloc_env.extras import extra
from relloc_env.files import whole
from relloc_env.rendering import robot_colour, target_colours
from relloc_env.rendering.animation import save_animation
from relloc_env.samples import Float

with extra("agents"):
    import matplotlib as mpl
    from matplotlib import font_manager
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch, Wedge
    from matplotlib.path import Path as Outline
    from PIL import Image, ImageDraw, ImageFont


STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.constrained_layout.use": True,
}
GREY = "#767676"
LINES = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7", "#8C6D31")
"""Okabe and Ito's colours, told apart by all."""
PAPER_TIMES = (13.0, 25.0)
"""[s] after which the depths of robots A and B have converged in the paper's experiment."""
Curves = dict[str, Float]
"""What `playing.play` keeps over time."""

HEADLINE = 30
"""[px] height of the line with a name."""
PAGE = (250, 250, 248)
PAUSE = 2.5
"""[s] that the last picture of the animation stays."""


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def _colour(rgb: tuple[int, int, int]) -> tuple[float, float, float]:
    red, green, blue = (part / 255.0 for part in rgb)
    return red, green, blue


def paper_experiment(episode: Episode, config: EnvConfig, path: Path) -> None:
    """Paths, depth errors, and errors of the relative pose of the paper's experiment."""
    with mpl.rc_context(STYLE):
        figure = _figure(10.0, 6.4)
        figure.suptitle(
            "The paper's experiment (consistent with its times, for which the targets were placed)",
            x=0.01, ha="left",
        )  # fmt: skip
        axes = figure.subplots(2, 2)
        _map(axes[0, 0], episode.poses, episode.points, config)
        axes[0, 0].set_title("Paths (ring: start), views at both ends; targets 1, 2")
        _depths(axes[0, 1], episode)
        for j, (axis, unit, name) in enumerate(
            zip(axes[1], (1.0, 180.0 / np.pi), ("Position", "Heading"), strict=True)
        ):
            for p, label in enumerate(("A's belief of B", "B's belief of A")):
                axis.plot(episode.time, unit * episode.pose_error[:, p, j], color=_colour(robot_colour(p)), label=label)
            axis.set(
                title=f"{name} of the other robot", xlabel="time [s]", ylabel=f"error [{'m' if j == 0 else 'deg'}]"
            )
            axis.set(yscale="log", ylim=(0.01, 20.0) if j == 0 else (0.05, 200.0))
            axis.legend(loc="upper right")
        with whole(path) as partial:
            figure.savefig(partial, dpi=130)


def _depths(axis: Axes, episode: Episode) -> None:
    for r in range(episode.poses.shape[1]):
        colour = _colour(robot_colour(r))
        for i in range(len(episode.points)):
            label = f"robot {'AB'[r]}, target {i + 1}"
            axis.plot(episode.time, episode.depth_error[:, r, i], color=colour, ls=("-", "--")[i % 2], label=label)
        axis.axvline(PAPER_TIMES[r], color=colour, lw=1.0, ls=":")
        axis.annotate(
            f"paper: {PAPER_TIMES[r]:g} s", (PAPER_TIMES[r], 1.0), xytext=(3, -8), textcoords="offset points",
            xycoords=("data", "axes fraction"), fontsize=8.0, color=colour,
        )  # fmt: skip
    axis.axhline(0.0, color=GREY, lw=0.8)
    axis.set(title="Depth estimates", xlabel="time [s]", ylabel="error [m]")
    axis.legend(loc="center right")


def _map(axis: Axes, poses: Float, targets: Float, config: EnvConfig, *, reach: float = 1.6) -> None:
    """The world from above: walls, targets, paths with their views at the start and at the end."""
    xy = np.concatenate([poses[..., :2].reshape(-1, 2), targets[:, :2]])
    for r in range(poses.shape[1]):
        colour, track = _colour(robot_colour(r)), poses[:, r]
        half = np.degrees(config.camera_of(r).half_view)
        for k, alpha in ((0, 0.12), (-1, 0.3)):
            x, y, angle = track[k]
            middle = np.degrees(angle)
            view = axis.add_patch(Wedge((x, y), reach, middle - half, middle + half, color=colour, alpha=alpha, lw=0.0))
            if config.arena is not None:
                view.set_clip_path(_floor(config.arena), axis.transData)
        axis.plot(track[:, 0], track[:, 1], color=colour, lw=1.4, solid_joinstyle="round")
        axis.plot(*track[0, :2], "o", color="white", mec=colour, mew=1.4, ms=5.0, zorder=3)
        axis.plot(*track[-1, :2], "o", color=colour, ms=5.5, zorder=3)
        axis.annotate(
            "AB"[r],
            (track[0, 0], track[0, 1]),
            xytext=(-9, -9),
            textcoords="offset points",
            color=colour,
            weight="bold",
            fontsize=8.0,
        )
    for i, ((x, y, _), rgb) in enumerate(zip(targets, target_colours(len(targets)), strict=True)):
        axis.plot(x, y, "*", color=_colour(rgb), mec="white", mew=0.6, ms=13.0, zorder=4)
        axis.annotate(f"{i + 1}", (x, y), xytext=(6, 5), textcoords="offset points", color=GREY, fontsize=8.0)
    low, high = xy.min(axis=0), xy.max(axis=0)
    if config.arena is not None:
        low = -0.5 * np.array(config.arena)
        high = -low
        axis.add_patch(PathPatch(_floor(config.arena), fill=False, ec="#787C80", lw=1.2))
    pad = 0.04 * float((high - low).max())
    axis.set_aspect("equal")
    axis.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad), xlabel="x [m]", ylabel="y [m]")


def _floor(arena: tuple[float, float]) -> Outline:
    x, y = 0.5 * arena[0], 0.5 * arena[1]
    return Outline([(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)], closed=True)


def motions(curves: Mapping[str, Mapping[str, Curves]], config: EnvConfig, path: Path) -> None:
    """For each motion, its paths from the first start; below, median errors of the relative pose with the bound.

    Args:
        curves: by motion and estimator; the paths and the bound are those of the first estimator.
        config: of the environment.
        path: file to write.
    """
    with mpl.rc_context(STYLE):
        figure = _figure(2.35 * len(curves), 7.2)
        episodes = len(next(iter(next(iter(curves.values())).values()))["information"])
        figure.suptitle(
            f"Paths from one start (ring: start, dot: end); A's errors of B, quartiles of {episodes} starts",
            x=0.01, ha="left",
        )  # fmt: skip
        axes = figure.subplots(3, len(curves), sharex="row", sharey="row", squeeze=False)
        for column, (name, both) in enumerate(curves.items()):
            first = next(iter(both.values()))
            _map(axes[0, column], first["ways"][0], first["points"][0], config)
            axes[0, column].set(title=name)
            if column:
                axes[0, column].set(ylabel="")
            for j, kind in enumerate(("position", "heading")):
                axis = axes[1 + j, column]
                for colour, (label, one) in zip((_colour(robot_colour(0)), "#B0B0B0"), both.items(), strict=True):
                    low, middle, high = quartiles(one[f"{kind}_error"])
                    axis.plot(one["time"], middle, color=colour, label=label)
                    axis.fill_between(one["time"], low, high, color=colour, alpha=0.2, lw=0.0)
                bound = np.median(first[f"{kind}_bound"], axis=0)
                axis.plot(first["time"], bound, color="black", ls="--", lw=1.1, label="bound")
                axis.axhline(POSE[j], color=GREY, lw=0.8, ls=":")
                axis.set(yscale="log", xlim=(0.0, first["time"][-1]))
            axes[2, column].set(xlabel="time [s]")
            for j, mark in enumerate(("5 cm", "1.5°")):
                place = (0.99, POSE[j])
                axes[1 + j, column].annotate(
                    mark, place, xytext=(0, 2), textcoords="offset points", ha="right", color=GREY, fontsize=7.5,
                    xycoords=("axes fraction", "data"),
                )  # fmt: skip
        axes[1, 0].set(ylabel="position error [m]", ylim=(2e-3, 10.0))
        axes[2, 0].set(ylabel="heading error [deg]", ylim=(2e-2, 200.0))
        handles, labels = axes[1, 0].get_legend_handles_labels()
        figure.legend(handles[:3], labels[:3], loc="upper right", ncols=3, handlelength=1.6)
        with whole(path) as partial:
            figure.savefig(partial, dpi=110)


def information(curves: Mapping[str, Curves], path: Path) -> None:
    """Information J of each motion over time, the median over the starts, named at the end of each line."""
    with mpl.rc_context(STYLE):
        figure = _figure(7.6, 4.4)
        axis = figure.subplots()
        over = {name: np.median(one["information"], axis=0) for name, one in curves.items()}
        last = {name: float(line[-1]) for name, line in over.items()}
        top = max(last.values())
        labels = _apart(sorted(last, key=lambda name: last[name]), last, 0.055 * (top - 1.0))
        for colour, (name, one) in zip(LINES, curves.items(), strict=False):
            end = one["time"][-1]
            axis.plot(one["time"], over[name], color=colour)
            axis.annotate(
                f"{name}  {last[name]:.2f}", (end, last[name]), xytext=(1.03 * end, labels[name]), color=colour,
                va="center", annotation_clip=False,
                arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.6, "relpos": (0.0, 0.5)},
            )  # fmt: skip
        axis.set(xlim=(0.0, end), xlabel="time [s]", ylabel="information J [nats]")
        starts = len(next(iter(curves.values()))["information"])
        axis.set_title(f"What each motion tells of the relative pose (median over {starts} starts; higher is better)")
        with whole(path) as partial:
            figure.savefig(partial, dpi=130)


def _apart(order: list[str], heights: Mapping[str, float], least: float) -> dict[str, float]:
    """Heights of labels from the lowest up, moved so that neighbours are `least` apart."""
    placed: dict[str, float] = {}
    below = -np.inf
    for name in order:
        below = max(heights[name], below + least)
        placed[name] = float(below)
    return placed


def animation(upper: list[Frame], lower: list[Frame], names: tuple[str, str], path: Path, rate: float) -> None:
    """Write an animation of two episodes, one above the other, with their names; `rate` is in frames per second."""
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans:bold"), 18)
    pages = [_page(frames, names, font) for frames in zip(upper, lower, strict=True)]
    save_animation(pages + pages[-1:] * round(PAUSE * rate), path, rate)


def _page(frames: tuple[Frame, ...], names: tuple[str, ...], font: ImageFont.FreeTypeFont) -> Frame:
    size = (frames[0].shape[1], frames[0].shape[0])
    page = Image.new("RGB", (size[0], len(frames) * (size[1] + HEADLINE)), PAGE)
    draw = ImageDraw.Draw(page)
    for k, (frame, name) in enumerate(zip(frames, names, strict=True)):
        top = k * (size[1] + HEADLINE)
        draw.text((12, top + 8), name, fill=(32, 36, 40), font=font)
        page.paste(Image.fromarray(frame), (0, top + HEADLINE))
    return np.asarray(page)
