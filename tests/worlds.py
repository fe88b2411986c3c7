"""Worlds for tests of motion and contacts, and geometry to hold them against."""

import cmath
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig, load_config
from relloc_env.simulation import Simulation

ROW = np.zeros(1, np.int64)


FAR_POINTS = [(40.0, 0.0, 0.5), (40.0, 3.0, 0.5)]


def world(num_envs: int = 1, **options: Any) -> Simulation:
    """A simulation without shield and with targets out of the way, reset with the seeds 0, 1, 2 and so on."""
    given = {"shield": None, "points": FAR_POINTS, "estimator": None, "samples_per_action": 1} | options
    simulation = Simulation(load_config(given), num_envs)
    rows = np.arange(num_envs)
    simulation.seed(rows, list(range(num_envs)))
    simulation.reset(rows)
    return simulation


def actions(*values: tuple[float, float]) -> NDArray[np.float64]:
    """One action of each robot of a single environment."""
    return np.array([values], dtype=np.float64)


def arc(pose: NDArray[np.float64], v: float, w: float, dt: float) -> tuple[float, float, float]:
    """Exact unicycle step by complex numbers: z + v e^(i theta) (e^(i w dt) - 1)/(i w)."""
    start = cmath.exp(1j * pose[2])
    step = v * dt * start if w == 0.0 else v * start * (cmath.exp(1j * w * dt) - 1.0) / (1j * w)
    z = complex(pose[0], pose[1]) + step
    return z.real, z.imag, float(pose[2]) + w * dt


def angle_between(a: float, b: float) -> float:
    return abs(cmath.phase(cmath.exp(1j * (a - b))))


def assert_on_arc(before: NDArray[np.float64], after: NDArray[np.float64], v: float, w: float, dt: float) -> None:
    x, y, theta = arc(before, v, w, dt)
    assert abs(after[0] - x) < 1e-12
    assert abs(after[1] - y) < 1e-12
    assert angle_between(after[2], theta) < 1e-12


def gap(config: EnvConfig, poses: NDArray[np.float64]) -> float:
    """Least distance [m] between bodies; negative where they overlap. Boxes by their corners, edges and sides."""
    least = math.inf
    for r, (x, y, _) in enumerate(poses):
        radius = config.robot_of(r).radius
        if config.arena is not None:
            least = min(least, 0.5 * config.arena[0] - abs(x) - radius, 0.5 * config.arena[1] - abs(y) - radius)
        for obstacle in config.obstacles:
            z = complex(x, y) - complex(*obstacle.position)
            if obstacle.shape == "disc":
                least = min(least, abs(z) - obstacle.radius - radius)
            else:
                z *= cmath.exp(-1j * obstacle.angle)
                out = (abs(z.real) - 0.5 * obstacle.size[0], abs(z.imag) - 0.5 * obstacle.size[1])
                outside = math.hypot(max(out[0], 0.0), max(out[1], 0.0))
                least = min(least, (outside if max(out) > 0.0 else max(out)) - radius)
        for other in range(r):
            reach = radius + config.robot_of(other).radius
            least = min(least, math.hypot(x - poses[other, 0], y - poses[other, 1]) - reach)
    return least


CLUTTER: dict[str, Any] = {
    "arena": (4.0, 3.0),
    "obstacles": [
        {"shape": "disc", "position": (0.9, 0.2), "radius": 0.3},
        {"shape": "box", "position": (-0.8, -0.4), "size": (0.7, 0.4), "angle": 0.6},
        {"shape": "box", "position": (0.0, 1.2), "size": (0.1, 0.6)},
    ],
    "robot": [{"mass": 5.0, "radius": 0.18}, {"mass": 12.0, "radius": 0.22}],
    "poses": [(-1.5, 1.0, -0.5), (1.5, -1.0, 2.6)],
}


def random_driving(rng: np.random.Generator, num_envs: int) -> NDArray[np.float64]:
    """Full speed forward or backward, random turns."""
    choice = rng.uniform(-1, 1, (num_envs, 2, 2))
    choice[..., 0] = np.sign(choice[..., 0] + 0.3)
    return choice
