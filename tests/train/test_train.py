"""Training leaves a policy that loads, and an evaluation."""

import json
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from typer.testing import CliRunner

from train.__main__ import app
from train.ppo import train


def test_train_leaves_a_policy_and_its_evaluation(tmp_path: Path) -> None:
    result = train("relloc_env/ActiveDepth-v0", 64, tmp_path, envs=2, episodes=2)
    assert json.loads((tmp_path / "evaluation.json").read_text("utf-8")) == result
    assert {len(values) for values in result["information_at_the_end"].values()} == {2}
    assert PPO.load(tmp_path / "policy.zip", device="cpu").num_timesteps == result["steps"] >= 64


def test_an_unknown_id_is_one_line() -> None:
    result = CliRunner().invoke(app, ["relloc_env/NoSuch-v0", "--steps", "1"])
    assert result.exit_code == 2
    assert "NoSuch" in result.output
