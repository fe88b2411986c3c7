"""Curves over time and the plot of time against way, as SVG that takes the page's colours and letters.

Each agent's parts are groups with the classes `a` and `aK`, K its place in the page's list of agents: `line` and
`name` are always there, `pick` where the agent is chosen.
"""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.demo_figures import LINES, STYLE
from agents.playing import DEPTH_SHARE, POSE
from agents.registry import short
from agents.results import Result
from agents.statistics import median
from relloc_env.extras import extra
from relloc_env.samples import Float

with extra("agents"):
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter


INK, GRID, MUTED = "#a10000", "#a10001", "#a10002"
"""Stand for the page's variables --ink, --grid, --muted."""
SHEET: Any = STYLE | {
    "svg.fonttype": "none",
    "figure.constrained_layout.use": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": MUTED,
    "grid.color": GRID,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "text.color": INK,
}
WIDTH, HEIGHT = 4.1, 2.75
"""[in]"""
POINTS = 61
"""Most instants that are drawn of a curve."""
DECADES = 3.3
"""Most powers of ten that a logarithmic axis covers, from the greatest value down."""
MOST = 200.0
"""Times what counts as found, up to which a logarithmic axis goes."""
REPEAT = len(LINES)


@dataclass(frozen=True)
class Panel:
    """A quantity over time."""

    curve: str
    """Of `playing.CURVES`."""
    title: str
    bound: str | None = None
    """The curve of its bound."""
    mark: float | None = None
    """Where it counts as found."""
    log: bool = False


PANELS = (
    Panel("information", "Information J [nats]"),
    Panel("position_error", "Position error [m]", "position_bound", POSE[0], log=True),
    Panel("heading_error", "Heading error [°]", "heading_bound", POSE[1], log=True),
    Panel("depth_share", "Worst depth error, share of the range", "depth_bound", DEPTH_SHARE, log=True),
    Panel("excitation", "Smallest excitation ∫σ² dt [m²/s]"),
)


def colour(place: int) -> str:
    """Stands for the variable --cK of an agent's place."""
    return f"#a2{place % REPEAT:04x}"


def dash(place: int) -> str:
    """Line style of an agent's place: solid, and dashed once the colours repeat."""
    return "-" if place < REPEAT else "--"


def panels(results: Sequence[Result], places: Mapping[str, int], name: str) -> list[tuple[str, str]]:
    """Title and SVG of each quantity over time; quantities that a task has not are left out.

    Args:
        results: of one suite and estimator.
        places: of the agents, by name.
        name: tells the figures of a page apart.
    """
    found = []
    for panel in PANELS:
        if all(np.isnan(result.curves[panel.curve]).all() for result in results):
            continue
        figure, axis = _sheet()
        for result in results:
            _draw(axis, result, panel, places[result.job.agent])
        if panel.mark is not None:
            axis.axhline(panel.mark, color=MUTED, lw=0.9, ls=":")
        if panel.log:
            curves = [result.curves[name] for result in results for name in (panel.curve, panel.bound) if name]
            _logarithmic(axis, np.concatenate([curve.ravel() for curve in curves]), panel)
        axis.set(xlim=(0.0, results[0].time[-1]), xlabel="time [s]")
        found.append((panel.title, _svg(figure, f"{name}-{panel.curve}", panel.title)))
    return found


def _draw(axis: Axes, result: Result, panel: Panel, place: int) -> None:
    chosen = np.unique(np.linspace(0, len(result.time) - 1, POINTS).round().astype(int))
    time, (low, middle, high) = result.time[chosen], result.curves[panel.curve][:, chosen]
    band = axis.fill_between(time, low, high, color=colour(place), alpha=0.16, lw=0.0)
    band.set_gid(f"a a{place} pick")
    (line,) = axis.plot(time, middle, color=colour(place), ls=dash(place))
    line.set_gid(f"a a{place} line")
    if panel.bound is not None and np.isfinite(result.curves[panel.bound]).any():
        (line,) = axis.plot(time, result.curves[panel.bound][1, chosen], color=colour(place), ls=":", lw=1.3)
        line.set_gid(f"a a{place} pick")


def _logarithmic(axis: Axes, values: Float, panel: Panel) -> None:
    positive = values[np.isfinite(values) & (values > 0.0)]
    top = min(float(positive.max()), MOST * (panel.mark or 1.0)) if positive.size else 1.0
    low = max(float(positive.min()), top / 10.0**DECADES) if positive.size else 0.1
    axis.set_yscale("log")
    axis.set_ylim(0.8 * min(low, 0.5 * (panel.mark or low)), 1.3 * top)
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())


