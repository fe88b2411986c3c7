"""Pictures as one robot's camera takes them."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig
from relloc_env.kernels.image_rendering import LAYER, render
from relloc_env.kernels.motion import advance
from relloc_env.parameters import pack_obstacles
from relloc_env.samples import Float
from relloc_env.vision.lens import from_pixels
from relloc_env.vision.protocol import Picture, view_of

BODIES = ((112.0, 114.0, 118.0), (132.0, 130.0, 126.0))
"""Colours of the robots."""
MOMENTS = 12
"""Most moments of which a blurred picture is the mean."""
MARGIN = 1.25
"""A tag with its white border, in edges of the tag."""


@cache
def _normals() -> NDArray[np.float32]:
    """Standard normal numbers for the noise of pixels."""
    return np.random.default_rng(0).standard_normal(1 << 16, np.float32)


class Sensor:
    """Takes the pictures of one robot; for one thread.

    Args:
        config: of the environment.
        robot: whose camera.
        size: [px] width and height of the picture, if not the camera's own; it shows the same view.
    """

    def __init__(self, config: EnvConfig, robot: int, size: tuple[int, int] | None = None) -> None:
        self.view = view = view_of(config, robot, size)
        camera = config.camera_of(robot)
        image, marker = camera.image, config.marker
        self._robot = robot
        self._others = [r for r in range(config.robots) if r != robot]
        self._bodies = np.array([[config.robot_of(r).radius, config.robot_of(r).height] for r in self._others])
        self._mount = camera.mount_height
        half = (math.inf, math.inf) if config.arena is None else (0.5 * config.arena[0], 0.5 * config.arena[1])
        f_x, f_y, c_x, c_y = view.intrinsics
        rows, columns = np.mgrid[: view.height, : view.width] + 0.5
        rays = from_pixels(np.stack([columns, rows], axis=-1), view.intrinsics, view.lens)
        self._rays = rays.astype(np.float32)
        first, last, step = rays[..., 0].min(), rays[..., 0].max(), 1.0 / f_x
        count = round((last - first) / step) + 1
        obstacles = pack_obstacles(config.obstacles)
        tags = marker.kind == "tag"
        cells = _tags(config.targets) if tags else np.zeros((config.targets, 0, 0), np.float32)
        size_ = 0.5 * MARGIN * marker.size if tags else marker.radius
        self.shutter, self._moments = image.shutter, 1
        if image.shutter > 0.0:
            speed = config.robot_of(robot).max_yaw_rate * (1.0 + max(first * first, last * last))
            self._moments = min(max(2, math.ceil(speed * f_x * image.shutter)), MOMENTS)
        b, k, m = self._moments, len(self._others), config.targets
        self._before = (self._rays, np.array([first, step]), np.array([f_x, f_y, c_x, c_y]), view.lens)
        self._world = (np.array([BODIES[r % 2] for r in self._others]).reshape(-1, 3), obstacles,
                       np.array([o.colour for o in config.obstacles], np.float64).reshape(-1, 3))  # fmt: skip
        self._half = half
        self._targets = (np.full(m, size_), np.array([marker.colour_of(i) for i in range(m)], np.float64), cells)
        self._light = (image.exposure * np.array(image.white_balance), image.noise, _normals())
        self._work = (
            np.zeros((b, count, 2 + k + len(obstacles), LAYER), np.float32), np.zeros((b, count), np.int64),
            np.zeros((b, m, 8)), np.zeros((b, m), np.int64), np.zeros((view.width, 3), np.float32),
        )  # fmt: skip

    def take(self, out: Picture, poses: Float, velocities: Float, points: Float, seed: int) -> None:
        """Take a picture.

        Args:
            out: uint8 (H, W, 3) or (3, H, W), C-contiguous, written.
            poses: [m, m, rad] (R, 3) of all robots in the world.
            velocities: [m/s, m/s, rad/s] (R, 3) forward, left, yaw rate; they blur the picture.
            points: [m] (M, 3) targets in the world.
            seed: of the noise, 64 bits.
        """
        width, height = self.view.width, self.view.height
        steps = (3 * width, 3, 1) if out.shape[-1] == 3 and out.shape[0] == height else (width, 1, width * height)
        moments = poses[None] if self._moments == 1 else self._meanwhile(poses, velocities)
        bodies = np.empty((len(moments), len(self._others), 4))
        bodies[..., :2] = moments[:, self._others, :2]
        bodies[..., 2:] = self._bodies
        render(
            out.reshape(-1), np.array(steps), *self._before, np.ascontiguousarray(moments[:, self._robot]), self._mount,
            *self._half, bodies, *self._world, points, *self._targets, *self._light, np.uint64(seed), *self._work,
        )  # fmt: skip

    def _meanwhile(self, poses: Float, velocities: Float) -> Float:
        """[m, m, rad] (B, R, 3) poses while the shutter is open."""
        found = np.empty((self._moments, *poses.shape))
        for b in range(self._moments):
            t = self.shutter * ((b + 0.5) / self._moments - 0.5)
            for r, (pose, velocity) in enumerate(zip(poses, velocities, strict=True)):
                found[b, r] = advance(*pose, *velocity, t)
        return found


def _tags(count: int) -> NDArray[np.float32]:
    """(M, T, T) cells of tags, from 0 for black to 1 for white."""
    from relloc_env.vision.tags import tag_cells

    return tag_cells(count)
