"""The measurement: all contenders in turn, round after round, so that what slows the machine slows all of them.

Only one process works at a time. A ratio is taken within each round; medians and quartiles are over rounds.
"""

import importlib.metadata
import json
import os
import platform
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from benchmarks.contenders import BATCH, CONTENDERS, SIZES, Contender

ROOT = Path(__file__).resolve().parents[1]
LIBRARIES = ("gymnasium", "jax", "mpe2", "numba", "numpy", "pettingzoo", "stable-baselines3", "torch", "vmas")
PLOT_EVERY = 3
"""Rounds in which sizes that only the plot needs are measured: every third."""

Names = tuple[str, ...]
Tell = Callable[[float, str], None]
"""Called with the part that is done and what is being done."""


def silent(_part: float, _words: str) -> None:
    """Tell nobody."""


class WorkerError(RuntimeError):
    """A contender's process ended; the message is the last it said."""


class Process:
    """A worker that is asked for one thing at a time."""

    def __init__(self, contender: Contender, cores: int) -> None:
        command = [sys.executable, "-m", "benchmarks.worker", contender.name, str(contender.cores or cores)]
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 - closed with the process
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True
        )

    def __enter__(self) -> Self:
        """Use it until the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self.close()

    def ask(self, do: str, **arguments: object) -> dict[str, Any]:
        """Let the worker do something, and wait for its answer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **arguments}) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            self._process.wait()
            self._errors.seek(0)
            said = [line for line in self._errors.read().splitlines() if line.strip()]
            raise WorkerError(said[-1] if said else f"ended with code {self._process.returncode}")
        found: dict[str, Any] = json.loads(answer)
        return found

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()
        self._errors.close()


@dataclass
class Entry:
    """A contender at one number of environments, and what was measured."""

    contender: Contender
    num_envs: int
    cores: int
    status: str = "measured"
    contact: float | None = None
    rates: dict[int, float] = field(default_factory=dict)
    """Environment steps per second, by round."""

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        found = {
            "name": self.contender.name, "words": self.contender.words, "package": self.contender.package,
            "num_envs": self.num_envs, "headline": self.contender.headline(self.num_envs), "cores": self.cores,
            "samples_per_step": self.contender.samples, "version": self.contender.version(), "status": self.status,
            "contact_share": self.contact, "rates": {str(r): rate for r, rate in self.rates.items()},
        }  # fmt: skip
        return {**found, "steps_per_second": spread(self.rates.values())}


def spread(values: Iterable[float]) -> dict[str, float] | None:
    """Median, quartiles and extremes; None of nothing."""
    found = list(values)
    if not found:
        return None
    names = ("min", "lower_quartile", "median", "upper_quartile", "max")
    return dict(zip(names, np.percentile(found, (0, 25, 50, 75, 100)).tolist(), strict=True))


def rates(entries: Iterable[Mapping[str, Any]], names: Names, num_envs: int) -> dict[str, float]:
    """The best of some contenders, by round; empty where none was measured."""
    found: dict[str, float] = {}
    for entry in entries:
        if entry["name"] in names and entry["num_envs"] == num_envs:
            for r, rate in entry["rates"].items():
                found[r] = max(rate, found.get(r, 0.0))
    return found


def ratio(entries: Iterable[Mapping[str, Any]], ours: Names, theirs: Names, num_envs: int) -> dict[str, float] | None:
    """Spread over rounds of the best of some contenders over the best of others in the same round."""
    entries = list(entries)
    a, b = rates(entries, ours, num_envs), rates(entries, theirs, num_envs)
    return spread(a[r] / b[r] for r in a if r in b)


