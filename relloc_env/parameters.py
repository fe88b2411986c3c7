"""A configuration as the plain records that kernels read."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import BoxConfig, DiscConfig, EnvConfig
from relloc_env.kernels.driving import FAST
from relloc_env.kernels.lanes import width_of
from relloc_env.kernels.placement import FIXED, GAUSSIAN, POSITIVE
from relloc_env.kernels.world import BOX, DISC
from relloc_env.samples import Float

PARAMETERS = np.dtype(
    [(name, np.float64) for name in (
        "dt", "half_x", "half_y", "shield_target", "shield_robot", "shield_wall", "latency", "jitter", "loss",
        "distance_min", "distance_max", "separation_min", "separation_max", "height_min", "height_max",
        "heading_error", "robot_distance", "margin", "guess_depth", "guess_position", "guess_heading",
    )]
    + [(name, np.int64) for name in (
        "samples_per_action", "shield", "message_every", "start_in_view", "guess_kind", "perfect_network",
        "actuator_noise", "image_noise", "misses", "odometry_noise", "width", "targets", "window", "reward_start",
        "fast",
    )],
    align=True,
)  # fmt: skip
"""Numbers of an environment that kernels read; one type for all configurations, so that nothing compiles anew."""

ROBOT = np.dtype(
    [(name, np.float64) for name in (
        "radius", "height", "max_speed", "min_speed", "max_yaw_rate", "gain_v", "gain_w", "actuator_v", "actuator_w",
        "odometry_v", "odometry_w", "focal_length", "centre_x", "centre_y", "mount_height", "pixel_noise",
        "quantisation", "near", "far", "miss_probability", "x_min", "x_max", "y_min", "y_max",
        "frames_per_sample",
    )],
    align=True,
)  # fmt: skip
"""Numbers of one robot and its camera that kernels read."""


def pack_parameters(config: EnvConfig, num_envs: int = 1) -> NDArray[np.void]:
    """Return the (1,) record of `PARAMETERS` for a configuration."""
    row = np.zeros(1, PARAMETERS)
    rate = config.network.rate
    shield, start, guess = config.shield, config.start, config.guess
    arena = config.arena or (math.inf, math.inf)
    robots = [config.robot_of(r) for r in range(config.robots)]
    cameras = [config.camera_of(r) for r in range(config.robots)]
    values: dict[str, float] = {
        "dt": config.sample_period,
        "half_x": 0.5 * arena[0],
        "half_y": 0.5 * arena[1],
        "latency": config.network.latency,
        "jitter": config.network.jitter,
        "loss": config.network.loss,
        "distance_min": start.target_distance[0],
        "distance_max": start.target_distance[1],
        "separation_min": start.target_separation[0],
        "separation_max": start.target_separation[1],
        "height_min": start.target_height[0],
        "height_max": start.target_height[1],
        "heading_error": math.radians(start.heading_error),
        "robot_distance": start.robot_distance,
        "margin": start.margin,
        "guess_depth": guess.depth,
        "guess_position": guess.position,
        "guess_heading": math.radians(guess.heading),
        "samples_per_action": config.samples_per_action,
        "shield": shield is not None,
        "message_every": 1 if rate is None else max(1, math.ceil(config.sample_rate / rate - 1e-9)),
        "start_in_view": start.in_view,
        "guess_kind": {"fixed": FIXED, "positive": POSITIVE, "gaussian": GAUSSIAN}[guess.kind],
        "width": width_of(num_envs),
        "targets": config.targets,
        "window": config.message_window,
        "reward_start": math.ceil(config.reward_start / (config.sample_period * config.samples_per_action) - 1e-9),
        "perfect_network": config.network.perfect,
        "actuator_noise": any(max(robot.actuator_noise) > 0.0 for robot in robots),
        "image_noise": any(camera.pixel_noise > 0.0 for camera in cameras),
        "misses": any(camera.miss_probability > 0.0 for camera in cameras),
        "odometry_noise": any(max(robot.odometry_noise) > 0.0 for robot in robots),
        "fast": any(robot.max_speed * config.sample_period > FAST * robot.radius for robot in robots),
    }
    if shield is not None:
        values |= {"shield_target": shield.target, "shield_robot": shield.robot, "shield_wall": shield.wall}
    for name, value in values.items():
        row[name] = value
    return row


def pack_robots(config: EnvConfig) -> NDArray[np.void]:
    """Return the (R,) records of `ROBOT` for a configuration."""
    rows = np.zeros(config.robots, ROBOT)
    for r in range(config.robots):
        robot, camera = config.robot_of(r), config.camera_of(r)
        centre_x, centre_y = camera.principal_point
        focal, inf = camera.focal_length, math.inf
        values: dict[str, float] = {
            "radius": robot.radius,
            "height": robot.height,
            "max_speed": robot.max_speed,
            "min_speed": -robot.max_speed if robot.reverse else 0.0,
            "max_yaw_rate": robot.max_yaw_rate,
            "gain_v": _gain(robot.lag[0], config.sample_period),
            "gain_w": _gain(robot.lag[1], config.sample_period),
            "actuator_v": robot.actuator_noise[0],
            "actuator_w": robot.actuator_noise[1],
            "odometry_v": robot.odometry_noise[0],
            "odometry_w": robot.odometry_noise[1],
            "focal_length": focal,
            "centre_x": centre_x,
            "centre_y": centre_y,
            "mount_height": camera.mount_height,
            "pixel_noise": camera.pixel_noise,
            "quantisation": camera.quantisation,
            "near": camera.near,
            "far": inf if camera.far is None else camera.far,
            "miss_probability": camera.miss_probability,
            "x_min": -centre_x / focal if camera.limited else -inf,
            "x_max": (camera.width - centre_x) / focal if camera.limited else inf,
            "y_min": -centre_y / focal if camera.limited else -inf,
            "y_max": (camera.height - centre_y) / focal if camera.limited else inf,
            "frames_per_sample": 1.0 if camera.frame_rate is None else camera.frame_rate / config.sample_rate,
        }
        for name, value in values.items():
            rows[name][r] = value
    return rows


def _gain(lag: float, dt: float) -> float:
    """Share of the way to the command that a first-order actuator goes in one sample."""
    return 1.0 if lag == 0.0 else -math.expm1(-dt / lag)


def pack_obstacles(obstacles: Sequence[DiscConfig | BoxConfig]) -> Float:
    """Return (O, 7) rows, see `kernels.world.BOX`."""
    rows = np.zeros((len(obstacles), 7))
    for row, obstacle in zip(rows, obstacles, strict=True):
        if isinstance(obstacle, DiscConfig):
            row[:] = (DISC, *obstacle.position, obstacle.radius, 0.0, 0.0, obstacle.height)
        else:
            half = (0.5 * obstacle.size[0], 0.5 * obstacle.size[1])
            row[:] = (BOX, *obstacle.position, *half, obstacle.angle, obstacle.height)
    return rows
