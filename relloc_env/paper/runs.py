"""Runs of the paper's scenarios: one simulation, and any number of estimators that see what its robots measure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.estimators import CascadeConfig, make
from relloc_env.kernels import motion
from relloc_env.samples import Bool, Float, Samples
from relloc_env.simulation import Simulation

DURATION = 40.0
"""[s] of every run: the paper's experiment lasts about as long."""
EXPERIMENT = ((0.1, 0.02), (0.1, -0.03))
"""[m/s, rad/s] inputs of robots A and B in the paper's experiment."""
PAPER_GAINS = (2.5, 120.0)
"""H [1/s] and αΛ [1/m²] of the paper's experiment."""
CONVERGED = 0.1
"""[m] a depth has converged once its error stays below this."""

_relative = np.vectorize(motion.relative)


@dataclass(frozen=True)
class Track:
    """Errors of one estimator over a run (estimate less truth)."""

    depth: Float
    """[m] (N, T, R, M) error of the depth."""
    pose: Float
    """[m, m, rad] (N, T, P, 3) error of the relative pose."""
    pose_covariance: Float
    """(N, T, P, 3, 3) covariance that the estimator claims for it."""

    @property
    def position(self) -> Float:
        """[m] (N, T, P) distance between the true and the estimated position."""
        return np.hypot(self.pose[..., 0], self.pose[..., 1])

    @property
    def heading(self) -> Float:
        """[deg] (N, T, P) size of the error of the heading."""
        return np.degrees(np.abs(self.pose[..., 2]))


@dataclass(frozen=True)
class Run:
    """What happened, and what the estimators made of it."""

    time: Float
    """[s] (T,)"""
    robots: Float
    """[m, m, rad] (N, T, R, 3) true poses in the world."""
    targets: Float
    """[m] (M, 3) in the world."""
    image: Float
    """[-] (N, T, R, M, 2) measured image coordinates."""
    depth: Float
    """[m] (N, T, R, M) true depths."""
    seen: Bool
    """(N, T, R, M)"""
    tracks: dict[str, Track]
    """By the name of the estimator's configuration."""


def simulate(
    config: EnvConfig,
    velocities: Sequence[tuple[float, float]],
    estimators: Mapping[str, CascadeConfig],
    *,
    num_envs: int = 1,
    seed: int = 0,
    depth_error: float | None = None,
    pose_error: Sequence[float] | None = None,
) -> Run:
    """Drive the robots at constant velocity for 40 s and run every estimator on the same samples.

    Args:
        config: fixed poses and points; one sample per action.
        velocities: [m/s, rad/s] forward speed and yaw rate of each robot.
        estimators: configurations by name.
        num_envs: number N of repetitions, which differ in their noise.
        seed: of the first repetition; the others follow.
        depth_error: [m] error of all depth guesses, signed; None for what the configuration says.
        pose_error: [m, m, rad] error of all pose guesses, signed; None for what the configuration says.
    """
    steps = round(DURATION * config.sample_rate)
    simulation = Simulation(config, num_envs)
    rows = np.arange(num_envs)
    simulation.seed(rows, [seed + n for n in range(num_envs)])
    simulation.reset(rows)
    limits = [(config.robot_of(r).max_speed, config.robot_of(r).max_yaw_rate) for r in range(config.robots)]
    actions = np.tile(np.array(velocities) / np.array(limits), (num_envs, 1, 1))
    mounts = np.array([config.camera_of(r).mount_height for r in range(config.robots)])
    record = _Recorder(simulation, steps + 1, estimators, mounts)
    record.start(depth_error, pose_error)
    for k in range(1, steps + 1):
        simulation.step(actions, rows)
        record.sample(k, simulation.samples)
    return record.run(config.sample_period)


