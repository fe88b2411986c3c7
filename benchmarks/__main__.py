"""`python -m benchmarks`: speed beside other environments and estimators beside the bound, from the command line."""

from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from relloc_env.console import lenient
from relloc_env.extras import MissingExtraError
from relloc_env.files import write_json
from relloc_env.folders import open_folder

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, help=__doc__
)


@app.callback()
def _benchmarks() -> None:
    """How fast the environments are, where the time goes, and how good the estimators are."""


@app.command()
def speed(
    out: Annotated[Path, typer.Option(help="Folder for results.json and speed.png.")] = Path("out/speed"),
    rounds: Annotated[int, typer.Option(min=1, help="Times that each contender is measured.")] = 12,
    seconds: Annotated[float, typer.Option(min=0.0, help="How long each time [s].")] = 1.0,
    cores: Annotated[int, typer.Option(min=1, help="Cores that a contender may use.")] = 2,
    only: Annotated[list[str] | None, typer.Option(help="Name of a contender; may be given again.")] = None,
    quick: Annotated[bool, typer.Option(help="Seconds instead of minutes: too short to compare.")] = False,
) -> None:
    """Steps per second beside other environments, memory, start-up and the share in training, in one run."""
    from benchmarks.report import progress, run
    from benchmarks.targets import speed_table, target_table

    try:
        with progress() as tell:
            results = run(out, names=only, rounds=rounds, seconds=seconds, cores=cores, quick=quick, tell=tell)
    except (ValueError, OSError) as error:
        _stop(str(error))
    console = Console()
    console.print(speed_table(results), target_table(results))
    console.print(f"Results: {out / 'results.json'}, {out / 'speed.png'}")


@app.command()
def map_reference(
    out: Annotated[Path, typer.Option(help="Folder for map-reference.json.")] = Path("out/map-reference"),
    runs: Annotated[int, typer.Option(min=1, help="Number of runs.")] = 20,
    seconds: Annotated[float, typer.Option(min=1.0, help="Length of each [s].")] = 40.0,
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
) -> None:
    """The posterior of whole episodes (extra: gtsam) beside map-alignment and the bound."""
    try:
        from benchmarks import map_reference as reference
    except MissingExtraError as error:
        _stop(str(error))
    from benchmarks.report import progress

    with progress() as tell:
        results = reference.run(out, runs=runs, seconds=seconds, seed=seed, tell=tell)
    console = Console()
    console.print(reference.table(results))
    console.print(f"Results: {out / 'map-reference.json'}")


@app.command()
def consistency(
    out: Annotated[Path, typer.Option(help="Folder for consistency.json and consistency.png.")] = Path(
        "out/consistency"
    ),
    runs: Annotated[int, typer.Option(min=2, help="Runs with noise of their own.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
) -> None:
    """What becomes of filtered depths that are fed in as white measurements: errors, claims and the bound over time."""
    from benchmarks.consistency import run
    from benchmarks.report import progress

    try:
        with progress() as tell:
            run(out, runs=runs, seed=seed, tell=tell)
    except OSError as error:
        _stop(str(error))
    Console().print(f"Results: {out / 'consistency.json'}, {out / 'consistency.png'}")


@app.command()
def profile(
    out: Annotated[Path, typer.Option(help="Folder for profile.json.")] = Path("out/speed"),
    num_envs: Annotated[int, typer.Option(min=1, help="Environments in the batch.")] = 4096,
    seconds: Annotated[float, typer.Option(min=0.0, help="How long each stage is measured [s].")] = 5.0,
) -> None:
    """How the time of a step divides among its stages."""
    from benchmarks.worker import limit_cores

    limit_cores(1)
    from benchmarks.profile import stages, table

    found = stages(num_envs, seconds)
    out = open_folder(out)
    write_json(out / "profile.json", found)
    Console().print(table(found))


@app.command()
def estimators(
    out: Annotated[Path, typer.Option(help="Folder for estimators.json.")] = Path("out/estimators"),
    runs: Annotated[int, typer.Option(min=1, help="Random runs of each row.")] = 1000,
    seconds: Annotated[float, typer.Option(min=5.0, help="How long each run is [s].")] = 40.0,
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    only: Annotated[list[str] | None, typer.Option(help="Name of a row; may be given again.")] = None,
) -> None:
    """Each estimator's errors against the information bound, its honesty, and the time of a sample."""
    from benchmarks.estimator_targets import accuracy_table, cost_table, target_table
    from benchmarks.estimators import run
    from benchmarks.report import progress

    try:
        with progress() as tell:
            results = run(out, only=only, runs=runs, seconds=seconds, seed=seed, tell=tell)
    except (ValueError, OSError) as error:
        _stop(str(error))
    console = Console()
    console.print(accuracy_table(results), cost_table(results), target_table(results))
    console.print(f"Results: {out / 'estimators.json'}")


@app.command()
def vision(
    out: Annotated[Path, typer.Option(help="Folder for vision.json.")] = Path("out/vision"),
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of open-field, 1200 pictures each.")] = 100,
    repetitions: Annotated[int, typer.Option(min=1, help="Runs of the paper's experiment.")] = 5,
    pictures: Annotated[int, typer.Option(min=1, help="Pictures of each hard case.")] = 200,
    actions: Annotated[int | None, typer.Option(min=1, help="Actions of each episode; default: all.")] = None,
) -> None:
    """Cameras that take pictures beside analytic ones (extra: vision): detections, poses, hard cases. 20 minutes."""
    from benchmarks.report import progress
    from benchmarks.vision import run, tables

    try:
        with progress() as tell:
            results = run(
                out, episodes=episodes, repetitions=repetitions, pictures=pictures, actions=actions, tell=tell
            )
    except (MissingExtraError, OSError) as error:
        _stop(str(error))
    console = Console()
    console.print(*tables(results))
    console.print(f"Results: {out / 'vision.json'}")


@app.command()
def digests(
    out: Annotated[Path, typer.Option(help="File of the record, .npz.")] = Path("out/digests.npz"),
    against: Annotated[Path | None, typer.Option(help="Record of before, to compare with.")] = None,
) -> None:
    """Record what must not change in a rebuilding; with an earlier record, name every part that is different."""
    from benchmarks.digests import TOLERANCE, compare, digest, record
    from benchmarks.report import progress

    try:
        with progress() as tell:
            count = record(out, tell)
        changes = [] if against is None else compare(against, out)
    except (ValueError, OSError) as error:
        _stop(str(error))
    for name, what, difference in changes:
        typer.echo(f"{difference:8.1e} {what}: {name}")
    typer.echo(f"{count} arrays, digest {digest(out)}: {out}")
    if against is not None:
        typer.echo(f"{len(changes)} parts differ" if changes else "The same to the bit")
    if any(difference > TOLERANCE for *_, difference in changes):
        raise typer.Exit(1)


def _stop(message: str) -> NoReturn:
    """Print one line and end with exit code 2."""
    typer.echo(f"Error: {message}", err=True)
    raise typer.Exit(2)


if __name__ == "__main__":
    lenient()
    app()
