"""A contender in a process of its own, which works when asked and sleeps otherwise.

`python -m benchmarks.worker NAME CORES` reads a request per line from the standard input and answers in a line, both
JSON. Whatever the libraries print goes to the standard error.
"""

import gc
import json
import os
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables by which libraries learn how many threads they may start."""


def limit_cores(cores: int) -> None:
    """Keep this process and what it will import to so many cores."""
    for name in THREADS:
        os.environ[name] = str(cores)
    os.environ["JAX_PLATFORMS"] = "cpu"
    if hasattr(os, "sched_setaffinity"):  # Linux; XLA counts the cores that it may use
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])


def resident() -> int:
    """Memory of this process that is in use [bytes]; 0 where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def array_bytes(root: object) -> int:
    """Size of all NumPy arrays that can be reached from an object [bytes], each buffer once."""
    import numpy as np

    found: dict[int, int] = {}
    seen, stack = {id(root)}, [root]
    while stack:
        item = stack.pop()
        if isinstance(item, np.ndarray):
            while isinstance(item.base, np.ndarray):
                item = item.base
            found[id(item)] = item.nbytes
            continue
        if isinstance(item, type) or type(item).__name__ in {"module", "function", "builtin_function_or_method"}:
            continue
        for other in gc.get_referents(item):
            if id(other) not in seen:
                seen.add(id(other))
                stack.append(other)
    return sum(found.values())


class Worker:
    """Drives of one contender, by number of environments."""

    def __init__(self, name: str) -> None:
        from benchmarks.contenders import CONTENDERS

        self._contender = CONTENDERS[name]
        self._drives: dict[int, Any] = {}

    def set_up(self, num_envs: int, warm_up: float = 1.0) -> dict[str, Any]:
        """Build the environments and run them until everything is compiled; says how often robots touch something."""
        drive = self._drives[num_envs] = self._contender.set_up(num_envs)
        for _ in range(2):  # JAX compiles for what comes out of the first call once more
            drive()
        self.run(num_envs, warm_up)
        return {"contact": drive.contact_share()} if hasattr(drive, "contact_share") else {}

    def run(self, num_envs: int, seconds: float) -> dict[str, Any]:
        """Step for about so long."""
        drive, steps = self._drives[num_envs], 0
        start = now = time.perf_counter()
        while now - start < seconds:
            steps += drive()
            now = time.perf_counter()
        return {"steps": steps, "seconds": now - start}

    def memory(self, num_envs: int) -> dict[str, Any]:
        """Memory of the environments' arrays, and of the whole process but for the actions [bytes]."""
        gc.collect()
        drive = self._drives[num_envs]
        arrays = array_bytes(drive.envs)
        return {"arrays": arrays, "resident": resident() - (array_bytes(drive) - arrays)}

    def growth(self, num_envs: int, steps: int, traced: int) -> dict[str, Any]:
        """How much memory the process takes, and Python's objects hold, after so many environment steps more [bytes].

        Python's own bookkeeping slows it down: its objects are counted over the first `traced` steps only.
        """
        drive = self._drives[num_envs]

        def go(count: int) -> None:
            while count > 0:
                count -= drive() * num_envs

        gc.collect()
        before = resident()
        go(steps)
        gc.collect()
        after = resident()
        tracemalloc.start()
        go(traced // 10)
        gc.collect()
        first = tracemalloc.get_traced_memory()[0]
        go(traced)
        gc.collect()
        last = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        return {"resident": after - before, "traced": last - first}

    def train(self, num_envs: int, updates: int) -> dict[str, Any]:
        """Share of the environment in the time of training."""
        from benchmarks.training import measure

        return measure(num_envs, updates)


def main(name: str, cores: int) -> None:
    """Answer requests until there are no more."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)
    limit_cores(cores)
    worker = Worker(name)
    for line in sys.stdin:
        request = json.loads(line)
        answer = getattr(worker, request.pop("do"))(**request)
        answers.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
