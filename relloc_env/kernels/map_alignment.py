"""The map-alignment estimator, sample by sample: local maps, messages, and the pose of each ordered pair.

A pair's anchor is the newest stamp at which both maps are known to the observer: with late messages it lies in the past,
and the maps of that sample are taken from a ring of the last W. The pose now is the anchor's, carried forward by the
observer's own odometry and by the last velocity heard of the other robot.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.alignment import (
    Problem,
    load_maps,
    load_prior,
    make_problem,
    minimise,
    pose_covariance,
    start_at,
    start_from_heading,
)
from relloc_env.kernels.local_map import arc_jacobian, depth_prior, map_correct, map_enter, map_forget, map_predict
from relloc_env.kernels.motion import arc, wrap_angle

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]


class Maps(NamedTuple):
    """Local maps: N environments, a ring of W samples, R robots, M points, D numbers a map."""

    state: Float
    """(N, W, R, D)."""
    covariance: Float
    """(N, W, R, D, D)."""
    known: Bool
    """(N, W, R, M) which points are in the map."""
    motion: Float
    """(N, W, R, 4) length of the interval before the sample [s], and the measured velocity over it."""
    cursor: Int
    """(N,) place of the newest sample in the ring."""
    ticks: Int
    """(N,) samples since the start."""
    rejected: Int
    """(N, R, M) how often in a row the gate refused the point."""
    unseen: Float
    """(N, R, M) [s] since the point was last accepted."""
    depth: Float
    """(N, R, M) [m] guess of the depth at first sight."""
    depth_sd: Float
    """(N,) [m] its standard deviation."""


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
    aligned: Bool
    """(N, P) whether there was any alignment yet."""
    turn: Int
    """(N, P) number of alignments so far; says where the next challenger starts."""


class Options(NamedTuple):
    """Numbers of the configuration; see `estimators.config.MapAlignmentConfig`."""

    image_variance: float
    speed_variance: float
    lateral_variance: float
    yaw_variance: float
    noise_period: float
    gate: float
    bearing_gate: float
    most_rejections: int
    forget_after: float
    rho: float
    rho_variance: float
    height_sd: float
    every: int
    challenger_every: int
    iterations: int
    tolerance: float
    unheard_speed_variance: float
    unheard_yaw_variance: float


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
    b_x, b_y, d_b = arc(v_b, l_b, w_b, dt)
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
def velocity_variance(options, dt):
    """Variances of (speed, lateral speed, yaw rate) measured over an interval of `dt`."""
    scale = options.noise_period / dt if options.noise_period > 0.0 and dt > 0.0 else 1.0
    return scale * options.speed_variance, scale * options.lateral_variance, scale * options.yaw_variance


@kernel
def observe(maps, options, n, dt, odometry, image, seen, work):
    """Take one sample into the local maps of environment n: predict, then correct with each seen point.

    Args:
        maps, options: see there.
        n: the environment.
        dt: [s] length of the interval before the sample.
        odometry, image, seen: (R, 3), (R, M, 2), (R, M) what the robots measured.
        work: (≥ D, ≥ 3) scratch.
    """
    robots, points = seen.shape
    old, window = maps.cursor[n], maps.state.shape[1]
    now = (old + 1) % window
    maps.cursor[n] = now
    var_v, var_l, var_w = velocity_variance(options, dt)
    for r in range(robots):
        state, covariance, known = maps.state[n, now, r], maps.covariance[n, now, r], maps.known[n, now, r]
        if window > 1:
            for i in range(state.shape[0]):
                state[i] = maps.state[n, old, r, i]
                for j in range(state.shape[0]):
                    covariance[i, j] = maps.covariance[n, old, r, i, j]
            for i in range(points):
                known[i] = maps.known[n, old, r, i]
        v, lateral, w = float(odometry[r, 0]), float(odometry[r, 1]), float(odometry[r, 2])
        motion = maps.motion[n, now, r]
        motion[0], motion[1], motion[2], motion[3] = dt, v, lateral, w
        if dt > 0.0:
            map_predict(state, covariance, known, v, lateral, w, dt, var_v, var_l, var_w, work)
        for i in range(points):
            if known[i]:
                maps.unseen[n, r, i] += dt
                if maps.unseen[n, r, i] > options.forget_after:
                    map_forget(state, covariance, known, i)
            if not seen[r, i]:
                continue
            x, y = float(image[r, i, 0]), float(image[r, i, 1])
            if known[i]:
                accepted, _ = map_correct(
                    state,
                    covariance,
                    points,
                    i,
                    x,
                    y,
                    w,
                    options.image_variance,
                    options.gate,
                    options.bearing_gate,
                    work,
                )
                if accepted:
                    maps.rejected[n, r, i] = 0
                    maps.unseen[n, r, i] = 0.0
                    continue
                maps.rejected[n, r, i] += 1
                if maps.rejected[n, r, i] < options.most_rejections:
                    continue
                rho, rho_variance = state[3 * i + 2], covariance[3 * i + 2, 3 * i + 2]
            elif options.rho_variance > 0.0:
                rho, rho_variance = options.rho, options.rho_variance
            else:
                rho, rho_variance = depth_prior(x, maps.depth[n, r, i], maps.depth_sd[n])
            map_enter(state, covariance, known, i, x, y, w, options.image_variance, rho, rho_variance)
            maps.rejected[n, r, i] = 0
            maps.unseen[n, r, i] = 0.0


@kernel
def scaled_motion(maps, n, slot, r):
    """(v, l, w) of a robot in one sample of the ring, by its own estimate of the odometry's scale."""
    state, motion = maps.state[n, slot, r], maps.motion[n, slot, r]
    first = 3 * maps.known.shape[3]
    if state.shape[0] > first:
        k_v, k_w = state[first], state[first + 1]
        return k_v * motion[1], k_v * motion[2], k_w * motion[3]
    return motion[1], motion[2], motion[3]


