"""Mean and covariance of a relative pose whose posterior is not Gaussian yet: a nested Laplace approximation.

The heading is fixed on nodes; the other unknowns of the alignment are minimised at each, and a node weighs
exp(-J/2) det(H)^-1/2 with the Hessian of what was minimised. A node also knows how J and the other unknowns change with
the heading (the gradient, and the implicit function theorem): the next node starts from there, J and the pose between
two nodes are cubic, and a Gaussian needs five nodes. More are added where that cubic is not to be trusted.
"""

import math

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.alignment import start_at
from relloc_env.kernels.descent import go, settle
from relloc_env.kernels.linalg import solve_factored
from relloc_env.kernels.motion import wrap_angle

MOST_NODES = 96
"""Nodes altogether."""
LOCAL_SD = 0.1
"""[rad] standard deviation of the heading up to which the nodes stay near what is believed."""
DROP, STEEPER = 2.0, 2.0
"""[-] a step to the next node is so long that the log weight is to fall by the first, and by the second times what it
has fallen already."""
LONGEST = math.pi / 9.0
"""[rad] longest step."""
TAIL = 8.0
"""[-] local nodes end where the log weight is lower than that of the optimum by more."""
HOPELESS = 25.0
"""[-] others end where it is lower by more."""
UNRESOLVED = 0.03
"""[-] a cell is divided whose cubic term, in log weight, times the part of the whole that it holds is above this."""
LEAST_GAP = 1e-4
"""[rad] nodes nearer to each other are not parted: there the weight jumps from one minimum of the rest to another."""
TOLERANCE = 1e-2
"""[-] the rest is minimised at a node until the next step promises to lower J by less; that step is still taken."""
OVERSHOOT = 2.0
"""[-] a cubic rises above the ends and the middle of its cell by less: where the weight falls by thousands from one end
to the other, which no cubic follows, it may not."""

OFFSET, WEIGHT, X, Y, XX, XY, YY, COST, SLOPE, CURVATURE = range(10)
"""Columns of a node: heading less that of the optimum, log weight, position and its covariance, J, first derivative of
-J/2 and less its second."""
FIRST = 10
"""Column where its unknowns begin; after them, their derivatives by the heading."""

_AT = (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970262)
_SHARE = (0.17392742256872692, 0.32607257743127307, 0.32607257743127307, 0.17392742256872692)
"""Points and weights of Gauss and Legendre on [0, 1]."""


def make_nodes(points: int) -> NDArray[np.float64]:
    """Return the scratch of `heading_grid` for up to `points` points."""
    return np.zeros((MOST_NODES + 1, FIRST + 2 * (3 * points + 4)))


@kernel
def _fill(problem, m, nodes, node, offset, mode, iterations, tolerance):
    """Minimise all but the heading at a node, from the unknowns that it holds.

    Args:
        problem, m, iterations, tolerance: as for `descent.minimise`.
        nodes, node: where; its log weight is -inf afterwards where there is no minimum.
        offset, mode: [rad] the node's heading is their sum.
    """
    last = 3 * m + 1
    theta, row = last + 2, nodes[node]
    row[WEIGHT] = -math.inf
    y, slopes = row[FIRST : FIRST + theta + 1], row[FIRST + theta + 1 :]
    y[theta] = mode + offset
    cost, log_det = settle(problem, m, y, theta, iterations, tolerance)
    row[OFFSET] = offset
    weight = -0.5 * (cost + log_det)
    if not cost < math.inf:
        return
    f, hessian = problem.factor, problem.hessian
    slope, curvature = -problem.gradient[theta], hessian[theta, theta]
    for i in range(theta):
        slope -= hessian[theta, i] * problem.step[i]
        slopes[i] = -hessian[theta, i]
    slopes[theta] = 1.0
    solve_factored(f, slopes, theta)
    for i in range(theta):
        curvature += hessian[theta, i] * slopes[i]
    i_xx, i_yy = 1.0 / f[last, last], 1.0 / f[last + 1, last + 1]
    i_yx = -f[last + 1, last] * i_xx * i_yy
    row[WEIGHT], row[COST], row[SLOPE], row[CURVATURE] = weight, cost, slope, curvature
    row[X], row[Y] = y[last], y[last + 1]
    row[XX], row[XY], row[YY] = i_xx * i_xx + i_yx * i_yx, i_yx * i_yy, i_yy * i_yy


@kernel
def _begin(problem, m, nodes, node, other, ahead):
    """Make a node new, with the unknowns to start from: those of the `other` one carried `ahead` [rad]."""
    size, step = 3 * m + 4, problem.step
    for i in range(size):
        step[i] = ahead * nodes[other, FIRST + size + i]
    go(m, nodes[other, FIRST:], step, nodes[node, FIRST:])


