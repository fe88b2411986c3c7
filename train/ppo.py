"""PPO on a Gymnasium id, and how the trained policy compares with driving straight on the same starts."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

import relloc_env  # noqa: F401 - registers the ids

TEST_SEED = 1_000_000
"""First seed of the episodes that training never sees."""


def train(
    name: str, steps: int, out: Path, *, seed: int = 0, envs: int = 8, progress: bool = False, episodes: int = 20
) -> dict[str, Any]:
    """Train PPO and write `policy.zip`, `normalisation.pkl` and `evaluation.json` into a folder.

    Args:
        name: Gymnasium id.
        steps: actions to train for.
        out: folder, made where it is missing.
        seed: of the starts, the noise and the network's weights.
        envs: environments that run in turn.
        progress: whether to show a bar.
        episodes: to compare with driving straight, on seeds of their own.

    Returns:
        What `evaluation.json` holds: information J at the end of each episode [nats], for PPO and for straight motion.
    """
    out.mkdir(parents=True, exist_ok=True)
    venv = VecNormalize(make_vec_env(name, n_envs=envs, seed=seed), norm_reward=False)
    rollout = max(2, 2048 // envs)
    model = PPO("MlpPolicy", venv, n_steps=rollout, batch_size=256, gamma=0.985, seed=seed, device="cpu")
    model.learn(steps, progress_bar=progress)
    model.save(out / "policy.zip")
    venv.save(str(out / "normalisation.pkl"))
    seeds = range(TEST_SEED, TEST_SEED + episodes)

    def learned(observation: Any) -> Any:
        return model.predict(venv.normalize_obs(observation), deterministic=True)[0]

    def straight(_: Any) -> Any:
        return np.tile(np.array([1.0, 0.0], np.float32), relloc_robots(name))

    result = {
        "id": name,
        "steps": model.num_timesteps,
        "seed": seed,
        "information_at_the_end": {"ppo": evaluate(name, learned, seeds), "straight": evaluate(name, straight, seeds)},
    }
    (out / "evaluation.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def relloc_robots(name: str) -> int:
    """Number of robots that an id drives."""
    space = gym.make(name).action_space
    assert space.shape is not None
    return int(space.shape[0]) // 2


def evaluate(name: str, policy: Callable[[Any], Any], seeds: range) -> list[float]:
    """Information J at the end of one episode per seed [nats]: of the pose, or of depth with one robot."""
    env = gym.make(name)
    found = []
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        ended = False
        while not ended:
            observation, _, terminated, truncated, info = env.step(policy(observation))
            ended = terminated or truncated
        depth, pose = info["information"]["depth"], info["information"]["pose"]
        found.append(float(pose if len(depth) > 1 else depth[0]))
    return found
