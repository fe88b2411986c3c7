"""What it takes to begin: import, first and second `gym.make`, first compilation. Each in fresh processes."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.speed import ROOT, Tell, silent, spread

_IMPORT = """
import time
start = time.perf_counter()
import gymnasium
middle = time.perf_counter()
import relloc_env
print(middle - start, time.perf_counter() - middle)
"""
_MAKE = """
import time, gymnasium, relloc_env
times = [time.perf_counter()]
for _ in range(2):
    env = gymnasium.make("relloc_env/RelativePose-v0", estimator="cascade")
    times.append(time.perf_counter())
env.reset(seed=0)
env.step(env.action_space.sample())
times.append(time.perf_counter())
print(*(b - a for a, b in zip(times, times[1:])))
"""


def _run(code: str, **variables: str) -> list[float]:
    """Numbers that a program prints."""
    environment = {**os.environ, **variables}
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    return [float(word) for word in run.stdout.split()]


def measure(repeats: int = 15, *, compile_first: bool = True, tell: Tell = silent) -> dict[str, Any]:
    """Times to begin [s], medians and spreads over fresh processes.

    Args:
        repeats: processes that import, and that make.
        compile_first: whether to compile into an empty cache as well, once.
        tell: told the part that is done.
    """
    _run(_MAKE)  # fills the cache
    imports, makes = [], []
    for k in range(repeats):
        tell(k / (repeats + 4), "import and gym.make in fresh processes")
        imports.append(_run(_IMPORT))
        makes.append(_run(_MAKE))
    found = {
        "import_gymnasium": spread(a for a, _ in imports),
        "import_relloc_env": spread(b for _, b in imports),
        "first_make": spread(a for a, _, _ in makes),
        "second_make": spread(b for _, b, _ in makes),
        "first_reset_and_step": spread(c for *_, c in makes),
    }
    if compile_first:
        tell(repeats / (repeats + 4), "first compilation, into an empty cache")
        with tempfile.TemporaryDirectory() as folder:
            found["first_compilation"] = spread([sum(_run(_MAKE, NUMBA_CACHE_DIR=str(Path(folder))))])
    return found
