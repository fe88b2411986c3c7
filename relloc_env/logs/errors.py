"""What goes wrong with recorded files, said so that the file can be mended."""

from pathlib import Path


class LogError(Exception):
    """A recorded file cannot be used. The message names the file and, where there is one, the line."""

    def __init__(self, path: Path, message: str, line: int | None = None) -> None:
        where = str(path) if line is None else f"{path}, line {line}"
        super().__init__(f"{where}: {message}")
        self.path = path
        self.line = line
