"""Velocities between the samples of a log: exact arcs composed, and the constant velocity that gives the same arc."""

import math

import numpy as np

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import advance, relative, sinc
from relloc_env.samples import Float, Float32


@kernel
def arc_velocity(c_x, c_y, delta, dt):
    """Constant velocity whose exact arc over `dt` is chord `c` and turn `delta`: the inverse of `motion.arc`.

    [v, l] = R(-delta/2) c / (dt sinc(delta/2)),  w = delta/dt   (|delta| < 2 pi).

    Returns:
        (v, lateral, w): [m/s, m/s, rad/s].
    """
    half = 0.5 * delta
    cos, sin = math.cos(half), math.sin(half)
    scale = 1.0 / (dt * sinc(half))
    return (cos * c_x + sin * c_y) * scale, (-sin * c_x + cos * c_y) * scale, delta / dt


@kernel
def _dead_reckon(time, velocity, at, poses):
    x, y, theta = 0.0, 0.0, 0.0
    now = at[0]
    i = 0
    while i + 1 < time.shape[0] and time[i + 1] <= now:
        i += 1
    for k in range(at.shape[0]):
        while now < at[k]:
            end = at[k]
            moving = now >= time[0]
            if not moving:
                end = min(end, time[0])
            elif i + 1 < time.shape[0]:
                end = min(end, time[i + 1])
            if moving:
                x, y, theta = advance(x, y, theta, velocity[i, 0], velocity[i, 1], velocity[i, 2], end - now)
            now = end
            while i + 1 < time.shape[0] and time[i + 1] <= now:
                i += 1
        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, theta


def dead_reckon(time: Float, velocity: Float, at: Float) -> Float:
    """Poses at the times `at`, from the first of them, with each velocity held until the next one.

    Args:
        time: [s] (T,) not decreasing; at rest before the first.
        velocity: [m/s, m/s, rad/s] (T, 3) forward, lateral, yaw rate from `time` on.
        at: [s] (K,) not decreasing.

    Returns:
        [m, m, rad] (K, 3), heading not wrapped; (0, 0, 0) first.
    """
    poses = np.zeros((len(at), 3))
    _dead_reckon(np.ascontiguousarray(time), np.ascontiguousarray(velocity), np.ascontiguousarray(at), poses)
    return poses


@kernel
def _mean_velocity(poses, period, out):
    for k in range(1, poses.shape[0]):
        if period[k] > 0.0:
            a, b = poses[k - 1], poses[k]
            c_x, c_y, _ = relative(a[0], a[1], a[2], b[0], b[1], b[2])
            out[k, 0], out[k, 1], out[k, 2] = arc_velocity(c_x, c_y, b[2] - a[2], period[k])


def mean_velocity(poses: Float, period: Float) -> Float32:
    """Constant velocities (K, 3) that lead from each pose (K, 3; heading not wrapped) to the next over `period` (K,)."""
    out = np.zeros((len(poses), 3))
    _mean_velocity(np.ascontiguousarray(poses), np.ascontiguousarray(period), out)
    return out.astype(np.float32)


def smooth_poses(time: Float, poses: Float, at: Float, width: float) -> Float:
    """Poses (K, 3) at the times `at`, by a line fitted to the recorded ones with a Gaussian window.

    Args:
        time: [s] (T,) increasing. poses: [m, m, rad] (T, 3), any heading. at: [s] (K,).
        width: [s] standard deviation of the window.
    """
    values = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    grid = np.arange(time[0], time[-1] + 0.01, 0.01)
    even = np.column_stack([np.interp(grid, time, values[:, j]) for j in range(3)])
    if width > 0.0:
        reach = round(4.0 * width / 0.01)
        window = np.exp(-0.5 * (np.arange(-reach, reach + 1) * 0.01 / width) ** 2)
        window /= window.sum()
        padded = np.concatenate([2 * even[:1] - even[reach:0:-1], even, 2 * even[-1:] - even[-2 : -reach - 2 : -1]])
        even = np.column_stack([np.convolve(padded[:, j], window, mode="valid") for j in range(3)])
    return np.column_stack([np.interp(at, grid, even[:, j]) for j in range(3)])


def fill_times(frames: Float, longest: float) -> Float:
    """Sample times: the frames (sorted, distinct) with steps between them so that none lasts over `longest` [s]."""
    parts = [frames[:1]]
    for a, b in zip(frames[:-1], frames[1:], strict=True):
        steps = max(1, math.ceil((b - a) / longest - 1e-9))
        parts.append(a + (b - a) * np.arange(1, steps + 1) / steps)
    return np.concatenate(parts)
