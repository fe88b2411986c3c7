"""The first compilation on two cores: a second process compiles the estimator and the motion meanwhile.

numba compiles one kernel at a time in a process. What the other process stores in the cache, this one loads.
"""

import atexit
import contextlib
import functools
import json
import multiprocessing
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np

from relloc_env.envs.threads import cores
from relloc_env.estimators.config import OwnConfig
from relloc_env.kernels._compile import announce, is_awaited
from relloc_env.kernels.stepping import advance

if TYPE_CHECKING:
    from relloc_env.envs.core import Core

ALONE = "RELLOC_ONE_PROCESS"
"""Environment variable: anything but empty or 0 keeps all compilation in this process."""
_PATIENCE = 300.0
"""[s] for which the other process is waited for."""
_NONE = np.zeros(0, np.int64)


@functools.cache
def _begun() -> list["subprocess.Popen[bytes]"]:
    """The other process, once there is one."""
    return []


def compile_kernels(core: "Core") -> None:
    """Compile what `core` needs, where this process is the first to need any of it, and may have help."""
    own = core.own_estimator or isinstance(core.config.estimator, OwnConfig)
    alone = os.environ.get(ALONE, "0") not in ("", "0") or multiprocessing.parent_process() is not None
    if own or alone or _begun() or cores() < 2 or not sys.executable or not is_awaited(advance):
        return
    announce()
    told = json.dumps(core.config.to_dict())
    code = f"import sys; sys.path[:] = {sys.path!r}; from relloc_env.envs.ahead import help_out; help_out({told!r})"
    quiet = {**os.environ, ALONE: "1", "RELLOC_QUIET": "1"}
    helper = subprocess.Popen(  # noqa: S603 (this Python, on this package)
        [sys.executable, "-c", code], env=quiet, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    _begun().append(helper)
    atexit.register(helper.kill)
    core.compile_the_rest()
    with contextlib.suppress(subprocess.TimeoutExpired):  # then this process compiles what is left
        helper.wait(_PATIENCE)


def help_out(told: str) -> None:
    """Compile, in a process of its own, the kernels of the estimator and of the motion of a configuration."""
    from relloc_env.config import load_config
    from relloc_env.envs.core import Core

    core = Core(load_config(json.loads(told)))
    simulation, estimator = core.simulation, core.onboard.estimator
    if estimator is not None:
        estimator.update(simulation.samples, _NONE)
        estimator.reset(simulation.prior, _NONE)
    simulation.step(np.zeros((1, core.config.robots, 2)), _NONE)
