"""How much of PPO's training time the environment takes. Runs in a worker."""

import time
from typing import Any

from benchmarks.ours import EVERYTHING
from relloc_env.extras import extra

with extra("train"):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper


ROLLOUT = 64
"""Steps of each environment between two updates."""
MINIBATCH = 1024
EPOCHS = 10


class Timed(VecEnvWrapper):
    """Sums up the time [s] that the environments take."""

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self.seconds = 0.0

    def reset(self) -> Any:
        """Start all environments."""
        start = time.perf_counter()
        found = self.venv.reset()
        self.seconds += time.perf_counter() - start
        return found

    def step_async(self, actions: Any) -> None:
        """Begin a step."""
        start = time.perf_counter()
        self.venv.step_async(actions)
        self.seconds += time.perf_counter() - start

    def step_wait(self) -> Any:
        """End it."""
        start = time.perf_counter()
        found = self.venv.step_wait()
        self.seconds += time.perf_counter() - start
        return found


def measure(num_envs: int, updates: int) -> dict[str, Any]:
    """Train PPO with a policy of 64 x 64 units; what it takes, where.

    Args:
        num_envs: environments in the batch.
        updates: times that the policy is updated, after one that warms up.
    """
    from relloc_env.envs.sb3 import RellocVecEnv

    envs = Timed(RellocVecEnv(num_envs, **EVERYTHING))
    model = PPO("MlpPolicy", envs, n_steps=ROLLOUT, batch_size=MINIBATCH, n_epochs=EPOCHS, device="cpu", seed=0)
    rollout = ROLLOUT * num_envs
    model.learn(rollout)
    envs.seconds, train = 0.0, 0.0
    start = time.perf_counter()
    original = model.train

    def timed_train() -> None:
        nonlocal train
        began = time.perf_counter()
        original()
        train += time.perf_counter() - began

    model.train = timed_train  # type: ignore[method-assign]
    model.learn(updates * rollout)
    total = time.perf_counter() - start
    return {
        "num_envs": num_envs, "steps": updates * rollout, "rollout": ROLLOUT, "minibatch": MINIBATCH, "epochs": EPOCHS,
        "seconds": total, "environment_share": envs.seconds / total, "update_share": train / total,
        "policy_and_rest_share": 1.0 - (envs.seconds + train) / total,
    }  # fmt: skip
