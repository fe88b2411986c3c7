"""The bound of two robots with 60 digits, from nothing but the equations: what the factors of the kernels must keep.

All unknowns of an episode are one vector: the pose of B and the points in A's first frame, and the slips of the
odometry of both robots at each sample where they have noise. Their information is a sum over the priors and the
measurements, differentiated by central differences whose steps are far below what matters; the covariance of what is
asked for at the end is H I⁻¹ Hᵀ. There is no recursion, and nothing that is shared with the kernels.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import mpmath
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
DIGITS = 60
_STEP = mpmath.mpf(10) ** -20
_STEPS = 2 * _STEP


class Task(NamedTuple):
    """What two robots do and see; numbers as in `relloc_env.metrics.trajectory_bound`."""

    start: Array
    """[m, m, rad] (2, 3) {W}"""
    points: Array
    """[m] (M, 3) {W}"""
    heights: Array
    """[m] (2,)"""
    velocity: Array
    """[m/s, rad/s] (K, 2, 2) over the interval before each sample; the first is not used."""
    visible: Array
    """(K, 2, M)"""
    period: float
    image_sd: float
    speed_sd: float
    turn_sd: float
    depth_sd: float
    pose_sd: tuple[float, float, float]
    unseen_sd: float


def arc(pose: Any, v: Any, w: Any, dt: Any) -> Any:
    """Pose at the end of an exact arc."""
    half = w * dt / 2
    length = v * dt * mpmath.sinc(half)
    x, y, theta = pose
    return x + length * mpmath.cos(theta + half), y + length * mpmath.sin(theta + half), theta + w * dt


def into(frame: Any, place: Any) -> Any:
    """Place (x, y) in the axes of a pose."""
    d_x, d_y, cos, sin = place[0] - frame[0], place[1] - frame[1], mpmath.cos(frame[2]), mpmath.sin(frame[2])
    return cos * d_x + sin * d_y, cos * d_y - sin * d_x


def unknowns(task: Task) -> tuple[list[Any], list[Any]]:
    """True values, and prior standard deviations, of everything that is not known."""
    a, b = ([mpmath.mpf(float(x)) for x in pose] for pose in task.start)
    truth = [*into(a, b), b[2] - a[2]]
    spread = [*task.pose_sd]
    for x, y, z in task.points:
        truth += [*into(a, (x, y)), mpmath.mpf(float(z)) - float(task.heights[0])]
        spread += 3 * [task.unseen_sd]
    slips = [sd for sd in (task.speed_sd, task.turn_sd) if sd > 0.0]
    count = 2 * (len(task.velocity) - 1)
    return truth + count * len(slips) * [mpmath.mpf(0)], spread + count * slips


def drive(task: Task, z: list[Any]) -> list[list[Any]]:
    """Poses (K, 2) in A's first frame if the unknowns are `z`."""
    slips = iter(z[3 + 3 * len(task.points) :])
    poses = [[(mpmath.mpf(0),) * 3, tuple(z[:3])]]
    for u in task.velocity[1:]:
        now = []
        for robot in range(2):
            v, w = (mpmath.mpf(float(x)) for x in u[robot])
            v += next(slips) if task.speed_sd > 0.0 else 0
            w += next(slips) if task.turn_sd > 0.0 else 0
            now.append(arc(poses[-1][robot], v, w, mpmath.mpf(task.period)))
        poses.append(now)
    return poses


def measured(task: Task, z: list[Any]) -> list[Any]:
    """Every measurement over its noise, images and the first guesses of depths, if the unknowns are `z`."""
    found, guessed = [], set()
    points = [z[3 + 3 * i : 6 + 3 * i] for i in range(len(task.points))]
    drop = mpmath.mpf(float(task.heights[1])) - float(task.heights[0])
    for poses, visible in zip(drive(task, z), task.visible, strict=True):
        for robot, i in np.argwhere(visible).tolist():
            depth, left = into(poses[robot], points[i])
            found += [-left / depth / task.image_sd, -(points[i][2] - robot * drop) / depth / task.image_sd]
            if (robot, i) not in guessed:
                guessed.add((robot, i))
                found.append(depth / task.depth_sd)
    return found


def asked(task: Task, z: list[Any]) -> list[Any]:
    """The pose of B in {A} and the ranges (2, M) at the end."""
    a, b = drive(task, z)[-1]
    points = [z[3 + 3 * i : 6 + 3 * i] for i in range(len(task.points))]
    ranges = [mpmath.hypot(*into(pose, point)) for pose in (a, b) for point in points]
    return [*into(a, b), b[2] - a[2], *ranges]


def rows(function: Callable[[list[Any]], list[Any]], z: list[Any]) -> Any:
    """Jacobian by central differences: with steps of 1e-20 of what is of order 1 it is right to 1e-40."""
    columns = []
    for k in range(len(z)):
        more, less = list(z), list(z)
        more[k] += _STEP
        less[k] -= _STEP
        columns.append([(p - m) / _STEPS for p, m in zip(function(more), function(less), strict=True)])
    return mpmath.matrix(columns).T


def exact(task: Task) -> tuple[float, list[float]]:
    """J of the pose after the last sample, and J of the depths of A and of B."""
    with mpmath.workdps(DIGITS):
        z, spread = unknowns(task)
        h = rows(lambda x: measured(task, x), z)
        information = h.T * h
        for k, sd in enumerate(spread):
            information[k, k] += mpmath.mpf(sd) ** -2
        to = rows(lambda x: asked(task, x), z)
        covariance = to * (information**-1) * to.T
        pose = -mpmath.log(mpmath.det(covariance[:3, :3])) / 6
        count = len(task.points)
        depths = []
        for robot in range(2):
            variances = [covariance[3 + robot * count + i, 3 + robot * count + i] for i in range(count)]
            depths.append(float(-sum(mpmath.log(v) for v in variances) / 2 / count + mpmath.log("0.1")))
        return float(pose), depths
