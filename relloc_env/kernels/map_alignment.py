"""The map-alignment estimator over a batch of environments: local maps, messages, and the pose of each ordered pair."""

import math

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.alignment import (
    Problem,
    load_maps,
    load_prior,
    make_problem,
    pose_covariance,
    start_at,
    start_from_heading,
)
from relloc_env.kernels.descent import minimise, settle
from relloc_env.kernels.heading_grid import COST, FIRST, heading_grid, make_nodes
from relloc_env.kernels.map_tracking import observe
from relloc_env.kernels.mirroring import find_back, mirror_pair
from relloc_env.kernels.motion import relative, wrap_angle
from relloc_env.kernels.pair_tracking import keep_pair, show_pose

Float = NDArray[np.float64]

LEAST_INVERSE_RANGE = 0.05
"""[1/m] points further than this count as that far where a start is sought."""
SECOND_COST = 12.0
"""[-] an optimum whose J is higher by less is kept as a second mode."""
SECOND_HEADING = 0.03
"""[rad] two optima whose headings differ by less are one."""
FIRST_CHALLENGERS = 6
"""Headings all around from which the first alignment is sought; later ones try another twelfth of the circle each."""
GRID_SD = 0.02
"""[rad] standard deviation of the heading above which the pose comes from a grid of headings."""


@kernel
def mix(mean, covariance, other, other_covariance, weight):
    """Moment-match two Gaussians over a pose into the first; `weight` is that of the other."""
    d_x, d_y, d_t = other[0] - mean[0], other[1] - mean[1], wrap_angle(other[2] - mean[2])
    spread = weight * (1.0 - weight)
    for i in range(3):
        for j in range(3):
            d_i = d_x if i == 0 else (d_y if i == 1 else d_t)
            d_j = d_x if j == 0 else (d_y if j == 1 else d_t)
            covariance[i, j] = (1.0 - weight) * covariance[i, j] + weight * other_covariance[i, j] + spread * d_i * d_j
    mean[0], mean[1], mean[2] = mean[0] + weight * d_x, mean[1] + weight * d_y, wrap_angle(mean[2] + weight * d_t)


