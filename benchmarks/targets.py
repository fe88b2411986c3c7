"""What the speed is held against, and the tables of what was found. They read results, and measure nothing."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from rich.table import Table

from benchmarks.contenders import BATCH
from benchmarks.speed import Names, rates, ratio, spread


@dataclass(frozen=True)
class Target:
    """A figure and where it ought to be."""

    words: str
    value: float | None
    """None where it was not measured."""
    bound: float
    unit: str
    at_least: bool = False
    """Whether the bound is the least, rather than the greatest."""
    quartiles: tuple[float, float] | None = None

    @property
    def reached(self) -> bool | None:
        """None where it was not measured."""
        if self.value is None:
            return None
        return self.value >= self.bound if self.at_least else self.value < self.bound

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {**asdict(self), "reached": self.reached}


def _ratio(
    results: Mapping[str, Any], words: str, bound: float, ours: Names, theirs: Names, num_envs: int = BATCH
) -> Target:
    found = ratio(results.get("contenders", ()), ours, theirs, num_envs)
    if found is None:
        return Target(words, None, bound, "x", at_least=True)
    quartiles = (found["lower_quartile"], found["upper_quartile"])
    return Target(words, found["median"], bound, "x", at_least=True, quartiles=quartiles)


def _below(results: Mapping[str, Any], words: str, bound: float, unit: str, scale: float, *path: str) -> Target:
    """Target for a number somewhere in the results, or for the median of a spread."""
    found: Any = results
    for name in path:
        found = None if found is None else found.get(name)
    if isinstance(found, Mapping):
        quartiles = (found["lower_quartile"] * scale, found["upper_quartile"] * scale)
        return Target(words, found["median"] * scale, bound, unit, quartiles=quartiles)
    return Target(words, None if found is None else found * scale, bound, unit)


def _pictures(results: Mapping[str, Any]) -> Target:
    """Pictures per second: two in each step."""
    found = spread(2.0 * rate for rate in rates(results.get("contenders", ()), ("pictures",), 256).values())
    words, bound = "pictures of 84 x 84", 20e3
    if found is None:
        return Target(words, None, bound, "/s", at_least=True)
    quartiles = (found["lower_quartile"], found["upper_quartile"])
    return Target(words, found["median"], bound, "/s", at_least=True, quartiles=quartiles)


def targets(results: Mapping[str, Any]) -> list[Target]:
    """Every target, with what the results say; peers count as fast as they were, on one core or on all."""
    batch, default = ("everything",), ("default",)
    jaxmarl, vmas = ("jaxmarl", "jaxmarl-1"), ("vmas-navigation", "vmas-navigation-1")
    return [
        _ratio(results, "one environment, PettingZoo Parallel / mpe2", 4.0, ("parallel",), ("mpe2",), 1),
        _ratio(results, "one environment, Gymnasium / mpe2", 4.0, ("gymnasium",), ("mpe2",), 1),
        _ratio(results, f"batch of {BATCH} / JaxMARL MPE", 1.5, batch, jaxmarl),
        _ratio(results, f"batch of {BATCH} / VMAS navigation", 3.0, batch, vmas),
        _ratio(results, "default task, actions / VMAS navigation", 0.2, default, vmas),
        _ratio(results, f"batch of {BATCH}, all cores / one", 1.7, batch, ("everything-1",)),
        _pictures(results),
        _below(results, "memory of an environment, arrays", 4.0, "KB", 1e-3, "memory", "arrays"),
        _below(results, "memory of an environment, process", 4.0, "KB", 1e-3, "memory", "resident"),
        _below(results, "growth of the process, one environment", 1.0, "MB", 1e-6, "growth", "parallel", "resident"),
        _below(results, "growth of its objects, one environment", 10.0, "KB", 1e-3, "growth", "parallel", "traced"),
        _below(results, "growth of the process, a batch", 1.0, "MB", 1e-6, "growth", "everything", "resident"),
        _below(results, "growth of its objects, a batch", 10.0, "KB", 1e-3, "growth", "everything", "traced"),
        _below(results, "import relloc_env, after gymnasium", 30.0, "ms", 1e3, "startup", "import_relloc_env"),
        _below(results, "first gym.make, cache warm", 2.0, "s", 1.0, "startup", "first_make"),
        _below(results, "second gym.make", 20.0, "ms", 1e3, "startup", "second_make"),
        _below(results, "first compilation, make, reset and step", 30.0, "s", 1.0, "startup", "first_compilation"),
        _below(results, "environment in PPO's training", 10.0, "%", 100.0, "training", "environment_share"),
    ]  # fmt: skip


def speed_table(results: Mapping[str, Any]) -> Table:
    """Steps per second of whatever takes part in a comparison."""
    table = Table(title="Environment steps per second, medians (quartiles)")
    for name, justify in (
        ("contender", "left"),
        ("N", "right"),
        ("cores", "right"),
        ("steps/s", "right"),
        ("", "left"),
    ):
        table.add_column(name, justify="right" if justify == "right" else "left")
    for entry in results["contenders"]:
        if not entry["headline"]:
            continue
        found, notes = entry["steps_per_second"], []
        if found is None:
            notes.append(entry["status"])
        elif entry["samples_per_step"] > 1:
            notes.append(f"{_short(found['median'] * entry['samples_per_step'])} samples/s")
        if entry["contact_share"] is not None:
            notes.append(f"{100 * entry['contact_share']:.2g} % in contact")
        speed = "–" if found is None else _quartiles(found["median"], found["lower_quartile"], found["upper_quartile"])
        table.add_row(entry["words"], str(entry["num_envs"]), str(entry["cores"]), speed, ", ".join(notes))
    return table


def target_table(results: Mapping[str, Any]) -> Table:
    """What was to be reached, and whether it was."""
    table = Table(title="Targets, medians (quartiles)")
    for name in ("", "found", "target", ""):
        table.add_column(name)
    verdicts = {True: "[green]reached[/]", False: "[red]missed[/]", None: "not measured"}
    for target in results["targets"]:
        value, quartiles = target["value"], target["quartiles"]
        found = "–" if value is None else f"{value:.3g}"
        if quartiles:
            found += f" ({quartiles[0]:.3g}–{quartiles[1]:.3g})"
        sign = "≥" if target["at_least"] else "<"
        table.add_row(
            target["words"], found, f"{sign} {target['bound']:g} {target['unit']}", verdicts[target["reached"]]
        )
    return table


def _quartiles(median: float, lower: float, upper: float) -> str:
    return f"{_short(median)} ({_short(lower)}–{_short(upper)})"


def _short(rate: float) -> str:
    """Three digits, with k or M."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if rate >= size:
            return f"{rate / size:.3g}{letter}"
    return f"{rate:.3g}"