@kernel
def move_anchor(maps, pairs, options, n, p, a, b, work):
    """Move a pair's anchor on by one sample, by the odometry of both robots."""
    window = maps.state.shape[1]
    pairs.age[n, p] -= 1
    slot = (maps.cursor[n] - pairs.age[n, p]) % window
    dt = maps.motion[n, slot, a, 0]
    if dt == 0.0:
        return
    v_a, l_a, w_a = scaled_motion(maps, n, slot, a)
    v_b, l_b, w_b = scaled_motion(maps, n, slot, b)
    variance = velocity_variance(options, dt)
    carry(
        pairs.prior[n, p], pairs.prior_covariance[n, p], v_a, l_a, w_a, v_b, l_b, w_b, dt, variance, variance, work
    )
    anchored, covariance = pairs.anchored[n, p], pairs.anchored_covariance[n, p]
    carry(anchored, covariance, v_a, l_a, w_a, v_b, l_b, w_b, dt, variance, variance, work)
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
        v, lateral, w = scaled_motion(maps, n, slot, b)
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
        v_a, l_a, w_a = scaled_motion(maps, n, slot, a)
        v_b, l_b, w_b = pairs.heard[n, p, 0], pairs.heard[n, p, 1], pairs.heard[n, p, 2]
        variance = velocity_variance(options, dt)
        # A change of velocity lasts: displacement grows with the time unheard, not with its root.
        growth = 2.0 * (pairs.silence[n, p] - back) - 1.0
        unheard = (
            variance[0] + growth * options.unheard_speed_variance,
            variance[1],
            variance[2] + growth * options.unheard_yaw_variance,
        )
        carry(
            pairs.pose[n, p], pairs.pose_covariance[n, p], v_a, l_a, w_a, v_b, l_b, w_b, dt, variance, unheard, work
        )


@kernel
def mix(mean, covariance, other, other_covariance, weight):
    """Moment-match two Gaussians over a pose into the first; `weight` is that of the other."""
    d_x, d_y, d_t = other[0] - mean[0], other[1] - mean[1], wrap_angle(other[2] - mean[2])
    spread = weight * (1.0 - weight)
    for i in range(3):
        for j in range(3):
            d_i = d_x if i == 0 else (d_y if i == 1 else d_t)
            d_j = d_x if j == 0 else (d_y if j == 1 else d_t)
            covariance[i, j] = (
                (1.0 - weight) * covariance[i, j] + weight * other_covariance[i, j] + spread * d_i * d_j
            )
    mean[0], mean[1], mean[2] = mean[0] + weight * d_x, mean[1] + weight * d_y, wrap_angle(mean[2] + weight * d_t)


LEAST_INVERSE_RANGE = 0.05
"""[1/m] points further than this count as that far where a start is sought."""
SECOND_COST = 12.0
"""[-] an optimum whose J is higher by less is kept as a second mode."""
SECOND_HEADING = 0.03
"""[rad] two optima whose headings differ by less are one."""


