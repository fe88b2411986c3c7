"""Stable-Baselines3's PPO on each id as it comes: no wrapper, no argument."""

import gymnasium as gym
import numpy as np
import pytest

stable_baselines3 = pytest.importorskip("stable_baselines3")


@pytest.mark.parametrize("name", ["relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0"])
def test_ppo_runs_out_of_the_box(name: str) -> None:
    """10,000 steps: whole episodes with finite returns, the policy moves, and it acts within bounds afterwards."""
    import torch

    torch.set_num_threads(1)
    env = gym.make(f"relloc_env:{name}")
    model = stable_baselines3.PPO("MlpPolicy", env, n_steps=1000, batch_size=500, n_epochs=4, seed=1, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(10_000)
    assert model.num_timesteps == 10_000
    returns = [episode["r"] for episode in model.ep_info_buffer]
    lengths = [episode["l"] for episode in model.ep_info_buffer]
    assert lengths == [120] * 83
    assert np.isfinite(returns).all()
    after = list(model.policy.parameters())
    assert all(torch.isfinite(parameter).all() for parameter in after)
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    observation, _ = env.reset(seed=1)
    for _ in range(5):
        action, _ = model.predict(observation, deterministic=True)
        assert env.action_space.contains(action)
        observation, *_ = env.step(action)
