"""Rewards: a sum of named, weighted terms, all computed from the truth in one kernel.

`TERMS` says what each term is. A term is added in two places of this file, in the same order: its meaning in `TERMS`
and its number in `score`.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import REWARD_TERMS, EnvConfig
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.bound import bound_measure, bound_move, bound_reset
from relloc_env.kernels.information import (
    depth_information,
    excitation,
    pose_covariance,
    pose_information,
    range_variance,
)
from relloc_env.kernels.motion import relative, wrap_angle
from relloc_env.kernels.world import Truth, World
from relloc_env.samples import Estimate, Samples

TERMS: Mapping[str, str] = {
    "excitation": "least over the targets of the excitation gained, the integral of v²(x² + y²) over the action [m²/s]",
    "information_depth": "increment of the mean over the targets of -log(range sd / 0.1 m), from the bound [nats]",
    "information_pose": "increment of -log det(covariance of the relative pose)/6, from the bound [nats]",
    "depth_error": "mean over the targets of the relative error of the estimated range, at most 1 each",
    "pose_error": "distance of the estimated from the true position of the other robots [m], plus heading error [rad]",
    "visibility": "share of the targets seen, over the samples of the action",
    "collision": "1 where the robot touched something during the action",
    "blocked": "share of the action's samples in which the shield held the robot",
    "effort": "mean of the squares of the action's entries",
}
"""Meaning of each term. Terms are positive quantities: costs take a negative weight."""

assert tuple(TERMS) == REWARD_TERMS
EXCITATION, DEPTH_INFO, POSE_INFO, DEPTH_ERROR, POSE_ERROR, VISIBILITY, COLLISION, BLOCKED, EFFORT = range(len(TERMS))


class Score(NamedTuple):
    """What the truth says about the last action and so far; C-contiguous arrays, N first."""

    bound: Any
    """(N, D, D) covariance of the bound (`kernels.information`)."""
    sighted: Any
    """(N, R, M) whether a target was measured since the start."""
    depth_information: Any
    """[nats] (N, R) mean over the targets of -log(range sd / 0.1 m)."""
    pose_information: Any
    """[nats] (N,) -log det(P)/6 of the relative pose of the first pair."""
    pose_covariance: Any
    """[m, m, rad] (N, 3, 3) the bound of the pose of robot B in {A}."""
    worst_sd: Any
    """[m, rad] (N, 2) bound's worst standard deviation: of range or position, and of heading."""
    depth_error: Any
    """[m] (N, R, M) estimated minus true range; infinite for points not known yet."""
    pose_error: Any
    """[m, rad] (N, P, 2) distance and angle between estimated and true pose."""
    terms: Any
    """(N, R, T) the terms of the reward."""


def make_score(config: EnvConfig, num_envs: int) -> Score:
    """Empty arrays."""
    n, r, m = num_envs, config.robots, config.targets
    d = 3 * (m + r - 1)
    return Score(
        bound=np.zeros((n, d, d)),
        sighted=np.zeros((n, r, m), np.bool_),
        depth_information=np.zeros((n, r)),
        pose_information=np.zeros(n),
        pose_covariance=np.zeros((n, 3, 3)),
        worst_sd=np.zeros((n, 2)),
        depth_error=np.zeros((n, r, m)),
        pose_error=np.zeros((n, r * (r - 1), 2)),
        terms=np.zeros((n, r, len(TERMS))),
    )


def weights(config: EnvConfig) -> NDArray[np.float64]:
    """(T,) weight of each term."""
    chosen = config.reward_weights
    return np.array([chosen.get(name, 0.0) for name in TERMS])


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
def _measure(score, world, truth, known, work, n, k):
    """Take the images of sample k into the bound."""
    bound_measure(
        score.bound[n],
        work,
        score.sighted[n],
        truth.pose[n, k],
        world.points[n],
        known.camera_heights,
        truth.visible[n, k],
        known.image_sd,
        known.depth_sd,
        True,
    )


@kernel
def _informations(score, world, n):
    """Refresh information and worst standard deviations from the bound."""
    robots, count = world.pose.shape[1], world.points.shape[1]
    worst = 0.0
    for r in range(robots):
        score.depth_information[n, r] = depth_information(score.bound[n], world.pose[n], world.points[n], r)
    if robots == 1:
        for i in range(count):
            worst = max(worst, range_variance(score.bound[n], world.pose[n], world.points[n], 0, i))
        score.worst_sd[n, 0] = math.sqrt(worst)
        score.worst_sd[n, 1] = 0.0
        return
    score.pose_information[n] = pose_information(score.bound[n], count, 1)
    covariance = score.pose_covariance[n]
    pose_covariance(score.bound[n], count, world.pose[n], 0, 1, covariance)
    score.worst_sd[n, 0] = math.sqrt(max(covariance[0, 0], covariance[1, 1]))
    score.worst_sd[n, 1] = math.sqrt(covariance[2, 2])


