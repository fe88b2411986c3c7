"""This project's environments as contenders, driven with smooth random actions made in advance.

"Everything on": two robots with noisy odometry and cameras that see two points or lose them, contacts, a network that
carries every robot's message to the other in each sample, the paper's cascade, the excitation reward, observations,
autoreset; one sample per action.
"""

from collections.abc import Mapping
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import relloc_env  # registers the ids
from benchmarks.peers import AGENTS, HORIZON, Drive, block

ID = "relloc_env/RelativePose-v0"
EVERYTHING: dict[str, Any] = {
    "estimator": "cascade",
    "reward": {"excitation": 1.0},
    "samples_per_action": 1,
    "max_cycles": HORIZON,
    "shield": None,  # or else nothing would ever touch
    "arena": (10.0, 10.0),
    "start": {"margin": 1.0},
}
"""Robots start so far from the walls that about 1 % of the steps are in contact."""
CROWDED: dict[str, Any] = {
    **EVERYTHING,
    "arena": (5.0, 5.0),
    "start": {"margin": 0.3, "target_distance": (1.0, 7.0), "robot_distance": 0.6},
}
"""The same where about 10 % are."""
DEFAULT: dict[str, Any] = {"estimator": "cascade"}
"""The ids' default task but for the estimator: the information reward, an action held for five samples."""

STEADY = 20.0
"""Steps over which actions stay alike."""


def smooth_actions(num_envs: int, seed: int = 0) -> NDArray[np.float32]:
    """Actions (T, N, 2 x AGENTS): a first-order autoregression, slightly forward, clipped to [-1, 1].

    They are played forward, then backward, and so on: the process looks the same both ways, so that this stays smooth.
    """
    length = max(HORIZON, 2**16 // num_envs)
    make = np.random.default_rng(seed)
    actions: NDArray[np.float32] = make.standard_normal((length, num_envs, 2 * AGENTS), np.float32)
    keep = np.float32(np.exp(-1.0 / STEADY))
    for t in range(1, length):
        actions[t] = keep * actions[t - 1] + np.sqrt(1.0 - keep * keep) * actions[t]
    actions *= 0.5
    actions[..., ::2] += 0.3
    np.clip(actions, -1.0, 1.0, out=actions)
    return actions


class _Player:
    """Actions for ever."""

    def __init__(self, num_envs: int) -> None:
        self._bank = smooth_actions(num_envs)
        self._at, self._way = 0, 1

    def next(self) -> NDArray[np.float32]:
        """Actions (N, 2 x AGENTS) of the next step."""
        now: NDArray[np.float32] = self._bank[self._at]
        if not 0 <= self._at + self._way < len(self._bank):
            self._way = -self._way
        self._at += self._way
        return now


FASTEST: dict[str, Any] = {"info": (), "copy": False}
"""No truth beside the observations, which are written into the same array each time."""


class Batch:
    """The native vector environment, its episodes spread over the horizon as in a long run."""

    def __init__(self, options: Mapping[str, Any], num_envs: int, form: Mapping[str, Any] = FASTEST) -> None:
        self.envs = cast(Any, gym.make_vec(ID, num_envs, **form, **options))
        self._player, self._block = _Player(num_envs), 64 if num_envs <= 64 else 4
        self.envs.reset(seed=0)
        core: Any = self.envs.unwrapped.core
        core.elapsed[:] = np.random.default_rng(0).integers(0, core.config.max_cycles, num_envs)
        for _ in range(core.config.max_cycles):
            self.envs.step(self._player.next())

    def __call__(self) -> int:
        """Step some times."""
        for _ in range(self._block):
            self.envs.step(self._player.next())
        return self._block

    def contact_share(self) -> float:
        """Share of environment steps in which a robot touches something, over a quarter of the horizon."""
        core: Any = self.envs.unwrapped.core
        shares = []
        for _ in range(max(1, core.config.max_cycles // 4)):
            self.envs.step(self._player.next())
            shares.append(np.any(core.simulation.world.collided, axis=1).mean())
        return float(np.mean(shares))


def everything(num_envs: int) -> Drive:
    """Everything on, about 1 % of the steps in contact."""
    return Batch(EVERYTHING, num_envs)


def with_info(num_envs: int) -> Drive:
    """Everything on, as `gym.make_vec` gives it: with the truth in `info`, observations in fresh arrays."""
    return Batch(EVERYTHING, num_envs, {})


def lossy_network(num_envs: int) -> Drive:
    """Everything on, messages 0.1 s late and one in ten lost."""
    return Batch({**EVERYTHING, "network": {"latency": 0.1, "loss": 0.1}}, num_envs)


def crowded(num_envs: int) -> Drive:
    """Everything on, about 10 % of the steps in contact."""
    return Batch(CROWDED, num_envs)


def critical(num_envs: int) -> Drive:
    """Everything on, the cascade with critically damped gains."""
    return Batch({**EVERYTHING, "estimator": "cascade-critical"}, num_envs)


def alignment(num_envs: int) -> Drive:
    """Everything on, the alignment of local maps."""
    return Batch({**EVERYTHING, "estimator": "map-alignment"}, num_envs)


def default(num_envs: int) -> Drive:
    """The default task; a step is an action, five samples."""
    return Batch(DEFAULT, num_envs)


def default_alignment(num_envs: int) -> Drive:
    """The ids' task with their own estimator, aligned once per action."""
    return Batch({}, num_envs)


def pictures(num_envs: int) -> Drive:
    """Everything on but the estimator; observations are the pictures of both cameras, 84 x 84."""
    return Batch({**EVERYTHING, "estimator": None, "observation": "image"}, num_envs)


def gymnasium_door(num_envs: int) -> Drive:
    """Everything on, through `gym.make`: one environment."""
    assert num_envs == 1
    env, player = gym.make(ID, **EVERYTHING), _Player(1)
    env.reset(seed=0)

    def drive() -> int:
        for _ in range(block(1)):
            _, _, terminated, truncated, _ = env.step(player.next()[0])
            if terminated or truncated:
                env.reset()
        return block(1)

    return drive


def parallel_door(num_envs: int) -> Drive:
    """Everything on, through PettingZoo's parallel interface: one environment."""
    assert num_envs == 1
    env, player = relloc_env.parallel_env(None, **EVERYTHING), _Player(1)
    env.reset(seed=0)

    def drive() -> int:
        for _ in range(block(1)):
            a, b = player.next().reshape(AGENTS, 2)
            env.step({"robot_a": a, "robot_b": b})
            if not env.agents:
                env.reset()
        return block(1)

    return drive


def stable_baselines(num_envs: int) -> Drive:
    """Everything on, through Stable-Baselines3's interface."""
    from relloc_env.envs.sb3 import RellocVecEnv

    envs, player = RellocVecEnv(num_envs, **EVERYTHING), _Player(num_envs)
    envs.reset()

    def drive() -> int:
        for _ in range(block(num_envs)):
            envs.step(player.next())
        return block(num_envs)

    return drive
