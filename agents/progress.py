"""A progress bar for whatever takes long."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn


@contextmanager
def bar() -> Iterator[Callable[[str, float], None]]:
    """A progress bar with the time left; call what this yields with words and the part that is done.

    It is shown from the first call on.
    """
    columns = (SpinnerColumn(), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn())
    progress = Progress(*columns, TextColumn("{task.description}"), console=Console(stderr=True))
    task = progress.add_task("", total=1.0)

    def tell(words: str, part: float) -> None:
        progress.start()
        progress.update(task, completed=part, description=words)

    try:
        yield tell
    finally:
        if progress.live.is_started:
            progress.stop()
