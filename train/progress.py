"""Says how a run is getting on: a bar on a terminal, a line for each evaluation elsewhere."""

from collections.abc import Mapping
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn


class Show:
    """A bar with the time left and the score against the best script.

    Args:
        total: steps of the run.
        score: name of the score.
        quiet: whether to say nothing.
    """

    def __init__(self, total: int, score: str, *, quiet: bool = False) -> None:
        self._console = Console(stderr=True, quiet=quiet)
        self._score, self._words = score, ""
        self._bar = Progress(
            SpinnerColumn(), BarColumn(bar_width=24), MofNCompleteColumn(), TimeRemainingColumn(),
            TextColumn("{task.description}"), console=self._console, disable=quiet or not self._console.is_terminal,
        )  # fmt: skip
        self._task = self._bar.add_task("", total=total)

    def __enter__(self) -> Self:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the bar as it is."""
        self._bar.stop()

    def at(self, steps: int) -> None:
        """So many steps are done."""
        self._bar.update(self._task, completed=steps)

    def doing(self, words: str) -> None:
        """Something other than steps is being done."""
        self._bar.update(self._task, description=words)

    def line(self, words: str) -> None:
        """Say something that stays."""
        self._console.print(words, markup=False, highlight=False)

    def evaluated(self, line: Mapping[str, Any]) -> None:
        """An evaluation is over."""
        words = f"{self._score} {line['score']:.3f} (best {line['best']:.3f})"
        if line["script"]:
            words += f", {line['script']} {line['script_score']:.3f}"
        self.doing(words)
        if not self._console.is_terminal:
            self.line(f"{line['steps']:,} steps: {words}")
