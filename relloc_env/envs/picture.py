"""The picture of one environment, for every door: what a `Scene` needs, taken from the core."""

import math
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from relloc_env.samples import Estimate, Float

if TYPE_CHECKING:
    from relloc_env.envs.core import Core
    from relloc_env.rendering.scene import Scene


class Picture:
    """Draws environment n of a core, and remembers where its robots went."""

    def __init__(self, core: "Core", mode: str, n: int = 0, size: tuple[int, int] = (960, 540)) -> None:
        from relloc_env.rendering import Renderer

        self._core, self._n = core, n
        self._trails: list[list[Float]] = [[] for _ in range(core.config.robots)]
        rate = core.config.sample_rate / core.config.samples_per_action
        self._renderer = Renderer(size=size, mode=cast("Literal['rgb_array', 'human']", mode), fps=rate)

    def follow(self, *, new: bool = False) -> None:
        """Note where the robots are; `new` starts the trails afresh."""
        poses = (
            self._core.simulation.truth.pose[self._n] if not new else self._core.simulation.world.pose[self._n][None]
        )
        for r, trail in enumerate(self._trails):
            if new:
                trail.clear()
            trail.extend(pose[r, :2].copy() for pose in poses)

    def draw(self) -> Any:
        """Draw the present: an array (H, W, 3) for "rgb_array", else None."""
        return self._renderer.draw(scene(self._core, self._n, [np.array(trail) for trail in self._trails]))

    def close(self) -> None:
        """Let the window go."""
        self._renderer.close()


def scene(core: "Core", n: int, trails: list[Float]) -> "Scene":
    """Describe environment n as it is now."""
    from relloc_env.rendering.scene import CameraGeometry, Reading, Scene, target_colours

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
    readings = []
    if not core.bare:
        for r in range(config.robots):
            error = np.abs(core.score.depth_error[n, r])
            known = error[np.isfinite(error)]
            readings.append(Reading("depth error", f"{known.max():.2f} m" if known.size else "none", r))
        for p, (a, _) in enumerate(core.simulation.pairs):
            length, angle = core.score.pose_error[n, p]
            readings.append(Reading("pose error", f"{length:.2f} m {math.degrees(angle):.1f}°", int(a)))
    j = core.score.pose_information[n] if config.robots > 1 else core.score.depth_information[n, 0]
    readings.append(Reading("information", f"{j:.2f} nats"))
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
        obstacles=world.obstacles[n].copy() if len(config.obstacles) else None,
        trails=trails,
        estimate=None if core.bare else Estimate(*(np.array(part[n]) for part in core.onboard.estimate)),
        contact=world.contact[n].copy(),
        blocked=world.blocked[n] > 0,
        readings=readings,
    )
