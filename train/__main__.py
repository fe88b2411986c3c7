"""`python -m train`: policies from the command line."""

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False,
    help="Train policies with Stable-Baselines3, and see what they are worth.",
)  # fmt: skip

Config = Annotated[str, typer.Argument(metavar="CONFIG", help="Name of a published configuration, or a YAML file.")]
Overrides = Annotated[
    list[str] | None, typer.Argument(metavar="[FIELD=VALUE]...", help="E.g. seed=2 algorithm.gamma=0.99")
]


@app.callback()
def _train() -> None:
    """Train policies."""


@app.command()
def run(
    config: Config,
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the run; default: out/train/NAME-seedN.")] = None,
) -> None:
    """Train; stopped at any time, the same command goes on."""
    try:
        from train.config import load
        from train.run import DivergedError, train
    except ModuleNotFoundError as error:
        _missing(error)
    try:
        chosen = load(config, overrides or ())
        folder = out or Path(f"out/train/{chosen.name}-seed{chosen.seed}")
        policy = train(chosen, folder, command=" ".join(["python -m train", *sys.argv[1:]]))
    except (DivergedError, ValueError, OSError) as error:
        _stop(str(error))
    except KeyboardInterrupt:
        _stop("Stopped; the same command goes on from the last checkpoint")
    typer.echo(f"Policy: {policy}")


def _missing(error: ModuleNotFoundError) -> NoReturn:
    _stop(f"The package `{error.name}` is missing: pip install -e '.[train]'")


def _stop(message: str) -> NoReturn:
    """Print one line and end with exit code 2."""
    typer.echo(f"Error: {message}", err=True)
    raise typer.Exit(2)


if __name__ == "__main__":
    app()
