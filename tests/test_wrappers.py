"""The estimator outside gives what the one inside gives; an episode written down replays to the same estimates."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env  # noqa: F401 - registers the ids
from relloc_env.config import ConfigError
from relloc_env.estimators import make
from relloc_env.logs import read_log
from relloc_env.replay.settings import configure
from relloc_env.wrappers import EstimateObservation, RecordLog

IDS = ("relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0")
NETWORKS: dict[str, dict[str, Any]] = {
    "perfect": {},
    "late": {"network": {"latency": 0.12, "jitter": 0.1, "loss": 0.3, "rate": 10.0}},
}


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("estimator", ["cascade", "cascade-critical", "inverse-depth", "map-alignment"])
@pytest.mark.parametrize("name", IDS)
def test_estimator_outside_is_the_estimator_inside(name: str, estimator: str, network: str) -> None:
    """Two episodes of 30 actions each, missed detections on: observations equal to the last bit."""
    options = {"camera": {"preset": "pi", "miss_probability": 0.1}, **NETWORKS[network]}
    inside = gym.make(name, estimator=estimator, **options)
    outside = EstimateObservation(gym.make(name, estimator=None, **options), estimator)
    assert outside.observation_space == inside.observation_space
    assert outside.field_slices == inside.unwrapped.field_slices  # type: ignore[attr-defined]
    rng = np.random.default_rng(5)
    for seed in (1, 2):
        expected, _ = inside.reset(seed=seed)
        shown, _ = outside.reset(seed=seed)
        np.testing.assert_array_equal(shown, expected)
        for _ in range(30):
            action = rng.uniform(-1.0, 1.0, inside.action_space.shape or ()).astype(np.float32)
            expected, reward, *_ = inside.step(action)
            shown, bare_reward, *_ = outside.step(action)
            np.testing.assert_array_equal(shown, expected)
            assert bare_reward == reward
    belief = inside.unwrapped.core.onboard.estimate  # type: ignore[attr-defined]
    for one, other in zip(outside.estimate, belief, strict=True):
        np.testing.assert_array_equal(one, other)


def test_estimator_of_ones_own() -> None:
    """An object that follows the protocol is taken inside and outside alike."""
    own, other = make("cascade", 1, 2, 2), make("cascade", 1, 2, 2)
    inside = gym.make(IDS[1], estimator=own)
    outside = EstimateObservation(gym.make(IDS[1], estimator=None), other)
    expected, _ = inside.reset(seed=4)
    shown, _ = outside.reset(seed=4)
    np.testing.assert_array_equal(shown, expected)
    assert own.estimate.known.all()
    full = gym.make(IDS[1], config={"estimator": None}, estimator=make("cascade", 1, 2, 2))
    np.testing.assert_array_equal(full.reset(seed=4)[0], expected)


def test_only_bare_environments_are_wrapped() -> None:
    for env in (gym.make(IDS[0]), gym.make(IDS[0], estimator=None, observation="dict"), gym.make("CartPole-v1")):
        with pytest.raises(ConfigError, match="Argument `env` must be"):
            EstimateObservation(env)
    with pytest.raises(ConfigError, match=r"[Dd]id you mean"):
        EstimateObservation(gym.make(IDS[0], estimator=None), "casade")


def test_recorded_episode_replays_to_the_same_estimates(tmp_path: Path) -> None:
    """One episode of 20 actions through the log on disk: the estimator ends with the same bits."""
    env = RecordLog(gym.make(IDS[1], max_cycles=20, estimator="cascade-critical"), tmp_path)
    env.reset(seed=9)
    env.action_space.seed(9)
    ended = False
    while not ended:
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        ended = terminated or truncated
    core: Any = env.unwrapped.core  # type: ignore[attr-defined]
    log = read_log(tmp_path / "episode_000")
    assert len(log) == 101
    estimator, rows = make(configure(log, "cascade-critical"), 1, 2, 2), np.zeros(1, np.int64)
    estimator.reset(log.prior, rows)
    for block in log.blocks():
        estimator.update(block, rows)
    for one, other in zip(estimator.estimate, core.onboard.estimate, strict=True):
        np.testing.assert_array_equal(one, other)
    assert log.truth is not None
    np.testing.assert_array_equal(log.truth.poses[-1], core.simulation.world.pose[0])