def machine() -> dict[str, Any]:
    """What this runs on."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        model = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        model = platform.processor()
    versions: dict[str, str | None] = {}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "processor": model, "cores": os.cpu_count(), "system": platform.platform(),
        "python": platform.python_version(), "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "versions": versions,
    }  # fmt: skip


def measure(
    names: Iterable[str] = tuple(CONTENDERS), *, sizes: Iterable[int] = SIZES, cores: int = 2, rounds: int = 12,
    seconds: float = 1.0, warm_up: float = 1.0, seed: int = 0, tell: Tell = silent,
) -> list[dict[str, Any]]:  # fmt: skip
    """Measure contenders side by side.

    Args:
        names: of `CONTENDERS`.
        sizes: numbers of environments to measure, of those that a contender has.
        cores: that those may use which are not for one core.
        rounds: times that each of them is asked.
        seconds: [s] that it steps then.
        warm_up: [s] that it steps before the first.
        seed: of the order in a round.
        tell: told the part that is done.

    Returns:
        One dictionary for each contender and number of environments.
    """
    wanted = set(sizes)
    entries = [
        Entry(c, n, c.cores or cores, "measured" if c.version() else "not installed")
        for c in (CONTENDERS[name] for name in names)
        for n in c.sizes
        if n in wanted
    ]
    ready = [entry for entry in entries if entry.status == "measured"]
    processes: dict[str, Process] = {}
    turns = [
        [e for e in ready if r % PLOT_EVERY == 0 or e.contender.headline(e.num_envs)] for r in range(rounds)
    ]  # which sizes take part in a round
    done, total = 0, len(ready) + sum(map(len, turns))

    def ask(entry: Entry, do: str, **arguments: object) -> dict[str, Any]:
        """Ask a contender; one that fails once is out."""
        nonlocal done
        name = entry.contender.name
        tell(done / total, f"{name}, N = {entry.num_envs}")
        done += 1
        if entry.status != "measured":
            return {}
        if name not in processes:
            processes[name] = Process(entry.contender, cores)
        try:
            return processes[name].ask(do, num_envs=entry.num_envs, **arguments)
        except WorkerError as error:
            entry.status = f"failed: {error}"
            processes.pop(name).close()
            for other in ready:
                if other.contender is entry.contender and other.status == "measured":
                    other.status = f"failed with N = {entry.num_envs}"
            return {}

    try:
        for entry in ready:
            entry.contact = ask(entry, "set_up", warm_up=warm_up).get("contact")
        order = random.Random(seed)  # noqa: S311 - no secret
        for r, turn in enumerate(turns):
            order.shuffle(turn)
            for entry in turn:
                answer = ask(entry, "run", seconds=seconds)
                if answer:
                    entry.rates[r] = answer["steps"] * entry.num_envs / answer["seconds"]
    finally:
        for process in processes.values():
            process.close()
    return [entry.as_dict() for entry in entries]


def memory(cores: int, small: int = BATCH, large: int = SIZES[-1]) -> dict[str, Any]:
    """Memory of one environment of the batch [bytes]: of its arrays, and by how much a process grows with more."""
    found = {}
    for n in (small, large):
        with Process(CONTENDERS["everything"], cores) as process:
            process.ask("set_up", num_envs=n, warm_up=0.0)
            found[n] = process.ask("memory", num_envs=n)
    a, b = found[small], found[large]
    return {
        "arrays": b["arrays"] / large,
        "resident": (b["resident"] - a["resident"]) / (large - small) if a["resident"] else None,
    }


def growth(cores: int, steps: int = 1_000_000) -> dict[str, Any]:
    """By how much a process grows in so many environment steps [bytes], one environment and a batch."""
    found = {}
    for name, n in (("parallel", 1), ("everything", 64)):
        with Process(CONTENDERS[name], cores) as process:
            process.ask("set_up", num_envs=n)
            found[name] = {"steps": steps, **process.ask("growth", num_envs=n, steps=steps, traced=steps // 20)}
    return found


def training(cores: int, num_envs: int = 256, updates: int = 5) -> dict[str, Any]:
    """Share of the environment in the time of PPO's training."""
    with Process(CONTENDERS["sb3"], cores) as process:
        return process.ask("train", num_envs=num_envs, updates=updates)