@kernel
def align_pair(maps, pairs, options, heights, problem, starts, n, p, a, b, work):
    """Align the maps of a pair at its anchor: from the optimum carried forward, from one challenger, from the second.

    Args:
        maps, pairs, options: see there.
        heights: (R,) [m] of the cameras.
        problem: the workspace of the alignment.
        starts: (≥ 2, 3 M + 4) scratch.
        n, p, a, b: environment, pair, observer and observed.
        work: (≥ 6, ≥ 3) scratch.
    """
    slot = (maps.cursor[n] - pairs.age[n, p]) % maps.state.shape[1]
    m = load_maps(
        problem,
        maps.state[n, slot, a],
        maps.covariance[n, slot, a],
        maps.known[n, slot, a],
        maps.state[n, slot, b],
        maps.covariance[n, slot, b],
        maps.known[n, slot, b],
    )
    if m <= 0:
        return
    difference = heights[b] - heights[a]
    if not load_prior(problem, difference, options.height_sd, pairs.prior[n, p], pairs.prior_covariance[n, p]):
        return
    unknowns, last = 3 * m + 4, 3 * m + 1
    mode, second, turn = pairs.mode[n, p], pairs.second[n, p], pairs.turn[n, p]
    pairs.turn[n, p] = turn + 1
    best, other = starts[0], starts[1]
    cov, other_cov = work[0:3, 0:3], work[3:6, 0:3]
    cost, log_det, rival_cost, rival_log_det = math.inf, 0.0, math.inf, 0.0
    for source in range(3):
        if source == 0:
            start_at(problem, m, mode, other)
        elif source == 1 and pairs.has_second[n, p]:
            start_at(problem, m, second, other)
        elif source == 2 and turn % options.challenger_every == 0:
            heading = pairs.prior[n, p, 2] + (turn // options.challenger_every % 12) * math.pi / 6.0
            start_from_heading(problem, m, heading, LEAST_INVERSE_RANGE, other)
        else:
            continue
        other_cost, other_log_det = minimise(problem, m, other, unknowns, options.iterations, options.tolerance)
        far = cost == math.inf or abs(wrap_angle(other[last + 2] - best[last + 2])) > SECOND_HEADING
        if other_cost < cost:
            # The challenger leads; the former leader, if another optimum, becomes the rival.
            if far and cost < rival_cost:
                rival_cost, rival_log_det = cost, log_det
                for i in range(3):
                    second[i] = best[last + i]
                    for j in range(3):
                        other_cov[i, j] = cov[i, j]
            cost, log_det = other_cost, other_log_det
            for i in range(unknowns):
                best[i] = other[i]
            pose_covariance(problem, m, cov)
        elif far and other_cost < rival_cost:
            rival_cost, rival_log_det = other_cost, other_log_det
            for i in range(3):
                second[i] = other[last + i]
            pose_covariance(problem, m, other_cov)
    if not cost < math.inf:
        return
    anchored, anchored_covariance = pairs.anchored[n, p], pairs.anchored_covariance[n, p]
    for i in range(3):
        mode[i] = anchored[i] = best[last + i]
        for j in range(3):
            anchored_covariance[i, j] = cov[i, j]
    pairs.has_second[n, p] = rival_cost - cost < SECOND_COST and (
        abs(wrap_angle(second[2] - mode[2])) > SECOND_HEADING
    )
    if pairs.has_second[n, p]:
        log_odds = 0.5 * (rival_cost - cost + rival_log_det - log_det)
        mix(anchored, anchored_covariance, second, other_cov, 1.0 / (1.0 + math.exp(min(log_odds, 700.0))))
    pairs.aligned[n, p] = True


@kernel
def take_samples(
    rows, period, odometry, image, seen, arrived, maps, pairs, options, ends, heights, problem, starts, work
):
    """Take all K samples of the environments `rows` in, in order.

    Args:
        rows: environments.
        period, odometry, image, seen, arrived: as `samples.Samples`.
        maps, pairs, options: what is remembered, and the numbers of the configuration.
        ends: (P, 2) observer and observed of each pair.
        heights: (R,) [m] of the cameras.
        problem, starts, work: scratch.
    """
    count = seen.shape[1]
    for index in range(rows.shape[0]):
        n = rows[index]
        for k in range(count):
            observe(maps, options, n, period[n, k], odometry[n, k], image[n, k], seen[n, k], work)
            due = k == count - 1 if options.every == 0 else maps.ticks[n] % options.every == 0
            maps.ticks[n] += 1
            for p in range(ends.shape[0]):
                a, b = ends[p, 0], ends[p, 1]
                renewed = keep_pair(maps, pairs, options, n, p, a, b, arrived[n, k, p], work)
                if due and pairs.pending[n, p]:
                    align_pair(maps, pairs, options, heights, problem, starts, n, p, a, b, work)
                    pairs.pending[n, p] = False
                    renewed = True
                show_pose(maps, pairs, options, n, p, a, renewed, work)


def scratch(points: int, size: int) -> tuple[Problem, Float, Float]:
    """Return the scratch that `take_samples` needs for maps of `size` numbers."""
    return make_problem(points), np.zeros((2, 3 * points + 4)), np.zeros((max(size, 6), 3))
