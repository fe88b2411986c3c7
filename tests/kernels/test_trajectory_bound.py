"""The recursive bound against the information of a whole trajectory, all its unknowns at once in one dense matrix."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from relloc_env.metrics import trajectory_bound

Float = NDArray[np.float64]
STEP, STEPS = 0.1, 25
IMAGE_SD, SPEED_SD, TURN_SD, UNSEEN_SD = 0.002, 0.01, 0.02, 30.0
POSE_SD = np.array([1.5, 1.5, np.pi / 3.0])
HEIGHTS = np.array([0.2, 0.25])
POINTS = np.array([[4.0, 0.9, 0.4], [5.0, -1.2, 0.7], [3.5, -0.2, 0.1]])


class Priors(NamedTuple):
    height: float | None
    scale: tuple[float, float] | None


def turned(angle: float, vector: Float) -> Float:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])


def drive(start: Float, velocity: Float) -> Float:
    """Poses (K, 3) along arcs, by their chords."""
    poses = [start]
    for v, lateral, w in velocity[1:]:
        x, y, theta = poses[-1]
        half = 0.5 * w * STEP
        chord = STEP * np.sinc(half / np.pi) * turned(theta + half, np.array([v, lateral]))
        poses.append(np.array([x + chord[0], y + chord[1], theta + w * STEP]))
    return np.array(poses)


def unpack(unknown: Float) -> tuple[Float, Float, float, Float, Float]:
    """Pose of B and points in A's first frame, height difference, scales (2, 2), slips of the odometry (2, K, 2)."""
    pose, points, height, scales, slips = np.split(unknown, [3, 12, 13, 17])
    return pose, points.reshape(3, 3), float(height[0]), scales.reshape(2, 2), slips.reshape(2, STEPS, 2)


def paths(unknown: Float, velocity: Float) -> tuple[Float, Float]:
    """What A and B, at `velocity` (K, 2, 3), drive in A's first frame if the unknowns are so."""
    pose, _, _, scales, slips = unpack(unknown)
    ways = []
    for robot, start in ((0, np.zeros(3)), (1, pose)):
        u = velocity[:, robot] * scales[robot, [0, 0, 1]]
        u[:, ::2] += slips[robot]
        ways.append(drive(start, u))
    return ways[0], ways[1]


def views(unknown: Float, velocity: Float) -> Float:
    """(K, 2, 3, 3) depth and image (x, y) of each point for each robot."""
    _, points, height, _, _ = unpack(unknown)
    found = np.zeros((STEPS, 2, 3, 3))
    for robot, way in enumerate(paths(unknown, velocity)):
        d = points[None, :, :2] - way[:, None, :2]
        cos, sin = np.cos(way[:, None, 2]), np.sin(way[:, None, 2])
        depth, left = cos * d[..., 0] + sin * d[..., 1], cos * d[..., 1] - sin * d[..., 0]
        up = points[:, 2] - robot * height
        found[:, robot] = np.stack([depth, -left / depth, -up / depth], axis=-1)
    return found


def relative(unknown: Float, velocity: Float, k: int, observer: int) -> Float:
    both = [way[k] for way in paths(unknown, velocity)]
    a, b = both[observer], both[1 - observer]
    return np.array([*turned(-a[2], b[:2] - a[:2]), b[2] - a[2]])


def jacobian(function, at: Float) -> Float:
    columns = [(function(at + e) - function(at - e)) / 2e-5 for e in 1e-5 * np.eye(len(at))]
    return np.stack([np.ravel(column) for column in columns], axis=1)


@pytest.mark.parametrize(
    "priors", [Priors(None, None), Priors(0.03, None), Priors(None, (0.02, 0.05)), Priors(0.03, (0.02, 0.05))], ids=str
)
def test_the_bound_is_the_inverse_of_the_information_of_all_that_is_unknown(priors: Priors) -> None:
    """25 samples, 2 robots, 3 points, a third of the images missed: 17 unknown constants and 100 slips of odometry."""
    rng = np.random.default_rng(5)
    velocity = rng.normal(0.0, [0.3, 0.1, 0.3], (STEPS, 2, 3))
    velocity[0] = 0.0
    start = np.array([0.3, -1.0, 0.2])
    truth = np.concatenate([start, (POINTS - [0.0, 0.0, HEIGHTS[0]]).ravel(), HEIGHTS[1:] - HEIGHTS[0], np.ones(4)])
    truth = np.concatenate([truth, np.zeros(2 * STEPS * 2)])
    visible = rng.random((STEPS, 2, 3)) < 0.67

    nearly_known = 1e-7
    spread = np.concatenate([POSE_SD, np.full(9, UNSEEN_SD), [priors.height or nearly_known]])
    spread = np.concatenate([spread, np.tile(priors.scale or (nearly_known, nearly_known), 2)])
    spread = np.concatenate([spread, np.tile([SPEED_SD, TURN_SD], 2 * STEPS)])
    rows = jacobian(lambda z: views(z, velocity), truth).reshape(STEPS, 2, 3, 3, -1)
    information = np.diag(spread**-2.0)
    for k, robot, i in np.argwhere(visible):
        image = rows[k, robot, i, 1:] / IMAGE_SD
        information += image.T @ image
        if not visible[:k, robot, i].any():
            information += np.outer(rows[k, robot, i, 0], rows[k, robot, i, 0])

    ways = np.stack(paths(truth, velocity), axis=1)
    bound = trajectory_bound(
        np.r_[0.0, np.full(STEPS - 1, STEP)], ways, POINTS, velocity, visible, HEIGHTS,
        image_sd=IMAGE_SD, speed_sd=SPEED_SD, turn_sd=TURN_SD, pose_sd=POSE_SD, unseen_sd=UNSEEN_SD,
        height_sd=priors.height, scale_sd=priors.scale,
    )  # fmt: skip
    for observer in (0, 1):
        to_pose = jacobian(lambda z, o=observer: relative(z, velocity, STEPS - 1, o), truth)
        expected = to_pose @ np.linalg.solve(information, to_pose.T)
        sd = np.sqrt(np.diag(expected))
        assert_allclose(bound.pose[-1, observer] / np.outer(sd, sd), expected / np.outer(sd, sd), atol=1e-6)
