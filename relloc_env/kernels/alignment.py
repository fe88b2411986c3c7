"""The pose of one robot in another's frame from their two joint maps, by least squares with nothing remembered.

Over X_A (the points as A sees them), dh (camera height of B less that of A) and xi = (r_x, r_y, theta):

    J = |X_A - X̂_A|²_{P_A⁻¹} + |g(xi, dh, X_A) - X̂_B|²_{P_B⁻¹} + |xi - xi_p|²_{P_p⁻¹} + (dh - dh_p)²/s²

with g of `local_map.transfer`. Unknowns are ordered (X_A, dh, r_x, r_y, theta), so that the last rows of the Cholesky
factor of the Hessian hold the covariance of xi, and leaving out the last one fixes theta.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.linalg import invert
from relloc_env.kernels.local_map import transfer
from relloc_env.kernels.motion import wrap_angle

Float = NDArray[np.float64]


class Problem(NamedTuple):
    """One alignment: what is given, and the workspace; made once for m points, used with any number up to that."""

    mean_a: Float
    """(3 m,) points common to both, as A sees them."""
    mean_b: Float
    """(3 m,) the same as B sees them."""
    info_a: Float
    """(3 m, 3 m) P_A⁻¹."""
    info_b: Float
    """(3 m, 3 m) P_B⁻¹."""
    prior: Float
    """(4,) (dh_p, xi_p)."""
    prior_info: Float
    """(4, 4) its information; the diagonal of dh negative: dh is exactly dh_p."""
    views: Float
    """(3 m, 13) g and its derivatives, point by point: 1/n and twelve entries on each third row."""
    res_a: Float
    """(3 m,) X_A - X̂_A."""
    res_b: Float
    """(3 m,) g - X̂_B."""
    res_p: Float
    """(4,) (dh, xi) less the prior."""
    pull: Float
    """(3 m,) P_A⁻¹ res_a."""
    cross: Float
    """(3 m, 5) P_B⁻¹ [E, res_b], E the derivatives of g by (dh, xi)."""
    hessian: Float
    """(3 m + 4, 3 m + 4) lower triangle."""
    factor: Float
    """(3 m + 4, 3 m + 4) of the (damped) Hessian."""
    gradient: Float
    """(3 m + 4,) half of dJ."""
    step: Float
    """(3 m + 4,)."""
    trial: Float
    """(3 m + 4,)."""
    start: Float
    """(3 m + 4,)."""


def make_problem(points: int) -> Problem:
    """Return the workspace for alignments of up to `points` points."""
    m, n = 3 * points, 3 * points + 4
    shapes: list[tuple[int, ...]] = [(m,), (m,), (m, m), (m, m), (4,), (4, 4), (m, 13), (m,), (m,), (4,), (m,), (m, 5)]
    shapes += [(n, n), (n, n), (n,), (n,), (n,), (n,)]
    return Problem(*(np.zeros(shape) for shape in shapes))


@kernel
def load_maps(problem, state_a, covariance_a, known_a, state_b, covariance_b, known_b):
    """Fill in the points that both maps know, with the information of their marginals.

    Returns:
        m, their number; -1 where a covariance is not positive definite.
    """
    m = 0
    for i in range(known_a.shape[0]):
        if not (known_a[i] and known_b[i]):
            continue
        for k in range(3):
            problem.mean_a[3 * m + k], problem.mean_b[3 * m + k] = state_a[3 * i + k], state_b[3 * i + k]
        row = 0
        for j in range(i + 1):
            if not (known_a[j] and known_b[j]):
                continue
            for k in range(3):
                for c in range(3):
                    problem.factor[3 * m + k, row + c] = covariance_a[3 * i + k, 3 * j + c]
                    problem.hessian[3 * m + k, row + c] = covariance_b[3 * i + k, 3 * j + c]
            row += 3
        m += 1
    if not (invert(problem.factor, problem.info_a, 3 * m) and invert(problem.hessian, problem.info_b, 3 * m)):
        return -1
    return m


@kernel
def load_prior(problem, height, height_sd, pose, covariance):
    """Fill in the prior of dh [m] and xi; `height_sd` 0 fixes dh."""
    prior, info = problem.prior, problem.prior_info
    prior[0] = height
    factor, inverse = problem.factor, problem.hessian
    for i in range(3):
        prior[1 + i] = pose[i]
        info[0, 1 + i] = info[1 + i, 0] = 0.0
        for j in range(3):
            factor[i, j] = covariance[i, j]
    info[0, 0] = 1.0 / (height_sd * height_sd) if height_sd > 0.0 else -1.0
    good = invert(factor, inverse, 3)
    for i in range(3):
        for j in range(3):
            info[1 + i, 1 + j] = inverse[i, j]
    return good


@kernel
def evaluate(problem, m, y):
    """J at y = (X_A, dh, xi), leaving residuals and derivatives in the workspace; infinite at B's own place."""
    size = 3 * m
    dh, r_x, r_y, theta = y[size], y[size + 1], y[size + 2], y[size + 3]
    res_a, res_b, res_p, view = problem.res_a, problem.res_b, problem.res_p, problem.views
    for p in range(0, size, 3):
        values = transfer(y[p], y[p + 1], y[p + 2], r_x, r_y, theta, dh)
        if not values[3] < 1e4:
            return math.inf
        for k in range(13):
            view[p, k] = values[3 + k]
        res_a[p] = wrap_angle(y[p] - problem.mean_a[p])
        res_b[p] = wrap_angle(values[0] - problem.mean_b[p])
        res_a[p + 1], res_b[p + 1] = y[p + 1] - problem.mean_a[p + 1], values[1] - problem.mean_b[p + 1]
        res_a[p + 2], res_b[p + 2] = y[p + 2] - problem.mean_a[p + 2], values[2] - problem.mean_b[p + 2]
    cost = 0.0
    for i in range(size):
        total_a, total_b = 0.0, 0.0
        for j in range(size):
            total_a += problem.info_a[i, j] * res_a[j]
            total_b += problem.info_b[i, j] * res_b[j]
        problem.pull[i] = total_a
        problem.cross[i, 4] = total_b
        cost += total_a * res_a[i] + total_b * res_b[i]
    for k in range(3):
        res_p[k] = y[size + k] - problem.prior[k]
    res_p[3] = wrap_angle(theta - problem.prior[3])
    if problem.prior_info[0, 0] > 0.0:
        cost += problem.prior_info[0, 0] * res_p[0] * res_p[0]
    for i in range(1, 4):
        for j in range(1, 4):
            cost += problem.prior_info[i, j] * res_p[i] * res_p[j]
    return cost


