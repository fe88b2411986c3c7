"""Command line of training."""

from pathlib import Path
from typing import Annotated

import gymnasium as gym
import typer
from rich.console import Console

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, help="Train policies with Stable-Baselines3."
)


@app.callback()
def _train() -> None:
    """Train policies with Stable-Baselines3."""


@app.command()
def run(
    name: Annotated[str, typer.Argument(metavar="ID", help="Gymnasium id")] = "relloc_env/RelativePose-v0",
    steps: Annotated[int, typer.Option(min=1, help="actions to train for")] = 200_000,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    envs: Annotated[int, typer.Option(min=1, help="environments that run in turn")] = 8,
    out: Annotated[Path, typer.Option(help="folder for the policy and its evaluation")] = Path("out/train"),
) -> None:
    """Train PPO on an id, then compare it with driving straight on 20 starts that it never saw."""
    console = Console()
    try:
        from train.ppo import train
    except ModuleNotFoundError as error:
        console.print(f"[red]{error.name} is missing:[/red] pip install -e '.\\[train]'")
        raise typer.Exit(2) from None
    try:
        result = train(name, steps, out, seed=seed, envs=envs, progress=console.is_terminal)
    except (gym.error.Error, ImportError, OSError) as error:
        console.print(f"[red]Error:[/red] {error}", highlight=False)
        raise typer.Exit(2) from None
    for policy, values in result["information_at_the_end"].items():
        console.print(f"{policy:10s} J at the end: {sum(values) / len(values):.2f} nats")
    console.print(f"Policy and evaluation: {out}")


if __name__ == "__main__":
    app()
