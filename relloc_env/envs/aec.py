"""The PettingZoo door for clients that let agents act in turn."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pettingzoo import AECEnv
from pettingzoo.utils.conversions import parallel_to_aec
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from relloc_env.config import EnvConfig
from relloc_env.envs.parallel import parallel_env


def env(
    config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
    *,
    render_mode: str | None = None,
    estimator: Any = "default",
    **options: Any,
) -> AECEnv[str, Any, Any]:
    """Build the PettingZoo AEC environment; arguments as in `relloc_env.envs.centralised.RellocEnv`."""
    return OrderEnforcingWrapper(
        parallel_to_aec(parallel_env(config, render_mode=render_mode, estimator=estimator, **options))
    )
