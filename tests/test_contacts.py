"""The contact solver depends on the contact alone: not on what was solved before, nor on how many at once."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.config import EnvConfig, load_config
from relloc_env.kernels.motion import wrap_angle
from relloc_env.world import SUBSTEPS, ContactSolver

CONFIG: dict[str, Any] = {
    "arena": (4.0, 3.0),
    "obstacles": [
        {"shape": "disc", "position": (1.48, 0.2), "radius": 0.2},
        {"shape": "box", "position": (-0.8, -0.4), "size": (0.7, 0.4), "angle": 0.6},
    ],
    "robot": [{"mass": 5.0, "radius": 0.18}, {"mass": 12.0, "radius": 0.22}],
    "estimator": None,
}
CASES = 400
HALF = np.array([2.0, 1.5])


def contacts(rng: np.random.Generator) -> Any:
    """Poses and pending poses of robots that are about to hit things, up to four at once.

    The first robot stands in a corner, at a wall, between disc and wall, or at the box; the other one close to it.
    """
    pose = np.zeros((CASES, 2, 3))
    for n in range(CASES):
        gap = rng.uniform(0.0, 0.002, 3)
        match n % 4:
            case 0:
                pose[n, 0, :2] = rng.choice([-1.0, 1.0], 2) * (HALF - 0.18 - gap[:2])
            case 1:
                pose[n, 0, :2] = (rng.choice([-1.0, 1.0]) * (HALF[0] - 0.18 - gap[0]), rng.uniform(-0.9, -0.4))
            case 2:
                y = 0.2 - rng.uniform(0.3, 0.37)
                pose[n, 0, :2] = (1.48 + math.sqrt((0.38 + gap[0]) ** 2 - (y - 0.2) ** 2), y)
            case _:
                out = np.array([-math.sin(0.6), math.cos(0.6)])
                pose[n, 0, :2] = np.array([-0.8, -0.4]) + (0.38 + gap[0]) * out
        while True:
            angle, reach = rng.uniform(-math.pi, math.pi), 0.4 + gap[2]
            pose[n, 1, :2] = pose[n, 0, :2] + reach * np.array([math.cos(angle), math.sin(angle)])
            inside = (np.abs(pose[n, 1, :2]) < HALF - 0.22).all()
            if (
                inside
                and math.dist(pose[n, 1, :2], (1.48, 0.2)) > 0.42
                and math.dist(pose[n, 1, :2], (-0.8, -0.4)) > 0.6
            ):
                break
        pose[n, :, 2] = rng.uniform(-math.pi, math.pi, 2)
    step = rng.uniform(-1.0, 1.0, (CASES, 2, 3)) * (0.015, 0.015, 0.04)
    return situation(pose, pose + step)


def situation(pose: NDArray[np.float64], pending: NDArray[np.float64]) -> Any:
    """What the solver reads and writes of a world."""
    return SimpleNamespace(pose=pose, pending=pending.copy(), collided=np.zeros(pose.shape[:2], np.bool_))


@pytest.fixture(scope="module")
def config() -> EnvConfig:
    return load_config(CONFIG)


@pytest.fixture(scope="module")
def world() -> Any:
    return contacts(np.random.default_rng(1))


@pytest.fixture(scope="module")
def alone(config: EnvConfig, world: Any) -> NDArray[np.float64]:
    """What a space gives that never saw another contact."""
    solved = situation(world.pose, world.pending)
    for n in range(CASES):
        ContactSolver(config).solve_many(solved, np.array([n]))
    pending: NDArray[np.float64] = solved.pending
    return pending


def test_most_cases_are_contacts_of_several_things(world: Any, alone: NDArray[np.float64]) -> None:
    hit = (alone != world.pending).any(axis=2)
    assert hit.all(axis=1).mean() > 0.4
    assert hit.any(axis=1).mean() > 0.8


def test_order_and_history_change_no_bit(config: EnvConfig, world: Any, alone: NDArray[np.float64]) -> None:
    """400 contacts at once and one by one, in six orders, in a space that has seen all of them before."""
    rng, solver = np.random.default_rng(2), ContactSolver(config)
    for run in range(6):
        solved = situation(world.pose, world.pending)
        for rows in np.split(rng.permutation(CASES), (1, 400, 100)[run % 3]):
            solver.solve_many(solved, rows)
        np.testing.assert_array_equal(solved.pending, alone)


def test_the_compiled_loop_does_what_pymunk_does(config: EnvConfig, world: Any, alone: NDArray[np.float64]) -> None:
    """The same bodies set, stepped and read one by one through pymunk's own interface."""
    dt = config.sample_period
    for n in range(0, CASES, 5):
        space = ContactSolver(config)._space
        velocity = world.pending[n] - world.pose[n]
        velocity[:, 2] = [wrap_angle(angle) for angle in velocity[:, 2]]
        velocity /= dt
        for body, pose, speed in zip(space.bodies, world.pose[n], velocity, strict=True):
            body.position, body.angle = tuple(pose[:2]), pose[2]
            body.velocity, body.angular_velocity = tuple(speed[:2]), speed[2]
        for _ in range(SUBSTEPS):
            space.step(dt / SUBSTEPS)
        for r, body in enumerate(space.bodies):
            if (alone[n, r] != world.pending[n, r]).any():
                assert tuple(body.position) == tuple(alone[n, r, :2])
                assert wrap_angle(body.angle) == alone[n, r, 2]
