"""Saved policies of Stable-Baselines3, trained on either door, do what Stable-Baselines3 says they do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from agents.policy import Task
from agents.registry import agent
from relloc_env.config import load_config

sb3: Any = pytest.importorskip("stable_baselines3")


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("algorithm", ["PPO", "SAC", "TD3"])
def test_acts_as_the_saved_policy_predicts(tmp_path: Path, algorithm: str, shared: bool) -> None:
    from stable_baselines3.common.vec_env import VecNormalize

    from relloc_env.envs.sb3 import RellocVecEnv

    options: dict[str, Any] = {"estimator": "cascade", "max_cycles": 8}
    envs: Any = VecNormalize(RellocVecEnv(3, decentralised=shared, **options), norm_reward=False)
    model = getattr(sb3, algorithm)("MlpPolicy", envs, seed=1, device="cpu", policy_kwargs={"net_arch": [8]})
    envs.reset()
    for _ in range(20):
        envs.step(np.random.default_rng(0).uniform(-1.0, 1.0, (envs.num_envs, *envs.action_space.shape)))
    model.save(tmp_path / "policy.zip")
    envs.save(str(tmp_path / "normalisation.pkl"))
    task = Task.of(load_config(**options))
    with pytest.warns(UserWarning, match="pickle"):
        policy = agent(f"learned:{tmp_path / 'policy.zip'}")(task)
    policy.reset(3, 0)
    raw = envs.get_original_obs()
    expected = model.predict(envs.normalize_obs(raw), deterministic=True)[0]
    assert_allclose(policy.act(task.rows(raw)).reshape(expected.shape), expected, atol=1e-5)


def test_says_what_is_wrong_with_a_file(tmp_path: Path) -> None:
    task = Task.of(load_config(estimator="cascade"))
    with pytest.raises(ValueError, match="no file"):
        agent(f"learned:{tmp_path / 'none.zip'}")(task)


def test_what_is_remembered_ends_at_a_reset_where_no_time_is_seen() -> None:
    """Pictures do not tell that an episode starts."""
    from agents.layout import Layout
    from agents.learned import Acting

    task = Task.of(load_config(robots=1, observation="image", estimator=None, reward={"excitation": 1.0}))
    told: list[list[bool]] = []

    def decide(rows: Any, new: Any) -> Any:
        told.append(new.tolist())
        return np.zeros((len(rows), 2))

    policy = Acting(task, Layout.of(task, joint=False), decide)
    pictures = np.zeros((3, 1, task.size), np.float32)
    for _ in range(2):
        policy.reset(3, 0)
        policy.act(pictures)
        policy.act(pictures)
    assert told == [[True] * 3, [False] * 3] * 2
