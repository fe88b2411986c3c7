"""Recorded velocities joined to poses by exact arcs, and the constant velocity that gives the same arc."""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import advance, relative, sinc


@kernel
def arc_velocity(c_x, c_y, delta, dt):
    """Constant velocity whose exact arc over `dt` is chord `c` and turn `delta`: the inverse of `motion.arc`.

    [v, l] = R(-delta/2) c / (dt sinc(delta/2)),  w = delta/dt

    Args:
        c_x, c_y: [m] chord, body frame at the start.
        delta: [rad] turn, within ±2 pi.
        dt: [s] length of the step, above 0.

    Returns:
        (v, lateral, w): [m/s, m/s, rad/s].
    """
    half = 0.5 * delta
    cos, sin = math.cos(half), math.sin(half)
    scale = 1.0 / (dt * sinc(half))
    return (cos * c_x + sin * c_y) * scale, (-sin * c_x + cos * c_y) * scale, delta / dt


@kernel
def dead_reckon(time, velocity, at, poses):
    """Poses at the times `at`, from the first of them on, with each velocity held until the next one.

    Args:
        time: [s] (T,) not decreasing; at rest before the first.
        velocity: [m/s, m/s, rad/s] (T, 3) forward, lateral (left), yaw rate from `time` on.
        at: [s] (K,) not decreasing.
        poses: [m, m, rad] (K, 3) result, in the body frame at at[0]; the heading is not wrapped.
    """
    x, y, theta = 0.0, 0.0, 0.0
    now = at[0]
    i = -1
    for k in range(at.shape[0]):
        while now < at[k]:
            while i + 1 < time.shape[0] and time[i + 1] <= now:
                i += 1
            end = at[k]
            if i + 1 < time.shape[0]:
                end = min(end, time[i + 1])
            if i >= 0:
                x, y, theta = advance(x, y, theta, velocity[i, 0], velocity[i, 1], velocity[i, 2], end - now)
            now = end
        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, theta


@kernel
def mean_velocity(poses, period, velocity):
    """Constant velocities that lead from each pose to the next along one arc.

    Args:
        poses: [m, m, rad] (K, 3), the heading not wrapped.
        period: [s] (K,) time since the pose before; 0 leaves the velocity at 0.
        velocity: [m/s, m/s, rad/s] (K, 3) result; row 0 is left as it is.
    """
    for k in range(1, poses.shape[0]):
        if period[k] > 0.0:
            a, b = poses[k - 1], poses[k]
            c_x, c_y, _ = relative(a[0], a[1], a[2], b[0], b[1], b[2])
            v, lateral, w = arc_velocity(c_x, c_y, b[2] - a[2], period[k])
            velocity[k, 0], velocity[k, 1], velocity[k, 2] = v, lateral, w
