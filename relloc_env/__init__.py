"""relloc_env: two ground robots, a camera on each, and the motion that lets them find depth and one another.

Importing this registers the ids `relloc_env/ActiveDepth-v0` and `relloc_env/RelativePose-v0` with Gymnasium, and with
PettingZoo where that is loaded. Compiled kernels load with the first environment, not here.
"""

import sys
from typing import TYPE_CHECKING, Any

import gymnasium as _gymnasium

if TYPE_CHECKING:
    from relloc_env.envs.aec import env
    from relloc_env.envs.parallel import parallel_env

__version__ = "0.1.0"
__all__ = ["env", "parallel_env"]

_DOORS = {"env": "relloc_env.envs.aec:env", "parallel_env": "relloc_env.envs.parallel:parallel_env"}
_IDS = ("relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0")


def _register() -> None:
    """Enter the ids into the registries that are loaded; doing it again does nothing."""
    for name in _IDS:
        if name not in _gymnasium.registry:
            _gymnasium.register(
                id=name,
                entry_point="relloc_env.envs.centralised:RellocEnv",
                vector_entry_point="relloc_env.envs.vector:RellocVectorEnv",
                kwargs={"task": name},
            )
        pettingzoo = sys.modules.get("pettingzoo")
        if pettingzoo is not None and hasattr(pettingzoo, "parallel_registry"):  # from 1.27
            for kind, door in (("aec", "env"), ("parallel", "parallel_env")):
                if name not in getattr(pettingzoo, f"{kind}_registry"):
                    pettingzoo.register(kind, name, entry_point=_DOORS[door], kwargs={"task": name})


_register()


def __getattr__(name: str) -> Any:
    if name in _DOORS:
        from importlib import import_module

        module, attribute = _DOORS[name].split(":")
        door = getattr(import_module(module), attribute)
        _register()  # PettingZoo is loaded by now
        return door
    raise AttributeError(f"module 'relloc_env' has no attribute {name!r}")
