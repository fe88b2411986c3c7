"""`python -m train`: policies from the command line."""

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from relloc_env.console import lenient
from relloc_env.extras import MissingExtraError

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False,
    help="Train policies with Stable-Baselines3, and see what they are worth.",
)  # fmt: skip

Config = Annotated[str, typer.Argument(metavar="CONFIG", help="Name of a published configuration, or a YAML file.")]
Overrides = Annotated[
    list[str] | None, typer.Argument(metavar="[FIELD=VALUE]...", help="E.g. seed=2 algorithm.gamma=0.99")
]

Trust = Annotated[
    bool, typer.Option("--trust", help="Run code that files name, and read pickled ones: of people you trust alone.")
]


@app.callback()
def _train() -> None:
    """Train policies."""


@app.command()
def run(
    config: Config,
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the run; default: out/train/NAME-seedN.")] = None,
    trust: Trust = False,
) -> None:
    """Train; stopped at any time, the same command goes on."""
    try:
        from train.config import load
        from train.run import DivergedError, train
    except MissingExtraError as error:
        _stop(str(error))
    try:
        chosen = load(config, overrides or (), trust=trust)
        folder = out or Path(f"out/train/{chosen.name}-seed{chosen.seed}")
        policy = train(chosen, folder, command=_command())
    except (DivergedError, MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))
    except KeyboardInterrupt:
        _stop("Stopped; the same command goes on from the last checkpoint")
    typer.echo(f"Policy: {policy}")


@app.command()
def export(
    out: Annotated[Path, typer.Argument(help="Folder of a run, over or not.", metavar="RUN")],
    name: Annotated[str | None, typer.Option(help="Name among the policies that ship; default: stay in RUN.")] = None,
    trust: Trust = False,
) -> None:
    """Write the best policy of a run so far as an ONNX file with its card."""
    try:
        from train.config import load
        from train.folder import CONFIG, ship
        from train.run import Run
    except MissingExtraError as error:
        _stop(str(error))
    try:
        chosen = load(out / CONFIG, trust=trust)
        policy = ship(out, name) if name else Run(chosen, out).finish()
    except (MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))
    typer.echo(f"Policy: {policy}")


@app.command()
def tune(
    config: Config,
    overrides: Overrides = None,
    trials: Annotated[int, typer.Option(min=1, help="Trials, those of earlier calls included.")] = 30,
    out: Annotated[Path | None, typer.Option(help="Folder of the study; default: out/tune/NAME.")] = None,
    trust: Trust = False,
) -> None:
    """Search for hyper-parameters with Optuna; stopped at any time, the same command goes on."""
    try:
        from train.config import load
        from train.tune import tune as search
    except MissingExtraError as error:
        _stop(str(error))
    try:
        chosen = load(config, overrides or (), trust=trust)
        found = search(chosen, trials, out or Path(f"out/tune/{chosen.name}"), tell=typer.echo)
    except (MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))
    except KeyboardInterrupt:
        _stop("Stopped; the same command goes on")
    typer.echo(f"Best configuration: {found}")


@app.command()
def evaluate(
    policies: Annotated[list[str], typer.Argument(help="Names of policies that ship, or .onnx or .zip files.")],
    out: Annotated[Path, typer.Option(help="Folder of results; what is there already is not done again.")] = Path(
        "out/evaluate"
    ),
    suite: Annotated[str, typer.Option(help="Names of suites, parted by commas.")] = "open-field",
    agents: Annotated[str, typer.Option(help="Agents to compare with; all: scripted and feedback.")] = "all",
    estimators: Annotated[
        str | None, typer.Option(help="Names of estimators, parted by commas; default: as it was trained with.")
    ] = None,
    env: Annotated[str | None, typer.Option(help="Id of the environment; default: as the card says.")] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each agent on each suite.")] = 400,
    seeds: Annotated[str, typer.Option(help="Set of seeds: train, validation or test.")] = "test",
    options: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="OPTION=VALUE", help="Of the environment, over every suite: robot.lag=[0.2,0.1]"),
    ] = None,
    cores: Annotated[int | None, typer.Option(min=1, help="Cores to use; default: all.")] = None,
    animations: Annotated[bool, typer.Option(help="Draw an episode of each agent.")] = True,
    trust: Trust = False,
) -> None:
    """Play policies beside scripts on the same episodes: the benchmark's results, tables and page for them."""
    try:
        from agents.__main__ import EVERY, names
        from agents.benchmark import benchmark
        from agents.jobs import Asked
        from agents.learned import PREFIX, trained_with
        from agents.progress import bar
        from agents.registry import AGENTS, refuse_pickled
        from agents.report import report
        from relloc_env.config import TASKS
    except MissingExtraError as error:
        _stop(str(error))
    try:
        if not trust:
            refuse_pickled(PREFIX + each for each in policies)
        robots, estimator = trained_with(policies[0])
        asked = Asked(
            env=env or {count: name for name, count in TASKS.items()}[robots],
            suites=names(suite),
            agents=(*(PREFIX + each for each in policies), *(tuple(AGENTS) if agents == EVERY else names(agents))),
            estimators=names(estimators) if estimators else (estimator,),
            episodes=episodes,
            seeds=seeds,
            options=tuple(options or ()),
        )
        with bar() as tell:
            benchmark(asked, out, cores=cores, tell=tell)
            page = report(out, animations=animations, trust=trust, tell=tell)
    except (MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))
    except KeyboardInterrupt:
        _stop("Stopped; the same command goes on")
    typer.echo(f"Page: {page}; every figure of its tables: {page.with_name('summary.json')}")


@app.command()
def curves(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs.", metavar="RUN...")],
    out: Annotated[Path, typer.Option(help="Picture to write: .svg, .png or .pdf.")] = Path("out/curves.svg"),
) -> None:
    """Draw the learning curves of runs, and print a table of their policies' scores on test seeds as Markdown."""
    try:
        from train.curves import curves as draw
        from train.curves import table
    except MissingExtraError as error:
        _stop(str(error))
    try:
        draw(runs, out)
        typer.echo(table(runs))
    except (MissingExtraError, ValueError, OSError) as error:
        _stop(str(error))
    typer.echo(f"Curves: {out}")


def _command() -> str:
    """The command that was given, for the card."""
    return " ".join(["python -m train", *sys.argv[1:]])


def _stop(message: str) -> NoReturn:
    """Print one line and end with exit code 2."""
    typer.echo(f"Error: {message}", err=True)
    raise typer.Exit(2)


if __name__ == "__main__":
    lenient()
    app()
