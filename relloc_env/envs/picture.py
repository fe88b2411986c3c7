"""The picture of one environment, for every door: what a `Scene` needs, taken from the core."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from relloc_env.envs.history import History
from relloc_env.pinhole import project
from relloc_env.samples import Estimate

if TYPE_CHECKING:
    from relloc_env.envs.core import Core
    from relloc_env.rendering import Renderer
    from relloc_env.rendering.scene import Scene
    from relloc_env.vision.sensor import Sensor


class Picture:
    """Draws environment n of a core, and remembers where its robots went. Without a mode it does nothing.

    Args:
        mode: None, "rgb_array" or "human".
        size: [px] width and height.
        past: [s] of the past that the numbers over time show; default: a whole episode.
    """

    def __init__(
        self,
        core: "Core",
        mode: str | None,
        n: int = 0,
        size: tuple[int, int] = (960, 540),
        past: float = math.inf,
    ) -> None:
        self._core, self._mode, self._n, self._size, self._past = core, mode, n, size, past
        self._history: History | None = None
        self._sensors: dict[int, Sensor] = {}
        self._renderer: Renderer | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What a copy has; it opens a window and takes pictures of its own."""
        return {**self.__dict__, "_renderer": None, "_sensors": {}}

    def follow(self, *, new: bool = False) -> None:
        """Note what happened in the last action (`new`: an episode starts), and refresh the window.

        A window that its user closed stays closed; one that others in this process took away opens at the next start.
        """
        if self._mode is None:
            return
        if self._history is None:
            self._history = History(self._core, self._n, self._past)
        self._history.note(new=new)
        if new and self._renderer is not None and self._renderer.lost:
            self.close()
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
        if self._history is None:
            raise ResetNeeded("Call `reset` before `render`: there is nothing to show yet")
        return self._draw() if self._mode == "rgb_array" else None

    def scene(self) -> "Scene":
        """The present, to be drawn or recorded; only with a mode, and after `follow`."""
        assert self._history is not None
        drawn = scene(self._core, self._n, self._history)
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


def scene(core: "Core", n: int, history: History) -> "Scene":
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
        trails=history.trails(),
        estimate=None if core.bare else Estimate(*(np.array(part[n]) for part in core.onboard.estimate)),
        contact=world.contact[n].copy(),
        blocked=world.blocked[n] > 0,
        strips=history.course().strips(),
        horizon=min(history.past, config.max_cycles * config.samples_per_action * config.sample_period),
    )
