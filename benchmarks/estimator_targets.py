"""What the estimators are held against, and the tables of what was found. They read results, and measure nothing."""

from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from benchmarks.targets import Target

NOISY, NOMINAL = 1.5, 1.3
"""[-] greatest whitened error at 10 s: at image noise 0.01, and otherwise."""


def targets(results: Mapping[str, Any], rows: Mapping[str, Any]) -> list[Target]:
    """Every target of map-alignment, with what the results say."""
    found: list[Target] = []
    for row in results["rows"]:
        if row["estimator"] == "map-alignment":
            found.extend(_row_targets(row, rows[row["name"]]))
    if "cost" in results:
        cost = results["cost"]
        for what, words, bound in (
            ("filter", "local filter, a robot and sample", 3.0),
            ("mean", "alignment, a direction and sample, mean", 60.0),
            ("p99", "alignment, a direction and sample, p99", 1000.0),
        ):
            found.append(Target(f"{words}, 2 to 4 points", max(entry[what] for entry in cost.values()), bound, "µs"))
    return found


def _row_targets(row: Mapping[str, Any], what: Any) -> Iterator[Target]:
    words, modelled = row["words"], what.scene.height > 0.0 or what.scene.scale > 0.0
    for index, time in enumerate(row["times"]):
        if time < what.judged_from:
            continue
        at = f"{words}: {time:g} s, "
        mean = row["nees"][index]
        if time == 5.0:
            yield Target(at + "mean NEES", mean, 4.0, "")
            continue
        if modelled:
            yield Target(at + "mean NEES", mean, 3.8, "")
            continue
        early = NOISY if what.scene.image_noise >= 0.01 else NOMINAL
        yield Target(at + "whitened error", row["whitened"][index], early if time == 10.0 else 1.2, "")
        if what.scene.paper:
            yield Target(at + "worst axis / bound", max(row["ratio"][index]), 1.15, "")
        yield Target(at + "mean NEES", mean, 2.3, "", at_least=True)
        yield Target(at + "mean NEES", mean, 3.5, "")
        yield Target(at + "95 % quantile of NEES", row["nees_quantile"][index], 9.5, "")
        if time in (10.0, 40.0):
            share = 0.7 if time == 10.0 else 0.3
            yield Target(at + "runs with NEES > 30", 100.0 * row["inconsistent"][index], share, "%")
        if time == 40.0:
            yield Target(at + "runs beyond 0.5 m or 20°", 100.0 * row["lost"][index], 0.5, "%")


def accuracy_table(results: Mapping[str, Any]) -> Table:
    """Errors in units of the bound, and how honest they are."""
    times = results["rows"][0]["times"]
    table = Table(title=f"{results['settings']['runs']} runs a row, at " + " / ".join(f"{t:g}" for t in times) + " s")
    columns = ("scene (image / odometry noise)", "estimator", "whitened", "mean NEES", "95 % NEES", "NEES > 30 [%]")
    for name in (*columns, "lost [%]"):
        table.add_column(name, overflow="fold")
    before = None
    for row in results["rows"]:
        words = "" if row["words"] == before else row["words"]
        before = row["words"]
        table.add_row(
            words,
            row["estimator"],
            _by_time(row["whitened"]),
            _by_time(row["nees"]),
            _by_time(row["nees_quantile"]),
            _by_time([100.0 * x for x in row["inconsistent"]]),
            _by_time([100.0 * x for x in row["lost"]]),
        )
    return table


def cost_table(results: Mapping[str, Any]) -> Table:
    """Time of one sample."""
    table = Table(title="Cost of a sample of map-alignment, one core [µs]")
    for name in ("points", "local filter, per robot", "alignment: median", "mean", "p99"):
        table.add_column(name)
    for m, cost in results["cost"].items():
        table.add_row(m, f"{cost['filter']:.2f}", *(f"{cost[what]:.0f}" for what in ("median", "mean", "p99")))
    return table


def _by_time(values: list[float]) -> str:
    return " / ".join(f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}" for value in values)
