"""`python -m relloc_env`: the paper reproduced, recorded robots replayed, robots driven by hand."""

import itertools
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer

import relloc_env
from relloc_env.console import lenient
from relloc_env.extras import MissingExtraError

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, help=__doc__
)

Rerun = Annotated[
    Path | None, typer.Option(help="A file, .rrd, for the viewer of Rerun (extra: rerun).", dir_okay=False)
]
Out = Annotated[Path, typer.Option(help="Folder for the results; made where it is missing.", file_okay=False)]


@app.command()
def paper(out: Out) -> None:
    """Reproduce the paper's simulations and experiment: claims.json, claims.md and the figures."""
    with _plain_errors(), _progress() as tell:
        from relloc_env.paper import claims_table, reproduce, tally

        claims = reproduce(out, lambda words: tell(words, None))
    _print(claims_table(claims), f"{tally(claims)}; see {out}/")


@app.command()
def replay(
    path: Annotated[
        Path, typer.Argument(help="Folder: an MR.CLAM set, a STAR-loc sequence, or a log of this package.")
    ],
    out: Out,
    robots: Annotated[tuple[int, int] | None, typer.Option(help="MR.CLAM: two robots; default: all pairs.")] = None,
    start: Annotated[float | None, typer.Option("--from", help="[s] Start of the stretch.")] = None,
    stop: Annotated[float | None, typer.Option("--to", help="[s] End of the stretch.")] = None,
    velocity: Annotated[
        Literal["commands", "mocap"] | None, typer.Option(help="MR.CLAM: where velocities come from.")
    ] = None,
    estimator: Annotated[
        list[str] | None, typer.Option(help="Name; may be given again. Default: the best one and the paper's.")
    ] = None,
    pose_model: Annotated[
        Literal["position", "velocity", "printed"] | None, typer.Option(help="Observation model of the cascade's pose.")
    ] = None,
    initial_depth: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="GUESS SD", help="[m] First guess of every depth and its spread; no truth is used."),
    ] = None,
    initial_depth_error: Annotated[
        float | None, typer.Option(help="[m] Added to the true depth for the first guess; STAR-loc: 1.")
    ] = None,
    initial_pose_error: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y DEG", help="[m, m, deg] Added to the true pose for the first guess."),
    ] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="What is refused in a recording, as gap=120 [s]; may be given again."),
    ] = None,
    rerun: Rerun = None,
) -> None:
    """Run estimators on a recorded log and score them: replay.json and figures."""
    with _plain_errors(), _progress() as tell:
        from relloc_env.logs import Limits
        from relloc_env.replay import replay as run

        pose_error = None
        if initial_pose_error is not None:
            pose_error = (*initial_pose_error[:2], math.radians(initial_pose_error[2]))
        result = (partial(run, limits=Limits.of(limit)) if limit else run)(
            path,
            robots=robots,
            start=start,
            stop=stop,
            velocity=velocity,
            estimator=estimator or None,
            pose_model=pose_model,
            initial_depth=initial_depth,
            initial_depth_error=initial_depth_error,
            initial_pose_error=pose_error,
            out=out,
            progress=tell,
        )
        if rerun is not None:
            from relloc_env.replay.recording import record

            tell("recording", None)
            record(result, rerun)
    from rich.markup import escape
    from rich.table import Table

    heads, rows = result.table()
    table = Table(title=f"{path.name}, velocities: {result.options['velocity']}", title_justify="left")
    for k, (head, *cells) in enumerate(zip(heads, *rows, strict=True)):
        if k == 0:
            table.add_column(escape(head))
            for name in cells:
                table.add_column(escape(name), justify="right")
        else:
            table.add_row(escape(head), *map(escape, cells))
    _print(table, "\n".join([*result.notes(), f"Results: {out}/"]))