class _Recorder:
    """Feeds samples to the estimators and keeps truth and estimates."""

    def __init__(
        self, simulation: Simulation, length: int, estimators: Mapping[str, CascadeConfig], mounts: Float
    ) -> None:
        self._simulation, self._mounts = simulation, mounts
        n, r, m = simulation.num_envs, simulation.config.robots, simulation.config.targets
        p = len(simulation.pairs)
        self._rows = np.arange(n)
        self._poses = np.zeros((n, length, r, 3))
        self._image = np.zeros((n, length, r, m, 2))
        self._seen = np.zeros((n, length, r, m), dtype=np.bool_)
        self._estimators = {name: make(one, n, r, m) for name, one in estimators.items()}
        self._depths = {name: np.zeros((n, length, r, m)) for name in estimators}
        self._pairs = {name: (np.zeros((n, length, p, 3)), np.zeros((n, length, p, 3, 3))) for name in estimators}

    def start(self, depth_error: float | None, pose_error: Sequence[float] | None) -> None:
        """Give the estimators their guesses and the first sample."""
        prior = self._simulation.prior
        poses = self._simulation.world.pose[:, None]
        if depth_error is not None:
            prior = prior._replace(depth=self._true_depth(poses)[:, 0] + depth_error)
        if pose_error is not None:
            prior = prior._replace(pose=self._true_pose(poses)[:, 0] + np.array(pose_error))
        for estimator in self._estimators.values():
            estimator.reset(prior, self._rows)
        self.sample(0, self._simulation.first)

    def sample(self, k: int, samples: Samples) -> None:
        """Take one sample in."""
        self._poses[:, k] = self._simulation.world.pose
        self._image[:, k], self._seen[:, k] = samples.image[:, 0], samples.seen[:, 0]
        for name, estimator in self._estimators.items():
            estimator.update(samples, self._rows)
            estimate = estimator.estimate
            self._depths[name][:, k] = np.cos(estimate.points[..., 0]) / estimate.points[..., 2]
            mean, covariance = self._pairs[name]
            mean[:, k], covariance[:, k] = estimate.pose, estimate.pose_covariance

    def run(self, period: float) -> Run:
        """Compare with the truth."""
        depth, pose = self._true_depth(self._poses), self._true_pose(self._poses)
        tracks = {}
        for name, (mean, covariance) in self._pairs.items():
            error = mean - pose
            error[..., 2] = (error[..., 2] + math.pi) % (2.0 * math.pi) - math.pi
            tracks[name] = Track(self._depths[name] - depth, error, covariance)
        time: Float = period * np.arange(self._poses.shape[1], dtype=np.float64)
        points = self._simulation.world.points[0].copy()
        return Run(time, self._poses, points, self._image, depth, self._seen, tracks)

    def _true_depth(self, poses: Float) -> Float:
        points = self._simulation.world.points[:, None, None]
        offset = points[..., :2] - poses[..., None, :2]
        heading = poses[..., None, 2]
        depth: Float = np.cos(heading) * offset[..., 0] + np.sin(heading) * offset[..., 1]
        return depth

    def _true_pose(self, poses: Float) -> Float:
        pairs = self._simulation.pairs
        if not len(pairs):
            return np.zeros((*poses.shape[:2], 0, 3))
        a, b = poses[:, :, pairs[:, 0]], poses[:, :, pairs[:, 1]]
        pose: Float = np.stack(_relative(*np.moveaxis(a, -1, 0), *np.moveaxis(b, -1, 0)), axis=-1)
        return pose


def settle_time(time: Float, error: Float, limit: float = CONVERGED) -> float:
    """[s] when |error| (T,) falls below `limit` for good, between samples by linear interpolation; inf if never."""
    size = np.abs(error)
    above = np.flatnonzero(~(size < limit))
    if above.size == 0:
        return 0.0
    last = int(above[-1])
    if last == len(time) - 1:
        return math.inf
    share = (size[last] - limit) / (size[last] - size[last + 1])
    return float(time[last] + share * (time[last + 1] - time[last]))


def pose_settle_time(time: Float, track: Track, pair: int, position: float = 0.2, heading: float = 5.0) -> float:
    """[s] when the errors of position [m] and heading [deg] fall below their limits for good, in the first run."""
    return max(
        settle_time(time, track.position[0, :, pair], position), settle_time(time, track.heading[0, :, pair], heading)
    )
