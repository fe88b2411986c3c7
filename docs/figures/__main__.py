"""`python -m docs.figures`: draw the figures of docs/pictures.md."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer

from docs.figures import bound, motion, observer, pose
from relloc_env.console import lenient

FIGURES: Mapping[str, Callable[[Path], None]] = {
    "motion": motion.draw,
    "observer": observer.draw,
    "pose": pose.draw,
    "bound": bound.draw,
}


def main(
    out: Annotated[Path, typer.Option(help="folder of the pictures")] = Path("docs/images"),
    only: Annotated[list[str] | None, typer.Option(help=f"one of {', '.join(FIGURES)}; again for more")] = None,
) -> None:
    """Draw the figures as SVG, the same file each time."""
    out.mkdir(parents=True, exist_ok=True)
    for name in only or FIGURES:
        FIGURES[name](out / f"{name}.svg")


if __name__ == "__main__":
    lenient()
    typer.run(main)