@app.command()
def play(
    config: Annotated[str | None, typer.Option(help="Scenario, or file of options; default: the default task.")] = None,
    trust: Annotated[bool, typer.Option("--trust", help="Run code that the file names: of people you trust.")] = False,
    suite: Annotated[str | None, typer.Option(help="Suite of the benchmark, in place of a scenario.")] = None,
    robots: Annotated[int | None, typer.Option(min=1, max=2, help="Number of robots.")] = None,
    estimator: Annotated[str | None, typer.Option(help="The one that watches first.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first start.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for a log of each drive.", file_okay=False)] = Path("out/play"),
    size: Annotated[tuple[int, int], typer.Option(metavar="W H", help="[px] of the window.")] = (1280, 720),
    dark: Annotated[bool, typer.Option("--dark", help="Light on dark.")] = False,
    rerun: Rerun = None,
) -> None:
    """Drive the robots by keyboard or gamepad and watch the estimates; H tells the keys. Each drive becomes a log."""
    with _plain_errors():
        from relloc_env.play import Session
        from relloc_env.play import play as run
        from relloc_env.rendering.rerun_file import recorder
        from relloc_env.scenarios import suite as named

        if config is not None and suite is not None:
            raise ValueError("Argument `config` must be left out where `suite` is given")
        options: dict[str, Any] = {} if suite is None else dict(named(suite).variants[0])
        options |= {k: v for k, v in (("robots", robots), ("estimator", estimator)) if v is not None}
        session = Session(config, seed=seed, logs=out, trust=trust, **options)
        with recorder(rerun) as watch:
            run(session, size=size, theme="dark" if dark else "light", watch=watch)
    for path in session.written:
        typer.echo(f"Log: {path}; python -m relloc_env replay {path} --out {path}/replay")


@app.command("compile")
def fill_cache(
    config: Annotated[
        list[str] | None, typer.Option(help="Scenario, or file of options; may be given again. Default: both ids.")
    ] = None,
    estimator: Annotated[
        list[str] | None, typer.Option(help="Name; may be given again. Default: that of each configuration.")
    ] = None,
) -> None:
    """Compile the kernels ahead: before many processes start, or while a container is built."""
    with _plain_errors(), _progress() as tell:
        from relloc_env.config import load_config
        from relloc_env.config.loading import TASKS
        from relloc_env.envs import precompile

        given: list[tuple[str, dict[str, Any]]] = [(name, {"config": name}) for name in config or ()]
        given = given or [(name, {"task": name}) for name in TASKS]
        for (name, options), chosen in itertools.product(given, [*(estimator or ()), *([] if estimator else [None])]):
            words = ", ".join(filter(None, (name, chosen)))
            tell(words, None)
            start = time.perf_counter()
            found = load_config(**options) if chosen is None else load_config(**options, estimator=chosen)
            count = precompile.fill_cache(found)
            what = f"{count} kernels compiled" if count else "nothing was missing"
            typer.echo(f"{words}: {what} ({time.perf_counter() - start:.0f} s)")


@app.command()
def version() -> None:
    """Print the version."""
    typer.echo(relloc_env.__version__)


@contextmanager
def _plain_errors() -> Iterator[None]:
    """Turn what can be wrong with the input into one line and exit code 2."""
    from relloc_env.logs.errors import LogError

    try:
        yield
    except (LogError, MissingExtraError, TypeError, ValueError, OSError) as error:
        _stop(str(error))


@contextmanager
def _progress() -> Iterator[Callable[[str, float | None], None]]:
    """A bar on a terminal; yields what to call with words and the part that is done, None where that is unknown."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda words, part: bar.update(
            task, description=words, total=None if part is None else 1.0, completed=part or 0.0
        )


def _print(table: object, words: str) -> None:
    from rich.console import Console

    console = Console()
    console.print(table)
    console.print(words, markup=False, highlight=False)


def _stop(message: str) -> NoReturn:
    typer.echo("Error: " + "; ".join(message.splitlines()), err=True)
    raise typer.Exit(2)


if __name__ == "__main__":
    lenient()
    app()
