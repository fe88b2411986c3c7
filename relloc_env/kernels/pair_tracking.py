"""The pose of one robot in another's frame between alignments: motion, and messages that come late.

A pair's anchor is the newest stamp at which the observer knows both maps: with late messages it lies in the past, and
the maps of that sample are taken from a ring of the last W. The pose now is the anchor's, carried forward by the
observer's own odometry and by the last velocity heard of the other robot.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.local_map import arc_jacobian
from relloc_env.kernels.map_tracking import motion_of, velocity_variance
from relloc_env.kernels.motion import arc, wrap_angle

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]


class Pairs(NamedTuple):
    """Ordered pairs (observer, observed), P of them. Poses are [m, m, rad], of the observed in the observer's frame."""

    prior: Float
    """(N, P, 3) initial guess carried to the anchor: predicted, never updated."""
    prior_covariance: Float
    """(N, P, 3, 3)."""
    mode: Float
    """(N, P, 3) optimum at the anchor."""
    second: Float
    """(N, P, 3) another optimum that is nearly as good, at the anchor."""
    has_second: Bool
    """(N, P)."""
    anchored: Float
    """(N, P, 3) what is believed at the anchor."""
    anchored_covariance: Float
    """(N, P, 3, 3)."""
    pose: Float
    """(N, P, 3) what is believed now."""
    pose_covariance: Float
    """(N, P, 3, 3)."""
    heard: Float
    """(N, P, 3) velocity of the observed robot in its newest message."""
    silence: Int
    """(N, P) samples since that message was made; W before the first one."""
    age: Int
    """(N, P) samples since the anchor; -1 before the first one."""
    pending: Bool
    """(N, P) whether the anchor has moved since the last alignment."""
    since_grid: Float
    """(N, P) [s] since the pose last came from a grid of headings."""
    when: Int
    """(N, P) sample of the last alignment, counted from the start; -1 before."""
    aligned: Bool
    """(N, P) whether there was any alignment yet."""
    turn: Int
    """(N, P) number of alignments so far; says where the next challenger starts."""


@kernel
def carry_mean(pose, v_a, l_a, w_a, v_b, l_b, w_b, dt):
    """Move a relative pose (3,) in place by both robots' motion: r⁺ = R(-d_a)(r + R(theta) c_b - c_a)."""
    a_x, a_y, d_a = arc(v_a, l_a, w_a, dt)
    b_x, b_y, d_b = arc(v_b, l_b, w_b, dt)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    d_x = pose[0] + cos * b_x - sin * b_y - a_x
    d_y = pose[1] + sin * b_x + cos * b_y - a_y
    cos, sin = math.cos(d_a), math.sin(d_a)
    pose[0], pose[1] = cos * d_x + sin * d_y, -sin * d_x + cos * d_y
    pose[2] = wrap_angle(pose[2] + d_b - d_a)


