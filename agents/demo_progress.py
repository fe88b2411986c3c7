"""Says what the demonstration is doing."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Self

from numba.core.event import Event, Listener, install_listener
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

Tell = Callable[..., None]
"""Called with the part of a step that is done, and more words where there are any."""


class Steps:
    """Says what is being done: a bar on a terminal, one line for each step elsewhere."""

    def __init__(self, console: Console, total: int) -> None:
        self._console, self._total, self._done = console, total, 0
        self._bar: Progress | None = None
        if console.is_terminal:
            self._bar = Progress(
                SpinnerColumn(), BarColumn(bar_width=28), TextColumn("{task.description}"), TimeElapsedColumn(),
                console=console, transient=True,
            )  # fmt: skip
            self._task = self._bar.add_task("", total=total)

    def __enter__(self) -> Self:
        """Show the bar."""
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()

    @contextmanager
    def step(self, words: str) -> Iterator[Tell]:
        """One of the steps; call what this yields with the part that is done, and more words."""
        if self._bar is None:
            self._console.print(f"[{self._done + 1}/{self._total}] {words}", markup=False, highlight=False)

        def tell(part: float, more: str = "") -> None:
            if self._bar is not None:
                self._bar.update(
                    self._task, completed=self._done + min(part, 1.0), description=f"{words} {more}".strip()
                )

        tell(0.0)
        with install_listener("numba:compile", _Compilation(tell)):
            yield tell
        self._done += 1
        tell(0.0)


class _Compilation(Listener):
    """Tells which kernel is being compiled: that takes most of the first run."""

    USUAL = 110
    """Kernels that a first run compiles, about."""

    def __init__(self, tell: Tell) -> None:
        self._tell, self._count = tell, 0

    def on_start(self, event: Event) -> None:
        """Say so."""
        self._count += 1
        self._tell(self._count / self.USUAL, f"({self._count}: {event.data['dispatcher'].__name__})")

    def on_end(self, event: Event) -> None:
        """The next step or kernel says what comes."""