@kernel
def assemble(problem, m, y):
    """Half the gradient of J and its Gauss-Newton Hessian (lower triangle) from what `evaluate` left."""
    size = 3 * m
    view, info_b, cross = problem.views, problem.info_b, problem.cross
    gradient, hessian = problem.gradient, problem.hessian
    for i in range(size):
        e_h, e_x, e_y, e_t = 0.0, 0.0, 0.0, 0.0
        for p in range(0, size, 3):
            v = view[p]
            i_b, i_e, i_r = info_b[i, p], info_b[i, p + 1], info_b[i, p + 2]
            e_h -= i_e * v[0] * y[p + 2]
            e_x += i_b * v[7] + i_e * v[8] + i_r * v[9]
            e_y += i_b * v[10] + i_e * v[11] + i_r * v[12]
            e_t -= i_b
        cross[i, 0], cross[i, 1], cross[i, 2], cross[i, 3] = e_h, e_x, e_y, e_t
        gradient[i] = problem.pull[i]
    for a in range(4):
        row = size + a
        gradient[row] = 0.0
        for b in range(4):
            gradient[row] += problem.prior_info[a, b] * problem.res_p[b]
            if b <= a:
                hessian[row, size + b] = problem.prior_info[a, b]
    for p in range(0, size, 3):
        v = view[p]
        inv, bb, eb, rb, br, er, rr = v[0], v[1], v[2], v[3], v[4], v[5], v[6]
        # (dh, xi) rows: E_pᵀ times `cross`, and `cross`ᵀ G_p.
        for b in range(5):
            c_b, c_e, c_r = cross[p, b], cross[p + 1, b], cross[p + 2, b]
            e_h = -inv * y[p + 2] * c_e
            e_x = v[7] * c_b + v[8] * c_e + v[9] * c_r
            e_y = v[10] * c_b + v[11] * c_e + v[12] * c_r
            g_b, g_e, g_r = bb * c_b + eb * c_e + rb * c_r, inv * c_e, br * c_b + er * c_e + rr * c_r
            if b == 4:
                gradient[size] += e_h
                gradient[size + 1] += e_x
                gradient[size + 2] += e_y
                gradient[size + 3] -= c_b
                gradient[p] += g_b
                gradient[p + 1] += g_e
                gradient[p + 2] += g_r
            else:
                if b == 0:
                    hessian[size, size] += e_h
                if b <= 1:
                    hessian[size + 1, size + b] += e_x
                if b <= 2:
                    hessian[size + 2, size + b] += e_y
                hessian[size + 3, size + b] -= c_b
                hessian[size + b, p] = g_b
                hessian[size + b, p + 1] = g_e
                hessian[size + b, p + 2] = g_r
        for q in range(0, p + 1, 3):
            u = view[q]
            inv_q, qbb, qeb, qrb, qbr, qer, qrr = u[0], u[1], u[2], u[3], u[4], u[5], u[6]
            for row in range(3):
                if row == 0:
                    f_b, f_e, f_r = bb, eb, rb
                elif row == 1:
                    f_b, f_e, f_r = 0.0, inv, 0.0
                else:
                    f_b, f_e, f_r = br, er, rr
                i_b = f_b * info_b[p, q] + f_e * info_b[p + 1, q] + f_r * info_b[p + 2, q]
                i_e = f_b * info_b[p, q + 1] + f_e * info_b[p + 1, q + 1] + f_r * info_b[p + 2, q + 1]
                i_r = f_b * info_b[p, q + 2] + f_e * info_b[p + 1, q + 2] + f_r * info_b[p + 2, q + 2]
                r = p + row
                hessian[r, q] = problem.info_a[r, q] + i_b * qbb + i_e * qeb + i_r * qrb
                hessian[r, q + 1] = problem.info_a[r, q + 1] + i_e * inv_q
                hessian[r, q + 2] = problem.info_a[r, q + 2] + i_b * qbr + i_e * qer + i_r * qrr
    if problem.prior_info[0, 0] < 0.0:
        gradient[size] = 0.0
        for j in range(size):
            hessian[size, j] = 0.0
        hessian[size, size] = 1.0
        for row in range(size + 1, size + 4):
            hessian[row, size] = 0.0


