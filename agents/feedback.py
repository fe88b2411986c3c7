"""Laws that steer by what the robot believes about the points."""

import numpy as np

from agents.policy import COSINE, ELEVATION, INVERSE_RANGE, SINE, Task
from relloc_env.envs.onboard import POINT
from relloc_env.samples import Bool, Float, Float32


class Edge:
    """Keep the outermost point near one edge of the image, at full speed: that is where motion tells most of depth.

    Yaw rate `gain` (beta - s `margin` half view), where beta is the outermost bearing on side s (+1: left). The robot
    drives ahead until it is near a point, the bearings spread too far, or a point is about to leave the image at the
    top or bottom; then back, until it is far enough. Each reversal changes the side. Active structure from motion: R.
    Spica, P. Robuffo Giordano, F. Chaumette, "Active Structure From Motion: Application to Point, Sphere, and
    Cylinder", IEEE T-RO 30(6), 2014.

    Args:
        task: what the robots know of themselves.
        near, far: [m] distance to the nearest point at which it turns back, and goes ahead again.
        gain: [1/s]
        margin: [-] share of half the view, and of half the image height, that is made use of.
        keep: how many points it cares for, the nearest at the start and at each reversal: many points are seldom all in
            view from nearby. None: all.
    """

    PATIENCE = 4
    """Actions after a reversal before the next one."""

    def __init__(
        self,
        task: Task,
        near: float = 1.0,
        far: float = 4.5,
        gain: float = 3.0,
        margin: float = 0.85,
        keep: int | None = None,
    ) -> None:
        self._task, self._near, self._far, self._gain, self._margin = task, near, far, gain, margin
        self._keep = task.targets if keep is None else min(keep, task.targets)
        self.reset(0, 0)

    def reset(self, n: int, seed: int) -> None:  # noqa: ARG002 - asked for by the interface
        """Nothing is random; what is remembered starts with each episode."""
        shape = (n, self._task.robots)
        self._way: Float = np.ones(shape)
        self._side: Float = np.ones(shape)
        self._turned_at: Float = np.zeros(shape)
        self._since = np.zeros(shape, np.int64)
        self._kept: Bool = np.ones((*shape, self._task.targets), np.bool_)

    def act(self, observations: Float32) -> Float:
        """Steer by the bearings, choose the way by the distances."""
        task = self._task
        points = task.field(observations, "points").reshape(*observations.shape[:2], task.targets, POINT)
        sine, cosine = points[..., SINE], points[..., COSINE]
        known = sine * sine + cosine * cosine > 0.5
        bearing = np.arctan2(sine, cosine)
        started = task.time(observations) == 0.0
        self._choose_points(started[:, None] | (self._since == 0), points[..., INVERSE_RANGE], known)
        known &= self._kept
        self._begin(started, bearing, known)
        self._choose_way(observations, points, bearing, known)
        outermost = self._side * np.where(known, self._side[..., None] * bearing, -np.inf).max(axis=-1, initial=-np.inf)
        aim = self._side * self._margin * task.half_view
        turn = np.where(known.any(axis=-1), self._gain * (outermost - aim), 0.0)
        return task.shares(self._way * task.limits[:, 0], turn)

    def _begin(self, started: Bool, bearing: Float, known: Bool) -> None:
        """Start ahead, towards the edge that is nearer to a point."""
        far_left = np.where(known, bearing, -np.inf).max(axis=-1)
        far_right = np.where(known, bearing, np.inf).min(axis=-1)
        side = np.where(known.any(axis=-1) & (far_left < -far_right), -1.0, 1.0)
        self._way[started], self._side[started] = 1.0, side[started]
        self._turned_at[started], self._since[started] = 0.0, self.PATIENCE

    def _choose_points(self, anew: Bool, inverse_range: Float, known: Bool) -> None:
        """Care for the nearest points, where it is time to choose."""
        if self._keep < self._task.targets:
            order = np.argsort(-np.where(known, inverse_range, -np.inf), axis=-1)
            nearest = np.zeros_like(self._kept)
            np.put_along_axis(nearest, order[..., : self._keep], True, axis=-1)
            self._kept = np.where(anew[..., None], nearest, self._kept)

    def _choose_way(self, observations: Float32, points: Float, bearing: Float, known: Bool) -> None:
        task, some = self._task, known.any(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(known, 1.0 / points[..., INVERSE_RANGE], np.inf).min(axis=-1)
            height = np.where(known, np.abs(points[..., ELEVATION] / points[..., COSINE]), 0.0).max(axis=-1)
        left = np.where(known, bearing, -np.inf).max(axis=-1)
        right = np.where(known, bearing, np.inf).min(axis=-1)
        wide = left - right > 2.0 * self._margin * task.half_view
        high = height > self._margin * task.half_height
        stop = some & ((distance < self._near) | wide | high)
        clear = distance > np.maximum(self._far, self._turned_at + self._far - self._near)
        held = task.field(observations, "blocked")[..., 0] > 0.0
        turn = np.where(self._way > 0.0, stop | held, clear | held) & (self._since >= self.PATIENCE)
        self._turned_at = np.where(turn & (self._way > 0.0) & some, distance, self._turned_at)
        self._way, self._side = np.where(turn, -self._way, self._way), np.where(turn, -self._side, self._side)
        self._since = np.where(turn, 0, self._since + 1)