@kernel
def _walk(problem, m, nodes, middle, direction, reach, mode, iterations, tolerance):
    """Add nodes from the one in the `middle` on, in one direction; returns the last one."""
    node, top = middle, nodes[middle, WEIGHT]
    while abs(node - middle) < MOST_NODES // 3:
        fallen, limit = top - nodes[node, WEIGHT], math.pi - abs(nodes[node, OFFSET])
        if fallen > reach or limit <= 0.0:
            break
        rise, curvature = direction * nodes[node, SLOPE], max(nodes[node, CURVATURE], 1e-12)
        drop = DROP + STEEPER * max(fallen, 0.0)
        step = (rise + math.sqrt(rise * rise + 2.0 * curvature * drop)) / curvature
        step = min(step, LONGEST, limit)
        after = node + direction
        _begin(problem, m, nodes, after, node, direction * step)
        _fill(problem, m, nodes, after, nodes[node, OFFSET] + direction * step, mode, iterations, tolerance)
        if nodes[after, WEIGHT] == -math.inf:
            break
        node, top = after, max(top, nodes[after, WEIGHT])
    return node


@kernel
def _insert(nodes, count, node):
    """Put the node behind the last one before `node`."""
    spare = nodes.shape[0] - 1
    nodes[spare] = nodes[count]
    for i in range(count, node, -1):
        nodes[i] = nodes[i - 1]
    nodes[node] = nodes[spare]


@kernel
def _visit(problem, m, nodes, count, second, mode, iterations, tolerance):
    """Reach the nodes from a second optimum as well: the rest may have several minima for one heading.

    Returns:
        The number of nodes, one more than before.
    """
    size, apart = 3 * m + 4, wrap_angle(second[2] - mode)
    start_at(problem, m, second, nodes[count, FIRST : FIRST + size])
    _fill(problem, m, nodes, count, apart, mode, iterations, tolerance)
    node = 0
    while node < count and nodes[node, OFFSET] < apart:
        node += 1
    if nodes[count, WEIGHT] == -math.inf:
        return count
    _insert(nodes, count, node)
    count += 1
    for direction in (1, -1):
        at = node + direction
        while 0 <= at < count:
            before, offset = at - direction, nodes[at, OFFSET]
            _begin(problem, m, nodes, count, before, offset - nodes[before, OFFSET])
            _fill(problem, m, nodes, count, offset, mode, iterations, tolerance)
            if not nodes[count, WEIGHT] > max(nodes[at, WEIGHT], nodes[node, WEIGHT] - HOPELESS):
                break
            nodes[at] = nodes[count]
            at += direction
    return count


@kernel
def _middle(nodes, node):
    """Log weight half way to the next node."""
    here, there = nodes[node], nodes[node + 1]
    gap = there[OFFSET] - here[OFFSET]
    return 0.5 * (here[WEIGHT] + there[WEIGHT]) + 0.125 * gap * (here[SLOPE] - there[SLOPE])


@kernel
def _worst(nodes, count):
    """The node after which another one is missed most, or -1."""
    top, total, worst, found = -math.inf, 0.0, 0.0, -1
    for node in range(count):
        top = max(top, nodes[node, WEIGHT])
        if node < count - 1:
            top = max(top, _middle(nodes, node))
    for node in range(count - 1):
        here, there = nodes[node], nodes[node + 1]
        gap = there[OFFSET] - here[OFFSET]
        high = max(here[WEIGHT], there[WEIGHT], _middle(nodes, node)) - top
        low = min(here[WEIGHT], there[WEIGHT]) - top
        held = gap * math.exp(high)
        total += 0.5 * (held + gap * math.exp(low))
        cubic = abs(0.5 * (here[COST] - there[COST]) - 0.5 * gap * (here[SLOPE] + there[SLOPE]))
        if gap > LEAST_GAP and cubic * held > worst:
            worst, found = cubic * held, node
    return found if worst > UNRESOLVED * total else -1


@kernel
def _place(problem, m, best, second, has_second, sd, iterations, tolerance, nodes):
    """Place the nodes; arguments as of `heading_grid`. Returns their number; they are in order, from the first on."""
    size, middle = 3 * m + 4, MOST_NODES // 2
    mode = best[size - 1]
    for i in range(size):
        nodes[middle, FIRST + i] = best[i]
    _fill(problem, m, nodes, middle, 0.0, mode, iterations, tolerance)
    if nodes[middle, WEIGHT] == -math.inf:
        return 0
    reach = HOPELESS if sd > LOCAL_SD or has_second else TAIL
    last = _walk(problem, m, nodes, middle, 1, reach, mode, iterations, tolerance)
    first = _walk(problem, m, nodes, middle, -1, reach, mode, iterations, tolerance)
    count = last + 1 - first
    for node in range(count):
        nodes[node] = nodes[first + node]
    if has_second:
        count = _visit(problem, m, nodes, count, second, mode, iterations, tolerance)
    while count < MOST_NODES:
        node = _worst(nodes, count)
        if node < 0:
            break
        offset = 0.5 * (nodes[node, OFFSET] + nodes[node + 1, OFFSET])
        better = node if nodes[node, WEIGHT] >= nodes[node + 1, WEIGHT] else node + 1
        _begin(problem, m, nodes, count, better, offset - nodes[better, OFFSET])
        _fill(problem, m, nodes, count, offset, mode, iterations, tolerance)
        if nodes[count, WEIGHT] == -math.inf:
            break
        _insert(nodes, count, node + 1)
        count += 1
    return count


