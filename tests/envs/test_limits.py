"""Every number of every configuration has limits: within them all is finite, beyond them its name is said."""

import math
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env
from relloc_env.config import REWARD_TERMS, ConfigError, load_config
from relloc_env.envs.vector import RellocVectorEnv
from tests.envs.extremes import BEYOND, OPTIONS, Option, drawn, given

NAMES = sorted({option.path for option in OPTIONS})
LARGE = ("samples_per_action", "image_size", "targets", "camera.width", "camera.height")
"""What makes an environment large, not strange: built without being run."""
ELSEWHERE = ("No start was found", "must have robots", "focal_length", "limits of depth")
"""What is said where a number is possible by itself, but not with the others."""
TERMS = [name for name in REWARD_TERMS if not name.startswith("information")]


def said(options: dict[str, Any], path: str) -> str:
    """What a refusal says; nothing where three actions of an environment give finite numbers within the spaces."""
    try:
        if path in LARGE:
            load_config(**options)
        else:
            env = relloc_env.parallel_env(**{"estimator": "cascade", **options})
            check_parallel(env, 3, np.random.default_rng(0))
    except ConfigError as error:
        return str(error)
    return ""


def check_parallel(env: Any, actions: int, rng: np.random.Generator) -> None:
    """What the PettingZoo interface gives is within its spaces, and finite."""
    observations, _ = env.reset(seed=0)
    for _ in range(actions):
        for agent, observation in observations.items():
            assert env.observation_space(agent).contains(observation)
        assert env.state_space.contains(env.state())
        if not env.agents:
            break
        observations, rewards, *_ = env.step({agent: rng.choice([-1.0, 0.5, 1.0], 2) for agent in env.agents})
        assert all(map(math.isfinite, rewards.values()))


def check_joint(env: Any, actions: int, rng: np.random.Generator) -> None:
    """The same of the Gymnasium interface."""
    observation, _ = env.reset(seed=0)
    for _ in range(actions):
        assert env.observation_space.contains(observation)
        assert env.state_space.contains(env.state())
        observation, reward, terminated, truncated, _ = env.step(rng.choice([-1.0, 1.0], env.action_space.shape))
        assert math.isfinite(reward)
        if terminated or truncated:
            observation, _ = env.reset()


def check_batch(env: Any, actions: int, rng: np.random.Generator) -> None:
    """The same of the native vector interface."""
    observation, _ = env.reset(seed=0)
    for _ in range(actions):
        assert env.observation_space.contains(observation)
        assert np.abs(env.state()).max() <= 1000.0
        observation, reward, *_ = env.step(rng.choice([-1.0, 1.0], env.action_space.shape))
        assert np.isfinite(reward).all()


def check_rows(env: Any, actions: int, rng: np.random.Generator) -> None:
    """The same of the interface for Stable-Baselines3."""
    rows = env.reset()
    for _ in range(actions):
        assert all(map(env.observation_space.contains, rows))
        assert np.abs(env.states()).max() <= 1000.0
        rows, rewards, *_ = env.step(rng.choice([-1.0, 1.0], (env.num_envs, *env.action_space.shape)))
        assert np.isfinite(rewards).all()


def of(path: str) -> Iterator[Option]:
    """The numbers of an option."""
    return (option for option in OPTIONS if option.path == path)


def test_all_models_are_walked() -> None:
    assert len(OPTIONS) > 150
    parts = {name.rpartition(".")[0] for name in NAMES}
    assert {"", "robot", "camera", "camera.image", "shield", "start", "guess", "network", "gains", "marker"} <= parts
    assert {"obstacles:disc", "obstacles:box", "reward"} <= parts
    assert {f"estimator:{kind}" for kind in ("cascade", "inverse-depth", "map-alignment")} <= parts
    assert {"robot.lag", "camera.field_of_view", "poses", "estimator:cascade.h"} <= set(NAMES)


@pytest.mark.parametrize("path", NAMES)
def test_a_number_has_limits(path: str) -> None:
    for option in of(path):
        assert len(option.limits) == 2
        assert all(map(math.isfinite, option.limits))


@pytest.mark.parametrize("path", NAMES)
def test_what_nobody_means_is_refused_by_name_or_runs(path: str) -> None:
    """24 values for each number: 0, beyond any range, not finite, of other types."""
    for option in of(path):
        for value in BEYOND:
            message = said(given(option, value), path)
            assert not message or option.name in message or any(part in message for part in ELSEWHERE)
            assert len(message) < 3000
        for value in (1e150, math.inf, math.nan, 10**400, "much", object()):
            assert option.name in said(given(option, value), path)


