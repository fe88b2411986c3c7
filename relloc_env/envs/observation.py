"""What a robot observes: named fields of one flat vector, written by one kernel.

A field is added in two places of this file, in the same order: its name and bounds in `fields`, its numbers in the
kernel. Values beyond the bounds are clipped; a point that is not seen, or not known yet, reads as zeros.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.envs.onboard import BARE_POINT, FAR, IMAGE, MOTION, POINT, Memory, bounded, write_motion, write_point
from relloc_env.kernels._compile import kernel
from relloc_env.samples import Estimate, Samples


class Field(NamedTuple):
    """A named part of the observation."""

    name: str
    shape: tuple[int, ...]
    low: float
    high: float
    meaning: str

    @property
    def size(self) -> int:
        """Count of its numbers."""
        return math.prod(self.shape)


def fields(config: EnvConfig) -> list[Field]:
    """Return the fields of one robot's observation, in order."""
    m, k, others = config.targets, config.samples_per_action, config.robots - 1
    bare = config.estimator is None
    own = [
        Field("last_action", (2,), -1.0, 1.0, "the action before, speed and yaw rate"),
        Field("time", (1,), 0.0, 1.0, "share of the episode that is over"),
        Field("dead_reckoning", (MOTION,), -FAR, FAR, "x, y [m], sin and cos of the heading since the start"),
        Field("bumper", (1,), 0.0, 1.0, "1 where something was touched during the action"),
        Field("blocked", (1,), 0.0, 1.0, "share of the action during which the shield held the robot"),
    ]
    told = [
        Field("message_age", (others,), 0.0, FAR, "[s] age of the newest message of each other robot"),
        Field("message_motion", (others, MOTION), -FAR, FAR, "its dead reckoning"),
    ]
    if bare:
        own += [
            Field("valid", (k,), 0.0, 1.0, "1 for samples taken: all, or the last alone after a reset"),
            Field("image", (k, m, 2), -IMAGE, IMAGE, "image points, normalised; 0 where not seen"),
            Field("seen", (k, m), 0.0, 1.0, "1 where a point is seen"),
            Field("velocity", (k, 3), -FAR, FAR, "odometry: forward, left [m/s], yaw rate [rad/s]"),
        ]
        told += [
            Field("message_points", (others, m, BARE_POINT), -IMAGE, IMAGE, "seen, x, y of each point, as told"),
            Field("arrived", (k, others, config.message_window), 0.0, 1.0, "1 where a message of this age arrived"),
        ]
        return own + (told if others else [])
    own += [
        Field("points", (m, POINT), -IMAGE, IMAGE, _POINT_MEANING),
    ]
    told += [
        Field("message_points", (others, m, POINT), -IMAGE, IMAGE, "the same, as the other robot told it"),
        Field("pose", (others, 4), -FAR, FAR, "estimated x, y [m], sin and cos of the heading of the other robot"),
        Field("pose_log_sd", (others, 3), -20.0, 20.0, "log of the standard deviations [m, m, rad]"),
        Field("pose_correlation", (others, 3), -1.0, 1.0, "correlations xy, x theta, y theta"),
        Field("pose_log_det", (others,), -60.0, 60.0, "log of the determinant of the covariance"),
    ]
    return own + (told if others else [])


_POINT_MEANING = (
    "of each point: seen, measured x, y (0 if unseen); estimated sin and cos of the bearing, elevation, inverse range "
    "[1/m], log of the relative standard deviation of the range"
)


def slices(config: EnvConfig) -> dict[str, slice]:
    """Return where each field is in one robot's flat observation."""
    where, start = {}, 0
    for field in fields(config):
        where[field.name] = slice(start, start + field.size)
        start += field.size
    return where


def bounds(config: EnvConfig) -> tuple[Any, Any]:
    """Return float32 (D,) least and greatest values of one robot's observation."""
    low = [np.full(field.size, field.low, np.float32) for field in fields(config)]
    high = [np.full(field.size, field.high, np.float32) for field in fields(config)]
    return np.concatenate(low), np.concatenate(high)


@kernel
def _pose(out, at, estimate, n, p):
    """Write the estimate of the other robot's pose and its covariance, for one pair; returns (places) filled."""
    out[at] = bounded(estimate.pose[n, p, 0], FAR)
    out[at + 1] = bounded(estimate.pose[n, p, 1], FAR)
    out[at + 2] = math.sin(estimate.pose[n, p, 2])
    out[at + 3] = math.cos(estimate.pose[n, p, 2])


