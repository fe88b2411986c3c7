"""Steering laws drawn at random: what a planner tries first, before it changes the best of them."""

import math

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.samples import Float

AHEAD = 0.6
"""Share of the laws that start ahead."""
MARGIN = (0.5, 0.95)
"""Least and greatest share of half the view at which a point is kept."""
NEAREST = 2
"""Most points that a law cares for."""
REVERSED = 1.7
"""Latest reversal, in horizons: those beyond one do not come about."""
GAIN = 3.0
"""[1/s] yaw rate per angle."""


class Laws:
    """One law per world of a search, at full speed: keep the outermost of the nearest points at an angle to one side.

    Each goes ahead or back, and changes both way and side once, at a time of its own; like `agents.feedback.Edge`, but
    when to turn is left to chance, and to the choice among many.

    Args:
        config: of the real environments.
        shape: numbers N of environments and S of laws in each.
        steps: of a plan.
        stream: where they are drawn from.
    """

    def __init__(self, config: EnvConfig, shape: tuple[int, int], steps: int, stream: np.random.Generator) -> None:
        size = (*shape, config.robots)
        half_view = [min(config.camera_of(r).half_view, 0.5 * math.pi) for r in range(config.robots)]
        self._limit = np.array([config.robot_of(r).max_yaw_rate for r in range(config.robots)])
        self._way = np.where(stream.random(size) < AHEAD, 1.0, -1.0)
        self._side = np.where(stream.random(size) < 0.5, 1.0, -1.0)
        self._angle = stream.uniform(*MARGIN, size) * np.array(half_view)
        self._reversal = stream.uniform(0.0, REVERSED * steps, size)
        self._count = stream.integers(1, min(config.targets, NEAREST) + 1, size)
        self._kept = np.zeros((*size, config.targets), np.bool_)

    def actions(self, step: int, poses: Float, points: Float) -> Float:
        """Actions [-] (N, S, R, 2) at one step of the plan, in order from 0.

        Args:
            step: of the plan.
            poses: [m, m, rad] (N, S, R, 3) of the robots.
            points: [m] (N, S, M, 3).
        """
        offset = points[:, :, None, :, :2] - poses[:, :, :, None, :2]
        if step == 0:
            distance = np.hypot(offset[..., 0], offset[..., 1])
            self._kept = np.argsort(np.argsort(distance, axis=-1), axis=-1) < self._count[..., None]
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - poses[..., 2, None]
        bearing = np.mod(bearing + math.pi, 2.0 * math.pi) - math.pi
        turned = np.where(step >= self._reversal, -1.0, 1.0)
        side = turned * self._side
        outermost = np.where(self._kept, side[..., None] * bearing, -np.inf).max(axis=-1)
        turn = GAIN * side * (outermost - self._angle)
        return np.stack([turned * self._way, np.clip(turn / self._limit, -1.0, 1.0)], axis=-1)
