"""Pictures as one robot's camera takes them."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig
from relloc_env.kernels.image_columns import LAYER
from relloc_env.kernels.image_rendering import HORIZON, STRIDE, render
from relloc_env.kernels.streams import PICTURE, draw_u64
from relloc_env.kernels.world import World
from relloc_env.parameters import pack_obstacles
from relloc_env.samples import Float, Rows
from relloc_env.vision.lens import picture_rays
from relloc_env.vision.protocol import Picture, view_of

ROBOTS = ((112.0, 114.0, 118.0), (132.0, 130.0, 126.0))
"""Colours of the robots."""
MOMENTS = 12
"""Most moments of which a blurred picture is the mean."""
BORDER = 1.25
"""A tag with its white border, in edges of the tag: ten cells, of which eight are the tag."""


@cache
def _noise(sd: float) -> NDArray[np.float32]:
    """[levels] noise of pixels, and 1/2: see `kernels.image_rendering.render`."""
    normals = np.random.default_rng(0).standard_normal((1 << 17) + STRIDE, np.float32)
    return np.float32(sd) * normals + np.float32(0.5)


class Sensor:
    """Takes the pictures of one robot; for one thread.

    Args:
        config: of the environment.
        robot: whose camera.
        size: [px] width and height of the picture, if not the camera's own; it shows the same view.
    """

    def __init__(self, config: EnvConfig, robot: int, size: tuple[int, int] | None = None) -> None:
        self.view = view = view_of(config, robot, size)
        camera, robots = config.camera_of(robot), [config.robot_of(r) for r in range(config.robots)]
        image, marker, m = camera.image, config.look, config.targets
        f_x = float(view.intrinsics[0])
        rays = picture_rays(view.width, view.height, view.intrinsics, view.lens)
        first, last = float(rays[..., 0].min()), float(rays[..., 0].max())
        count = round((last - first) * f_x) + 1
        rays = np.pad(rays, ((0, 0), (0, _whole(view.width) - view.width), (0, 0)), mode="edge")
        width = rays.shape[1]
        moments = 1
        if image.shutter > 0.0:
            speed = config.robot_of(robot).max_yaw_rate * (1.0 + max(first * first, last * last))
            moments = min(max(2, math.ceil(speed * f_x * image.shutter)), MOMENTS)
        obstacles = pack_obstacles(config.obstacles)
        half = (math.inf, math.inf) if config.arena is None else (0.5 * config.arena[0], 0.5 * config.arena[1])
        self._optics = (
            _ground(rays, camera.mount_height, 1.0 / float(view.intrinsics[1])),
            np.rint((rays[..., 0] - first) * f_x).astype(np.int32),
            np.array([first, 1.0 / f_x, count]), view.intrinsics, view.lens,
        )  # fmt: skip
        self._world = (
            robot, image.shutter, np.array([config.camera_of(r).mount_height for r in range(config.robots)]), *half,
            np.array([[one.radius, one.height] for one in robots]),
            np.array([ROBOTS[r % 2] for r in range(len(robots))]),
            obstacles, np.array([one.colour for one in config.obstacles], np.float64).reshape(-1, 3),
        )  # fmt: skip
        tags = marker.kind == "tag"
        self._targets = (
            0.5 * BORDER * marker.size if tags else marker.radius,
            np.array([marker.colour_of(i) for i in range(m)], np.float64),
            _tags(m) if tags else np.zeros((m, 0, 0), np.float32),
        )
        gains = image.exposure * np.array(image.white_balance)
        self._light = (gains, _noise(image.noise))
        self._room = (
            _nothing((moments, len(robots) + len(obstacles), LAYER, _whole(count))),
            np.zeros((moments, len(robots) + len(obstacles), 2), np.int64),
            np.zeros((moments, len(robots) + len(obstacles), 4), np.float32),
            np.zeros((moments, m, 8)), np.zeros((moments, m), np.int64),
            *(np.zeros(shape, np.float32) for shape in ((3, width), (3, width), (width,))),
            np.zeros(3 * width, np.uint8),
        )  # fmt: skip

    def take(
        self, out: Picture, poses: Float, velocities: Float, points: Float, seeds: NDArray[np.uint64],
        places: NDArray[np.int64] | None = None,
    ) -> None:  # fmt: skip
        """Take P pictures.

        Args:
            out: uint8 (..., H, W, 3) or (..., 3, H, W), C-contiguous: pictures, of which P are written.
            poses: [m, m, rad] (P, R, 3) of all robots in the world.
            velocities: [m/s, m/s, rad/s] (P, R, 3) forward, left, yaw rate; they blur the pictures.
            points: [m] (P, M, 3) targets in the world.
            seeds: (P,) of the noise.
            places: (P,) which pictures of `out`, counted along all its leading axes; None for all.
        """
        width, height = self.view.width, self.view.height
        channels_last = out.shape[-3:] == (height, width, 3)
        steps = np.array((3 * width, 3, 1) if channels_last else (width, 1, width * height))
        starts = (np.arange(len(poses)) if places is None else places) * (3 * width * height)
        render(
            out.reshape(-1), starts, steps, *self._optics, poses, velocities, *self._world, points, *self._targets,
            *self._light, seeds, *self._room,
        )  # fmt: skip


class Pictures:
    """The pictures that policies see of N environments: one of each robot's camera, of a size of its own.

    Args:
        config: of the environments.
        threads: how many may ask at once.
    """

    def __init__(self, config: EnvConfig, threads: int) -> None:
        self._sensors = [[Sensor(config, r, config.image_size) for r in range(config.robots)] for _ in range(threads)]

    def take(self, out: Picture, world: World, rows: Rows, thread: int = 0) -> None:
        """Take the pictures (N, R, 3, H, W) of the environments `rows`."""
        poses, velocities, points = world.pose[rows], world.velocity[rows], world.points[rows]
        for r, sensor in enumerate(self._sensors[thread]):
            seeds = np.empty(len(rows), np.uint64)
            draw_u64(world.streams, rows, PICTURE, seeds)
            sensor.take(out, poses, velocities, points, seeds, rows * out.shape[1] + r)


def _whole(count: int) -> int:
    """So many, or more for a whole number of strides."""
    return -(-count // STRIDE) * STRIDE


def _nothing(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Upright parts (B, L, LAYER, C) of columns, none of which has any."""
    layers = np.zeros(shape, np.float32)
    layers[:, :, 0], layers[:, :, 1], layers[:, :, 2] = np.inf, np.inf, -np.inf
    return layers


def _ground(rays: Float, mount: float, pixel: float) -> NDArray[np.float32]:
    """(H, 5, W) rays (H, W, 2), and how the floor or the sky looks there: see `kernels.image_rendering.render`."""
    x, y = np.moveaxis(rays, -1, 0)
    below = y > HORIZON
    z = np.where(below, mount / np.where(below, y, 1.0), 0.0)
    far = 0.86 + 0.14 / (1.0 + 0.04 * z)
    bright = np.where(below, far, 1.0 + 0.1 * np.maximum(y, -1.0))
    contrast = np.where(below, far / (1.0 + 16.0 * (pixel * z * z / mount) ** 2), 0.0)  # less where a pixel is large
    return np.stack([x, y, z, bright, contrast], axis=1).astype(np.float32)


def _tags(count: int) -> NDArray[np.float32]:
    """(M, T, T) cells of tags, from 0 for black to 1 for white."""
    from relloc_env.vision.tags import tag_cells

    return tag_cells(count)