@kernel
def carry(pose, covariance, v_a, l_a, w_a, v_b, l_b, w_b, dt, var_a, var_b, work):
    """Move a relative pose and its covariance by both robots' motion ([RMDA19] eq. 3, over an exact arc).

    Args:
        pose, covariance: (3,), (3, 3), changed in place.
        v_a, l_a, w_a, v_b, l_b, w_b: [m/s, m/s, rad/s] velocities of observer and observed.
        dt: [s] length of the step.
        var_a, var_b: variances of the two velocities, (speed, lateral, yaw rate) each.
        work: (≥ 3, ≥ 3) scratch.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    b_x, b_y, _ = arc(v_b, l_b, w_b, dt)
    m_x, m_y = cos * b_x - sin * b_y, sin * b_x + cos * b_y
    d_a = w_a * dt
    turn_c, turn_s = math.cos(d_a), math.sin(d_a)
    # F = [[R(-d_a), R(-d_a) J m], [0, 1]] on the covariance.
    f_x, f_y = -turn_c * m_y + turn_s * m_x, turn_s * m_y + turn_c * m_x
    for j in range(3):
        p, q, t = covariance[0, j], covariance[1, j], covariance[2, j]
        work[0, j] = turn_c * p + turn_s * q + f_x * t
        work[1, j] = -turn_s * p + turn_c * q + f_y * t
        work[2, j] = t
    for i in range(3):
        p, q, t = work[i, 0], work[i, 1], work[i, 2]
        covariance[i, 0] = turn_c * p + turn_s * q + f_x * t
        covariance[i, 1] = -turn_s * p + turn_c * q + f_y * t
        covariance[i, 2] = t
    carry_mean(pose, v_a, l_a, w_a, v_b, l_b, w_b, dt)
    chords_a, chords_b = arc_jacobian(v_a, l_a, w_a, dt), arc_jacobian(v_b, l_b, w_b, dt)
    for source in range(6):
        kind = source % 3
        if source < 3:
            c_x, c_y, variance = -chords_a[2 * kind], -chords_a[2 * kind + 1], var_a[kind]
            turn = -dt if kind == 2 else 0.0
            g_x, g_y = turn_c * c_x + turn_s * c_y, -turn_s * c_x + turn_c * c_y
            g_x, g_y = g_x - turn * pose[1], g_y + turn * pose[0]
        else:
            e_x, e_y, variance = chords_b[2 * kind], chords_b[2 * kind + 1], var_b[kind]
            turn = dt if kind == 2 else 0.0
            c_x, c_y = cos * e_x - sin * e_y, sin * e_x + cos * e_y
            g_x, g_y = turn_c * c_x + turn_s * c_y, -turn_s * c_x + turn_c * c_y
        covariance[0, 0] += variance * g_x * g_x
        covariance[1, 1] += variance * g_y * g_y
        covariance[2, 2] += variance * turn * turn
        covariance[0, 1] += variance * g_x * g_y
        covariance[0, 2] += variance * g_x * turn
        covariance[1, 2] += variance * g_y * turn
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = covariance[0, 1], covariance[0, 2], covariance[1, 2]


@kernel
def move_anchor(maps, pairs, options, n, p, a, b, work):
    """Move a pair's anchor on by one sample, by the odometry of both robots."""
    window = maps.state.shape[1]
    pairs.age[n, p] -= 1
    slot = (maps.cursor[n] - pairs.age[n, p]) % window
    dt = maps.motion[n, slot, a, 0]
    if dt == 0.0:
        return
    v_a, l_a, w_a = motion_of(maps, n, slot, a)
    v_b, l_b, w_b = motion_of(maps, n, slot, b)
    var_a, var_b = velocity_variance(options, dt, v_a, l_a, w_a), velocity_variance(options, dt, v_b, l_b, w_b)
    carry(pairs.prior[n, p], pairs.prior_covariance[n, p], v_a, l_a, w_a, v_b, l_b, w_b, dt, var_a, var_b, work)
    anchored, covariance = pairs.anchored[n, p], pairs.anchored_covariance[n, p]
    carry(anchored, covariance, v_a, l_a, w_a, v_b, l_b, w_b, dt, var_a, var_b, work)
    carry_mean(pairs.mode[n, p], v_a, l_a, w_a, v_b, l_b, w_b, dt)
    if pairs.has_second[n, p]:
        carry_mean(pairs.second[n, p], v_a, l_a, w_a, v_b, l_b, w_b, dt)


