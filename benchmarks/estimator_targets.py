"""What the estimators are held against, and the tables of what was found. They read results, and measure nothing."""

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

from rich.table import Table

from benchmarks.scenarios import Scene
from benchmarks.targets import Target

OURS = "map-alignment"
NOISY = 0.01
"""[-] image noise from which on the whitened error at 10 s may be greater."""


def targets(
    results: Mapping[str, Any], scenes: Mapping[str, Scene], judged_from: Mapping[str, float]
) -> Iterator[dict[str, Any]]:
    """Every target of map-alignment, with what the results say.

    Args:
        results: as of `benchmarks.estimators.run`.
        scenes: of each row.
        judged_from: [s] from which on the targets of a row are meant.
    """
    for row in results["rows"]:
        if row["estimator"] != OURS:
            continue
        for index, time in enumerate(row["times"]):
            if time >= judged_from[row["name"]]:
                for target in _at(time, {k: v[index] for k, v in row.items() if k in FIGURES}, scenes[row["name"]]):
                    yield {"row": row["words"], "time": time, **target.as_dict()}
    for what, words, bound in (
        ("filter", "local filter of a robot", 3.0),
        ("mean", "alignment of a direction, mean", 60.0),
        ("p99", "alignment of a direction, p99", 1000.0),
    ):
        for m, entry in results.get("cost", {}).items():
            yield {"row": f"cost of a sample, {m} points", **Target(words, entry[what], bound, "µs").as_dict()}


FIGURES = ("whitened", "ratio", "nees", "nees_quantile", "inconsistent", "lost")
"""What is judged, by its name in the results."""


def _at(time: float, found: Mapping[str, Any], scene: Scene) -> Iterator[Target]:
    """Targets at one time [s]."""
    mean = found["nees"]
    if time == 5.0:
        yield Target("mean NEES", mean, 4.0, "")
        return
    if scene.height > 0.0 or scene.scale > 0.0:
        yield Target("mean NEES", mean, 3.8, "")
        return
    early = 1.5 if scene.image_noise >= NOISY else 1.3
    yield Target("whitened error", found["whitened"], early if time == 10.0 else 1.2, "")
    if scene.paper:
        yield Target("worst axis / bound", max(found["ratio"]), 1.15, "")
    yield Target("mean NEES", mean, 2.3, "", at_least=True)
    yield Target("mean NEES", mean, 3.5, "")
    yield Target("95 % quantile of NEES", found["nees_quantile"], 9.5, "")
    if time in (10.0, 40.0):
        yield Target("runs with NEES > 30", 100.0 * found["inconsistent"], 0.7 if time == 10.0 else 0.3, "%")
    if time == 40.0:
        yield Target("runs beyond 0.5 m or 20°", 100.0 * found["lost"], 0.5, "%")


def accuracy_table(results: Mapping[str, Any]) -> Table:
    """Errors in units of the bound, and how honest they are."""
    times = results["rows"][0]["times"]
    when = " / ".join(f"{time:g}" for time in times)
    table = Table(title=f"{results['settings']['runs']} runs a row, after {when} s", show_lines=False)
    for name in ("scene, noise of image / odometry", "estimator"):
        table.add_column(name, overflow="fold")
    for name in ("whitened", "mean NEES", "95 % NEES", "NEES > 30 [%]", "lost [%]", "(of the bound)"):
        table.add_column(name, overflow="fold", justify="right")
    for words, rows in groupby(results["rows"], key=lambda row: row["words"]):
        for index, row in enumerate(rows):
            shares = ([100.0 * x for x in row[what]] for what in ("inconsistent", "lost", "lost_at_bound"))
            lists = (row["whitened"], row["nees"], row["nees_quantile"], *shares)
            table.add_row("" if index else words, row["estimator"], *(" / ".join(map(_short, x)) for x in lists))
        table.add_section()
    return table


def cost_table(results: Mapping[str, Any]) -> Table:
    """Time of one sample."""
    table = Table(title="map-alignment, time of a sample on one core [µs]")
    for name in ("points", "local filter, a robot", "alignment, a direction: median", "mean", "p99"):
        table.add_column(name, justify="right")
    for m, cost in results["cost"].items():
        table.add_row(m, f"{cost['filter']:.2f}", *(f"{cost[what]:.0f}" for what in ("median", "mean", "p99")))
    return table


def target_table(results: Mapping[str, Any]) -> Table:
    """What was to be reached, and whether it was: one line for all times of a figure."""
    table = Table(title="Targets of map-alignment")
    for name in ("", "", "after [s]", "found", "target", ""):
        table.add_column(name, overflow="fold")
    lines: dict[tuple[str, str, bool], list[dict[str, Any]]] = {}
    for target in results["targets"]:
        lines.setdefault((target["row"], target["words"], target["at_least"]), []).append(target)
    before = ""
    for (row, words, at_least), some in lines.items():
        if row != before:
            table.add_section()
        reached = [target["reached"] for target in some]
        table.add_row(
            "" if row == before else row,
            words,
            " / ".join(f"{target['time']:g}" for target in some if "time" in target),
            " / ".join(_short(target["value"]) for target in some),
            f"{'≥' if at_least else '<'} "
            + " / ".join(f"{target['bound']:g}" for target in some)
            + f" {some[0]['unit']}",
            "[green]reached[/]" if all(reached) else "[red]missed[/]",
        )
        before = row
    return table


def _short(value: float) -> str:
    if abs(value) < 10.0:
        return f"{value:.2f}" if value else "0"
    return f"{value:.0f}" if value < 1e4 else f"{value:.0e}"