@kernel
def _errors(score, world, estimate, pairs, n):
    """Refresh the true errors of what is estimated."""
    for r in range(world.pose.shape[1]):
        for i in range(world.points.shape[1]):
            d_x = world.points[n, i, 0] - world.pose[n, r, 0]
            d_y = world.points[n, i, 1] - world.pose[n, r, 1]
            if estimate.known[n, r, i]:
                found = 1.0 / max(estimate.points[n, r, i, 2], 1e-6)
                score.depth_error[n, r, i] = found - math.sqrt(d_x * d_x + d_y * d_y)
            else:
                score.depth_error[n, r, i] = math.inf
    for p in range(pairs.shape[0]):
        a, b = world.pose[n, pairs[p, 0]], world.pose[n, pairs[p, 1]]
        x, y, theta = relative(a[0], a[1], a[2], b[0], b[1], b[2])
        d_x, d_y = estimate.pose[n, p, 0] - x, estimate.pose[n, p, 1] - y
        score.pose_error[n, p, 0] = math.sqrt(d_x * d_x + d_y * d_y)
        score.pose_error[n, p, 1] = abs(wrap_angle(estimate.pose[n, p, 2] - theta))


@kernel
def start_score(score_, world_, first_truth_, estimate_, known_, pairs, work, rows):
    """Start the bound of new episodes from the priors and their first images."""
    score, world, truth = Score(*score_), World(*world_), Truth(*first_truth_)
    estimate, known = Estimate(*estimate_), Known(*known_)
    for n in rows:
        bound_reset(score.bound[n], score.sighted[n], world.pose[n], known.pose_sd, 0.0, UNSEEN_SD)
        _measure(score, world, truth, known, work, n, 0)
        _informations(score, world, n)
        _errors(score, world, estimate, pairs, n)
        score.terms[n] = 0.0


@kernel
def score_action(
    score_, world_, samples_, truth_, estimate_, known_, actions, weights_, reward, params_, robots, pairs, work, rows
):
    """Score one action: carry the bound over its samples, compute every term and the reward of each robot.

    Args:
        actions: [-] (N, R, 2) what was done.
        weights_: (T,) weight of each term.
        reward: (N, R) written.
        work: (2, D) scratch of the bound.
        rows: environments that moved.
    """
    score, world, samples, truth = Score(*score_), World(*world_), Samples(*samples_), Truth(*truth_)
    estimate, known, dt = Estimate(*estimate_), Known(*known_), params_[0].dt
    block, count, others = samples.period.shape[1], world.points.shape[1], robots.shape[0] - 1
    for n in rows:
        for k in range(block):
            bound_move(
                score.bound[n],
                work,
                truth.pose[n, k],
                world.points[n],
                truth.velocity[n, k],
                dt,
                known.speed_sd,
                known.turn_sd,
            )
            _measure(score, world, truth, known, work, n, k)
        pose_before = score.pose_information[n]
        for r in range(robots.shape[0]):
            score.terms[n, r, DEPTH_INFO] = -score.depth_information[n, r]
        _informations(score, world, n)
        _errors(score, world, estimate, pairs, n)
        for r in range(robots.shape[0]):
            terms = score.terms[n, r]
            terms[DEPTH_INFO] += score.depth_information[n, r]
            terms[POSE_INFO] = score.pose_information[n] - pose_before if others > 0 else 0.0
            terms[EXCITATION], terms[VISIBILITY] = _seen(world, samples, truth, known.camera_heights[r], n, r, dt)
            total = 0.0
            for i in range(count):
                d_x = world.points[n, i, 0] - world.pose[n, r, 0]
                d_y = world.points[n, i, 1] - world.pose[n, r, 1]
                error = score.depth_error[n, r, i]
                share = abs(error) / math.sqrt(d_x * d_x + d_y * d_y)
                total += min(1.0, share)
            terms[DEPTH_ERROR] = total / count
            total = 0.0
            for p in range(pairs.shape[0]):
                if pairs[p, 0] == r:
                    total += score.pose_error[n, p, 0] + score.pose_error[n, p, 1]
            terms[POSE_ERROR] = total
            terms[COLLISION] = 1.0 if world.collided[n, r] else 0.0
            terms[BLOCKED] = world.blocked[n, r] / block
            terms[EFFORT] = 0.5 * (actions[n, r, 0] * actions[n, r, 0] + actions[n, r, 1] * actions[n, r, 1])
            total = 0.0
            for j in range(weights_.shape[0]):
                total += weights_[j] * terms[j]
            reward[n, r] = total


@kernel
def _seen(world, samples, truth, height, n, r, dt):
    """(least excitation over the targets, share of targets seen) over the samples of the action, for robot r."""
    block, count = samples.period.shape[1], world.points.shape[1]
    least, sights = math.inf, 0
    for i in range(count):
        total = 0.0
        for k in range(block):
            if samples.seen[n, k, r, i]:
                sights += 1
                cos, sin = math.cos(truth.pose[n, k, r, 2]), math.sin(truth.pose[n, k, r, 2])
                d_x = world.points[n, i, 0] - truth.pose[n, k, r, 0]
                d_y = world.points[n, i, 1] - truth.pose[n, k, r, 1]
                chi = 1.0 / (cos * d_x + sin * d_y)
                x, y = (sin * d_x - cos * d_y) * chi, (height - world.points[n, i, 2]) * chi
                total += excitation(x, y, truth.velocity[n, k, r, 0], truth.velocity[n, k, r, 1]) * dt
        least = min(least, total)
    return least, sights / (block * count)
