"""Ways over the arena, from above, as SVG in metres: a few episodes of each agent."""

import math
from collections.abc import Sequence

import numpy as np

from agents.results import Result
from relloc_env.config import EnvConfig
from relloc_env.rendering import robot_colour, target_colours
from relloc_env.samples import Float

SHOWN = 3
"""Episodes of each agent."""
EVERY = 3
"""Actions between two corners of a way."""
ROOM = 0.5
"""[m] around everything."""
STAR = 5
"""Points of a target's star."""


def maps(results: Sequence[Result], config: EnvConfig) -> dict[str, list[str]]:
    """SVG of the first episodes of each agent; an episode shows the same part of the world for all agents.

    Args:
        results: of agents on one suite.
        config: of the suite's first variant, of which the ways are.
    """
    drawn: dict[str, list[str]] = {result.job.agent: [] for result in results}
    for k in range(min(SHOWN, len(results[0].ways))):
        points = results[0].points[k]
        everywhere = [result.ways[k, :, :, :2].reshape(-1, 2) for result in results]
        frame = _frame(np.concatenate([*everywhere, points[:, :2]]))
        for result in results:
            drawn[result.job.agent].append(_map(result.ways[k], points, config, frame))
    return drawn


def _map(ways: Float, points: Float, config: EnvConfig, frame: tuple[float, float, float]) -> str:
    """One episode.

    Args:
        ways: [m, m, rad] (T, R, 3).
        points: [m] (M, 3).
        config: of the episode.
        frame: [m] left, top (downwards) and side of the square that is shown.
    """
    left, top, side = frame
    unit = side / 100.0
    parts = [f'<svg class="map" viewBox="{left:.2f} {top:.2f} {side:.2f} {side:.2f}" aria-hidden="true">']
    if config.arena is not None:
        x, y = 0.5 * config.arena[0], 0.5 * config.arena[1]
        room = f'x="{-x:g}" y="{-y:g}" width="{2 * x:g}" height="{2 * y:g}"'
    else:
        room = f'x="{left:.2f}" y="{top:.2f}" width="{side:.2f}" height="{side:.2f}"'
    columns, rows = (range(math.ceil(low), math.floor(low + side) + 1) for low in (left, top))
    metres = [f"M{x} {top:.2f}v{side:.2f}" for x in columns] + [f"M{left:.2f} {y}h{side:.2f}" for y in rows]
    parts += [f'<rect class="floor" {room}/>', f'<path class="metres" d="{"".join(metres)}"/>']
    if config.arena is not None:
        parts.append(f'<rect class="walls" {room}/>')
    for obstacle in config.obstacles:
        x, y = obstacle.position
        if obstacle.shape == "disc":
            parts.append(f'<circle class="pillar" cx="{x:g}" cy="{-y:g}" r="{obstacle.radius:g}"/>')
        else:
            width, depth = obstacle.size
            turned = f'transform="rotate({-np.degrees(obstacle.angle):.1f} {x:g} {-y:g})"'
            box = f'x="{x - 0.5 * width:.2f}" y="{-y - 0.5 * depth:.2f}" width="{width:g}" height="{depth:g}"'
            parts.append(f'<rect class="pillar" {box} {turned}/>')
    for r in range(ways.shape[1]):
        parts += _way(ways[:, r], _hex(robot_colour(r)), unit, config.camera_of(r).half_view)
    for (x, y, _), rgb in zip(points, target_colours(len(points)), strict=True):
        parts.append(f'<path class="star" d="{_star(x, -y, 3.4 * unit)}" fill="{_hex(tuple(rgb))}"/>')
    return "".join([*parts, "</svg>"])


def _way(way: Float, colour: str, unit: float, half_view: float) -> list[str]:
    """A line with a ring at its start, a dot at its end, and the view from there."""
    corners = " ".join(f"{x:.2f},{-y:.2f}" for x, y, _ in [*way[:-1:EVERY], way[-1]])
    (x, y, _), (x_end, y_end, angle) = way[0], way[-1]
    reach = 14.0 * unit
    edges = [(x_end + reach * np.cos(a), y_end + reach * np.sin(a)) for a in (angle - half_view, angle + half_view)]
    view = " ".join(f"{a:.2f},{-b:.2f}" for a, b in ((x_end, y_end), *edges))
    return [
        f'<polygon points="{view}" fill="{colour}" opacity=".22"/>',
        f'<polyline points="{corners}" stroke="{colour}" fill="none"/>',
        f'<circle class="start" cx="{x:.2f}" cy="{-y:.2f}" r="{1.7 * unit:.2f}" stroke="{colour}"/>',
        f'<circle cx="{x_end:.2f}" cy="{-y_end:.2f}" r="{2.2 * unit:.2f}" fill="{colour}"/>',
    ]


def _frame(xy: Float) -> tuple[float, float, float]:
    """Left, top (downwards) and side of a square around all places (K, 2), [m]."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    side = float((high - low).max()) + 2.0 * ROOM
    x, y = 0.5 * (low + high)
    return float(x) - 0.5 * side, -float(y) - 0.5 * side, side


def _star(x: float, y: float, size: float) -> str:
    angles = np.pi * np.arange(2 * STAR) / STAR - 0.5 * np.pi
    radii = size * np.where(np.arange(2 * STAR) % 2, 0.45, 1.0)
    corners = zip(x + radii * np.cos(angles), y + radii * np.sin(angles), strict=True)
    return "M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in corners) + "Z"


def _hex(rgb: tuple[int, ...]) -> str:
    return "#" + "".join(f"{int(part):02x}" for part in rgb)
