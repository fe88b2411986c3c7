"""What a robot observes: named fields of one flat vector, written by one kernel.

A field is added in two places of this file, in the same order: its name and bounds in `fields`, its numbers in the
kernel. Values beyond the bounds are clipped; a point that is not seen, or not known yet, reads as zeros.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig
from relloc_env.envs.onboard import BARE_POINT, FAR, IMAGE, MOTION, POINT, bounded
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.elementary import log, sin_cos
from relloc_env.kernels.lanes import W, natural, workspace

LAYOUT = 1
"""Version of what the fields hold: another number where one of them changes its meaning or its size."""


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
    if config.observation == "image":
        width, height = config.image_size
        return [Field("picture", (3, height, width), 0.0, 255.0, "what the camera sees: red, green, blue")]
    m, k, others = config.targets, config.samples_per_action, config.robots - 1
    bare = config.estimator is None
    own = [
        Field("last_action", (2,), -1.0, 1.0, "the action before, speed and yaw rate"),
        Field("time", (1,), 0.0, 1.0, "share of the episode that is over"),
        Field("dead_reckoning", (MOTION,), -FAR, FAR, "x, y [m], sin and cos of the heading since the start"),
        Field("bumper", (1,), 0.0, 1.0, "1 where something was touched during the action"),
        Field("blocked", (1,), 0.0, 1.0, "share of the action during which the shield held the robot"),
    ]
    if config.gain_names:
        own.append(Field("gains", (m, len(config.gain_names)), -1.0, 1.0, "of each point's observer, as set last"))
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


def places(config: EnvConfig, targets: int) -> NDArray[np.int64]:
    """Where the numbers of one robot's flat observation stand in that of an environment with more targets.

    The others are zeros there, as of points that were never seen.
    """
    found, start = [], 0
    for small, large in zip(fields(config), fields(config.model_copy(update={"targets": targets})), strict=True):
        within = np.ravel_multi_index(tuple(np.indices(small.shape)), large.shape)
        found.append(start + within.ravel())
        start += large.size
    return np.concatenate(found)


def bounds(config: EnvConfig) -> tuple[Any, Any]:
    """Return float32 (D,) least and greatest values of one robot's observation."""
    low = [np.full(field.size, field.low, np.float32) for field in fields(config)]
    high = [np.full(field.size, field.high, np.float32) for field in fields(config)]
    return np.concatenate(low), np.concatenate(high)


# Workspace of `observe`, in lanes: a pose, its covariance, and what is written of them.
_THETA, _COVARIANCE, _SIN, _COS, _LOG_SD, _CORRELATION, _LOG_DET = (k * W for k in (0, 1, 7, 8, 9, 12, 15))
_WORK = 16


@kernel
def _pose(t, width):
    """Sine and cosine of a heading; log standard deviations, correlations and log determinant of its covariance."""
    for i in range(width):
        c = i + _COVARIANCE
        t[i + _SIN], t[i + _COS] = sin_cos(t[i + _THETA])
        x, y, theta = max(t[c], 1e-16), max(t[c + 3 * W], 1e-16), max(t[c + 5 * W], 1e-16)
        xy, xt, yt = t[c + W] / np.sqrt(x * y), t[c + 2 * W] / np.sqrt(x * theta), t[c + 4 * W] / np.sqrt(y * theta)
        log_x, log_y, log_t = log(x), log(y), log(theta)
        t[i + _LOG_SD], t[i + _LOG_SD + W] = bounded(0.5 * log_x, 20.0), bounded(0.5 * log_y, 20.0)
        t[i + _LOG_SD + 2 * W] = bounded(0.5 * log_t, 20.0)
        inner_part = 1.0 + 2.0 * xy * xt * yt - xy * xy - xt * xt - yt * yt
        t[i + _CORRELATION], t[i + _CORRELATION + W] = bounded(xy, 1.0), bounded(xt, 1.0)
        t[i + _CORRELATION + 2 * W] = bounded(yt, 1.0)
        t[i + _LOG_DET] = bounded(log_x + log_y + log_t + log(max(inner_part, 1e-12)), 60.0)


