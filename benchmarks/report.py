"""The whole run: everything is measured, then written, then drawn."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from benchmarks import speed, startup
from benchmarks.contenders import BATCH, CONTENDERS, SIZES
from benchmarks.figure import draw
from benchmarks.speed import Tell, silent
from benchmarks.targets import targets
from relloc_env.files import write_json
from relloc_env.folders import open_folder


@contextmanager
def progress() -> Iterator[Tell]:
    """A bar on the terminal."""
    columns = (SpinnerColumn(), BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda part, words: bar.update(task, completed=part, description=words)


def run(
    out: Path, *, names: Sequence[str] | None = None, rounds: int = 12, seconds: float = 1.0, cores: int = 2,
    quick: bool = False, tell: Tell = silent,
) -> dict[str, Any]:  # fmt: skip
    """Measure, and write `results.json` and `speed.png` into a folder.

    Args:
        out: folder, made where it is missing.
        names: contenders to measure, and nothing else; None for all, memory, start-up and training.
        rounds, seconds, cores: as in `benchmarks.speed.measure`.
        quick: whether to be done in seconds, with nothing that can be compared.
        tell: told the part that is done.

    Returns:
        What `results.json` holds.

    Raises:
        ValueError: a name that no contender has.
    """
    for name in names or ():
        if name not in CONTENDERS:
            raise ValueError(f"Argument `names` must be among {', '.join(CONTENDERS)}, but has `{name}`")
    if quick:
        rounds, seconds = 2, 0.01
    out = open_folder(out)
    results: dict[str, Any] = {
        "machine": speed.machine(),
        "settings": {"rounds": rounds, "seconds": seconds, "cores": cores, "batch": BATCH, "quick": quick},
    }

    def part(start: float, end: float) -> Tell:
        return lambda done, words: tell(start + done * (end - start), words)

    if names is None and not quick:
        results["startup"] = startup.measure(tell=part(0.0, 0.1))
        tell(0.1, "memory of a batch")
        results["memory"] = speed.memory(cores)
        tell(0.12, "memory over a million steps")
        results["growth"] = speed.growth(cores)
        tell(0.25, "training with PPO")
        results["training"] = speed.training(cores)
    results["contenders"] = speed.measure(
        names or CONTENDERS, sizes=(1, 4) if quick else SIZES, cores=cores, rounds=rounds, seconds=seconds,
        warm_up=0.0 if quick else 1.0, tell=part(0.3, 1.0),
    )  # fmt: skip
    results["targets"] = [target.as_dict() for target in targets(results)]
    write_json(out / "results.json", results)
    draw(results, out / "speed.png")
    return results
