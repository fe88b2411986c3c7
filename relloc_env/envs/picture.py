"""The picture of one environment, for every door: what a `Scene` needs, taken from the core."""

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded

from relloc_env.kernels.information import range_variance
from relloc_env.metrics import nees, nees_band, point_errors, pose_errors
from relloc_env.samples import Estimate, Float

if TYPE_CHECKING:
    from relloc_env.envs.core import Core
    from relloc_env.rendering import Renderer
    from relloc_env.rendering.scene import Reading, Scene


class Picture:
    """Draws environment n of a core, and remembers where its robots went. Without a mode it does nothing.

    Args:
        mode: None, "rgb_array" or "human".
        size: [px] width and height.
    """

    def __init__(self, core: "Core", mode: str | None, n: int = 0, size: tuple[int, int] = (960, 540)) -> None:
        self._core, self._mode, self._n, self._size = core, mode, n, size
        self._trails: list[list[Float]] = [[] for _ in range(core.config.robots)]
        self._renderer: Renderer | None = None

    def follow(self, *, new: bool = False) -> None:
        """Note where the robots went in the last action (`new`: an episode starts), and refresh the window."""
        if self._mode is None:
            return
        simulation, n = self._core.simulation, self._n
        poses = simulation.world.pose[n][None] if new else simulation.truth.pose[n]
        for r, trail in enumerate(self._trails):
            if new:
                trail.clear()
            trail.extend(pose[r, :2].copy() for pose in poses)
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

    def _draw(self) -> Any:
        if self._renderer is None:
            from relloc_env.rendering import Renderer

            rate = self._core.config.sample_rate / self._core.config.samples_per_action
            self._renderer = Renderer(size=self._size, mode=cast("Literal['rgb_array', 'human']", self._mode), fps=rate)
        return self._renderer.draw(scene(self._core, self._n, [np.array(trail) for trail in self._trails]))

    def close(self) -> None:
        """Let the window go."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def scene(core: "Core", n: int, trails: list[Float]) -> "Scene":
    """Describe environment n as it is now."""
    from relloc_env.rendering.scene import CameraGeometry, Scene, target_colours

    config, world, samples = core.config, core.simulation.world, core.simulation.samples
    robots = [config.camera_of(r) for r in range(config.robots)]
    cameras = [
        CameraGeometry(
            width=camera.width,
            height=camera.height,
            focal=camera.focal_length,
            c_x=camera.principal_point[0],
            c_y=camera.principal_point[1],
            near=camera.near,
            far=math.inf if camera.far is None else camera.far,
            limited=camera.limited,
            mount=camera.mount_height,
        )
        for camera in robots
    ]
    poses, points = world.pose[n], world.points[n]
    heading = poses[:, 2, None]
    d = points[None, :, :2] - poses[:, None, :2]
    ahead = np.cos(heading) * d[..., 0] + np.sin(heading) * d[..., 1]
    right = np.sin(heading) * d[..., 0] - np.cos(heading) * d[..., 1]
    down = np.array([camera.mount_height for camera in robots])[:, None] - points[None, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        image = np.stack([right / ahead, down / ahead], axis=-1)
    half = None if config.arena is None else (0.5 * config.arena[0], 0.5 * config.arena[1])
    return Scene(
        time=float(world.tick[n]) * config.sample_period,
        poses=poses.copy(),
        points=points.copy(),
        colours=target_colours(config.targets),
        cameras=cameras,
        true_image=image,
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
        readings=_readings(core, n),
    )


def _readings(core: "Core", n: int) -> "list[Reading]":
    """Errors, and how they compare with what is claimed and with what is possible."""
    from relloc_env.rendering.scene import Reading

    config, score, readings = core.config, core.score, []
    if not core.bare:
        for r in range(config.robots):
            error = np.abs(score.depth_error[n, r])
            known = error[np.isfinite(error)]
            readings.append(Reading("depth error", f"{known.max():.2f} m" if known.size else "none", r))
        for p, (a, _) in enumerate(core.simulation.pairs):
            length, angle = score.pose_error[n, p]
            readings.append(Reading("pose error", f"{length:.2f} m {math.degrees(angle):.1f}°", int(a)))
        readings += [_gauge("NEES", value, band, r) for value, band, r in _honesty(core, n)]
        if config.tracks_bound:
            readings.append(_gauge("error / bound", *_against_bound(core, n)))
    if config.tracks_bound:
        j = score.pose_information[n] if config.robots > 1 else score.depth_information[n, 0]
        readings.append(Reading("information", f"{j:.2f} nats"))
    return readings


def _gauge(label: str, value: float, band: tuple[float, float], robot: int = -1) -> "Reading":
    """A number with the band that holds 95 % where all is right."""
    from relloc_env.rendering.scene import Reading

    if math.isnan(value):
        words = "none"
    elif value < 1e5:
        words = f"{value:.2f}" if value < 10.0 else f"{value:,.0f}"
    else:
        words = "> 10⁵"
    return Reading(label, words, robot, (value, *band))


def _honesty(core: "Core", n: int) -> list[tuple[float, tuple[float, float], int]]:
    """NEES with its band and the robot that claims: of each pose, or of a single robot's points, their mean."""
    poses, estimate = core.simulation.world.pose[n : n + 1], core.onboard.estimate
    one = Estimate._make(part[n : n + 1] for part in estimate)
    if core.config.robots > 1:
        errors = pose_errors(one, poses)[0]
        claims = zip(errors, one.pose_covariance[0], core.simulation.pairs[:, 0].tolist(), strict=True)
        return [(_nees(error, covariance), _band(3, 1), robot) for error, covariance, robot in claims]
    heights = np.array([core.config.camera_of(0).mount_height])
    polar = point_errors(one, poses, core.simulation.world.points[n : n + 1], heights).polar[0, 0]
    known = np.flatnonzero(one.known[0, 0])
    values = [_nees(polar[m], one.points_covariance[0, 0, m]) for m in known]
    return [(float(np.mean(values)) if values else math.nan, _band(3, max(len(values), 1)), 0)]


def _against_bound(core: "Core", n: int) -> tuple[float, tuple[float, float]]:
    """Whitened error of B's pose in {A}, or of a single robot's ranges, with its band; 1 is at the bound."""
    world, score = core.simulation.world, core.score
    if core.config.robots > 1:
        one = Estimate._make(part[n : n + 1] for part in core.onboard.estimate)
        square, band = _nees(pose_errors(one, world.pose[n : n + 1])[0, 0], score.pose_covariance[n]) / 3.0, _band(3, 1)
        return math.sqrt(square), (math.sqrt(band[0] / 3.0), math.sqrt(band[1] / 3.0))
    error = score.depth_error[n, 0]
    known = np.flatnonzero(np.isfinite(error))
    squares = [error[m] ** 2 / range_variance(score.bound[n], world.pose[n], world.points[n], 0, m) for m in known]
    low, high = _band(1, max(len(squares), 1))
    return math.sqrt(np.mean(squares)) if squares else math.nan, (math.sqrt(low), math.sqrt(high))


def _nees(error: Float, covariance: Float) -> float:
    """NEES; NaN where nothing usable is claimed."""
    value = float(nees(error, covariance))
    return value if math.isfinite(value) else math.nan


_band = lru_cache(nees_band)
