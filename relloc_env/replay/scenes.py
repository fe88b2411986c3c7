"""What there was to see in a replay, instant by instant: the log, and what an estimator believed along it."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from relloc_env.parameters import pack_obstacles
from relloc_env.pinhole import project
from relloc_env.rendering.course import Course, Instant, least_excitation
from relloc_env.rendering.scene import CameraGeometry, Scene, target_colours
from relloc_env.replay.scores import NEES_BAND
from relloc_env.replay.settings import environment_of
from relloc_env.samples import Estimate, ordered_pairs

if TYPE_CHECKING:
    from relloc_env.replay.run import Run

_RADIUS = 0.18
"""[m] drawn for robots whose size a log does not state."""


def scenes(run: "Run", period: float = 0.25) -> Iterator[Scene]:
    """Yield scenes of one estimator on one log, where the places of all robots are known.

    Args:
        run: with the truth of the log.
        period: [s] between two scenes at least.

    Raises:
        ValueError: a log without truth.
    """
    log, config = run.log, environment_of(run.log)
    truth = log.truth
    if truth is None:
        raise ValueError(f"Argument `rerun` must be left out for {log.name}: it has no truth to place the robots")
    shown = np.flatnonzero(np.isfinite(truth.points[:, :2]).all(axis=1))
    robots = len(log.robots)
    if config is None:
        cameras = [CameraGeometry(limited=False)] * robots
        arena, obstacles, radius, height = None, None, _RADIUS, 2.0 * _RADIUS
    else:
        cameras = [CameraGeometry.of(config.camera_of(r)) for r in range(robots)]
        arena = None if config.arena is None else tuple(0.5 * s * config.arena[k] for k in (0, 1) for s in (-1.0, 1.0))
        obstacles = pack_obstacles(config.obstacles) if config.obstacles else None
        radius, height = config.robot_of(0).radius, config.robot_of(0).height
    points = truth.points[shown]
    points[:, 2] = np.where(np.isfinite(points[:, 2]), points[:, 2], cameras[0].mount)
    course, due = Course(robots, NEES_BAND), -math.inf
    for k in np.flatnonzero(np.isfinite(truth.poses).all(axis=(1, 2))).tolist():
        time = float(log.time[k] - log.time[0])
        if time < due:
            continue
        due = time + period - 1e-6
        course.add(_instant(run, k, time))
        seen = log.samples.seen[0, k][:, shown]
        yield Scene(
            time=time,
            poses=truth.poses[k],
            points=points,
            colours=target_colours(len(points)),
            cameras=cameras,
            true_image=project(truth.poses[k], [camera.mount for camera in cameras], points)[..., :2],
            in_view=seen,
            image=log.samples.image[0, k][:, shown].astype(np.float64),
            seen=seen,
            robot_radius=radius,
            robot_height=height,
            arena=arena,  # type: ignore[arg-type]
            obstacles=obstacles,
            trails=[way[np.isfinite(way).all(axis=1)] for way in np.moveaxis(truth.poses[: k + 1, :, :2], 1, 0)],
            estimate=Estimate(
                run.trace.points[k][:, shown], run.trace.points_covariance[k][:, shown],
                run.trace.known[k][:, shown], run.trace.pose[k], run.trace.pose_covariance[k],
            ),
            strips=course.strips(),
            horizon=float(log.time[-1] - log.time[0]) or 1.0,
            title=f"{log.name}, {run.estimator}",
        )  # fmt: skip


def _instant(run: "Run", k: int, time: float) -> Instant:
    """The numbers at sample k: errors of the points in sight, and of the first other robot."""
    log, robots = run.log, len(run.log.robots)
    none = np.full(robots, np.nan)
    depth, bound = none, math.nan
    if run.depth is not None:
        error = np.abs(run.depth.error[k])
        depth = np.where(np.isfinite(error).any(axis=1), np.where(np.isfinite(error), error, 0.0).max(axis=1), np.nan)
        sds = run.depth.bound_sd[k][np.isfinite(run.depth.bound_sd[k]) & np.isfinite(error)]
        bound = float(sds.max()) if sds.size else math.nan
    position, heading, honest, pose_bound = none, none, none, math.nan
    if run.poses:
        pairs = ordered_pairs(robots)
        first = [run.poses[int(np.flatnonzero(pairs[:, 0] == r)[0])] for r in range(robots)]
        position = np.array([np.hypot(*errors.error[k, :2]) for errors in first])
        heading = np.array([abs(errors.error[k, 2]) for errors in first])
        honest = np.array([errors.nees[k] for errors in first])
        honest = np.where(np.isfinite(honest), honest, np.nan)
        if first[0].bound is not None:
            pose_bound = float(np.sqrt(np.trace(first[0].bound[k, :2, :2])))
    moved, now = log.samples, np.s_[0, k : k + 1]
    excitation = least_excitation(moved.odometry[now], moved.image[now], moved.seen[now])
    return Instant(time, depth, position, heading, honest, excitation, bound, pose_bound)