@kernel
def keep_pair(maps, pairs, options, n, p, a, b, arrived, work):
    """Account for one sample in a pair: move the anchor to the newest message.

    Args:
        maps, pairs, options: see there.
        n, p, a, b: environment, pair, observer and observed.
        arrived: (bits) j-th set where the message made j samples ago arrives now.
        work: (≥ 3, ≥ 3) scratch.

    Returns:
        Whether a newer message than all before was heard.
    """
    window = maps.state.shape[1]
    pairs.age[n, p] += 1
    pairs.silence[n, p] += 1
    newest = -1
    for j in range(min(window, pairs.silence[n, p])):
        if (arrived >> np.uint64(j)) & np.uint64(1):
            newest = j
            break
    heard = 0 <= newest <= pairs.age[n, p]
    if heard:
        pairs.silence[n, p] = newest
        slot = (maps.cursor[n] - newest) % window
        v, lateral, w = motion_of(maps, n, slot, b)
        pairs.heard[n, p, 0], pairs.heard[n, p, 1], pairs.heard[n, p, 2] = v, lateral, w
    # Without a message the anchor still moves, quietly, before the ring loses its sample.
    target = newest if heard else window - 1
    pairs.pending[n, p] = heard or (pairs.pending[n, p] and pairs.age[n, p] <= target)
    while pairs.age[n, p] > target:
        move_anchor(maps, pairs, options, n, p, a, b, work)
    return heard


@kernel
def show_pose(maps, pairs, options, n, p, a, renewed, work):
    """Bring a pair's pose to now: from the anchor where that was `renewed`, else from the sample before."""
    steps = 1
    if renewed:
        steps = pairs.age[n, p]
        for i in range(3):
            pairs.pose[n, p, i] = pairs.anchored[n, p, i]
            for j in range(3):
                pairs.pose_covariance[n, p, i, j] = pairs.anchored_covariance[n, p, i, j]
    window = maps.state.shape[1]
    for back in range(steps - 1, -1, -1):
        slot = (maps.cursor[n] - back) % window
        dt = maps.motion[n, slot, a, 0]
        if dt == 0.0:
            continue
        v_a, l_a, w_a = motion_of(maps, n, slot, a)
        v_b, l_b, w_b = pairs.heard[n, p, 0], pairs.heard[n, p, 1], pairs.heard[n, p, 2]
        var_a, var_b = velocity_variance(options, dt, v_a, l_a, w_a), velocity_variance(options, dt, v_b, l_b, w_b)
        # A change of velocity lasts: displacement grows with the time unheard, not with its root.
        growth = 2.0 * (pairs.silence[n, p] - back) - 1.0
        unheard = (
            var_b[0] + growth * options.unheard_speed_variance,
            var_b[1],
            var_b[2] + growth * options.unheard_yaw_variance,
        )
        carry(pairs.pose[n, p], pairs.pose_covariance[n, p], v_a, l_a, w_a, v_b, l_b, w_b, dt, var_a, unheard, work)


@kernel
def invert_pose(pose, covariance, inverse, inverse_covariance):
    """Pose of A in B's frame from that of B in A's: r' = -R(theta)ᵀ r, theta' = -theta, with its covariance.

    Args:
        pose, covariance: (3,), (3, 3).
        inverse, inverse_covariance: the same, written; not the same arrays.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y = -cos * pose[0] - sin * pose[1], sin * pose[0] - cos * pose[1]
    inverse[0], inverse[1], inverse[2] = x, y, -pose[2]
    # d(r') = -Rᵀ dr - J r' dtheta, the rows below.
    for i in range(3):
        f_x, f_y, f_t = 0.0, 0.0, -1.0
        if i == 0:
            f_x, f_y, f_t = -cos, -sin, y
        elif i == 1:
            f_x, f_y, f_t = sin, -cos, -x
        h_x = f_x * covariance[0, 0] + f_y * covariance[1, 0] + f_t * covariance[2, 0]
        h_y = f_x * covariance[0, 1] + f_y * covariance[1, 1] + f_t * covariance[2, 1]
        h_t = f_x * covariance[0, 2] + f_y * covariance[1, 2] + f_t * covariance[2, 2]
        inverse_covariance[i, 0] = -cos * h_x - sin * h_y + y * h_t
        inverse_covariance[i, 1] = sin * h_x - cos * h_y - x * h_t
        inverse_covariance[i, 2] = -h_t
