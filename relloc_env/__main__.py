"""`python -m relloc_env`: the paper reproduced, recorded robots replayed, robots driven by hand."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer

import relloc_env

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, help=__doc__
)

EXTRAS = {
    "cv2": "vision",
    "matplotlib": "logs",
    "pygame": "render",
    "imageio_ffmpeg": "render",
    "PIL": "render",
    "rerun": "rerun",
}
"""The extra of this package that brings each optional one."""

Rerun = Annotated[
    Path | None, typer.Option(help="A file, .rrd, for the viewer of Rerun (extra: rerun).", dir_okay=False)
]
Out = Annotated[Path, typer.Option(help="Folder for the results; made where it is missing.", file_okay=False)]


@app.command()
def paper(out: Out) -> None:
    """Reproduce the paper's simulations and experiment: claims.json and the figures."""
    with _plain_errors(), _progress() as tell:
        from relloc_env.paper import claims_table, reproduce

        claims = reproduce(out, lambda words: tell(words, None))
    _print(
        claims_table(claims), f"{sum(one.holds for one in claims)} of {len(claims)} claims hold as printed; see {out}/"
    )


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
        session = Session(config, seed=seed, logs=out, **options)
        with recorder(rerun) as watch:
            run(session, size=size, theme="dark" if dark else "light", watch=watch)
    for path in session.written:
        typer.echo(f"Log: {path}; python -m relloc_env replay {path} --out {path}/replay")


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
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in EXTRAS:
            raise
        _stop(f"The package `{missing}` is missing: pip install 'relloc-env[{EXTRAS[missing]}]'")
    except (LogError, TypeError, ValueError, OSError) as error:
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
    app()
