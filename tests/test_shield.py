"""The shield against geometry."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.config import EnvConfig
from tests.worlds import (
    ROW,
    actions,
    angle_between,
    gap,
    random_driving,
    world,
)


def distances(config: EnvConfig, poses: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[float, float, float]:
    """Least distance of robots' centres to targets, to one another, and to walls and obstacles."""
    target = min(math.hypot(x - p[0], y - p[1]) for x, y, _ in poses for p in points)
    pair = math.hypot(*(poses[0] - poses[1])[:2])
    return target, pair, gap(config, poses[:1]) + config.robot_of(0).radius


def test_shield_keeps_its_distances() -> None:
    """24 environments, 800 samples at full speed; random starts, obstacles, lag and noise."""
    rng = np.random.default_rng(7)
    simulation = world(
        24, shield={}, points=None, arena=(5.0, 5.0),
        start={"target_distance": (0.8, 4.0), "in_view": False, "heading_error": 180.0},
        obstacles=[{"shape": "disc", "position": (0.5, 0.5), "radius": 0.2}],
        robot={"lag": (0.1, 0.1), "actuator_noise": (0.02, 0.05)},
    )  # fmt: skip
    config, rows = simulation.config, np.arange(24)
    held_back, least = 0, np.full(3, math.inf)
    for step in range(800):
        if step % 20 == 0:
            held = random_driving(rng, 24)
        simulation.step(held, rows)
        held_back += int(simulation.world.blocked.sum())
        for n in range(24):
            for r in range(2):
                poses = simulation.world.pose[n, [r, 1 - r]]
                least = np.minimum(least, distances(config, poses, simulation.world.points[n]))
        assert not simulation.world.contact.any()
    assert (least >= np.array([0.5, 0.6, 0.3]) - 1e-12).all()
    assert held_back > 1000


@pytest.mark.parametrize("seed", range(4))
def test_shield_holds_between_robots_side_by_side(seed: int) -> None:
    """Robots abreast and a little inward: each alone would get ahead of the other, both together close in."""
    rng = np.random.default_rng(seed)
    inward = rng.uniform(0.001, 0.03, 2)
    simulation = world(
        arena=None, shield={}, poses=[(0.0, 0.0, inward[0]), (0.0, 0.6001, -inward[1])], samples_per_action=5
    )
    for _ in range(100):
        simulation.step(actions((1.0, 0.0), (1.0, 0.0)), ROW)
        poses = simulation.truth.pose[0]
        assert np.hypot(*(poses[:, 0] - poses[:, 1])[:, :2].T).min() >= 0.6 - 1e-12


START_INSIDE: dict[str, dict[str, Any]] = {
    "target": {"points": [(0.3, 0.0, 0.5), (9.0, 9.0, 0.5)], "arena": None, "robots": 1, "poses": [(0.0, 0.0, 0.0)]},
    "wall": {"poses": [(4.8, 0.0, 0.0)], "robots": 1},
    "box": {
        "poses": [(0.0, 0.0, 0.0)], "robots": 1,
        "obstacles": [{"shape": "box", "position": (0.5, 0.0), "size": (0.5, 1.0)}],
    },
    "robot": {"poses": [(0.0, 0.0, 0.0), (0.5, 0.0, 1.0)], "arena": None},
}  # fmt: skip


@pytest.mark.parametrize("name", START_INSIDE)
def test_shield_lets_out_whoever_starts_within_it(name: str) -> None:
    """Towards the thing nothing moves but the heading, and each sample counts as blocked; away it is free."""
    simulation = world(shield={}, samples_per_action=5, **START_INSIDE[name])
    robots = simulation.config.robots
    start = simulation.world.pose[0].copy()
    still = [(0.0, 0.0)] * (robots - 1)
    simulation.step(actions((1.0, 0.1), *still), ROW)
    np.testing.assert_array_equal(simulation.world.pose[0, :, :2], start[:, :2])
    assert angle_between(simulation.world.pose[0, 0, 2], start[0, 2] + 0.1 * 0.8 * 0.25) < 1e-12
    assert simulation.world.blocked[0, 0] == 5
    simulation.step(actions((-1.0, 0.0), *still), ROW)
    assert simulation.world.blocked[0, 0] == 0
    assert abs(math.hypot(*(simulation.world.pose[0, 0] - start[0])[:2]) - 0.3 * 0.25) < 1e-12
