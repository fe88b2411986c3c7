"""Which motions show how far away a point is: four ways to drive, and three distances that one image leaves open."""

from pathlib import Path

import numpy as np

from docs.figures.style import INK, MUTED, page, plan, robot
from relloc_env.kernels.motion import advance, relative
from relloc_env.samples import Float

BEARING, DISTANCES = np.radians(20.0), (2.0, 3.0, 5.0)  # [rad], [m]
MOTIONS = (
    ("stand", 0.0, 0.0, BEARING),
    ("turn", 0.0, 0.2, BEARING),
    ("drive at it", 0.3, 0.0, 0.0),
    ("drive past it", 0.3, 0.0, BEARING),
)
"""Name, speed [m/s], yaw rate [rad/s], bearing of the point [rad]."""
SECONDS, STEPS = 4.0, 41
COLOURS = ("#1b9e77", "#d95f02", "#7570b3")


def candidates(bearing: float) -> Float:
    """[m] (3, 2) places on one ray from the origin."""
    return np.outer(DISTANCES, [np.cos(bearing), np.sin(bearing)])


def images(v: float, w: float, points: Float) -> Float:
    """[-] (T, 3) horizontal image coordinate of each candidate over time."""
    seen = np.zeros((STEPS, len(points)))
    for k, time in enumerate(np.linspace(0.0, SECONDS, STEPS)):
        pose = advance(0.0, 0.0, 0.0, v, 0.0, w, time)
        for i, (x, y) in enumerate(points):
            ahead, left, _ = relative(pose[0], pose[1], pose[2], x, y, 0.0)
            seen[k, i] = -left / ahead
    return seen


def draw(path: Path) -> None:
    """Above each way to drive with the three candidates, below their images over time."""
    time = np.linspace(0.0, SECONDS, STEPS)
    with page(path, 4.3) as figure:
        above, below = figure.subplots(2, len(MOTIONS), height_ratios=(1.0, 1.35))
        for k, (name, v, w, bearing) in enumerate(MOTIONS):
            points, chart, field = candidates(bearing), below[k], above[k]
            plan(field)
            field.set(xlim=(-2.1, 1.0), ylim=(-0.7, 5.5), title=name)
            # Drawn with the robot's heading up.
            field.plot([0.0, -points[-1, 1]], [0.0, points[-1, 0]], color=MUTED, lw=0.8, ls=":")
            poses = np.array([advance(0.0, 0.0, 0.0, v, 0.0, w, t) for t in time])
            field.plot(-poses[:, 1], poses[:, 0], color=INK, lw=1.2)
            robot(field, (0.0, 0.0, np.pi / 2), size=0.28)
            if v or w:
                robot(field, (-poses[-1, 1], poses[-1, 0], np.pi / 2 + poses[-1, 2]), size=0.28)
            seen = images(v, w, points)
            for i, distance in enumerate(DISTANCES):
                field.plot(-points[i, 1], points[i, 0], "o", color=COLOURS[i], ms=6, zorder=6)
                style = {0: "-", 1: "--", 2: ":"}[i]
                chart.plot(time, seen[:, i], style, color=COLOURS[i], lw=2.4, label=f"{distance:g} m away")
            chart.set(xlabel="time [s]", ylim=(-1.0, 0.75), xticks=(0, 2, 4))
            if k:
                chart.tick_params(labelleft=False)
        below[0].set_ylabel("image x of the point [-]")
        figure.legend(*below[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