@kernel
def align_pair(maps, pairs, options, heights, problem, starts, nodes, n, p, a, b, back, work):
    """Align the maps of a pair at its anchor: from the optimum carried forward, from the second, from challengers.

    Args:
        maps, pairs, options: see there.
        heights: (R,) [m] of the cameras.
        problem: the workspace of the alignment.
        starts: (≥ 2, 3 M + 4) and nodes: scratch; see `scratch`.
        n, p, a, b: environment, pair, observer and observed.
        back: the other direction, where that was aligned just now: its optimum is the first challenger, and after the
            first alignment the only one. Or -1.
        work: (≥ 6, ≥ 3) scratch.

    Returns:
        Whether there was an optimum: common points, a prior, a finite least cost.
    """
    slot = (maps.cursor[n] - pairs.age[n, p]) % maps.state.shape[1]
    m = load_maps(
        problem,
        maps.state[n, slot, a],
        maps.covariance[n, slot, a],
        maps.confirmed[n, slot, a],
        maps.state[n, slot, b],
        maps.covariance[n, slot, b],
        maps.confirmed[n, slot, b],
    )
    if m <= 0:
        return False
    difference = heights[b] - heights[a]
    if not load_prior(problem, difference, options.height_sd, pairs.prior[n, p], pairs.prior_covariance[n, p]):
        return False
    unknowns, last = 3 * m + 4, 3 * m + 1
    mode, second, turn = pairs.mode[n, p], pairs.second[n, p], pairs.turn[n, p]
    pairs.turn[n, p] = turn + 1
    every = options.challenger_every if pairs.anchored_covariance[n, p, 2, 2] < GRID_SD * GRID_SD else 1
    best, other = starts[0], starts[1]
    cov, other_cov = work[0:3, 0:3], work[3:6, 0:3]
    cost, log_det, rival_cost, rival_log_det = math.inf, 0.0, math.inf, 0.0
    first = not pairs.aligned[n, p]
    challengers = FIRST_CHALLENGERS if first else (options.challengers if back < 0 else 1)
    for source in range(2 + challengers):
        if source == 0:
            start_at(problem, m, mode, other)
        elif source == 1 and pairs.has_second[n, p]:
            start_at(problem, m, second, other)
        elif source == 2 and back >= 0:
            x, y, theta = pairs.mode[n, back]
            pose = relative(x, y, theta, 0.0, 0.0, 0.0)
            if cost < math.inf and abs(wrap_angle(pose[2] - best[last + 2])) < SECOND_HEADING:
                continue
            start_at(problem, m, pose, other)
        elif source > 1 and turn % every == 0:
            place = (source - 2) * (12 // FIRST_CHALLENGERS) if first else turn // every * challengers + source - 2
            heading = pairs.prior[n, p, 2] + place % 12 * math.pi / 6.0
            start_from_heading(problem, m, heading, LEAST_INVERSE_RANGE, other)
        else:
            continue
        if source < 2:
            other_cost, other_log_det = settle(problem, m, other, unknowns, options.iterations, options.tolerance)
        else:
            other_cost, other_log_det, _ = minimise(
                problem, m, other, unknowns, options.iterations, options.tolerance, cost + SECOND_COST
            )
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
        return False
    for i in range(3):
        mode[i] = best[last + i]
    apart = abs(wrap_angle(second[2] - mode[2])) > SECOND_HEADING
    pairs.has_second[n, p] = apart and rival_cost - cost < SECOND_COST
    anchored, anchored_cov = pairs.anchored[n, p], pairs.anchored_covariance[n, p]
    pairs.aligned[n, p] = True
    sd = math.sqrt(max(anchored_cov[2, 2], cov[2, 2]))
    if options.grid_period > 0.0 and sd > GRID_SD:
        if pairs.since_grid[n, p] < options.grid_period:
            return True
        pairs.since_grid[n, p] = 0.0
        node = heading_grid(
            problem,
            m,
            best,
            second,
            pairs.has_second[n, p],
            sd,
            options.iterations,
            options.tolerance,
            nodes,
            anchored,
            anchored_cov,
        )
        if node >= 0 and nodes[node, COST] < cost:
            for i in range(3):
                mode[i] = nodes[node, FIRST + last + i]
        return True
    for i in range(3):
        anchored[i] = mode[i]
        for j in range(3):
            anchored_cov[i, j] = cov[i, j]
    if pairs.has_second[n, p]:
        log_odds = 0.5 * (rival_cost - cost + rival_log_det - log_det)
        mix(anchored, anchored_cov, second, other_cov, 1.0 / (1.0 + math.exp(min(log_odds, 700.0))))
    return True


@kernel
def take_samples(
    rows, period, odometry, image, seen, arrived, maps, pairs, options, ends, heights, problem, starts, nodes, work
):
    """Take all K samples of the environments `rows` in, in order.

    Args:
        rows: environments.
        period, odometry, image, seen, arrived: as `samples.Samples`.
        maps, pairs, options: what is remembered, and the numbers of the configuration.
        ends: (P, 2) observer and observed of each pair.
        heights: (R,) [m] of the cameras.
        problem, starts, nodes, work: scratch; see `scratch`.

    Returns:
        Whether all messages were of samples still in the ring; if not, nothing was done.
    """
    window = np.uint64(maps.state.shape[1])
    if window < np.uint64(64):
        for index in range(rows.shape[0]):
            for k in range(arrived.shape[1]):
                for p in range(arrived.shape[2]):
                    if arrived[rows[index], k, p] >> window:
                        return False
    count, robots = seen.shape[1], seen.shape[2]
    for index in range(rows.shape[0]):
        n = rows[index]
        for k in range(count):
            observe(maps, options, n, period[n, k], odometry[n, k], image[n, k], seen[n, k], work)
            due = k == count - 1 if options.every == 0 else maps.ticks[n] % options.every == 0
            for p in range(ends.shape[0]):
                a, b = ends[p, 0], ends[p, 1]
                pairs.since_grid[n, p] += period[n, k]
                renewed = keep_pair(maps, pairs, options, n, p, a, b, arrived[n, k, p], work)
                if due and pairs.pending[n, p]:
                    back = find_back(pairs, n, p, a, b, robots, maps.ticks[n]) if options.mirror else -1
                    done = back >= 0 and mirror_pair(pairs, n, p, back, work)
                    if not done:
                        done = align_pair(maps, pairs, options, heights, problem, starts, nodes, n, p, a, b, back, work)
                    if done:
                        pairs.when[n, p] = maps.ticks[n]
                    pairs.pending[n, p] = False
                    renewed = True
                show_pose(maps, pairs, options, n, p, a, renewed, work)
            maps.ticks[n] += 1
    return True


def scratch(points: int, size: int) -> tuple[Problem, Float, Float, Float]:
    """Return the scratch that `take_samples` needs for maps of `size` numbers."""
    unknowns = 3 * points + 4
    return make_problem(points), np.zeros((2, unknowns)), make_nodes(points), np.zeros((max(size, 18), 3))
