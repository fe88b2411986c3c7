"""The information bound beside an episode: what the best estimator could know by now, from the truth.

Rewards, metrics and `info` read it; estimators never do.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.bound import bound_measure, bound_move, bound_reset
from relloc_env.kernels.information import depth_information, pose_covariance, pose_information, range_variance
from relloc_env.rewards import DEPTH_INFO, POSE_INFO

UNSEEN_SD = 100.0
"""[m] what the bound knows of a target before its first image."""
LEAST_IMAGE_SD = 1e-4
"""[-] image noise of the bound where the camera has less: a bound of zero has no logarithm."""


class Known(NamedTuple):
    """What the bound is told: noise and priors, the same as the estimators are; C-contiguous arrays."""

    depth_sd: Any
    """[m] (R,)"""
    pose_sd: Any
    """[m, m, rad] (3,)"""
    camera_heights: Any
    """[m] (R,)"""
    speed_sd: Any
    """[m/s] (R,) odometry noise of one sample."""
    turn_sd: Any
    """[rad/s] (R,)"""
    image_sd: Any
    """[-] (R,)"""


def pack_known(config: EnvConfig) -> Known:
    """Noise and priors of a configuration."""
    robots = [config.robot_of(r) for r in range(config.robots)]
    cameras = [config.camera_of(r) for r in range(config.robots)]
    guess = config.guess
    return Known(
        depth_sd=np.full(config.robots, guess.depth_sd),
        pose_sd=np.array([guess.position_sd, guess.position_sd, math.radians(guess.heading_sd)]),
        camera_heights=np.array([camera.mount_height for camera in cameras]),
        speed_sd=np.array([robot.odometry_noise[0] for robot in robots]),
        turn_sd=np.array([robot.odometry_noise[1] for robot in robots]),
        image_sd=np.array([max(camera.image_noise, LEAST_IMAGE_SD) for camera in cameras]),
    )


@kernel
def start_bound(
    bound, sighted, depth_info, pose_info, pose_cov, worst_sd, pose, points, t_pose, t_visible,
    depth_sd, pose_sd, heights, _speed_sd, _turn_sd, image_sd, rows,
):  # fmt: skip
    """Start the bound of new episodes from the priors and their first images; arguments as for `carry_bound`."""
    work = np.zeros((2, bound.shape[1]))
    for n in rows:
        bound_reset(bound[n], sighted[n], pose[n], pose_sd, 0.0, UNSEEN_SD)
        bound_measure(
            bound[n], work, sighted[n], t_pose[n, 0], points[n], heights, t_visible[n, 0], image_sd, depth_sd, True
        )
        _inform(bound[n], depth_info[n], pose_info, pose_cov[n], worst_sd[n], pose[n], points[n], n)


@kernel
def carry_bound(
    bound, sighted, depth_info, pose_info, pose_cov, worst_sd, pose, points, t_pose, t_visible,
    depth_sd, _pose_sd, heights, speed_sd, turn_sd, image_sd, rows, terms, t_velocity, dt,
):  # fmt: skip
    """Carry the bound over the samples of an action; the information gained goes to the terms of the reward.

    Args:
        bound, ..., worst_sd: fields of `Score`, changed in place.
        pose, points: of `World`.
        t_pose, t_visible: of `Truth`.
        depth_sd, ..., image_sd: `Known`.
        rows: environments that moved.
        terms: of `Score`, written.
        t_velocity: of `Truth`.
        dt: [s] length of a sample.
    """
    work, robots = np.zeros((2, bound.shape[1])), pose.shape[1]
    for n in rows:
        for k in range(t_pose.shape[1]):
            bound_move(bound[n], work, t_pose[n, k], points[n], t_velocity[n, k], dt, speed_sd, turn_sd)
            bound_measure(
                bound[n], work, sighted[n], t_pose[n, k], points[n], heights, t_visible[n, k], image_sd, depth_sd, True
            )
        before = pose_info[n]
        for r in range(robots):
            terms[n, r, DEPTH_INFO] = -depth_info[n, r]
        _inform(bound[n], depth_info[n], pose_info, pose_cov[n], worst_sd[n], pose[n], points[n], n)
        for r in range(robots):
            terms[n, r, DEPTH_INFO] += depth_info[n, r]
            terms[n, r, POSE_INFO] = pose_info[n] - before


@kernel
def read_bound(bound, sighted, depth_info, pose_info, pose_cov, worst_sd, pose, points, rows):  # noqa: ARG001
    """Refresh what is read from the bounds of the environments `rows`; arguments as for `carry_bound`."""
    for n in rows:
        _inform(bound[n], depth_info[n], pose_info, pose_cov[n], worst_sd[n], pose[n], points[n], n)


@kernel
def _inform(bound, depth_info, pose_info, pose_cov, worst_sd, pose, points, n):
    """Refresh information and worst standard deviations of one environment from its bound."""
    robots, count = pose.shape[0], points.shape[0]
    first, second, worst = np.int64(0), np.int64(1), 0.0  # numbers alone would be compiled for anew
    for r in range(robots):
        depth_info[r] = depth_information(bound, pose, points, r)
    if robots == 1:
        for i in range(count):
            worst = max(worst, range_variance(bound, pose, points, first, i))
        worst_sd[0], worst_sd[1] = math.sqrt(worst), 0.0
        return
    pose_info[n] = pose_information(bound, count, second)
    pose_covariance(bound, count, pose, first, second, pose_cov)
    worst_sd[0], worst_sd[1] = math.sqrt(max(pose_cov[0, 0], pose_cov[1, 1])), math.sqrt(pose_cov[2, 2])
