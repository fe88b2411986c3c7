"""The information bound along a log whose noise is known: what any estimator's errors can be held against."""

import numpy as np

from relloc_env.bound import pack_known
from relloc_env.logs.odometry import mean_velocity
from relloc_env.logs.source import Log
from relloc_env.metrics import TrajectoryBound, trajectory_bound
from relloc_env.replay.settings import environment_of

BOUND = "root mean square of the pose's error (one robot: of the last depths') whitened by the bound; 1 is at the bound"
"""What the ratio of error and bound is."""
NEEDS = (
    "the bound needs the truth, white noise of stated size, known camera heights and odometry scales; logs of this "
    "package's environments have them, those of real robots do not"
)
"""Why there is no bound for other logs."""


def bound_of(log: Log) -> TrajectoryBound | None:
    """Bound along the truth of a simulated log, with the log's own priors; None where noise or truth are not known.

    Camera heights and the scales of the odometry count as known, and every image of every robot as told at once.
    """
    config, truth = environment_of(log), log.truth
    if config is None or truth is None or not (np.isfinite(truth.poses).all() and np.isfinite(truth.points).all()):
        return None
    known, period = pack_known(config), log.samples.period[0]
    poses = truth.poses.copy()
    poses[..., 2] = np.unwrap(poses[..., 2], axis=0)
    velocity = np.stack([mean_velocity(poses[:, r], period) for r in range(len(log.robots))], axis=1).astype(np.float64)
    return trajectory_bound(
        period,
        truth.poses,
        truth.points,
        velocity,
        log.samples.seen[0],
        known.camera_heights,
        image_sd=known.image_sd,
        speed_sd=known.speed_sd,
        turn_sd=known.turn_sd,
        depth_sd=log.prior.depth_sd,
        pose_sd=log.prior.pose_sd,
    )
