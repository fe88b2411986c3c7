"""The first compilation on two cores: a second process compiles the estimator and the motion meanwhile.

numba compiles one kernel at a time in a process. What the other process stores in the cache, this one loads. It is help
and no more: where it cannot be started or does not end, this process compiles everything. `fill_cache` compiles ahead
of the first environment: before many processes start, or while a container is built.
"""

import json
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numba.core.dispatcher import Dispatcher

from relloc_env.config import EnvConfig
from relloc_env.envs.threads import cores
from relloc_env.estimators.config import OwnConfig
from relloc_env.kernels._compile import QUIET, announce, is_awaited, is_set
from relloc_env.kernels.stepping import advance

if TYPE_CHECKING:
    from relloc_env.envs.core import Core

ALONE = "RELLOC_ONE_PROCESS"
"""Environment variable: anything but empty or 0 keeps all compilation in this process."""
_LEAST_PATIENCE = 60.0
"""[s] for which the other process is waited for at least; else, as long as this one took for its part."""
_CODE = "import json, sys; told = json.load(sys.stdin); sys.path[:] = told['path']; \
from relloc_env.envs.precompile import help_out; help_out(told['config'])"
_NONE = np.zeros(0, np.int64)
_begun = threading.Lock()
"""Held for good by the first who needs something compiled."""


def compile_kernels(core: "Core") -> None:
    """Compile most of what `core` needs, where this process is the first to need any of it, and may have help."""
    if not is_awaited(advance) or not _may_have_help(core) or not _begun.acquire(blocking=False):
        return
    announce()
    try:
        helper = _start(core)
    except (OSError, ValueError):  # no more processes, nothing that can be written down
        return
    try:
        start = time.monotonic()
        core.compile_most()
        helper.wait(max(_LEAST_PATIENCE, time.monotonic() - start))
    except subprocess.TimeoutExpired:
        pass
    finally:
        helper.kill()
        helper.wait()


def _may_have_help(core: "Core") -> bool:
    """Whether another process could compile for this one, and would run nothing but this package."""
    config = core.config
    pictures = any(config.camera_of(r).kind == "image" for r in range(config.robots))  # perhaps with their own detector
    own = core.own_estimator or isinstance(config.estimator, OwnConfig) or pictures
    python = Path(sys.executable or "").name.startswith("python") and not getattr(sys, "frozen", False)
    return python and not own and not is_set(ALONE) and multiprocessing.parent_process() is None and cores() > 1


def _start(core: "Core") -> "subprocess.Popen[str]":
    """Start the other process, and tell it the configuration."""
    told = json.dumps({"path": sys.path, "config": core.config.to_dict()})
    helper = subprocess.Popen(  # noqa: S603 (this Python, on this package)
        [sys.executable, "-c", _CODE],
        env={**os.environ, ALONE: "1", QUIET: "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert helper.stdin is not None
    with helper.stdin as stream:
        stream.write(told)
    return helper


def help_out(config: dict[str, object]) -> None:
    """Compile, in a process of its own, the kernels of the estimator and of the motion of a configuration."""
    from relloc_env.config import load_config
    from relloc_env.envs.core import Core

    core = Core(load_config(config))
    simulation, estimator = core.simulation, core.onboard.estimator
    if estimator is not None:
        estimator.update(simulation.samples, _NONE)
        estimator.reset(simulation.prior, _NONE)
    simulation.step(np.zeros((1, core.config.robots, 2)), _NONE)


def fill_cache(config: EnvConfig) -> int:
    """Compile whatever environments of a configuration need, one or many of them, and return how much was missing.

    Raises:
        OSError: there is no folder where compiled kernels can be kept.
    """
    from relloc_env.envs.vector import RellocVectorEnv

    start = time.time() - 0.01  # the clock of a file may be a little behind
    env = RellocVectorEnv(2, config)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    env.core.simulation.solve_contacts(_NONE)
    folders = set(map(Path, filter(None, (each.stats.cache_path for each in _kernels() if each.signatures))))
    if not folders:
        raise OSError("There is no folder for compiled kernels that can be written: let NUMBA_CACHE_DIR name one")
    return sum(file.stat().st_mtime >= start for folder in folders for file in folder.glob("*.nbc"))


def _kernels() -> set[Dispatcher]:
    """All kernels of this package that were imported."""
    modules = [module for name, module in sys.modules.items() if name.partition(".")[0] == "relloc_env"]
    return {value for module in modules for value in vars(module).values() if isinstance(value, Dispatcher)}
