"""Where the time of a step goes: each compiled kernel that Python calls, and Python itself. On one core."""

import sys
import time
from collections.abc import Callable
from typing import Any

from numba.core.dispatcher import Dispatcher
from rich.table import Table

from benchmarks.ours import EVERYTHING, Batch


class _Timed:
    """A kernel that sums up its time [s] and calls."""

    def __init__(self, kernel: Callable[..., Any]) -> None:
        self._kernel = kernel
        self.seconds, self.calls = 0.0, 0

    def __call__(self, *arguments: object) -> Any:
        start = time.perf_counter()
        found = self._kernel(*arguments)
        self.seconds += time.perf_counter() - start
        self.calls += 1
        return found


def stages(num_envs: int, seconds: float) -> dict[str, Any]:
    """Measure a batch with everything on.

    Once all is compiled, kernels find each other without Python: only those that Python calls are seen here.

    Args:
        num_envs: environments in the batch.
        seconds: [s] how long.

    Returns:
        Nanoseconds per environment step: of the whole, of each kernel, of everything else.
    """
    batch = Batch(EVERYTHING, num_envs)
    timed: dict[int, tuple[str, _Timed]] = {}
    for name, module in list(sys.modules.items()):
        if not name.startswith("relloc_env"):
            continue
        for attribute, value in list(vars(module).items()):
            if isinstance(value, Dispatcher):
                home = value.py_func.__module__.removeprefix("relloc_env.")
                _, wrapped = timed.setdefault(id(value), (f"{home}.{value.py_func.__name__}", _Timed(value)))
                setattr(module, attribute, wrapped)
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds or not steps:
        steps += batch()
    total = time.perf_counter() - start
    scale = 1e9 / (steps * num_envs)
    kernels = {name: wrapped.seconds * scale for name, wrapped in timed.values() if wrapped.calls}
    return {
        "num_envs": num_envs, "steps": steps, "nanoseconds": total * scale,
        "kernels": dict(sorted(kernels.items(), key=lambda item: -item[1])),
        "rest": total * scale - sum(kernels.values()),
    }  # fmt: skip


def table(found: dict[str, Any]) -> Table:
    """The same as a table."""
    rows = Table(title=f"A step of {found['num_envs']} environments, everything on, one core")
    for name in ("kernel", "ns per environment step", "share"):
        rows.add_column(name, justify="left" if name == "kernel" else "right")
    for name, value in (*found["kernels"].items(), ("Python and NumPy", found["rest"]), ("all", found["nanoseconds"])):
        rows.add_row(name, f"{value:.1f}", f"{value / found['nanoseconds']:.1%}")
    return rows