def pareto(results: Sequence[Result], places: Mapping[str, int], score: str, name: str, title: str) -> str:
    """SVG of the median time to a score against the median way, with 95 % intervals; "never" has a line of its own."""
    figure, axis = _sheet(right=0.7)
    found = {r.job.agent: (median(r.scores["path"]), median(r.scores[score])) for r in results}
    end = float(results[0].time[-1])
    never = 1.1 * end
    spots: dict[str, tuple[float, float]] = {}
    for agent, (way, time) in found.items():
        place = places[agent]
        low, value, high = (min(part, never) for part in (time.low, time.value, time.high))
        spots[agent] = way.value, value
        for xs, ys in (([way.low, way.high], [value, value]), ([way.value, way.value], [low, high])):
            axis.plot(xs, ys, color=colour(place), lw=1.0, gid=f"a a{place} line")
        face = colour(place) if place < REPEAT else "none"
        axis.plot(*spots[agent], "o", ms=6.0, mfc=face, mec=colour(place), mew=1.4, gid=f"a a{place} name")
    front = sorted(spot for spot in spots.values() if spot[1] < never and not _worse(spot, spots.values()))
    if front:
        steps = [(front[0][0], never), *front, (max(way for way, _ in spots.values()), front[-1][1])]
        axis.step(*zip(*steps, strict=True), where="post", color=MUTED, lw=0.9, ls=":")
    axis.axhline(never, color=GRID, lw=0.8)
    most = max(*(way for way, _ in spots.values()), 0.5)
    axis.set(xlim=(-0.04 * most, 1.06 * most), ylim=(0.0, 1.16 * end), xlabel="way of a robot [m]")
    ticks = [tick for tick in axis.get_yticks() if tick < 0.97 * end]
    axis.set_yticks([*ticks, never], [*(f"{tick:g}" for tick in ticks), "never"])
    _name(axis, spots, places, 1.06 * most, 0.062 * 1.16 * end)
    return _svg(figure, f"{name}-pareto", title)


def _worse(spot: tuple[float, float], others: Any) -> bool:
    """Whether another one is there sooner on no longer a way, or as soon on a shorter one."""
    return any(o != spot and o[0] <= spot[0] and o[1] <= spot[1] for o in others)


def _name(
    axis: Axes, spots: Mapping[str, tuple[float, float]], places: Mapping[str, int], x: float, gap: float
) -> None:
    """Names at the right, one below the other, each with a thin line to its spot."""
    low, high = axis.get_ylim()
    order = sorted(spots, key=lambda agent: (spots[agent][1], -spots[agent][0]))
    heights = np.array([spots[agent][1] for agent in order])
    gap = min(gap, (high - low) / max(1, len(order)))
    for _ in range(2):  # Up from below, then down from the top edge.
        heights = np.maximum.accumulate(heights - gap * np.arange(len(order))) + gap * np.arange(len(order))
        heights[-1:] = np.minimum(heights[-1:], high)
        turned = (heights - gap * np.arange(len(order)))[::-1]
        heights = np.minimum.accumulate(turned)[::-1] + gap * np.arange(len(order))
    for agent, height in zip(order, heights, strict=True):
        place = places[agent]
        note = axis.annotate(
            short(agent), spots[agent], xytext=(x + 0.05 * x, height), va="center", fontsize=8.5,
            color=colour(place), annotation_clip=False, gid=f"a a{place} name",
            arrowprops={"arrowstyle": "-", "color": colour(place), "lw": 0.5, "relpos": (0.0, 0.5), "shrinkB": 4.0},
        )  # fmt: skip
        assert note.arrow_patch is not None
        note.arrow_patch.set_gid(f"a a{place} name")


def _sheet(right: float = 0.975) -> tuple[Figure, Axes]:
    with mpl.rc_context(SHEET):
        figure = Figure(figsize=(WIDTH, HEIGHT))
        FigureCanvasSVG(figure)
        axis = figure.add_axes((0.115, 0.165, right - 0.115, 0.795))
    return figure, axis


def _svg(figure: Figure, name: str, title: str) -> str:
    """The figure as part of the page: no size of its own, colours by variables, numbers short, no names twice."""
    buffer = io.StringIO()
    with mpl.rc_context(SHEET | {"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    opening = f'<svg viewBox="0 0 {72 * WIDTH:g} {72 * HEIGHT:g}" role="img" aria-label="{title}">'
    text = re.sub(r"<svg[^>]*>", opening, text, count=1)
    text = re.sub(r'id="(a a\d+ \w+)"', r'class="\1"', text)
    text = re.sub(r' id="(?!m[0-9a-f]{10}|p[0-9a-f]{10}|[Ch][0-9a-f]*_)[^"]*"', "", text)
    for number, variable in ((INK, "ink"), (GRID, "grid"), (MUTED, "muted")):
        text = text.replace(number, f"var(--{variable})")
    text = re.sub(r"#a2([0-9a-f]{4})", lambda found: f"var(--c{int(found[1], 16)})", text)
    text = re.sub(r" font-family: [^;\"]*;| transform=\"rotate\(-0 [^\"]*\"", "", text)
    text = re.sub(r"<[^>]*>", lambda tag: re.sub(r"-?\d+\.\d{2,}", lambda n: f"{float(n[0]):.1f}", tag[0]), text)
    return re.sub(r"\s+", " ", text).replace("> <", "><")
