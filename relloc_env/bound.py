"""The information bound beside an episode: what the best estimator could know by now, from the truth.

Rewards, metrics and `info` read it; estimators never do.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.bound import Bound, Noise, Prior, Scene, bound_measure, bound_move, bound_reset
from relloc_env.kernels.information import depth_information, pose_covariance, pose_information, range_variances
from relloc_env.rewards import DEPTH_INFO, POSE_INFO

UNSEEN_SD = 100.0
"""[m] what the bound knows of a target before its first image."""
LEAST_IMAGE_SD = 1e-4
"""[-] image noise of the bound where the camera has less: a bound of zero has no logarithm."""
LEAST_SD = 1e-6
"""[m], [rad] standard deviation of priors that are told with less."""
GREATEST_SD = 1e9
"""[m], [rad], [m/s], [rad/s], [-] standard deviation of priors and noise that are told with more."""


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
        depth_sd=np.full(config.robots, np.clip(guess.depth_sd, LEAST_SD, GREATEST_SD)),
        pose_sd=np.clip([guess.position_sd, guess.position_sd, math.radians(guess.heading_sd)], LEAST_SD, GREATEST_SD),
        camera_heights=np.array([camera.mount_height for camera in cameras]),
        speed_sd=np.array([min(robot.odometry_noise[0], GREATEST_SD) for robot in robots]),
        turn_sd=np.array([min(robot.odometry_noise[1], GREATEST_SD) for robot in robots]),
        image_sd=np.array([min(max(camera.image_noise, LEAST_IMAGE_SD), GREATEST_SD) for camera in cameras]),
    )


@kernel
def start_bound(
    factor, variances, sighted, depth_info, pose_info, pose_cov, worst_sd, points, origin, t_pose, t_visible,
    depth_sd, pose_sd, heights, speed_sd, turn_sd, image_sd, rows,
):  # fmt: skip
    """Start the bound of new episodes from the priors and their first images; arguments as for `carry_bound`."""
    work, ranges = np.zeros((4, variances.shape[1])), np.zeros(points.shape[1])
    noise = Noise(speed_sd, turn_sd, image_sd, depth_sd)
    prior = Prior(pose_sd, UNSEEN_SD, 0.0, 0.0, 0.0)
    for n in rows:
        bound = Bound(factor[n], variances[n], sighted[n], work)
        scene = Scene(t_pose[n, 0], points[n], heights, origin[n])
        bound_reset(bound, scene, prior)
        bound_measure(bound, scene, noise, t_visible[n, 0], True)
        _inform(bound, scene, ranges, depth_info[n], pose_info, pose_cov[n], worst_sd[n], n)


@kernel
def carry_bound(
    factor, variances, sighted, depth_info, pose_info, pose_cov, worst_sd, pose, points, origin, t_pose, t_visible,
    depth_sd, _pose_sd, heights, speed_sd, turn_sd, image_sd, rows, terms, t_velocity, dt,
):  # fmt: skip
    """Carry the bound over the samples of an action; the information gained goes to the terms of the reward.

    Args:
        factor, ..., worst_sd: fields of `Score`, changed in place.
        pose, points, origin: of `World`.
        t_pose, t_visible: of `Truth`.
        depth_sd, ..., image_sd: `Known`.
        rows: environments that moved.
        terms: of `Score`, written.
        t_velocity: of `Truth`.
        dt: [s] length of a sample.
    """
    work, ranges = np.zeros((4, variances.shape[1])), np.zeros(points.shape[1])
    noise = Noise(speed_sd, turn_sd, image_sd, depth_sd)
    robots = pose.shape[1]
    for n in rows:
        bound = Bound(factor[n], variances[n], sighted[n], work)
        for k in range(t_pose.shape[1]):
            scene = Scene(t_pose[n, k], points[n], heights, origin[n])
            bound_move(bound, scene, noise, t_velocity[n, k], dt)
            bound_measure(bound, scene, noise, t_visible[n, k], True)
        before = pose_info[n]
        for r in range(robots):
            terms[n, r, DEPTH_INFO] = -depth_info[n, r]
        scene = Scene(pose[n], points[n], heights, origin[n])
        _inform(bound, scene, ranges, depth_info[n], pose_info, pose_cov[n], worst_sd[n], n)
        for r in range(robots):
            terms[n, r, DEPTH_INFO] += depth_info[n, r]
            terms[n, r, POSE_INFO] = pose_info[n] - before


@kernel
def read_bound(factor, variances, sighted, depth_info, pose_info, pose_cov, worst_sd, pose, points, origin, rows):
    """Refresh what is read from the bounds of the environments `rows`; arguments as for `carry_bound`."""
    work, ranges = np.zeros((4, variances.shape[1])), np.zeros(points.shape[1])
    no_heights = np.zeros(pose.shape[1])
    for n in rows:
        bound = Bound(factor[n], variances[n], sighted[n], work)
        scene = Scene(pose[n], points[n], no_heights, origin[n])
        _inform(bound, scene, ranges, depth_info[n], pose_info, pose_cov[n], worst_sd[n], n)


@inlined
def _inform(bound, scene, ranges, depth_info, pose_info, pose_cov, worst_sd, n):
    """Refresh information and worst standard deviations of one environment from its bound; `ranges` (M,) is scratch."""
    robots, first, second = scene.poses.shape[0], np.int64(0), np.int64(1)  # numbers alone would be compiled for anew
    for r in range(robots):
        range_variances(bound, scene, r, ranges)
        depth_info[r] = depth_information(ranges)
    if robots == 1:
        worst_sd[0], worst_sd[1] = math.sqrt(ranges.max()), 0.0
        return
    pose_info[n] = pose_information(bound, scene, second)
    pose_covariance(bound, scene, first, second, pose_cov)
    worst_sd[0], worst_sd[1] = math.sqrt(max(pose_cov[0, 0], pose_cov[1, 1])), math.sqrt(pose_cov[2, 2])
