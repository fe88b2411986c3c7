"""Mean and covariance of a relative pose whose posterior is not Gaussian yet: a nested Laplace approximation.

The heading is fixed on evenly spaced nodes; the other unknowns of the alignment are minimised at each, and a node
weighs exp(-J/2) det(H)^-1/2 with the Hessian of what was minimised.
"""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.alignment import minimise, start_at
from relloc_env.kernels.motion import wrap_angle

CIRCLE_NODES = 72
"""Nodes over the full circle."""
LOCAL_NODES = 19
"""Nodes over ±4 standard deviations."""
LOCAL_SD = 0.1
"""[rad] standard deviation of the heading up to which the nodes stay near what is believed."""
LOCAL_REACH = 4.0
"""[-] standard deviations that the local nodes reach to either side."""


@kernel
def heading_grid(problem, m, best, second, has_second, centre, sd, iterations, tolerance, nodes, y, mean, covariance):
    """Write mean and covariance of xi over a grid of headings.

    Args:
        problem, m, iterations, tolerance: as for `alignment.minimise`.
        best: (≥ 3 m + 4,) the optimum found, from which the nodes are reached one by one.
        second, has_second: (3,) another optimum's pose, if there is one: the nodes are reached from there as well, and
            the better way counts, since the rest may have several minima for one heading.
        centre, sd: [rad] mean and standard deviation of the heading as believed so far.
        nodes: (≥ CIRCLE_NODES, ≥ 7) scratch.
        y: (≥ 3 m + 4,) scratch; holds the best node's unknowns when it returns.
        mean, covariance: (3,), (3, 3) written.

    Returns:
        J of the best node; infinite where there was none (then nothing is written).
    """
    last = 3 * m + 1
    mode = best[last + 2]
    offset, apart = wrap_angle(mode - centre), wrap_angle(second[2] - mode)
    if sd > LOCAL_SD or abs(offset) > 2.0 * sd or has_second:
        count, first = CIRCLE_NODES, CIRCLE_NODES // 2
        spacing = 2.0 * math.pi / count
        origin = mode
    else:
        count, spacing = LOCAL_NODES, 2.0 * LOCAL_REACH * sd / (LOCAL_NODES - 1)
        first = LOCAL_NODES // 2 + round(offset / spacing)
        origin = centre + (first - LOCAL_NODES // 2) * spacing
    origin -= first * spacing
    for node in range(count):
        nodes[node, 0] = -math.inf
    from_second = min(max(first + round(apart / spacing), 0), count - 1)
    top, top_node, top_cost = -math.inf, 0, math.inf
    for step in range(2 * count if has_second else count):
        # Upwards from the node nearest to an optimum, then downwards from there.
        start, index = (first, step) if step < count else (from_second, step - count)
        node = start + index if start + index < count else count - 1 - index
        if index == 0 or node == start - 1:
            if step < count:
                for i in range(3 * m + 4):
                    y[i] = best[i]
            else:
                start_at(problem, m, second, y)
        heading = origin + node * spacing
        y[last + 2] = heading
        cost, log_det = minimise(problem, m, y, last + 2, iterations, tolerance)
        weight = -0.5 * (cost + log_det)
        if not cost < math.inf:
            for i in range(3 * m + 4):
                y[i] = best[i]
            continue
        if weight <= nodes[node, 0]:
            continue
        f = problem.factor
        i_xx, i_yy = 1.0 / f[last, last], 1.0 / f[last + 1, last + 1]
        i_yx = -f[last + 1, last] * i_xx * i_yy
        nodes[node, 0] = weight
        nodes[node, 1], nodes[node, 2], nodes[node, 3] = y[last], y[last + 1], heading
        nodes[node, 4], nodes[node, 5], nodes[node, 6] = i_xx * i_xx + i_yx * i_yx, i_yx * i_yy, i_yy * i_yy
        if weight > top:
            top, top_node, top_cost = weight, node, cost
    if top == -math.inf:
        return math.inf
    total, s_x, s_y, s_t = 0.0, 0.0, 0.0, 0.0
    at_x, at_y, at_t = nodes[top_node, 1], nodes[top_node, 2], nodes[top_node, 3]
    s_xx, s_yy, s_xy, s_xt, s_yt, s_tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for node in range(count):
        if nodes[node, 0] < top - 40.0:
            continue
        weight = math.exp(nodes[node, 0] - top)
        d_x, d_y, d_t = nodes[node, 1] - at_x, nodes[node, 2] - at_y, wrap_angle(nodes[node, 3] - at_t)
        total += weight
        s_x += weight * d_x
        s_y += weight * d_y
        s_t += weight * d_t
        s_xx += weight * (d_x * d_x + nodes[node, 4])
        s_xy += weight * (d_x * d_y + nodes[node, 5])
        s_yy += weight * (d_y * d_y + nodes[node, 6])
        s_xt += weight * d_x * d_t
        s_yt += weight * d_y * d_t
        s_tt += weight * d_t * d_t
    s_x, s_y, s_t = s_x / total, s_y / total, s_t / total
    mean[0], mean[1], mean[2] = at_x + s_x, at_y + s_y, wrap_angle(at_t + s_t)
    covariance[0, 0], covariance[1, 1] = s_xx / total - s_x * s_x, s_yy / total - s_y * s_y
    # A node stands for a cell of the circle.
    covariance[2, 2] = s_tt / total - s_t * s_t + spacing * spacing / 12.0
    covariance[0, 1] = covariance[1, 0] = s_xy / total - s_x * s_y
    covariance[0, 2] = covariance[2, 0] = s_xt / total - s_x * s_t
    covariance[1, 2] = covariance[2, 1] = s_yt / total - s_y * s_t
    for i in range(3):
        y[last + i] = nodes[top_node, 1 + i]
    return top_cost
