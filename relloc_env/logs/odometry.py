"""Velocities between the samples of a log, from commands or from recorded poses."""

import math
from itertools import pairwise

import numpy as np

from relloc_env.kernels import dead_reckoning
from relloc_env.samples import Float, Float32

GRID = 0.01
"""[s] between the poses that are smoothed."""


def dead_reckon(time: Float, velocity: Float, at: Float) -> Float:
    """Poses [m, m, rad] (K, 3) at the times `at` (K,), from the first of them; see `kernels.dead_reckoning`."""
    poses = np.zeros((len(at), 3))
    time, velocity, at = np.ascontiguousarray(time), np.ascontiguousarray(velocity), np.ascontiguousarray(at)
    dead_reckoning.dead_reckon(time, velocity, at, poses)
    return poses


def mean_velocity(poses: Float, period: Float) -> Float32:
    """Constant velocities (K, 3) that lead from each pose (K, 3), heading not wrapped, to the next."""
    velocity = np.zeros((len(poses), 3))
    dead_reckoning.mean_velocity(np.ascontiguousarray(poses), np.ascontiguousarray(period), velocity)
    return velocity.astype(np.float32)


def smooth_poses(time: Float, poses: Float, at: Float, width: float) -> Float:
    """Poses (K, 3) at the times `at`, by a line fitted to the recorded ones with a Gaussian window.

    Args:
        time: [s] (T,) increasing. poses: [m, m, rad] (T, 3), any heading. at: [s] (K,).
        width: [s] standard deviation of the window.
    """
    values = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    grid = np.arange(time[0], time[-1] + GRID, GRID)
    even = np.column_stack([np.interp(grid, time, values[:, j]) for j in range(3)])
    if width > 0.0:
        reach = round(4.0 * width / GRID)
        window = np.exp(-0.5 * (np.arange(-reach, reach + 1) * GRID / width) ** 2)
        window /= window.sum()
        padded = np.concatenate([2 * even[:1] - even[reach:0:-1], even, 2 * even[-1:] - even[-2 : -reach - 2 : -1]])
        even = np.column_stack([np.convolve(padded[:, j], window, mode="valid") for j in range(3)])
    return np.column_stack([np.interp(at, grid, even[:, j]) for j in range(3)])


def count_times(frames: Float, longest: float) -> float:
    """Return the number of times that `fill_times` makes of the same frames, at no cost."""
    return 1.0 + float(np.maximum(1.0, np.ceil(np.diff(frames) / longest - 1e-9)).sum())


def fill_times(frames: Float, longest: float) -> Float:
    """Sample times: the frames (sorted, distinct) with steps between them so that none lasts over `longest` [s]."""
    parts = [frames[:1]]
    for a, b in pairwise(frames):
        steps = max(1, math.ceil((b - a) / longest - 1e-9))
        parts.append(np.append(a + (b - a) * np.arange(1, steps) / steps, b))  # the frame itself to the last bit
    return np.concatenate(parts)
