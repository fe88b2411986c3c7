"""Mean and covariance of a relative pose whose posterior is not Gaussian yet: a nested Laplace approximation.

The heading is fixed on nodes; the other unknowns of the alignment are minimised at each, and a node weighs
exp(-J/2) det(H)^-1/2 with the Hessian of what was minimised, times its cell. Nodes are added where the weight changes
much from one to the next, so that a narrow peak is resolved as well as a wide one.
"""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.alignment import settle, start_at
from relloc_env.kernels.motion import wrap_angle

CIRCLE_NODES = 36
"""Nodes over the full circle, to begin with."""
LOCAL_NODES = 11
"""Nodes near the optimum, to begin with."""
MOST_NODES = 96
"""Nodes altogether."""
LOCAL_SD = 0.1
"""[rad] standard deviation of the heading up to which the nodes stay near what is believed."""
LOCAL_SPACING = 0.8
"""[-] standard deviations between the local nodes."""
RESOLVED = 1.0
"""[-] log weights of two neighbours whose cell is not divided further differ by no more."""
NEGLIGIBLE = 1e-3
"""[-] part of the whole that a cell has to hold to be divided."""
TAIL = 8.0
"""[-] the nodes end where the log weight is lower than the highest by more."""
HOPELESS = 25.0
"""[-] nodes are not sought beyond one whose log weight is lower than that of the optimum they started from by more."""
LEAST_GAP = 1e-4
"""[rad] nodes nearer to each other are not parted: there the weight jumps from one minimum of the rest to another."""
FIRST = 8
"""Column of a node where its unknowns begin; before: heading less that of the optimum, log weight, x, y, xx, xy,
yy, J."""


@kernel
def _fill(problem, m, nodes, node, offset, mode, iterations, tolerance):
    """Minimise all but the heading at a node, from the unknowns that it holds; keeps what it held if that was better.

    Args:
        problem, m, iterations, tolerance: as for `alignment.minimise`.
        nodes, node: where; its log weight is -inf if it is new.
        offset, mode: [rad] the node's heading is their sum.
    """
    last, y = 3 * m + 1, nodes[node, FIRST:]
    y[last + 2] = mode + offset
    cost, log_det = settle(problem, m, y, last + 2, iterations, tolerance)
    nodes[node, 0] = offset
    weight = -0.5 * (cost + log_det)
    if not cost < math.inf or weight <= nodes[node, 1]:
        return
    f = problem.factor
    i_xx, i_yy = 1.0 / f[last, last], 1.0 / f[last + 1, last + 1]
    i_yx = -f[last + 1, last] * i_xx * i_yy
    nodes[node, 1], nodes[node, 2], nodes[node, 3] = weight, y[last], y[last + 1]
    nodes[node, 4], nodes[node, 5], nodes[node, 6] = i_xx * i_xx + i_yx * i_yx, i_yx * i_yy, i_yy * i_yy
    nodes[node, 7] = cost


@kernel
def _begin(nodes, node, m, y):
    """Give a new node the unknowns to start from."""
    nodes[node, 1] = -math.inf
    for i in range(3 * m + 4):
        nodes[node, FIRST + i] = y[i]


@kernel
def _insert(nodes, count, node):
    """Make room for a node before `node`."""
    for i in range(count, node, -1):
        nodes[i] = nodes[i - 1]


@kernel
def _gap(nodes, count, node, circle):
    """[rad] from a node to the next; the last one's next is the first on the circle, and far away otherwise."""
    if node < count - 1:
        return nodes[node + 1, 0] - nodes[node, 0]
    return nodes[0, 0] + 2.0 * math.pi - nodes[node, 0] if circle else 0.0


@kernel
def _coarsest(nodes, count, circle):
    """The node after which another one is missed most, or -1: cells are compared by what they hold if they are full."""
    top, total = -math.inf, 0.0
    for node in range(count):
        top = max(top, nodes[node, 1])
    worst, found = 0.0, -1
    for node in range(count):
        gap, here, there = _gap(nodes, count, node, circle), nodes[node, 1], nodes[(node + 1) % count, 1]
        high, low = max(here, there), min(here, there)
        if gap == 0.0 or high == -math.inf:
            continue
        held = gap * math.exp(high - top)
        total += 0.5 * gap * (math.exp(high - top) + math.exp(low - top))
        if high - low > RESOLVED and gap > LEAST_GAP and held > worst:
            worst, found = held, node
    return found if worst > NEGLIGIBLE * total else -1


