"""The PettingZoo door for clients that let agents act in turn."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pettingzoo import AECEnv
from pettingzoo.utils.conversions import parallel_to_aec
from pettingzoo.utils.wrappers import BaseWrapper, OrderEnforcingWrapper

from relloc_env.config import EnvConfig
from relloc_env.envs.door import check_actions
from relloc_env.envs.information import ENTRIES
from relloc_env.envs.parallel import parallel_env


class CheckedActions(BaseWrapper[str, Any, Any]):
    """Refuses a wrong action at the turn of the robot that it is for."""

    def step(self, action: Any) -> None:
        """Hand on an action (A,), or None for a robot whose episode is over."""
        agent = self.agent_selection
        if not (self.terminations[agent] or self.truncations[agent]):
            check_actions("action", action, np.empty(self.action_space(agent).shape or ()))
        elif action is not None:
            raise ValueError(f"Argument `action` must be None, as the episode of {agent} is over, but is {action!r}")
        super().step(action)


class InOrder(OrderEnforcingWrapper[str, Any, Any]):
    """PettingZoo's errors for calls before a `reset`; also where a `reset` was refused."""

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start an episode; arguments and errors as in `RellocEnv.reset`."""
        self._has_reset = False
        self.env.reset(seed=seed, options=None if options is None else dict(options))
        self._has_reset = self._has_updated = True


def env(
    config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
    *,
    render_mode: str | None = None,
    estimator: Any = "default",
    info: Sequence[str] = ENTRIES,
    **options: Any,
) -> AECEnv[str, Any, Any]:
    """Build the PettingZoo AEC environment; arguments as in `relloc_env.envs.centralised.RellocEnv`."""
    parallel = parallel_env(config, render_mode=render_mode, estimator=estimator, info=info, **options)
    return InOrder(CheckedActions(parallel_to_aec(parallel)))
