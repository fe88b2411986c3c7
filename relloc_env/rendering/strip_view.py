"""Numbers over time: one strip each, a line per robot, with the band of honest values and the bound."""

import math
from functools import lru_cache

import numpy as np

from relloc_env.rendering.canvas import Box, Canvas
from relloc_env.rendering.scene import Scene, Strip, robot_name
from relloc_env.rendering.theme import Colour, Theme, mix
from relloc_env.samples import Float

_CORNERS = 400


def chart_of(box: Box, letters: float) -> Box:
    """Where the lines of a strip are: below its words, right of the numbers of its axis."""
    left, top, width, height = box
    axis, words = 2.9 * letters, 1.5 * letters
    return left + axis, top + words, width - axis, max(height - words, 4.0)


def window(scene: Scene) -> tuple[float, float]:
    """First and last time [s] of the strips."""
    start = max(scene.time - scene.horizon, 0.0)
    return start, start + scene.horizon


def heights_of(values: Float, span: tuple[float, float]) -> Float:
    """How high values lie on a logarithmic axis, 0 to 1; NaN stays."""
    share = np.log(np.maximum(values, span[0]) / span[0]) / math.log(span[1] / span[0])
    clipped: Float = np.minimum(share, 1.0)
    return clipped


def height_of(value: float, span: tuple[float, float]) -> float:
    """How high a positive value lies on a logarithmic axis, 0 to 1."""
    return min(max(math.log(value / span[0]) / math.log(span[1] / span[0]), 0.0), 1.0)


def draw_frame(canvas: Canvas, box: Box, strip: Strip, theme: Theme, letters: float) -> None:
    """Draw what does not move: the band and a line per decade."""
    left, top, width, height = chart_of(box, letters)
    if strip.band is not None:
        low, high = (top + height * (1.0 - height_of(value, strip.span)) for value in strip.band)
        canvas.rectangle((left, high, width, low - high), band_colour(theme))
    for decade in _decades(strip.span):
        y = top + height * (1.0 - height_of(decade, strip.span))
        canvas.line((left, y), (left + width, y), theme.grid, 1.0)
    canvas.line((left, top + height), (left + width, top + height), mix(theme.page, theme.edge, 0.6), 1.0)


def draw_strip(canvas: Canvas, box: Box, strip: Strip, scene: Scene, theme: Theme, ui: float, letters: float) -> None:
    """Draw the lines so far, the newest numbers, and the words."""
    chart = chart_of(box, letters)
    left, top, width, height = chart
    for decade in _labelled(strip.span, height / letters):
        y = top + height * (1.0 - height_of(decade, strip.span))
        canvas.text(f"{decade:g}", (left - 0.4 * letters, y), 0.85 * letters, theme.muted, anchor=(1.0, 0.5))
    start, end = window(scene)
    first = int(np.searchsorted(strip.time, start))
    step = 1 + (len(strip.time) - first) // _CORNERS
    shown = np.s_[first + (len(strip.time) - 1 - first) % step :: step]
    across = left + width * (strip.time[shown] - start) / (end - start)
    lines = [(line, theme.robot(robot), max(1.5, 1.75 * ui)) for robot, line in enumerate(strip.lines)]
    if strip.bound is not None:
        lines.insert(0, (strip.bound, bound_colour(theme), max(1.0, 1.25 * ui)))
    with canvas.inside((left, top - ui, width, height + 2.0 * ui)):
        for line, colour, thick in lines:
            down = top + height * (1.0 - heights_of(line[shown], strip.span))
            _line(canvas, np.stack([across, down], axis=1), colour, thick)
    _words(canvas, box, strip, theme, letters)


def draw_clock(canvas: Canvas, box: Box, scene: Scene, theme: Theme, letters: float) -> None:
    """Write at the right end of a strip how far the time axis goes."""
    left, top, width, height = chart_of(box, letters)
    if height > 1.5 * letters:
        place, words = (left + width, top + height), f"{window(scene)[1]:.0f} s"
        canvas.text(words, place, 0.85 * letters, theme.muted, anchor=(1.0, 1.0))


def band_colour(theme: Theme) -> Colour:
    """Colour of the band of honest values."""
    return mix(theme.page, theme.muted, 0.25)


def bound_colour(theme: Theme) -> Colour:
    """Colour of the bound."""
    return mix(theme.page, theme.ink, 0.55)


def _line(canvas: Canvas, corners: Float, colour: Colour, width: float) -> None:
    """Draw a line, broken where there is no number, with a dot at its newest one."""
    there = np.isfinite(corners[:, 1])
    if there.all():
        canvas.path(corners, colour, width)
    else:
        for part in np.split(corners, np.flatnonzero(~there)):
            canvas.path(part[np.isfinite(part[:, 1])], colour, width)
    if len(there) and there[-1]:
        canvas.disc(corners[-1].tolist(), 1.5 * width, colour)


def _words(canvas: Canvas, box: Box, strip: Strip, theme: Theme, letters: float) -> None:
    """Write the label at the left, and at the right each robot's number behind its name."""
    left, top, width, _ = box
    robots = range(len(strip.lines))
    gap, names = 0.8 * letters, [f"{robot_name(robot)} " if len(strip.lines) > 1 else "" for robot in robots]
    size, newest = letters, strip.lines[:, -1] if len(strip.time) else np.full(len(strip.lines), math.nan)
    above = newest > (math.inf if strip.band is None else strip.band[1])
    values = [f"{value} !" if high else value for value, high in zip(strip.values, above.tolist(), strict=True)]
    while True:
        parts = [
            (canvas.width_of(name, size, bold=True), canvas.width_of(value, size, bold=True))
            for name, value in zip(names, values, strict=True)
        ]
        total = sum(map(sum, parts)) + gap * (len(parts) - 1)
        if size <= 8.0 or total + gap + canvas.width_of(strip.label, size) <= width:
            break
        size -= 1.0
    canvas.text(strip.label, (left, top), size, theme.muted)
    x = left + width - total
    for robot, (name, number) in zip(robots, parts, strict=True):
        canvas.text(names[robot], (x, top), size, theme.robot(robot), bold=True)
        canvas.text(values[robot], (x + name, top), size, theme.alarm if above[robot] else theme.ink, bold=True)
        x += name + number + gap


@lru_cache(maxsize=64)
def _decades(span: tuple[float, float]) -> list[float]:
    """Powers of ten inside an axis."""
    first, last = math.ceil(math.log10(span[0]) - 1e-9), math.floor(math.log10(span[1]) + 1e-9)
    return [10.0**k for k in range(first, last + 1)]


@lru_cache(maxsize=64)
def _labelled(span: tuple[float, float], room: float) -> list[float]:
    """Powers of ten that are written out, fewer where there is little room [letters]."""
    inner = [decade for decade in _decades(span) if 0.04 < height_of(decade, span) < 0.96]
    step = max(1, math.ceil(1.3 * len(inner) / max(room, 1.0)))
    return inner[::step]