@kernel
def heading_grid(problem, m, best, second, has_second, sd, iterations, tolerance, nodes, mean, covariance):
    """Write mean and covariance of xi over nodes of the heading.

    Args:
        problem, m, iterations, tolerance: as for `descent.minimise`.
        best: (≥ 3 m + 4,) the optimum found, from which the nodes are reached one by one.
        second, has_second: (3,) another optimum's pose, if there is one.
        sd: [rad] standard deviation of the heading as believed so far.
        nodes: scratch, see `make_nodes`.
        mean, covariance: (3,), (3, 3) written, unless there are no nodes with a minimum.

    Returns:
        The node that weighs most, its unknowns from column FIRST on; -1 where there is none.
    """
    count = _place(problem, m, best, second, has_second, sd, iterations, max(tolerance, TOLERANCE), nodes)
    top_node = 0
    for node in range(count):
        if nodes[node, WEIGHT] > nodes[top_node, WEIGHT]:
            top_node = node
    if count < 2:
        return -1
    top, size = nodes[top_node, WEIGHT], 3 * m + 4
    total, s_x, s_y, s_t = 0.0, 0.0, 0.0, 0.0
    at_t, at_x, at_y = nodes[top_node, OFFSET], nodes[top_node, X], nodes[top_node, Y]
    d_x, d_y = FIRST + size + 3 * m + 1, FIRST + size + 3 * m + 2
    s_xx, s_yy, s_xy, s_xt, s_yt, s_tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for node in range(count - 1):
        a, b = nodes[node], nodes[node + 1]
        gap = b[OFFSET] - a[OFFSET]
        high = max(a[WEIGHT], b[WEIGHT], _middle(nodes, node)) - top
        if high < -40.0:
            continue
        rest_a, rest_b = a[WEIGHT] + 0.5 * a[COST] - top, b[WEIGHT] + 0.5 * b[COST] - top
        for k in range(4):
            t = _AT[k]
            u = 1.0 - t
            # Hermite's cubics, and the straight line of what has no slope.
            h_a, h_b, g_a, g_b = u * u * (1.0 + 2.0 * t), t * t * (3.0 - 2.0 * t), gap * t * u * u, -gap * t * t * u
            log_weight = g_a * a[SLOPE] + g_b * b[SLOPE] - 0.5 * (h_a * a[COST] + h_b * b[COST])
            log_weight = min(log_weight + u * rest_a + t * rest_b, high + OVERSHOOT, 50.0)
            weight = gap * _SHARE[k] * math.exp(log_weight)
            x = h_a * (a[X] - at_x) + h_b * (b[X] - at_x) + g_a * a[d_x] + g_b * b[d_x]
            y = h_a * (a[Y] - at_y) + h_b * (b[Y] - at_y) + g_a * a[d_y] + g_b * b[d_y]
            theta = wrap_angle(a[OFFSET] + t * gap - at_t)
            total += weight
            s_x += weight * x
            s_y += weight * y
            s_t += weight * theta
            s_xx += weight * (x * x + u * a[XX] + t * b[XX])
            s_xy += weight * (x * y + u * a[XY] + t * b[XY])
            s_yy += weight * (y * y + u * a[YY] + t * b[YY])
            s_xt += weight * x * theta
            s_yt += weight * y * theta
            s_tt += weight * theta * theta
    if not total > 0.0:
        return -1
    s_x, s_y, s_t = s_x / total, s_y / total, s_t / total
    mean[0], mean[1], mean[2] = at_x + s_x, at_y + s_y, wrap_angle(best[size - 1] + at_t + s_t)
    covariance[0, 0], covariance[1, 1] = s_xx / total - s_x * s_x, s_yy / total - s_y * s_y
    covariance[2, 2] = s_tt / total - s_t * s_t
    covariance[0, 1] = covariance[1, 0] = s_xy / total - s_x * s_y
    covariance[0, 2] = covariance[2, 0] = s_xt / total - s_x * s_t
    covariance[1, 2] = covariance[2, 1] = s_yt / total - s_y * s_t
    return top_node
