"""How an episode of one environment went, for its picture: noted as it is, made into numbers where somebody looks."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.metrics import bound_range_sd, nees, nees_band, point_errors, pose_errors
from relloc_env.samples import Estimate, Float, Sharing

if TYPE_CHECKING:
    from relloc_env.envs.core import Core
    from relloc_env.rendering.course import Course, Instant, Table

_MOST = 256
"""Actions that are kept as they were; more than an episode of the default task has, so that it costs only copies."""
_BYTES = 2**20
"""Memory that they take at most, beyond one action."""
_TRAIL = 2**15
"""Positions of each robot that are kept at most."""

Raw = dict[str, NDArray[Any]]
"""What was there after each of T actions, by the names in `_live`."""


class History(Sharing):
    """Takes copies after each action; errors and trails are computed together, when they are asked for.

    Args:
        core: whose environment n it follows.
        n: which one.
        past: [s] of the past that numbers over time are shown of at most.
    """

    def __init__(self, core: "Core", n: int, past: float = math.inf) -> None:
        self._core, self._n, self.past = core, n, past
        live = _live(core, n)
        count = min(max(_BYTES // sum(array.nbytes for array in live.values()), 1), _MOST)
        self._raw: Raw = {name: np.zeros((count, *array.shape[1:]), array.dtype) for name, array in live.items()}
        self._share()
        self._room, self._count, self._fresh = count, 0, True
        self._course: Course | None = None
        self._trails: Table | None = None

    def _share(self) -> None:
        self._pairs = [(self._raw[name], array) for name, array in _live(self._core, self._n).items()]

    def note(self, *, new: bool = False) -> None:
        """Copy what is there now; `new`: an episode starts."""
        if new:
            self._count, self._fresh = 0, True
        elif self._count == self._room:
            self._take()
        for kept, array in self._pairs:
            kept[self._count] = array[0]
        self._count += 1

    def trails(self) -> list[Float]:
        """Where each robot was, [m] (T, 2)."""
        self._take()
        assert self._trails is not None
        return [rows.copy() for rows in np.split(self._trails.rows, self._core.config.robots, axis=1)]

    def course(self) -> "Course":
        """Errors, how they compare with what is claimed and with what is possible, and excitation, over time."""
        self._take()
        assert self._course is not None
        return self._course

    def _take(self) -> None:
        """Make numbers of the copies."""
        from relloc_env.rendering.course import Course, Table

        config = self._core.config
        if self._course is None or self._trails is None:
            # Of a single robot's points, each with three numbers, the mean is shown.
            count = 1 if config.robots > 1 else config.targets
            self._course = Course(config.robots, nees_band(3, count), self.past)
            self._trails = Table(2 * config.robots, _TRAIL)
        if self._count == 0:
            return
        raw = {name: array[: self._count] for name, array in self._raw.items()}
        way = raw["way"][..., :2].reshape(self._count * config.samples_per_action, -1)
        if self._fresh:
            self._course.clear()
            self._trails.clear()
            way = np.concatenate([raw["pose"][:1, :, :2].reshape(1, -1), way[config.samples_per_action :]])
        self._course.add(instants(self._core, raw))
        self._trails.add(way)
        self._count, self._fresh = 0, False


def _live(core: "Core", n: int) -> Raw:
    """Views (1, ...) of what a picture's numbers come from; the core refreshes them in place."""
    config, world, samples, score = core.config, core.simulation.world, core.simulation.samples, core.score
    live: Raw = {
        "tick": world.tick,
        "pose": world.pose,
        "way": core.simulation.truth.pose,
        "elapsed": core.elapsed,
        "odometry": samples.odometry,
        "image": samples.image,
        "seen": samples.seen,
    }
    if not core.bare:
        estimate = core.onboard.estimate
        live |= {"depth_error": score.depth_error, "pose_error": score.pose_error}
        live |= {f"estimate.{name}": array for name, array in estimate._asdict().items()}
    if config.tracks_bound:
        live |= {"bound_factor": score.bound_factor, "bound_variances": score.bound_variances}
        live |= {"origin": world.origin, "pose_bound": score.pose_covariance}
    if config.tracks_bound or not core.bare:
        live["points"] = world.points
    return {name: array[n : n + 1] for name, array in live.items()}


def instants(core: "Core", raw: Raw) -> "Instant":
    """Errors, how they compare with what is claimed and with what is possible, and excitation, of T instants."""
    from relloc_env.rendering.course import Instant, least_excitation

    config = core.config
    robots = config.robots
    none = np.full((len(raw["tick"]), robots), np.nan)
    depth, position, heading, consistency = none, none, none, none
    if not core.bare:
        error = np.abs(raw["depth_error"])
        depth = np.where(np.isfinite(error), error, -1.0).max(axis=2)
        depth = np.where(depth >= 0.0, depth, np.nan)
        if robots > 1:
            position, heading = np.moveaxis(raw["pose_error"], 2, 0)
        consistency = _nees(core, raw)
    excitation = least_excitation(raw["odometry"], raw["image"], raw["seen"])
    excitation = np.where(raw["elapsed"][:, None] > 0, excitation, np.nan)
    now = Instant(raw["tick"] * config.sample_period, depth, position, heading, consistency, excitation)
    if not config.tracks_bound:
        return now
    parts = ("bound_factor", "bound_variances", "pose", "points", "origin")
    ranges = bound_range_sd(*(raw[name] for name in parts))
    square = np.trace(raw["pose_bound"][:, :2, :2], axis1=1, axis2=2) if robots > 1 else none[:, 0]
    return now._replace(depth_bound=ranges.max(axis=(1, 2)), position_bound=np.sqrt(square))


def _nees(core: "Core", raw: Raw) -> Float:
    """(T, R) NEES of each robot's pose of the other; of one robot alone the mean of its points'; NaN where unusable."""
    poses, estimate = raw["pose"], Estimate(*(raw[f"estimate.{name}"] for name in Estimate._fields))
    if core.config.robots > 1:
        found = nees(pose_errors(estimate, poses), estimate.pose_covariance)
        return np.where(np.isfinite(found), found, np.nan)
    heights = np.array([core.config.camera_of(0).mount_height])
    polar = point_errors(estimate, poses, raw["points"], heights).polar
    known = estimate.known
    found = nees(polar, estimate.points_covariance)
    total = np.where(known, np.where(np.isfinite(found), found, np.nan), 0.0).sum(axis=2)
    count = known.sum(axis=2)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
