"""What two robots can tell of each other from one common point, and from two."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Circle

from docs.figures.style import MUTED, POINT, ROBOT, page, plan, robot
from relloc_env.samples import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

A, B = np.array([-0.4, 0.8, np.radians(52.0)]), np.array([3.6, 0.4, np.radians(115.0)])
POINTS = np.array([[1.2, 3.4], [3.0, 4.2]])


def draw(path: Path) -> None:
    """One point, and then two."""
    with page(path, 3.9) as figure:
        one, two = figure.subplots(1, 2)
        _scene(one, POINTS[:1])
        _circle(one, POINTS[0])
        one.set_title("one common point:\nB is somewhere on a circle")
        _scene(two, POINTS)
        frame = {"arrowstyle": "->", "color": MUTED, "lw": 1.4}
        two.annotate("", B[:2], A[:2], arrowprops=frame)
        two.text(1.6, 0.4, "r", ha="center", va="top", color=MUTED)
        two.set_title("two:\nplace and heading are fixed")
        for axes in (one, two):
            plan(axes)
            axes.set(xlim=(-3.1, 5.5), ylim=(-0.9, 7.7))


def _scene(axes: "Axes", points: Float) -> None:
    for r, pose in enumerate((A, B)):
        name, colour, side = "AB"[r], ROBOT[r], ("right", "left")[r]
        robot(axes, pose, r)
        axes.text(pose[0], pose[1] - 0.45, name, ha="center", va="top", color=colour, weight="bold")
        for i, point in enumerate(points):
            axes.plot(*np.transpose([pose[:2], point]), color=colour, lw=1.4)
            x, y = pose[:2] + (0.45 + 0.12 * i) * (point - pose[:2])
            axes.text(x + (-0.15, 0.15)[r], y, f"q$_{{{name}{i + 1}}}$", ha=side, va="center", color=colour)
    for i, point in enumerate(points):
        axes.plot(*point, "o", color=POINT[i], ms=9, zorder=6)


def _circle(axes: "Axes", point: Float) -> None:
    """Where B may be, and a few poses of it."""
    axes.add_patch(
        Circle((point[0], point[1]), float(np.hypot(*(B[:2] - point))), fill=False, color=MUTED, lw=1.0, ls="--")
    )
    for x, y, heading in alike():
        nose = np.array([np.cos(heading), np.sin(heading)])
        axes.add_patch(Circle((x, y), 0.22, fill=False, color=ROBOT[1], lw=1.5, zorder=5))
        axes.plot(*np.transpose([[x, y] + 0.22 * nose, [x, y] + 0.37 * nose]), color=ROBOT[1], lw=1.5)


def alike() -> Float:
    """Poses that see the first point where B sees it: B's, turned about the point."""
    turns, away = np.radians([50.0, 110.0, 175.0]), B[:2] - POINTS[0]
    rotated = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) @ away for a in turns]
    return np.column_stack([POINTS[0] + rotated, B[2] + turns])


def seen_from(pose: Float, point: Float) -> Float:
    """A point in the body frame of a pose, (ahead, left) [m]."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(np.array([[cos, sin], [-sin, cos]]) @ (point - pose[:2]))
