"""Levenberg-Marquardt on the cost J of an alignment.

Bearings are known far better than ranges, so that J has a narrow, curved valley: pose and ranges may change together
where all bearings stay. A step is therefore taken along a curve that is straight where the valley is: points move
along their rays, and the other robot turns about the points.
"""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.alignment import assemble, evaluate
from relloc_env.kernels.linalg import cholesky, log_determinant, solve_factored
from relloc_env.kernels.motion import wrap_angle

SOON = 12
"""Steps after which a minimum is sought another way."""
DAMPED = 1e-4
"""[-] greatest promise of a damped step that counts as the end."""
LEAST_DAMPING = 1e-4
"""[-] first damping, of the diagonal of H; a hundredth of it is none."""
FAR = 0.01
"""[1/m] inverse range below which it is changed by what the step says, and not the range."""
NEARER = 0.5
"""[-] part of its range that a point comes nearer at most by going along its ray."""


@kernel
def factor_damped(problem, rows, damping):
    """Factor H + damping diag(H) of the leading rows into `factor`."""
    hessian, factor = problem.hessian, problem.factor
    for i in range(rows):
        for j in range(i + 1):
            factor[i, j] = hessian[i, j]
        factor[i, i] *= 1.0 + damping
    return cholesky(factor, rows)


@kernel
def go(m, y, step, target):
    """Write where a `step` from y leads into `target`: y + step to first order, along rays and about the points."""
    size, c_x, c_y = 3 * m, 0.0, 0.0
    for p in range(0, size, 3):
        rho, change = y[p + 2], step[p + 2]
        target[p], target[p + 1], target[p + 2] = y[p] + step[p], y[p + 1] + step[p + 1], rho + change
        reach = 1.0 / max(rho, FAR)
        c_x += reach * math.cos(y[p]) / m
        c_y += reach * math.sin(y[p]) / m
        if rho > FAR:
            # The range changes by -change/rho². From where that makes it NEARER on, the curve goes on straight.
            part = change * reach
            if part < NEARER:
                target[p + 2] = rho / (1.0 - part)
            else:
                target[p + 2] = rho * (1.0 + (part - NEARER) / (1.0 - NEARER)) / (1.0 - NEARER)
    turn = step[size + 3]
    cos, sin = math.cos(turn), math.sin(turn)
    a_x, a_y = y[size + 1] - c_x, y[size + 2] - c_y
    target[size] = y[size] + step[size]
    target[size + 1] = c_x + cos * a_x - sin * a_y + turn * a_y + step[size + 1]
    target[size + 2] = c_y + sin * a_x + cos * a_y - turn * a_x + step[size + 2]
    target[size + 3] = y[size + 3] + turn


@kernel
def minimise(problem, m, y, free, iterations, tolerance, hopeless=math.inf):
    """Levenberg-Marquardt on J from y, in place; leaves the factor of the undamped Hessian in the workspace.

    Args:
        problem: filled by `load_maps` and `load_prior`.
        m: number of points.
        y: (≥ 3 m + 4,) start, and the minimum when it returns.
        free: number of leading unknowns that may move: 3 m + 4, or 3 m + 3 with theta fixed.
        iterations: greatest number of steps tried.
        tolerance: [-] ends where the next step promises to lower J by less. That step is still taken, as promised,
            and left in `step`; H is not looked at again. (A damped step promises little: it ends nothing above
            `DAMPED`, and is not taken; `step` is 0 then.)
        hopeless: [-] gives up where J stays above, even if each step that is left were to lower it as the next one
            promises.

    Returns:
        (J, log det H, whether it ended before the `iterations` did): infinite J where no minimum was found.
    """
    step, trial, ended = problem.step, problem.trial, False
    size = 3 * m + 4
    for i in range(size):
        trial[i], step[i] = y[i], 0.0
    cost, damping, harder, promise = math.inf, 0.0, 2.0, 0.0
    for tried in range(iterations + 1):
        new_cost = evaluate(problem, m, trial)
        if new_cost <= cost and new_cost < math.inf:
            if damping > 0.0:
                # Less damping, the better the promise was kept.
                kept = 2.0 * (cost - new_cost) / promise - 1.0
                damping *= max(0.1, 1.0 - kept * kept * kept)
                damping = damping if damping > 0.01 * LEAST_DAMPING else 0.0
            cost, harder = new_cost, 4.0
            for i in range(size):
                y[i] = trial[i]
            assemble(problem, m, y)
        elif cost == math.inf:
            return math.inf, 0.0, True
        else:
            damping, harder = max(harder * damping, LEAST_DAMPING), 2.0 * harder
        while not factor_damped(problem, free, damping):
            if damping > 1e6:
                return math.inf, 0.0, True
            damping = max(10.0 * damping, 1e-6)
        for i in range(free):
            step[i] = -problem.gradient[i]
        solve_factored(problem.factor, step, free)
        promise = 0.0
        for i in range(free):
            promise -= step[i] * problem.gradient[i]
        if promise < (tolerance if damping == 0.0 else min(tolerance, DAMPED)):
            ended = True
            break
        if cost - (iterations - tried) * promise > hopeless:
            return math.inf, 0.0, True
        go(m, y, step, trial)
    if ended and damping == 0.0:
        go(m, y, step, trial)
        for i in range(size):
            y[i] = trial[i]
        cost -= promise
    else:
        for i in range(free):
            step[i] = 0.0
    if damping > 0.0 and not factor_damped(problem, free, 0.0):
        return math.inf, 0.0, True
    y[size - 1] = wrap_angle(y[size - 1])
    return cost, log_determinant(problem.factor, free), ended


@kernel
def settle(problem, m, y, free, iterations, tolerance):
    """`minimise`, once more where it did not end soon: with the pose held, then with all free.

    A start off the valley's floor, as A's own map is where the other map disagrees about the ranges, takes very many
    steps; the floor is near for a given pose.
    """
    start = problem.start
    for i in range(3 * m + 4):
        start[i] = y[i]
    cost, log_det, ended = minimise(problem, m, y, free, SOON, tolerance)
    if ended:
        return cost, log_det
    for i in range(3 * m + 4):
        start[i], y[i] = y[i], start[i]
    minimise(problem, m, y, 3 * m, SOON, tolerance)
    other, log_det, _ = minimise(problem, m, y, free, iterations, tolerance)
    if other <= cost:
        return other, log_det
    for i in range(3 * m + 4):
        y[i] = start[i]
    cost, log_det, _ = minimise(problem, m, y, free, iterations, tolerance)
    return cost, log_det
