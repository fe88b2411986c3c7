"""The plot: steps per second against the number of environments. It reads results, and measures nothing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relloc_env.extras import extra
from relloc_env.files import whole


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw the contenders that were measured at more than one size, those with one size as a mark."""
    with extra("logs"):
        from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for entry in results["contenders"]:
        if entry["steps_per_second"] is not None:
            by_name.setdefault(entry["name"], []).append(entry)
    for entries in by_name.values():
        ours = entries[0]["package"] == "relloc-env"
        sizes = [entry["num_envs"] for entry in entries]
        if len(sizes) == 1 and sizes[0] != 1:
            continue
        rates = [entry["steps_per_second"] for entry in entries]
        (line,) = axes.plot(
            sizes, [rate["median"] for rate in rates], "o-" if ours else "s--", ms=4, lw=2.0 if ours else 1.2,
            label=entries[0]["words"], zorder=3 if ours else 2,
        )  # fmt: skip
        lower, upper = ([rate[key] for rate in rates] for key in ("lower_quartile", "upper_quartile"))
        axes.fill_between(sizes, lower, upper, color=line.get_color(), alpha=0.2, lw=0)
    axes.set(xscale="log", yscale="log", xlabel="environments", ylabel="environment steps / s")
    marks = sorted({entry["num_envs"] for entry in results["contenders"]})
    axes.set_xticks(marks, labels=[str(mark) for mark in marks])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    with whole(path) as partial:
        figure.savefig(partial, dpi=150)