@kernel
def observe(
    out, period, odometry, image, seen, arrived, pose, pose_covariance, ticks, outbox, inbox, inbox_tick, window,
    bumps, blocked, last_action, elapsed, gains, pairs, limits, rows, bare, width,
):  # fmt: skip
    """Write the observation of every robot into `out` float32 (N, R, D).

    Args:
        period, ..., arrived: `Samples`.
        pose, pose_covariance: of `Estimate`.
        ticks, outbox, inbox, inbox_tick: of `Memory`, flat; the newest of the outbox is what a robot knows itself.
        window: W of `Memory`.
        bumps: (N R) whether something was touched during the action.
        blocked: (N R) samples of the action in which the shield held the robot.
        last_action: [-] (N R 2).
        elapsed: (N,) actions since the start.
        gains: [-] (N, R, G) as the action set them, shares of their bounds; G = 0 where it sets none.
        pairs: (P, 2) ordered pairs.
        limits: (2,) actions in an episode, sample period [s].
        rows: environments to work on.
        bare: whether there is no estimator; then the whole block of samples is shown.
        width: lanes of a block.
    """
    robots, count, block, length = seen.shape[2], seen.shape[3], period.shape[1], out.shape[2]
    others = robots - 1
    size = count * (BARE_POINT if bare else POINT)
    own = 3 + MOTION + 2 + gains.shape[2]
    told = own + (block * (4 + 3 * count) if bare else size)
    rest = told + others * (1 + MOTION + size)
    line = out.ravel()
    for row in rows:
        n = natural(row)
        shown = 1 if elapsed[n] == 0 else block  # after a reset one sample was taken: it stands last
        slot = ticks[n] % window if window > 1 else 0
        time = min(elapsed[n] / limits[0], 1.0)
        for r in range(robots):
            robot = natural(n * robots + r)
            at, source = natural(robot * length), natural((robot * window + slot) * (size + MOTION))
            line[at], line[at + 1], line[at + 2] = last_action[2 * robot], last_action[2 * robot + 1], time
            for j in range(MOTION):
                line[at + 3 + j] = outbox[source + size + j]
            line[at + 3 + MOTION] = 1.0 if bumps[robot] else 0.0
            line[at + 4 + MOTION] = blocked[robot] / block
            for j in range(gains.shape[2]):
                line[at + 5 + MOTION + j] = gains[n, r, j]
            if bare:
                _block(out, own, period, odometry, image, seen, n, r, shown)
            else:
                for j in range(size):
                    line[at + own + j] = outbox[source + j]
        for p in range(pairs.shape[0]):
            r, o = pairs[p, 0], pairs[p, 1] - (1 if pairs[p, 1] > pairs[p, 0] else 0)
            pair, at = natural(n * pairs.shape[0] + p), natural((n * robots + r) * length + told)
            source = natural(pair * (size + MOTION))
            age = bounded((ticks[n] - inbox_tick[pair]) * limits[1], FAR)
            line[at + o] = age if inbox_tick[pair] >= 0 else FAR
            at = natural(at + others)
            for j in range(MOTION):
                line[at + o * MOTION + j] = inbox[source + size + j]
            at = natural(at + others * MOTION + o * size)
            for j in range(size):
                line[at + j] = inbox[source + j]
            if bare:
                _arrivals(out, rest, arrived, n, r, p, o, others, window, block, shown)
    if not bare:
        _poses(line, robots, length, rest, others, pose.ravel(), pose_covariance.ravel(), pairs, rows, width)


@kernel
def _poses(out, robots, length, rest, others, pose, covariance, pairs, rows, width):
    """Write the estimated poses of the other robots."""
    t, count = workspace(_WORK, width), pairs.shape[0]
    for begin in range(0, rows.shape[0], W):
        end = min(begin + W, rows.shape[0])
        for p in range(count):
            r, o = pairs[p, 0], pairs[p, 1] - (1 if pairs[p, 1] > pairs[p, 0] else 0)
            for j in range(begin, end):
                i, pair = j - begin, natural(rows[j] * count + p)
                at, c = 9 * pair, _COVARIANCE + i
                t[_THETA + i] = pose[3 * pair + 2]
                t[c], t[c + W], t[c + 2 * W] = covariance[at], covariance[at + 1], covariance[at + 2]
                t[c + 3 * W], t[c + 4 * W], t[c + 5 * W] = covariance[at + 4], covariance[at + 5], covariance[at + 8]
            _pose(t, width)
            for j in range(begin, end):
                i, pair = j - begin, natural(rows[j] * count + p)
                at = natural((rows[j] * robots + r) * length + rest)
                to = at + 4 * o
                out[to], out[to + 1] = bounded(pose[3 * pair], FAR), bounded(pose[3 * pair + 1], FAR)
                out[to + 2], out[to + 3] = t[_SIN + i], t[_COS + i]
                log_sd, correlation = at + 4 * others + 3 * o, at + 7 * others + 3 * o
                for d in range(3):
                    out[log_sd + d], out[correlation + d] = t[_LOG_SD + d * W + i], t[_CORRELATION + d * W + i]
                out[at + 10 * others + o] = t[_LOG_DET + i]


@kernel
def _arrivals(out, at, arrived, n, r, p, o, others, window, block, shown):
    """Write which messages of another robot arrived with each sample."""
    for k in range(block):
        for age in range(window):
            bit = (arrived[n, k, p] >> np.uint64(age)) & np.uint64(1)
            out[n, r, at + (k * others + o) * window + age] = 1.0 if k >= block - shown and bit else 0.0


@kernel
def _block(out, at, period, odometry, images, sights, n, r, shown):
    """Write the block of samples of robot r."""
    block, count = period.shape[1], sights.shape[3]
    image, seen = at + block, at + block + 2 * block * count
    velocity = seen + block * count
    for k in range(block):
        valid = k >= block - shown
        out[n, r, at + k] = 1.0 if valid else 0.0
        for i in range(count):
            sight = valid and sights[n, k, r, i]
            out[n, r, seen + k * count + i] = 1.0 if sight else 0.0
            for j in range(2):
                value = images[n, k, r, i, j] if sight else np.float32(0.0)
                out[n, r, image + 2 * (k * count + i) + j] = bounded(value, IMAGE)
        for j in range(3):
            out[n, r, velocity + 3 * k + j] = bounded(odometry[n, k, r, j], FAR) if valid else 0.0
