"""Tables of the demonstration: printed, and written beside the results."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from relloc_env.envs.core import ROBOT_NAMES
from relloc_env.files import whole, write_json, write_whole

HEADS = {
    "information_10s_nats": "J 10 s",
    "information_end_nats": "J end",
    "bound_reached_s": "bound [s]",
    "position_error_end_m": "pos. [m]",
    "heading_error_end_deg": "head. [°]",
    "worst_depth_error_end_m": "depth [m]",
    "all_seen_by_all": "seen [%]",
}
"""Columns of the table of motions, by the names of `Episode.summary`."""
EXPLAINED = """J: information about the relative pose [nats]. bound: when an ideal estimate is within 5 cm, 1.5°.
pos., head., depth: errors at the end, the worst of both robots; last: pos. with the paper's.
More in motions.csv."""
DIGITS = {"bound_reached_s": 1, "position_error_end_m": 3, "worst_depth_error_end_m": 3, "path_m": 1}
REPLAY_HEADS = {
    "estimator": "estimator",
    "tracks": "tracks",
    "initial depth error [m]": "depth, first [m]",
    "final [m]": "last [m]",
    "position [m]": "position [m]",
    "heading [deg]": "heading [°]",
    "NEES": "NEES",
}
"""Columns of a replay that are shown, by their names in `ReplayResult.table`."""


def _cell(name: str, value: float | None) -> str:
    if value is None:
        return "never" if name.endswith("_s") else "–"
    return f"{100.0 * value:.0f}" if name == "all_seen_by_all" else f"{value:.{DIGITS.get(name, 2)}f}"


Content = tuple[str, Sequence[str], Sequence[Sequence[str]]]
"""Title, heads and rows of a table."""


def _tables(results: Mapping[str, Any]) -> list[Content]:
    """What is printed, and written to tables.md."""
    paper = results["paper_experiment"]
    rows = [
        [
            name.replace("_", " "),
            _cell("settled_s", paper["depth_settled_s"][name]),
            f"{paper['depth_settled_paper_s'][name]:.0f}",
            f"{paper['depth_error_end_m'][name]:.3f}",
            f"{paper['position_error_end_m'][name]:.3f}",
            f"{paper['heading_error_end_deg'][name]:.2f}",
        ]
        for name in ROBOT_NAMES
    ]
    heads = ["", "depths known [s]", "paper [s]", "depth [m]", "other robot [m]", "heading [°]"]
    tables: list[Content] = [("The paper's experiment", heads, rows)]
    rows, best, other = _motions(results["motions"])
    title = f"Motions from one start (seed {results['seed']}), estimator {best}"
    tables.append((title, ["motion", *HEADS.values(), other], rows))
    for part in results["replays"]:
        title = f"Replayed log: {Path(part['path']).name}"
        if "error" in part:
            tables.append((title, ["error"], [[part["error"]]]))
        else:
            shown = [k for k, head in enumerate(part["heads"]) if head in REPLAY_HEADS]
            names = [REPLAY_HEADS[part["heads"][k]] for k in shown]
            tables.append((title, names, [[row[k] for k in shown] for row in part["rows"]]))
    return tables


def _motions(motions: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> tuple[list[list[str]], str, str]:
    """Rows of the table of motions, the most informative first, and the names of both estimators."""
    best, other = next(iter(motions.values()))
    rows = []
    for name, both in sorted(motions.items(), key=lambda item: -item[1][best]["information_end_nats"]):
        cells = [_cell(key, both[best][key]) for key in HEADS]
        rows.append([name, *cells, _cell("position_error_end_m", both[other]["position_error_end_m"])])
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
    for title, heads, rows in _tables(results):
        table = [heads, ["---"] * len(heads), *rows]
        text += f"\n## {title}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in table)
    write_whole(out / "tables.md", text)


FILES = {
    "tables.md": "the tables above",
    "paper-experiment.png": "the paper's two robots: paths, depths, poses",
    "motions.png": "paths of each motion over the arena, errors with the bound",
    "information.png": "what each motion tells of the pose",
    "script-and-policy.mp4": "the best script and the learned policy from one start",
    "results.json": "everything as data (motions.csv: the scores of the motions)",
}


def show(results: Mapping[str, Any], out: Path, console: Console) -> None:
    """Print the tables, and where to look."""
    for title, heads, rows in _tables(results):
        table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for k, head in enumerate(heads):
            # Heads break between words, never within one.
            least = max(map(len, [*head.split(), ""]))
            table.add_column(escape(head), justify="left" if k == 0 else "right", no_wrap=k == 0, min_width=least)
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)
        if rows and heads[0] == "motion":
            console.print(EXPLAINED + "\n", style="dim", highlight=False, markup=False, soft_wrap=True)
    console.print(
        f"\nDone in {results['seconds']:.0f} s. Where to look: {out}/", markup=False, highlight=False, soft_wrap=True
    )
    replays = {
        f"{part['folder']}/": "errors of the replay over time" for part in results["replays"] if "folder" in part
    }
    for name, words in {**FILES, **replays}.items():
        console.print(f"  {name:<26} {words}", markup=False, highlight=False, soft_wrap=True)
