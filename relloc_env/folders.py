"""Where results go: made and tried before the work begins, not after it."""

import contextlib
import os
import tempfile
from pathlib import Path

try:
    import fcntl
except ImportError:  # not on Windows; there two writers of one folder are not told
    fcntl = None  # type: ignore[assignment]

_LOCK = ".in-use"


def open_folder(path: str | Path, name: str = "out") -> Path:
    """Make a folder for results, try to write into it, and return its absolute path.

    Args:
        path: of the folder; those above it are made too.
        name: of the argument, for messages.

    Raises:
        OSError: it cannot be made, or not be written into.
    """
    folder = Path(path).expanduser().absolute()
    above = next(each for each in (folder, *folder.parents) if os.path.lexists(each))
    if not above.is_dir():
        raise NotADirectoryError(f"Argument `{name}` must be a folder, but {above} is a file")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise type(error)(
            f"Argument `{name}` must be a folder that can be written into, but {folder} is not: {reason}"
        ) from error
    return folder


def open_file(path: str | Path, name: str = "out") -> Path:
    """Make the folder of a file for results, try to write into it, and return the file's absolute path.

    Raises:
        OSError: the file is a folder, or its folder cannot be made or not be written into.
    """
    file = Path(path).expanduser().absolute()
    if file.is_dir():
        raise IsADirectoryError(f"Argument `{name}` must be a file, but {file} is a folder")
    open_folder(file.parent, name)
    return file


class FolderLock:
    """Keeps a folder for one writer, until it is released or its process ends. It cannot be copied.

    Args:
        folder: which exists.
        name: of the argument, for messages.

    Raises:
        OSError: somebody else writes there.
    """

    def __init__(self, folder: Path, name: str = "folder") -> None:
        self._path = folder / _LOCK
        self._file: int | None = None
        while fcntl is not None and self._file is None:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.path.samestat(os.fstat(file), self._path.stat()):
                    self._file = file
            except BlockingIOError:
                raise BlockingIOError(
                    f"Argument `{name}` must be a folder that nothing else writes into, but {folder} is in use by "
                    "another writer that is not closed"
                ) from None
            except FileNotFoundError:  # the last writer removed it just now
                pass
            finally:
                if self._file is None:
                    os.close(file)

    def __reduce__(self) -> str:
        raise TypeError("What writes into a folder cannot be copied: two would write into one")

    def release(self) -> None:
        """Let others write; may be called twice."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._path.unlink()
            os.close(self._file)
            self._file = None
