"""What every test runs with: no display, and the recorded data if at hand."""

import os
from pathlib import Path

import pytest

# Set before anything imports numba, pygame or matplotlib.
os.environ["SDL_VIDEODRIVER"] = "dummy"
os.environ["SDL_AUDIODRIVER"] = "dummy"
os.environ["MPLBACKEND"] = "Agg"
os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
# Test workers already use all cores.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Nor does anybody wait who has to be told what is compiled.
os.environ["RELLOC_QUIET"] = "1"
# Nor does a second process help to compile.
os.environ["RELLOC_ONE_PROCESS"] = "1"


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with the recorded data (`mrclam/`, `starloc/`): RELLOC_DATA."""
    given = os.environ.get("RELLOC_DATA")
    if not given or not Path(given).is_dir():
        pytest.skip(f"no recorded data: RELLOC_DATA is {given!r}")
    return Path(given)
