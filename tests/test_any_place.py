"""Rewards, observations and `state()` are finite wherever robots stand, and the same at any place on Earth."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

import relloc_env  # noqa: F401 (registers the ids)
from relloc_env.envs.vector import RellocVectorEnv

EXACT: dict[str, Any] = {
    "camera": "unlimited", "robot": {"odometry_noise": (0.0, 0.0)}, "guess": {"kind": "gaussian"}, "max_cycles": 200,
    "start": {"in_view": False, "heading_error": 180.0},
}  # fmt: skip


def finite(envs: RellocVectorEnv, actions: int, forward: float | None = None) -> None:
    """Play, and hold everything that the bound is read for against what is finite."""
    envs.reset(seed=0)
    rng = np.random.default_rng(1)
    for _ in range(actions):
        action = rng.uniform(-1.0, 1.0, envs.action_space.shape)
        if forward is not None:
            action[:, 0::2], action[:, 1::2] = forward, 0.0
        observation, reward, *_, info = envs.step(action)
        assert np.isfinite(reward).all()
        assert np.isfinite(observation).all()
        assert np.isfinite(envs.state()).all()
        for part in (info["bound_sd"], *(info[name] for name in info if name.startswith("reward/"))):
            assert np.isfinite(part).all()
        assert np.isfinite(envs.core.score.depth_information).all()
        assert np.isfinite(envs.core.score.pose_information).all()


def test_straight_ahead_without_noise_of_odometry() -> None:
    """The paper's simulation, where the determinant of the bound is below what its entries' digits tell."""
    env = gym.make("relloc_env/RelativePose-v0", config="paper-simulation")
    env.reset(seed=0)
    rewards = [env.step(np.array([1.0, 0.0, 1.0, 0.0]))[1] for _ in range(400)]
    assert np.isfinite(np.array(rewards, float)).all()


@pytest.mark.parametrize(
    "options",
    [
        EXACT,
        {**EXACT, "robots": 1, "targets": 1},
        {**EXACT, "guess": {"position_sd": 1e6, "heading_sd": 1e4}},
        {**EXACT, "guess": {"position_sd": 1e-6, "heading_sd": 1e-4, "depth_sd": 1e-6}},
        {"guess": {"position_sd": 1e6}},
        {"guess": {"heading_sd": 1e4}},
        {"robot": {"odometry_noise": (1e-12, 0.0)}},
        {"terminate_on_success": True, "camera": {"pixel_noise": 0.0}, "robot": {"odometry_noise": (0.0, 0.0)}},
    ],
    ids=str,
)
def test_finite_in_every_configuration(options: dict[str, Any]) -> None:
    """Eight environments, 60 random actions."""
    finite(RellocVectorEnv(8, estimator="cascade", **options), 60)


@pytest.mark.parametrize("robots", [1, 2])
@pytest.mark.parametrize("forward", [0.0, 1.0, -1.0])
def test_finite_where_a_robot_stands_on_a_point(robots: int, forward: float) -> None:
    """At rest on it, and driving off it ahead and back; cameras see from 0 m on and have no borders."""
    envs = RellocVectorEnv(
        2, estimator="cascade", robots=robots, shield=None, poses=[(1.0, 0.5, 0.3), (-1.0, 0.5, 0.1)][:robots],
        points=[(1.0, 0.5, 0.4), (3.0, 1.0, 0.3)], camera={"preset": "unlimited", "near": 0.0},
    )  # fmt: skip
    finite(envs, 12, forward)


def played(place: tuple[float, float], **options: Any) -> tuple[Any, Any, Any, Any]:
    """Returns, observations, states and origins of 40 actions of four environments, everything moved to `place`."""
    x, y = place
    envs = RellocVectorEnv(
        4, estimator="cascade", arena=None, poses=[(x, y, 0.8), (x - 0.45, y - 0.46, 0.8)],
        points=[(x + 3.0, y + 4.0, 0.4), (x + 4.0, y + 3.0, 0.2)],
        obstacles=[{"shape": "disc", "position": (x + 1.0, y - 0.5), "radius": 0.2, "height": 0.2}], **options,
    )  # fmt: skip
    _, info = envs.reset(seed=0)
    origin = info["origin"]
    rng = np.random.default_rng(0)
    total, seen, states, touched = np.zeros(4), [], [], False
    for k in range(40):
        action = rng.uniform(-1.0, 1.0, (4, 4)) if k % 2 else np.tile([-1.0, 0.0, 1.0, 0.0], (4, 1))
        observation, reward, *_, info = envs.step(action)
        total += reward
        seen.append(observation)
        states.append(envs.state())
        touched |= envs.core.simulation.world.collided.any()
        assert_allclose(info["origin"], origin)
        truth = envs.core.simulation.world
        # [x, y, heading] of both robots come first in a state; float32 keeps them to less than 0.1 mm.
        told = states[-1][:, :6].reshape(4, 2, 3)[..., :2] + origin[:, None]
        assert_allclose(told, truth.pose[..., :2], rtol=0.0, atol=1e-4)
    return total, np.array(seen), np.array(states), touched


EARTH = [(1000.0, -3000.0), (7000.0, 7000.0), (448262.25, 5411932.5), (5e5, 5e6), (-5e6, 1.0)]


@pytest.mark.parametrize("options", [{}, {"shield": None}], ids=["shield", "contacts"])
def test_the_same_anywhere_on_earth(options: dict[str, Any]) -> None:
    """Returns to 1e-6, observations and velocities of the state to what float32 holds; with contacts too."""
    total, seen, states, touched = played((0.0, 0.0), **options)
    assert touched == bool(options)
    for place in EARTH:
        there, seen_there, states_there, _ = played(place, **options)
        assert_allclose(there, total, rtol=0.0, atol=1e-6)
        assert_allclose(seen_there, seen, rtol=0.0, atol=1e-5)
        moved = (np.asarray(place) + 500.0) % 1000.0 - 500.0
        for start in (0, 3, 12, 15):  # poses of the robots, points
            states_there[..., start : start + 2] -= moved.astype(np.float32)
        assert_allclose(states_there, states, rtol=0.0, atol=1e-4)


def test_worlds_around_the_origin_keep_their_coordinates() -> None:
    env = gym.make("relloc_env/RelativePose-v0", estimator="cascade").unwrapped
    _, info = env.reset(seed=3)
    np.testing.assert_array_equal(info["origin"], np.zeros(2))
    world = env.core.simulation.world  # type: ignore[attr-defined]
    np.testing.assert_array_equal(env.state()[:6], world.pose[0].ravel().astype(np.float32))  # type: ignore[attr-defined]


def test_pictures_are_the_same_anywhere() -> None:
    """What the detector finds in pictures, floor and all, of five actions."""
    pytest.importorskip("cv2")
    found = []
    for x, y in ((0.0, 0.0), (5e5, 5e6)):
        envs = RellocVectorEnv(
            1, estimator=None, camera="image", arena=None, poses=[(x, y, 0.8), (x - 2.0, y, 0.8)],
            points=[(x + 3.0, y + 4.0, 0.4), (x + 4.0, y + 3.0, 0.2)],
        )  # fmt: skip
        envs.reset(seed=0)
        rng = np.random.default_rng(0)
        for _ in range(5):
            envs.step(rng.uniform(-1.0, 1.0, (1, 4)))
            found.append(envs.core.simulation.samples.image.copy())
    assert np.any(found[0] != 0.0)
    assert_allclose(found[5:], found[:5], rtol=0.0, atol=1e-6)