@kernel
def _pose_covariance(out, log_sd, correlation, log_det, cov):
    """Write log standard deviations, correlations and log determinant of a 3 x 3 covariance."""
    a, b, c = max(cov[0, 0], 1e-16), max(cov[1, 1], 1e-16), max(cov[2, 2], 1e-16)
    out[log_sd] = 0.5 * math.log(a)
    out[log_sd + 1] = 0.5 * math.log(b)
    out[log_sd + 2] = 0.5 * math.log(c)
    ab, ac, bc = cov[0, 1] / math.sqrt(a * b), cov[0, 2] / math.sqrt(a * c), cov[1, 2] / math.sqrt(b * c)
    out[correlation] = bounded(ab, 1.0)
    out[correlation + 1] = bounded(ac, 1.0)
    out[correlation + 2] = bounded(bc, 1.0)
    inner = 1.0 + 2.0 * ab * ac * bc - ab * ab - ac * ac - bc * bc
    out[log_det] = bounded(math.log(a) + math.log(b) + math.log(c) + math.log(max(inner, 1e-12)), 60.0)


@kernel
def observe(out, samples_, estimate_, onboard_, bumps, blocked, pairs, last_action, elapsed, limits, rows, bare):
    """Write the observation of every robot into `out` float32 (N, R, D).

    Args:
        bumps: (N, R) whether something was touched during the action.
        blocked: (N, R) samples of the action in which the shield held the robot.
        last_action: [-] (N, R, 2).
        elapsed: (N,) actions since the start.
        limits: (2,) actions in an episode, sample period [s].
        bare: whether there is no estimator; then the whole block of samples is shown.
    """
    samples, estimate, onboard = Samples(*samples_), Estimate(*estimate_), Memory(*onboard_)
    robots, count = samples.seen.shape[2], samples.seen.shape[3]
    block, others = samples.period.shape[1], robots - 1
    last = block - 1
    window = onboard.outbox.shape[2]
    for n in rows:
        shown = 1 if elapsed[n] == 0 else block  # after a reset one sample was taken: it stands last
        for r in range(robots):
            line = out[n, r]
            line[0] = last_action[n, r, 0]
            line[1] = last_action[n, r, 1]
            line[2] = min(elapsed[n] / limits[0], 1.0)
            at = write_motion(line, 3, onboard.dead_reckoning[n, r])
            line[at] = 1.0 if bumps[n, r] else 0.0
            line[at + 1] = blocked[n, r] / block
            at += 2
            if bare:
                at = _block(line, at, samples, n, r, shown)
            else:
                for i in range(count):
                    at = write_point(line, at, samples, estimate, n, last, r, i, False)
            o = 0
            for p in range(pairs.shape[0]):
                if pairs[p, 0] != r:
                    continue
                told = onboard.inbox[n, p]
                size = told.shape[0] - MOTION
                heard = onboard.inbox_tick[n, p] >= 0
                line[at + o] = bounded((onboard.tick[n] - onboard.inbox_tick[n, p]) * limits[1], FAR) if heard else FAR
                motion = at + others + o * MOTION
                points = at + others * (1 + MOTION) + o * size
                for j in range(MOTION):
                    line[motion + j] = told[size + j]
                for j in range(size):
                    line[points + j] = told[j]
                rest = at + others * (1 + MOTION + size)
                if bare:
                    for k in range(block):
                        valid = k >= block - shown
                        for age in range(window):
                            bit = (samples.arrived[n, k, p] >> np.uint64(age)) & np.uint64(1)
                            line[rest + (k * others + o) * window + age] = 1.0 if valid and bit else 0.0
                else:
                    _pose(line, rest + 4 * o, estimate, n, p)
                    _pose_covariance(
                        line,
                        rest + 4 * others + 3 * o,
                        rest + 7 * others + 3 * o,
                        rest + 10 * others + o,
                        estimate.pose_covariance[n, p],
                    )
                o += 1


@kernel
def _block(line, at, samples, n, r, shown):
    """Write the block of samples of robot r; returns the place after it."""
    block, count = samples.period.shape[1], samples.seen.shape[3]
    image, seen = at + block, at + block + 2 * block * count
    velocity = seen + block * count
    for k in range(block):
        valid = k >= block - shown
        line[at + k] = 1.0 if valid else 0.0
        for i in range(count):
            sight = valid and samples.seen[n, k, r, i]
            line[seen + k * count + i] = 1.0 if sight else 0.0
            for j in range(2):
                value = samples.image[n, k, r, i, j] if sight else np.float32(0.0)
                line[image + 2 * (k * count + i) + j] = bounded(value, IMAGE)
        for j in range(3):
            line[velocity + 3 * k + j] = samples.odometry[n, k, r, j] if valid else 0.0
    return velocity + 3 * block
