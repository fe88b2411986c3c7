"""Planar motion of a robot: exact arcs, and poses seen from one another.

A robot's velocity over a step is constant, u = (v, l, w): forward, lateral (left) and yaw rate. A differential drive
has l = 0; recorded velocities may not. Poses are (x, y, theta), theta counter-clockwise.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined
from relloc_env.kernels.elementary import sin_cos


@inlined
def wrap_angle(angle):
    """Return `angle` [rad] wrapped into [-pi, pi)."""
    return angle - 2.0 * math.pi * np.floor((angle + math.pi) / (2.0 * math.pi))


@inlined
def sinc(a):
    """Return sin(a)/a, by its series near zero (error below 1e-18)."""
    sin, _ = sin_cos(a)
    return 1.0 - a * a / 6.0 if abs(a) < 1e-4 else sin / a


@inlined
def arc(v, lateral, w, dt):
    """Exact displacement over a step with constant velocity, in the body frame at its start.

    c = dt sinc(w dt/2) R(w dt/2) [v, l],  delta = w dt   ([RMDA19] eq. 1 integrated; docs/equations.md, section 2).

    Args:
        v: [m/s] forward speed.
        lateral: [m/s] speed to the left.
        w: [rad/s] yaw rate, counter-clockwise.
        dt: [s] length of the step.

    Returns:
        (c_x, c_y, delta): [m, m, rad] chord and turn.
    """
    half = 0.5 * w * dt
    sin, cos = sin_cos(half)
    length = dt * (1.0 - half * half / 6.0 if abs(half) < 1e-4 else sin / half)
    return length * (v * cos - lateral * sin), length * (v * sin + lateral * cos), w * dt


@inlined
def advance(x, y, theta, v, lateral, w, dt):
    """Pose after a step of `dt` along the exact arc; theta is not wrapped. World frame [m, m, rad]."""
    c_x, c_y, delta = arc(v, lateral, w, dt)
    sin, cos = sin_cos(theta)
    return x + cos * c_x - sin * c_y, y + sin * c_x + cos * c_y, theta + delta


@inlined
def relative(x_a, y_a, theta_a, x_b, y_b, theta_b):
    """Pose of B in {A}: r = R(theta_A)^T (r_B - r_A), theta = theta_B - theta_A wrapped ([RMDA19] eq. 2)."""
    sin, cos = sin_cos(theta_a)
    d_x, d_y = x_b - x_a, y_b - y_a
    return cos * d_x + sin * d_y, -sin * d_x + cos * d_y, wrap_angle(theta_b - theta_a)


@inlined
def move_point(q_x, q_y, c_x, c_y, delta):
    """A static point in the body frame after the body moved by chord `c` and turn `delta`: R(-delta) (q - c)."""
    sin, cos = sin_cos(delta)
    d_x, d_y = q_x - c_x, q_y - c_y
    return cos * d_x + sin * d_y, -sin * d_x + cos * d_y
