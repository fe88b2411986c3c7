"""The picture of one environment, for every door: what a `Scene` needs, taken from the core."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from relloc_env.metrics import bound_range_sd, nees, nees_band, point_errors, pose_errors
from relloc_env.pinhole import project
from relloc_env.samples import Estimate, Float

if TYPE_CHECKING:
    from relloc_env.envs.core import Core
    from relloc_env.rendering import Renderer
    from relloc_env.rendering.course import Course, Instant
    from relloc_env.rendering.scene import Scene
    from relloc_env.vision.sensor import Sensor

_PIECES = 256
"""Pieces of a trail that are kept apart, so that those of long drives need not be put together for each picture."""


class Picture:
    """Draws environment n of a core, and remembers where its robots went. Without a mode it does nothing.

    Args:
        mode: None, "rgb_array" or "human".
        size: [px] width and height.
    """

    def __init__(self, core: "Core", mode: str | None, n: int = 0, size: tuple[int, int] = (960, 540)) -> None:
        self._core, self._mode, self._n, self._size = core, mode, n, size
        self._trails: list[list[Float]] = [[] for _ in range(core.config.robots)]
        self._course: Course | None = None
        self._sensors: dict[int, Sensor] = {}
        self._renderer: Renderer | None = None

    def follow(self, *, new: bool = False) -> None:
        """Note where the robots went in the last action (`new`: an episode starts), and refresh the window."""
        if self._mode is None:
            return
        simulation, n = self._core.simulation, self._n
        places = simulation.world.pose[n, None, :, :2] if new else simulation.truth.pose[n, ..., :2]
        for r, trail in enumerate(self._trails):
            if new:
                trail.clear()
            trail.append(places[:, r].copy())
            if len(trail) > _PIECES:
                trail[:] = [np.concatenate(trail)]
        if self._course is None:
            from relloc_env.rendering.course import Course

            # Of a single robot's points, each with three numbers, the mean is told.
            count = 1 if self._core.config.robots > 1 else self._core.config.targets
            self._course = Course(self._core.config.robots, nees_band(3, count))
        if new:
            self._course.clear()
        self._course.add(instant(self._core, n))
        if self._mode == "human":
            self._draw()

    def render(self) -> Any:
        """The present as an array (H, W, 3) for "rgb_array", else None.

        Raises:
            ResetNeeded: before the first episode.
        """
        if self._mode is None:
            gym.logger.warn("`render` without a `render_mode` draws nothing; choose one when the environment is made")
            return None
        if not self._trails[0]:
            raise ResetNeeded("Call `reset` before `render`: there is nothing to show yet")
        return self._draw() if self._mode == "rgb_array" else None

    def scene(self) -> "Scene":
        """The present, to be drawn or recorded; only with a mode, and after `follow`."""
        assert self._course is not None
        drawn = scene(self._core, self._n, [np.concatenate(trail) for trail in self._trails], self._course)
        config = self._core.config
        if all(config.camera_of(r).kind == "analytic" for r in range(config.robots)):
            return drawn
        painted = np.array([config.look.colour_of(m) for m in range(config.targets)], np.uint8)
        return replace(drawn, colours=painted, pictures=[self._take(r) for r in range(config.robots)])

    def _take(self, robot: int) -> NDArray[np.uint8] | None:
        """What a robot's camera sees now, if it takes pictures; their noise is drawn anew."""
        config, world, n = self._core.config, self._core.simulation.world, self._n
        if config.camera_of(robot).kind == "analytic":
            return None
        if robot not in self._sensors:
            from relloc_env.vision.sensor import Sensor

            self._sensors[robot] = Sensor(config, robot)
        sensor = self._sensors[robot]
        picture: NDArray[np.uint8] = np.zeros((sensor.view.height, sensor.view.width, 3), np.uint8)
        row = np.s_[n : n + 1]
        sensor.take(picture, world.pose[row], world.velocity[row], world.points[row], world.tick[row].astype(np.uint64))
        return picture

    def _draw(self) -> Any:
        if self._renderer is None:
            from relloc_env.rendering import Renderer

            rate = self._core.config.sample_rate / self._core.config.samples_per_action
            self._renderer = Renderer(size=self._size, mode=cast("Literal['rgb_array', 'human']", self._mode), fps=rate)
        return self._renderer.draw(self.scene())

    def close(self) -> None:
        """Let the window go."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def scene(core: "Core", n: int, trails: list[Float], course: "Course") -> "Scene":
    """Describe environment n as it is now, and how it came there."""
    from relloc_env.rendering.scene import CameraGeometry, Scene, target_colours

    config, world, samples = core.config, core.simulation.world, core.simulation.samples
    robots = [config.camera_of(r) for r in range(config.robots)]
    cameras = [CameraGeometry.of(camera) for camera in robots]
    poses, points = world.pose[n], world.points[n]
    half = None if config.arena is None else (0.5 * config.arena[0], 0.5 * config.arena[1])
    return Scene(
        time=float(world.tick[n]) * config.sample_period,
        poses=poses.copy(),
        points=points.copy(),
        colours=target_colours(config.targets),
        cameras=cameras,
        true_image=project(poses, [camera.mount_height for camera in robots], points)[..., :2],
        in_view=world.visible[n].copy(),
        image=samples.image[n, -1].astype(np.float64),
        seen=samples.seen[n, -1].copy(),
        robot_radius=config.robot_of(0).radius,
        robot_height=config.robot_of(0).height,
        arena=None if half is None else (-half[0], half[0], -half[1], half[1]),
        obstacles=core.simulation.obstacles.copy() if len(config.obstacles) else None,
        trails=trails,
        estimate=None if core.bare else Estimate(*(np.array(part[n]) for part in core.onboard.estimate)),
        contact=world.contact[n].copy(),
        blocked=world.blocked[n] > 0,
        strips=course.strips(),
        horizon=config.max_cycles * config.samples_per_action * config.sample_period,
    )


def instant(core: "Core", n: int) -> "Instant":
    """Errors of environment n, how they compare with what is claimed and with what is possible, and excitation."""
    from relloc_env.rendering.course import Instant, least_excitation

    config, score, world = core.config, core.score, core.simulation.world
    robots = config.robots
    none = np.full(robots, np.nan)
    depth, position, heading, honest = none, none, none, none
    if not core.bare:
        error = np.abs(score.depth_error[n])
        depth = np.where(np.isfinite(error), error, -1.0).max(axis=1)
        depth = np.where(depth >= 0.0, depth, np.nan)
        if robots > 1:
            position, heading = score.pose_error[n].T
        honest = _honesty(core, n)
    excitation = least_excitation(core.simulation.samples, n, slice(None)) if core.elapsed[n] else none
    now = Instant(float(world.tick[n]) * config.sample_period, depth, position, heading, honest, excitation)
    if not config.tracks_bound:
        return now
    read = (score.bound_factor, score.bound_variances, world.pose, world.points, world.origin)
    ranges = bound_range_sd(*(part[n : n + 1] for part in read))
    square = np.trace(score.pose_covariance[n, :2, :2]) if robots > 1 else math.nan
    return now._replace(depth_bound=float(ranges.max()), position_bound=math.sqrt(square))


def _honesty(core: "Core", n: int) -> Float:
    """(R,) NEES of each robot's pose of the other; of a single robot's points, their mean."""
    poses, estimate = core.simulation.world.pose[n : n + 1], core.onboard.estimate
    one = Estimate._make(part[n : n + 1] for part in estimate)
    if core.config.robots > 1:
        return _usable(nees(pose_errors(one, poses)[0], one.pose_covariance[0]))
    heights = np.array([core.config.camera_of(0).mount_height])
    polar = point_errors(one, poses, core.simulation.world.points[n : n + 1], heights).polar[0, 0]
    known = np.flatnonzero(one.known[0, 0])
    if not known.size:
        return np.full(1, np.nan)
    mean: Float = np.mean(_usable(nees(polar[known], one.points_covariance[0, 0, known])), keepdims=True)
    return mean


def _usable(values: Float) -> Float:
    """NaN where nothing usable is claimed."""
    return np.where(np.isfinite(values), values, np.nan)