@pytest.mark.parametrize("path", NAMES)
def test_at_its_limits_a_number_runs_or_is_refused_by_name(path: str) -> None:
    for option in of(path):
        for value in option.limits:
            for estimator in ("cascade", "cascade-critical", "inverse-depth", "map-alignment", None):
                message = said({"estimator": estimator, **given(option, value)}, path)
                assert not message or option.name in message or any(part in message for part in ELSEWHERE)


def draw(rng: np.random.Generator) -> dict[str, Any]:
    """A configuration with up to six options of any size within their limits, and others as they come."""
    options: dict[str, Any] = {
        "estimator": rng.choice(["cascade", "cascade-critical", "inverse-depth", "map-alignment", ""]).item() or None,
        "camera": {"preset": rng.choice(["pi", "unlimited"]).item(), "limited": bool(rng.integers(2))},
        "arena": (10.0, 10.0) if rng.integers(2) else None,
        "start": {"in_view": False, "heading_error": 180.0},
        "reward": dict.fromkeys(TERMS, 1.0),
        "bound": False,
    }
    paths = [name for name in NAMES if name not in LARGE and not name.startswith(("estimator", "reward.", "poses"))]
    for path in rng.choice(paths, rng.integers(1, 7), replace=False):
        numbers = list(of(path))
        option = numbers[rng.integers(len(numbers))]
        for key, value in given(option, drawn(option, rng)).items():
            if isinstance(value, dict):
                options[key] = {**options.get(key, {}), **value}
            else:
                options[key] = value
    if options.get("robots") == 1:
        options.pop("poses", None)
    return options


@pytest.mark.parametrize("seed", range(6))
def test_numbers_within_their_limits_give_finite_ones_on_every_interface(seed: int) -> None:
    """40 configurations a seed, 20 actions each at the limits of speed and yaw rate; a third or so cannot be."""
    rng = np.random.default_rng(seed)
    ran = 0
    for k in range(40):
        options = draw(rng)
        try:
            match k % 4:
                case 0:
                    check_parallel(relloc_env.parallel_env(**options), 20, rng)
                case 1:
                    options["robots"] = 2
                    check_joint(gym.make("relloc_env/RelativePose-v0", **options).unwrapped, 20, rng)
                case 2:
                    check_rows(pytest.importorskip("relloc_env.envs.sb3").RellocVecEnv(2, **options), 20, rng)
                case _:
                    check_batch(RellocVectorEnv(3, **options), 20, rng)
            ran += 1
        except ConfigError:
            continue
    assert ran >= 20


@pytest.mark.parametrize("estimator", ["cascade", "cascade-critical"])
@pytest.mark.parametrize("turn", [0.5, 1.5, 2.6, 4.0])
def test_points_that_sweep_through_the_image_leave_no_estimate_without_a_number(estimator: str, turn: float) -> None:
    """Up to 4 rad a sample, a camera that sees up to 90 degrees off its axis: 8 pairs, 40 actions."""
    env = RellocVectorEnv(
        8, estimator=estimator, camera="unlimited", robot={"max_yaw_rate": 20.0 * turn}, shield=None, bound=False,
        reward={"pose_error": -1.0, "depth_error": -1.0}, start={"in_view": False, "heading_error": 180.0},
    )  # fmt: skip
    check_batch(env, 40, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": {"max_yaw_rate": 3000.0}}, "`robot.max_yaw_rate` must be from 1e-06 to 100 rad/s, but is 3000.0"),
        ({"camera": {"pixel_noise": 1e6}}, "`camera.pixel_noise` must be from 0 to 1000 px, but is 1000000.0"),
        ({"camera": {"field_of_view": 179.9999}}, "`field_of_view` from 0.1 to 178 degrees, but it is 179.9999"),
        ({"camera": {"focal_length": 1.0}}, "borders of the image within 100 times the `focal_length`"),
        ({"guess": {"heading_sd": 1e11}}, "`guess.heading_sd` must be from 0.0001 to 10000 degrees"),
        ({"reward_start": 1e150}, "`reward_start` must be from 0 to 1000000 s, but is 1e+150"),
        ({"max_cycles": 2**64}, "`max_cycles` must be less than or equal to 1000000000, but is 18446744073709551616"),
        ({"max_cycles": 10**5000}, "but is a number of thousands of digits"),
        (
            {"estimator": {"kind": "inverse-depth", "odometry_noise": (1e300, 0)}},
            "`estimator.odometry_noise.0` must be from 0 to 100 m/s",
        ),
        (
            {"robots": 1, "estimator": {"kind": "map-alignment", "camera_heights": (1.0, 2.0)}},
            "must have 1 entries in `estimator.camera_heights`, but has 2",
        ),
        ({"estimator": {"kind": "cascade", "h": (1.0, 2.0, 3.0)}}, "must have 2 entries in `estimator.h`, but has 3"),
    ],
)
def test_what_cannot_be_is_told_in_words(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(options)
    assert message in str(caught.value)
