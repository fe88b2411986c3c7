"""Nothing is passed through, however thin it is, however fast a robot moves and however long a sample is."""

import math
from typing import Any

import numpy as np
import pytest

from relloc_env.config import ConfigError, load_config
from relloc_env.envs.vector import RellocVectorEnv

COUNT = 16
POINT = [(0.0, 0.0, 0.5)]


def drive(poses: Any, actions: list[float], until: int, **options: Any) -> tuple[Any, Any, Any]:
    """Poses (T, N, R, 3), and which robots touched something so far (T, N, R); `poses` (N, R, 3) are the starts."""
    env = RellocVectorEnv(
        len(poses), targets=1, estimator=None, shield=None, samples_per_action=1, max_cycles=10**6,
        reward={"collision": -1.0}, info=(), points=POINT, start={"in_view": False}, **options,
    )  # fmt: skip
    for n, pose in enumerate(poses):
        mask = np.arange(len(poses)) == n
        env.reset(seed=n, options={"reset_mask": mask, "poses": pose, "points": POINT})
    world = env.core.simulation.world
    where, touched = [world.pose.copy()], [world.collided.copy()]
    for _ in range(until):
        env.step(np.tile(actions, (len(poses), 1)))
        where.append(world.pose.copy())
        touched.append(touched[-1] | world.collided)
    return np.array(where), np.array(touched), env


@pytest.mark.parametrize("radius", [0.02, 0.18])
@pytest.mark.parametrize("rate", [1.0, 20.0])
@pytest.mark.parametrize("speed", [0.3, 1.0, 7.0, 30.0, 100.0])
def test_a_thin_wall_and_the_arena_stop_a_robot_of_any_speed(speed: float, rate: float, radius: float) -> None:
    """16 starts before a wall of 2 cm, towards it: none gets through or leaves the arena, all touch it."""
    if speed / rate > 1000.0 * radius:
        pytest.skip("refused, see below")
    rng = np.random.default_rng(0)
    x, y, theta = rng.uniform(-2.5, 0.7 - radius, COUNT), rng.uniform(-2, 2, COUNT), rng.uniform(-0.4, 0.4, COUNT)
    where, touched, env = drive(
        np.stack([x, y, theta], axis=-1)[:, None], [1.0, 0.0], math.ceil(5.0 * rate / speed) + 2, robots=1,
        robot={"max_speed": speed, "radius": radius}, sample_rate=rate, arena=(6.0, 6.0),
        obstacles=[{"shape": "box", "position": (1.0, 0.0), "size": (0.02, 6.0)}],
    )  # fmt: skip
    assert where[..., 0].max() < 0.99 - 0.5 * radius
    assert np.abs(where[..., :2]).max() < 3.0
    assert touched[-1].all()
    assert env.core.simulation.parameters["fast"][0] == (speed / rate > 0.5 * radius)


@pytest.mark.parametrize(("speed", "radius"), [(0.3, 0.18), (10.0, 0.18), (50.0, 0.18), (0.3, 0.002), (1.0, 0.01)])
def test_robots_that_meet_touch_before_they_could_change_sides(speed: float, radius: float) -> None:
    """16 pairs head on, up to a third of their width beside each other."""
    rng = np.random.default_rng(1)
    half, beside = rng.uniform(0.5, 3.0, COUNT), rng.uniform(-0.6, 0.6, COUNT) * radius
    zero = np.zeros(COUNT)
    poses = np.stack(
        [np.stack([-half, zero, zero], axis=-1), np.stack([half, beside, zero + math.pi], axis=-1)], axis=1
    )
    where, touched, _ = drive(
        poses, [1.0, 0.0, 1.0, 0.0], math.ceil(3.0 * 20.0 / speed) + 2, arena=(40.0, 40.0),
        robot={"max_speed": speed, "radius": radius},
    )  # fmt: skip
    first = touched.all(axis=2).argmax(axis=0)  # (N,) first sample after which both have touched
    assert touched[-1].all()
    for n, k in enumerate(first):
        assert (where[: k + 1, n, 0, 0] < where[: k + 1, n, 1, 0]).all()
        gap = np.linalg.norm(where[k, n, 0, :2] - where[k, n, 1, :2]) - 2.0 * radius
        assert gap > -radius


def test_a_way_of_more_than_a_thousand_radii_is_refused_with_the_options_that_ask_for_it() -> None:
    with pytest.raises(ConfigError, match=r"`robot.max_speed` 50\.0, `robot.radius` 0\.01 and `sample_rate` 2\.0"):
        load_config(robot={"max_speed": 50.0, "radius": 0.01}, sample_rate=2.0)
