"""What every test runs with: its own cache of compiled kernels, no display, and the recorded data if at hand."""

import hashlib
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def _compiled_sources() -> list[Path]:
    """Return the files that hold compiled functions: the kernels, and whatever else uses numba or their decorator."""
    files = [path for name in ("relloc_env", "agents", "train", "benchmarks") for path in (ROOT / name).rglob("*.py")]
    marks = ("import numba", "from numba", "kernels._compile")
    return sorted(p for p in files if p.parent.name == "kernels" or any(m in p.read_text("utf-8") for m in marks))


def _sources_digest() -> str:
    digest = hashlib.sha256()
    for path in _compiled_sources():
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


# Set before anything imports numba, pygame or matplotlib. numba notices a change of the file that a cached function
# stands in, not of the functions that it calls in other files: a cache per state of all sources is never stale.
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".cache" / "numba" / _sources_digest()))
os.environ["SDL_VIDEODRIVER"] = "dummy"
os.environ["SDL_AUDIODRIVER"] = "dummy"
os.environ["MPLBACKEND"] = "Agg"
os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
# Test workers already use all cores.
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with the recorded data (`mrclam/`, `starloc/`): RELLOC_DATA, or ../shared/data beside the project."""
    given = os.environ.get("RELLOC_DATA")
    path = Path(given) if given else ROOT.parent / "shared" / "data"
    if not path.is_dir():
        pytest.skip(f"no recorded data: RELLOC_DATA is {given!r} and the project has no ../shared/data beside it")
    return path