@kernel
def pose_covariance(problem, m, covariance):
    """Covariance of xi, its block of H⁻¹, from the factor that `descent.minimise` left: the last rows of (L Lᵀ)⁻¹."""
    f, p = problem.factor, 3 * m + 1
    i_xx, i_yy, i_tt = 1.0 / f[p, p], 1.0 / f[p + 1, p + 1], 1.0 / f[p + 2, p + 2]
    i_yx = -f[p + 1, p] * i_xx * i_yy
    i_ty = -f[p + 2, p + 1] * i_yy * i_tt
    i_tx = -(f[p + 2, p] * i_xx + f[p + 2, p + 1] * i_yx) * i_tt
    covariance[0, 0] = i_xx * i_xx + i_yx * i_yx + i_tx * i_tx
    covariance[0, 1] = covariance[1, 0] = i_yx * i_yy + i_tx * i_ty
    covariance[1, 1] = i_yy * i_yy + i_ty * i_ty
    covariance[0, 2] = covariance[2, 0] = i_tx * i_tt
    covariance[1, 2] = covariance[2, 1] = i_ty * i_tt
    covariance[2, 2] = i_tt * i_tt


@kernel
def start_at(problem, m, pose, y):
    """Write a start into y: A's own map, the height's prior and the given pose."""
    for i in range(3 * m):
        y[i] = problem.mean_a[i]
    y[3 * m], y[3 * m + 1], y[3 * m + 2], y[3 * m + 3] = problem.prior[0], pose[0], pose[1], pose[2]


@kernel
def start_from_heading(problem, m, theta, least_inverse_range, y):
    """Write a start into y for a heading: r = q̄_A - R(theta) q̄_B from the centroids of the two maps.

    Args:
        problem, m: as for `descent.minimise`.
        theta: [rad] heading of B in A's frame.
        least_inverse_range: [1/m] a point further away, or with rho < 0, is taken to be there.
        y: (≥ 3 m + 4,) where the start goes.
    """
    a_x, a_y, b_x, b_y = 0.0, 0.0, 0.0, 0.0
    for p in range(0, 3 * m, 3):
        range_a = 1.0 / max(problem.mean_a[p + 2], least_inverse_range)
        range_b = 1.0 / max(problem.mean_b[p + 2], least_inverse_range)
        a_x += range_a * math.cos(problem.mean_a[p])
        a_y += range_a * math.sin(problem.mean_a[p])
        b_x += range_b * math.cos(problem.mean_b[p])
        b_y += range_b * math.sin(problem.mean_b[p])
    cos, sin = math.cos(theta), math.sin(theta)
    pose = ((a_x - cos * b_x + sin * b_y) / m, (a_y - sin * b_x - cos * b_y) / m, theta)
    start_at(problem, m, pose, y)
