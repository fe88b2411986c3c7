"""From a configuration to a model of Stable-Baselines3 with its environment."""

import math
from typing import Any

import numpy as np

from relloc_env.extras import extra
from train.config import TrainConfig, algorithm_class
from train.worlds import Worlds

with extra("train"):
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.vec_env import VecNormalize


ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU, "elu": torch.nn.ELU}
GREATEST = 1e6
"""[-] weights beyond are those of a run that diverges."""


def build(config: TrainConfig) -> BaseAlgorithm:
    """A new model, seeded."""
    torch.set_num_threads(config.threads)
    env: Any = Worlds(config.environment, config.num_envs, config.threads)
    if config.normalise.observations or config.normalise.rewards:
        env = VecNormalize(
            env,
            norm_obs=config.normalise.observations,
            norm_reward=config.normalise.rewards,
            clip_obs=config.normalise.clip,
            gamma=float((config.algorithm.model_extra or {}).get("gamma", 0.99)),
        )
    algorithm, network = config.algorithm, config.network
    options: dict[str, Any] = {"net_arch": list(network.hidden), "activation_fn": ACTIVATIONS[network.activation]}
    if algorithm.name in ("PPO", "RecurrentPPO"):
        options["log_std_init"] = network.log_std
    if algorithm.name == "RecurrentPPO":
        options["lstm_hidden_size"] = network.lstm
    arguments = dict(algorithm.model_extra or {})
    if algorithm.action_noise:
        size = env.action_space.shape[0]
        arguments["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, algorithm.action_noise))
    rate = algorithm.learning_rate
    arguments["learning_rate"] = _Linear(rate) if algorithm.schedule == "linear" else rate
    model: BaseAlgorithm = algorithm_class(algorithm.name)(
        network.policy, env, seed=config.seed, device="cpu", policy_kwargs=options, **arguments
    )
    return model


class _Linear:
    """A rate that falls to 0 at the end; pickled by name."""

    def __init__(self, rate: float) -> None:
        self._rate = rate

    def __call__(self, left: float) -> float:
        """The rate where the share `left` of the training is ahead."""
        return self._rate * left


def sound(model: BaseAlgorithm) -> bool:
    """Whether all weights are numbers, and none is absurd."""
    with torch.no_grad():
        greatest = max(float(weight.abs().max()) for weight in model.policy.parameters() if weight.numel())
        # `max` of Python drops NaN where it is not the first
        total = sum(float(weight.abs().sum()) for weight in model.policy.parameters())
    return math.isfinite(total) and greatest < GREATEST