@kernel
def _place(problem, m, best, second, has_second, sd, iterations, tolerance, nodes):
    """Place the nodes; arguments as of `heading_grid`. Returns their number and whether they close a circle."""
    last = 3 * m + 1
    mode = best[last + 2]
    circle = sd > LOCAL_SD or has_second
    count = CIRCLE_NODES if circle else LOCAL_NODES
    spacing = 2.0 * math.pi / count if circle else LOCAL_SPACING * sd
    middle = count // 2
    for node in range(count):
        nodes[node, 0], nodes[node, 1] = (node - middle) * spacing, -math.inf
    for direction in (1, -1):
        for node in range(middle if direction == 1 else middle - 1, count if direction == 1 else -1, direction):
            _begin(nodes, node, m, best if node == middle else nodes[node - direction, FIRST:])
            _fill(problem, m, nodes, node, nodes[node, 0], mode, iterations, tolerance)
            if nodes[node, 1] < nodes[middle, 1] - HOPELESS:
                break
    if has_second:
        # The rest may have several minima for one heading: the nodes are reached from the second optimum as well.
        apart = wrap_angle(second[2] - mode)
        node = min(max(math.floor(apart / spacing) + middle + 1, 1), count)
        _insert(nodes, count, node)
        count += 1
        start_at(problem, m, second, nodes[node, FIRST:])
        nodes[node, 1] = -math.inf
        _fill(problem, m, nodes, node, apart, mode, iterations, tolerance)
        for direction in (1, -1):
            at = node + direction
            while 0 <= at < count:
                weight, offset = nodes[at, 1], nodes[at, 0]
                for i in range(3 * m + 4):
                    nodes[count, FIRST + i] = nodes[at - direction, FIRST + i]
                nodes[count, 1] = weight
                _fill(problem, m, nodes, count, offset, mode, iterations, tolerance)
                if not nodes[count, 1] > max(weight, nodes[node, 1] - HOPELESS):
                    break
                nodes[at] = nodes[count]
                at += direction
    while count < MOST_NODES:
        node = _coarsest(nodes, count, circle)
        if node >= 0:
            offset = nodes[node, 0] + 0.5 * _gap(nodes, count, node, circle)
            after = (node + 1) % count
            better = node if nodes[node, 1] >= nodes[after, 1] else after
            start = nodes[count]
            for i in range(3 * m + 4):
                start[FIRST + i] = nodes[better, FIRST + i]
            start[1] = -math.inf
            _fill(problem, m, nodes, count, offset, mode, iterations, tolerance)
            if node < count - 1:
                for i in range(nodes.shape[1]):
                    nodes[MOST_NODES, i] = nodes[count, i]
                _insert(nodes, count, node + 1)
                for i in range(nodes.shape[1]):
                    nodes[node + 1, i] = nodes[MOST_NODES, i]
            count += 1
            continue
        if circle:
            break
        top = nodes[0, 1]
        for i in range(count):
            top = max(top, nodes[i, 1])
        if nodes[count - 1, 1] > top - TAIL:
            _begin(nodes, count, m, nodes[count - 1, FIRST:])
            _fill(problem, m, nodes, count, nodes[count - 1, 0] + spacing, mode, iterations, tolerance)
        elif nodes[0, 1] > top - TAIL:
            offset = nodes[0, 0] - spacing
            _insert(nodes, count, 0)
            nodes[0, 1] = -math.inf
            _fill(problem, m, nodes, 0, offset, mode, iterations, tolerance)
        else:
            break
        count += 1
        circle = nodes[count - 1, 0] - nodes[0, 0] > 2.0 * math.pi - spacing
    return count, circle


@kernel
def heading_grid(problem, m, best, second, has_second, sd, iterations, tolerance, nodes, mean, covariance):
    """Write mean and covariance of xi over nodes of the heading.

    Args:
        problem, m, iterations, tolerance: as for `alignment.minimise`.
        best: (≥ 3 m + 4,) the optimum found, from which the nodes are reached one by one.
        second, has_second: (3,) another optimum's pose, if there is one.
        sd: [rad] standard deviation of the heading as believed so far.
        nodes: (MOST_NODES + 1, ≥ FIRST + 3 m + 4) scratch.
        mean, covariance: (3,), (3, 3) written, unless there is no node with a minimum.

    Returns:
        The node that weighs most, its J before column FIRST and its unknowns from there on; -1 where there is none.
    """
    count, circle = _place(problem, m, best, second, has_second, sd, iterations, tolerance, nodes)
    top_node = 0
    for node in range(count):
        if nodes[node, 1] > nodes[top_node, 1]:
            top_node = node
    top = nodes[top_node, 1]
    if top == -math.inf:
        return -1
    total, s_x, s_y, s_t = 0.0, 0.0, 0.0, 0.0
    at_t, at_x, at_y = nodes[top_node, 0], nodes[top_node, 2], nodes[top_node, 3]
    s_xx, s_yy, s_xy, s_xt, s_yt, s_tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for node in range(count):
        if nodes[node, 1] < top - 40.0:
            continue
        cell = _gap(nodes, count, node, circle) + _gap(nodes, count, (node - 1) % count, circle)
        weight = cell * math.exp(nodes[node, 1] - top)
        d_x, d_y, d_t = nodes[node, 2] - at_x, nodes[node, 3] - at_y, wrap_angle(nodes[node, 0] - at_t)
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
    mean[0], mean[1], mean[2] = at_x + s_x, at_y + s_y, wrap_angle(best[3 * m + 3] + at_t + s_t)
    covariance[0, 0], covariance[1, 1] = s_xx / total - s_x * s_x, s_yy / total - s_y * s_y
    covariance[2, 2] = s_tt / total - s_t * s_t
    covariance[0, 1] = covariance[1, 0] = s_xy / total - s_x * s_y
    covariance[0, 2] = covariance[2, 0] = s_xt / total - s_x * s_t
    covariance[1, 2] = covariance[2, 1] = s_yt / total - s_y * s_t
    return top_node
