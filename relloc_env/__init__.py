"""relloc_env: two ground robots, a camera on each, and the motion that lets them find depth and one another.

Importing this registers the Gymnasium ids `relloc_env/ActiveDepth-v0` and `relloc_env/RelativePose-v0`. Compiled
kernels load with the first environment, not here.
"""

from typing import TYPE_CHECKING, Any

import gymnasium as _gymnasium

if TYPE_CHECKING:
    from relloc_env.envs.aec import env
    from relloc_env.envs.parallel import parallel_env

__version__ = "0.1.0"
__all__ = ["env", "parallel_env"]

_DOORS = {"env": "relloc_env.envs.aec", "parallel_env": "relloc_env.envs.parallel"}

for _id, _robots in (("relloc_env/ActiveDepth-v0", 1), ("relloc_env/RelativePose-v0", 2)):
    if _id not in _gymnasium.registry:
        _gymnasium.register(
            id=_id,
            entry_point="relloc_env.envs.centralised:RellocEnv",
            kwargs={"robots": _robots},
            nondeterministic=False,
        )


def __getattr__(name: str) -> Any:
    if name in _DOORS:
        from importlib import import_module

        return getattr(import_module(_DOORS[name]), name)
    raise AttributeError(f"module 'relloc_env' has no attribute {name!r}")
