"""Environments of random configurations: everything finite, within bounds, and of the right form."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from relloc_env.config import REWARD_TERMS


def draw(rng: np.random.Generator) -> dict[str, Any]:
    """A configuration with every option off its default now and then."""

    def pick(*values: Any) -> Any:
        return values[rng.integers(len(values))]

    return {
        "targets": pick(1, 2, 3, 7),
        "estimator": pick("cascade", "cascade-critical", "inverse-depth", "map-alignment", None),
        "sample_rate": pick(5.0, 10.0, 20.0, 30.0, 50.0),
        "samples_per_action": pick(1, 2, 5, 13),
        "max_cycles": pick(1, 5, 60),
        "shield": pick(None, {}),
        "arena": pick(None, (10.0, 10.0), (8.0, 6.0)),
        "camera": {
            "preset": pick("pi", "kinect", "unlimited"), "pixel_noise": pick(0.0, 1.0, 20.0),
            "quantisation": pick(0.0, 1.0, 8.0), "miss_probability": pick(0.0, 0.3, 1.0), "near": pick(0.0, 0.1),
        },
        "robot": {
            "max_speed": pick(0.1, 0.3, 2.0), "max_yaw_rate": pick(0.5, 3.0), "reverse": pick(True, False),
            "lag": (pick(0.0, 0.2), pick(0.0, 0.2)), "actuator_noise": (pick(0.0, 0.1), pick(0.0, 0.1)),
            "odometry_noise": (pick(0.0, 0.01, 0.1), pick(0.0, 0.01, 0.1)),
        },
        "network": {
            "latency": pick(0.0, 0.1, 0.4), "jitter": pick(0.0, 0.1, 0.3), "loss": pick(0.0, 0.3, 1.0),
            "rate": pick(None, 3.0),
        },
        "start": {"in_view": pick(True, False), "target_height": pick((-0.3, 0.8), (0.0, 0.0))},
        "guess": {
            "kind": pick("fixed", "positive", "gaussian"), "depth": pick(0.0, 1.0, 5.0), "position": pick(0.0, 1.5),
            "heading": pick(0.0, 60.0, 180.0),
        },
        "observation": pick("flat", "dict"),
        "reward": pick(None, dict.fromkeys(REWARD_TERMS, 1.0)),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0"])
def test_any_configuration_runs(name: str) -> None:
    """25 configurations, 30 actions each at or beyond the limits, episodes back to back."""
    rng = np.random.default_rng(len(name))
    for seed in range(25):
        env: Any = gym.make(name, disable_env_checker=True, **draw(rng)).unwrapped
        observation, _ = env.reset(seed=seed)
        for _ in range(30):
            assert env.observation_space.contains(observation)
            assert env.state_space.contains(env.state())
            action = rng.choice([-1.5, -1.0, 0.5, 1.0], env.action_space.shape)
            observation, reward, terminated, truncated, info = env.step(action)
            assert math.isfinite(reward)
            assert all(math.isfinite(info[f"reward/{term}"]) for term in REWARD_TERMS)
            assert not terminated
            if truncated:
                observation, _ = env.reset()
