"""Tables of the demonstration: printed, and written beside the results."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from relloc_env.envs.core import ROBOT_NAMES
from relloc_env.files import whole, write_json, write_whole
from relloc_env.numerals import number

HEADS = {
    "information_10s": ("J 10 s", 2),
    "information_end": ("J end", 2),
    "time_bound_pose": ("bound [s]", 1),
    "position_error_end": ("pos. [m]", 3),
    "heading_error_end": ("head. [°]", 2),
    "depth_error_end": ("depth [%]", 1),
    "seen": ("seen [%]", 0),
}
"""Columns of the table of motions, by the names of `playing.SCORES`, and digits behind the point."""
PERCENT = ("depth_error_end", "seen")
CONSISTENT = """Consistent with the paper's times, no more: it does not say where the targets are, and they were placed
so that its times come out. Depths known: below 0.1 m for good. No noise. More: python -m relloc_env paper."""
EXPLAINED = """J: information about the relative pose [nats]. bound: when an ideal estimate is within 5 cm, 1.5°.
pos., head., depth: errors at the end (depth: share of the range); last: pos. with the paper's estimator.
More in motions.csv."""
REPLAYED = """Medians; last: at the end of each track; pose: over the seconds with an estimate. NEES: 2.4 is right."""
REPLAY_HEADS = {
    "estimator": "estimator",
    "tracks": "tracks",
    "initial depth error [m]": "depth, first [m]",
    "final depth error [m]": "last [m]",
    "position error [m]": "position [m]",
    "heading error [deg]": "heading [°]",
    "NEES": "NEES",
}
"""Columns of a replay that are shown, by their names in `ReplayResult.table`."""


def _cell(name: str, value: float | None) -> str:
    """A median; None is a time that did not come."""
    if name.startswith("time_") and value is None:
        return "never"
    share, digits = name in PERCENT, HEADS[name][1]
    error = ("%" if share else "m") if name in ERRORS else ""
    return number(100.0 * value if share and value is not None else value, digits, error=error)


ERRORS = ("position_error_end", "depth_error_end")
"""Beyond some size they say nothing."""


def _late(time: float | None) -> float:
    return math.inf if time is None else time


Content = tuple[str, Sequence[str], Sequence[Sequence[str]], str]
"""Title, heads and rows of a table, and what they mean."""


def _tables(results: Mapping[str, Any]) -> list[Content]:
    """What is printed, and written to tables.md."""
    paper = results["paper_experiment"]
    rows = [
        [
            name.replace("_", " "),
            number(_late(paper["depth_settled_s"][name]), 1),
            number(paper["depth_settled_paper_s"][name], 0),
            number(paper["depth_error_end_m"][name], 3, error="m"),
            number(paper["position_error_end_m"][name], 3, error="m"),
            number(paper["heading_error_end_deg"][name], 2),
        ]
        for name in ROBOT_NAMES
    ]
    heads = ["", "depths known [s]", "paper [s]", "depth [m]", "other robot [m]", "heading [°]"]
    tables: list[Content] = [("The paper's experiment", heads, rows, CONSISTENT)]
    rows, best, other = _motions(results["motions"])
    seeds = results["seeds"]
    title = f"Motions: medians over {len(seeds)} starts (seeds {seeds[0]} to {seeds[-1]}), estimator {best}"
    tables.append((title, ["motion", *(head for head, _ in HEADS.values()), other], rows, EXPLAINED))
    for part in results["replays"]:
        title = f"Replayed log: {Path(part['path']).name}"
        if "error" in part:
            tables.append((title, ["error"], [[part["error"]]], ""))
        else:
            shown = [k for k, head in enumerate(part["heads"]) if head in REPLAY_HEADS]
            names = [REPLAY_HEADS[part["heads"][k]] for k in shown]
            tables.append((title, names, [[row[k] for k in shown] for row in part["rows"]], REPLAYED))
    return tables


def _motions(motions: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> tuple[list[list[str]], str, str]:
    """Rows of the table of motions, the most informative first, and the names of both estimators."""
    best, other = next(iter(motions.values()))
    rows = []
    for name, both in sorted(motions.items(), key=lambda item: -item[1][best]["information_end"]):
        cells = [_cell(key, both[best][key]) for key in HEADS]
        rows.append([name, *cells, _cell("position_error_end", both[other]["position_error_end"])])
    return rows, best, other


def write(results: Mapping[str, Any], out: Path) -> None:
    """Write results.json, motions.csv and tables.md."""
    write_json(out / "results.json", results, allow_nan=False)
    with whole(out / "motions.csv") as partial, partial.open("w", encoding="utf-8", newline="") as file:
        lines = [
            {"motion": name, "estimator": estimator, **scores}
            for name, both in results["motions"].items()
            for estimator, scores in both.items()
        ]
        writer = csv.DictWriter(file, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)
    text = "# What the demonstration found\n"
    for title, heads, rows, about in _tables(results):
        table = [heads, ["---"] * len(heads), *rows]
        text += f"\n## {title}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in table)
        text += f"\n{about}\n" * bool(about)
    write_whole(out / "tables.md", text)


FILES = {
    "tables.md": "the tables above",
    "paper-experiment.png": "the paper's two robots: paths, depths, poses",
    "motions.png": "paths of each motion from the first start; median errors of all starts with the bound",
    "information.png": "what each motion tells of the pose",
    "script-and-policy.mp4": "the best script and the learned policy from one start",
    "results.json": "everything as data (motions.csv: the medians of the motions)",
}


def show(results: Mapping[str, Any], out: Path, console: Console) -> None:
    """Print the tables, and where to look."""
    for title, heads, rows, about in _tables(results):
        table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for k, head in enumerate(heads):
            # Heads break between words, never within one.
            least = max(map(len, [*head.split(), ""]))
            table.add_column(escape(head), justify="left" if k == 0 else "right", no_wrap=k == 0, min_width=least)
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)
        if about:
            console.print(about + "\n", style="dim", highlight=False, markup=False, soft_wrap=True)
    console.print(
        f"\nDone in {results['seconds']:.0f} s. Where to look: {out}/", markup=False, highlight=False, soft_wrap=True
    )
    replays = {
        f"{part['folder']}/": "errors of the replay over time" for part in results["replays"] if "folder" in part
    }
    for name, words in {**FILES, **replays}.items():
        console.print(f"  {name:<26} {words}", markup=False, highlight=False, soft_wrap=True)
