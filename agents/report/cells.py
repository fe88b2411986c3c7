"""Figures as the page writes them: cells with a number, its interval below, and what marks it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from agents.report.columns import COMPARED, J_10, J_END, MADE, MOVED, TOLD, Column, Figure, shown
from relloc_env.numerals import number


@dataclass(frozen=True)
class Cell:
    """What stands in one place of a table."""

    text: str
    note: str = ""
    """Its interval, below."""
    mark: str = ""
    """Classes: `best` of its column, `up` and `down` for a difference that is not 0, `in` and `out` of a band."""


@dataclass(frozen=True)
class Head:
    """What stands above a column."""

    text: str
    unit: str = ""
    about: str = ""


@dataclass(frozen=True)
class Table:
    """A table of agents: heads, and the cells of each agent by name."""

    title: str
    about: str
    heads: list[Head]
    rows: dict[str, list[Cell]]


def cell(figure: Figure, column: Column) -> Cell:
    """A figure in the units of its column, with its interval or the share that got there."""
    digits, scale = column.digits, column.scale
    notes = []
    if not math.isnan(figure.low) and figure.low != figure.high:
        between = "–" if figure.low >= 0.0 else " … "
        notes.append(between.join(number(scale * end, digits, error=column.error) for end in (figure.low, figure.high)))
    if not math.isnan(figure.share):
        notes.append(f"{100.0 * figure.share:.0f} %")
    return Cell(number(scale * figure.value, digits, error=column.error), " · ".join(notes))


def tables(part: Mapping[str, Any], band: Sequence[float], robots: int) -> list[Table]:
    """The three tables of one suite with one estimator.

    Args:
        part: of `summary.summarise`.
        band: in which the mean NEES is to lie.
        robots: number of robots.
    """
    agents = part["agents"]
    told = _table("What the motion tells", "By the bound: what an ideal estimator would know.", TOLD, agents, robots)
    for key, place in ((J_10.key, 2), (J_END.key, 1)):
        if key in part["references"]:
            reference = part["references"][key]
            when = "end" if key == J_END.key else "10 s"
            told.heads.insert(place, Head(f"Δ {when}", f"to {reference}", f"paired mean difference of {key}"))
            for name, row in told.rows.items():
                row.insert(place, _difference(agents[name]["figures"][f"{key}_difference"], name == reference))
    made = _table("What the estimator makes of it", "Errors against the truth.", MADE, agents, robots)
    for k, column in enumerate(shown(MADE, robots)):
        if column.key == "nees_mean":
            for name, row in made.rows.items():
                row[k] = _banded(row[k], agents[name]["figures"][column.key].value, band)
    moved = _table("How the robots move", "", MOVED, agents, robots)
    moved.heads.append(Head("an action takes", "ms", "time that the agent takes for an action of one environment"))
    for name, row in moved.rows.items():
        row.append(Cell(number(agents[name]["action_ms"], 3)))
    return [told, made, moved]


def compared(estimators: Mapping[str, Any], robots: int) -> list[tuple[Head, dict[str, list[Cell]]]]:
    """Estimators beside each other: for each measure, the cells of each agent, one per estimator."""
    found = []
    names = list(dict.fromkeys(name for part in estimators.values() for name in part["agents"]))
    for column in shown(tuple(c for c in MADE if c.key in COMPARED), robots):
        rows: dict[str, list[Cell]] = {}
        for name in names:
            all_of = [
                p["agents"][name]["figures"][column.key] if name in p["agents"] else None for p in estimators.values()
            ]
            cells = [Cell("–") if one is None else cell(one, column) for one in all_of]
            values = [math.nan if one is None else one.value for one in all_of]
            better = -1 if column.better == 0 else column.better
            target = [-abs(v - 0.95) for v in values] if column.key == "nees_inside" else [better * v for v in values]
            rows[name] = _best(cells, target)
        found.append((head(column, robots), rows))
    return found


def _table(title: str, about: str, columns: tuple[Column, ...], agents: Mapping[str, Any], robots: int) -> Table:
    chosen = shown(columns, robots)
    upright = []
    for column in chosen:
        figures = [one["figures"][column.key] for one in agents.values()]
        cells = [cell(figure, column) for figure in figures]
        upright.append(_best(cells, [column.better * f.value for f in figures]) if column.better else cells)
    rows = {name: [column[k] for column in upright] for k, name in enumerate(agents)}
    return Table(title, about, [head(column, robots) for column in chosen], rows)


def head(column: Column, robots: int) -> Head:
    """What stands above a column."""
    return Head(column.name(robots), column.unit, column.about(robots))


def _best(cells: list[Cell], goodness: list[float]) -> list[Cell]:
    """The same, with the best marked, unless none is finite or all are alike."""
    finite = [value for value in goodness if math.isfinite(value)]
    if not finite or len({one.text for one in cells}) < 2:
        return cells
    top = cells[goodness.index(max(finite))].text
    return [replace(one, mark="best") if one.text == top else one for one in cells]


def _difference(figure: Figure, itself: bool) -> Cell:
    if itself:
        return Cell("·")
    mark = "up" if figure.low > 0.0 else "down" if figure.high < 0.0 else ""
    note = f"{number(figure.low, 2, sign=True)} … {number(figure.high, 2, sign=True)}"
    return Cell(number(figure.value, 2, sign=True), note, mark)


def _banded(one: Cell, value: float, band: Sequence[float]) -> Cell:
    low, high = band
    if low <= value <= high:
        return replace(one, note="in the band", mark="in")
    return replace(one, note="above it" if value > high else "below it", mark="out")
