"""Training leaves a policy that loads, and an evaluation."""

import json
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO

from train.ppo import train


def test_train_leaves_a_policy_and_its_evaluation(tmp_path: Path) -> None:
    result = train("relloc_env/ActiveDepth-v0", 64, tmp_path, envs=2, episodes=2)
    assert json.loads((tmp_path / "evaluation.json").read_text("utf-8")) == result
    assert {len(values) for values in result["information_at_the_end"].values()} == {2}
    assert PPO.load(tmp_path / "policy.zip", device="cpu").num_timesteps == result["steps"] >= 64
