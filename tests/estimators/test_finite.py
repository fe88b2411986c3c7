"""Samples and priors that are no numbers are refused where they enter, by the number of the sample."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from relloc_env.estimators import PRESETS, make
from relloc_env.samples import Prior, Samples, empty_samples
from relloc_env.wrappers import EstimateObservation

ROWS = np.arange(2)


def prior() -> Prior:
    return Prior(np.full((2, 2, 3), 3.0), np.zeros((2, 2, 3)), 1.0, np.ones(3))


def samples() -> Samples:
    block = empty_samples(2, 4, 2, 3, 2)
    block.period[:, 1:] = 0.05
    block.seen[..., :2] = True
    block.arrived[:] = 1
    return block


@pytest.mark.parametrize("name", sorted(PRESETS))
@pytest.mark.parametrize(
    ("field", "at", "value", "words"),
    [
        ("period", (1, 2), np.nan, "`samples.period` must be finite .* is nan in sample 2 .from 0. of environment 1"),
        ("period", (1, 2), -0.1, "`samples.period` must be finite and not negative"),
        ("odometry", (0, 3, 1, 2), np.inf, "`samples.odometry` .* is inf in sample 3 .* environment 0 of robot 1"),
        ("image", (1, 1, 0, 1, 0), np.nan, "`samples.image` .* is nan in sample 1 .* 1 of robot 0 and point 1"),
        ("image", (1, 1, 0, 1, 1), -np.inf, "`samples.image` .* is -inf in sample 1"),
    ],
)
def test_a_sample_that_is_no_number_is_named(
    name: str, field: str, at: tuple[int, ...], value: float, words: str
) -> None:
    estimator = make(name, 2, 2, 3)
    estimator.reset(prior(), ROWS)
    block = samples()
    estimator.update(block, ROWS)
    getattr(block, field)[at] = value  # in the same arrays, as a driver of a robot fills them
    with pytest.raises(ValueError, match=words):
        estimator.update(block, ROWS)
    estimator.update(block, ROWS[:1] + 1 - at[0])  # the other environment is not concerned
    assert all(np.isfinite(part[estimator.estimate.known.any()]).all() for part in estimator.estimate[:2])


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_bearings_without_height_and_what_is_not_seen_may_be_anything(name: str) -> None:
    estimator = make(name, 2, 2, 3)
    estimator.reset(prior(), ROWS)
    block = samples()
    block.image[..., 1] = np.nan
    block.image[..., 2, 0] = np.nan
    estimator.update(block, ROWS)
    assert np.isfinite(estimator.estimate.pose).all()


@pytest.mark.parametrize("name", sorted(PRESETS))
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"depth": np.full((2, 2, 3), 0.0)}, "`prior.depth` must be finite and positive"),
        ({"depth": np.full((2, 2, 3), -1.0)}, "`prior.depth` must be finite and positive"),
        ({"depth": np.full((2, 2, 3), np.nan)}, "`prior.depth` must be finite and positive"),
        ({"pose": np.full((2, 2, 3), np.nan)}, "`prior.pose`.* must be finite"),
        ({"depth_sd": np.inf}, "`prior.depth_sd`.* must be finite"),
    ],
)
def test_a_prior_that_is_none_is_named(name: str, change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make(name, 2, 2, 3).reset(prior()._replace(**change), ROWS)


def test_the_simulator_does_not_look_through_what_it_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def look(*args: Any) -> None:
        raise AssertionError("looked")

    for name in ("cascade", "inverse_depth", "map_alignment"):
        monkeypatch.setattr(f"relloc_env.estimators.{name}.check_finite", look)
        monkeypatch.setattr(f"relloc_env.estimators.{name}.check_finite_prior", look)
    for estimator in ("cascade", "inverse-depth", "map-alignment"):
        env = gym.make("relloc_env/RelativePose-v0", estimator=estimator)
        env.reset(seed=0)
        env.step(env.action_space.sample())


class Spoil(gym.ObservationWrapper[Any, Any, Any]):
    """Make a number of the observation NaN."""

    at: int | None = None

    def observation(self, observation: Any) -> Any:
        observation = observation.copy()
        if self.at is not None:
            observation.reshape(-1)[self.at] = np.nan
        return observation


def test_an_estimator_around_an_environment_looks_at_what_it_reads() -> None:
    bare = gym.make("relloc_env/RelativePose-v0", estimator=None)
    spoil = Spoil(bare)
    env = EstimateObservation(spoil, "cascade")
    env.reset(seed=0)
    spoil.at = bare.unwrapped.field_slices["robot_a/velocity"].start  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"`samples\.odometry` must be finite, but is nan in sample 0 .* of robot 0"):
        env.step(env.action_space.sample())
