"""Alignment of two maps: its linear algebra against NumPy, its minimum and covariance against SciPy."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.optimize import least_squares

from relloc_env.kernels import alignment, descent, linalg
from relloc_env.kernels.local_map import transfer

Float = NDArray[np.float64]


def positive(rng: np.random.Generator, n: int, scale: float = 1.0) -> Float:
    root = rng.normal(size=(n, n))
    return scale * (root @ root.T + 0.1 * np.eye(n))


@pytest.mark.parametrize("n", [1, 3, 10, 22])
def test_cholesky_solve_and_inverse_agree_with_numpy(n: int) -> None:
    rng = np.random.default_rng(n)
    a, b = positive(rng, n), rng.normal(size=n)
    big = np.full((n + 3, n + 3), np.nan)
    big[:n, :n] = a
    assert linalg.cholesky(big, n)
    assert_allclose(np.tril(big[:n, :n]), np.linalg.cholesky(a), rtol=1e-10, atol=1e-12)
    assert_allclose(linalg.log_determinant(big, n), np.linalg.slogdet(a)[1], rtol=1e-10, atol=1e-12)
    x = b.copy()
    linalg.solve_factored(big, x, n)
    assert_allclose(x, np.linalg.solve(a, b), rtol=1e-8)
    inverse = np.empty_like(big)
    assert linalg.invert(a.copy(), inverse, n)
    assert_allclose(inverse[:n, :n], np.linalg.inv(a), rtol=1e-8, atol=1e-10)


def test_what_is_not_positive_definite_is_refused() -> None:
    assert not linalg.cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]), 2)
    assert not linalg.cholesky(np.array([[np.nan]]), 1)


class Case:
    """Two maps of the same points with correlated errors, the true pose, and a weak prior of it."""

    def __init__(self, seed: int, points: int, height_sd: float) -> None:
        rng = np.random.default_rng(seed)
        self.points, self.height_sd = points, height_sd
        self.xi = np.array(
            [rng.uniform(-1.5, 1.0), rng.choice([-1, 1]) * rng.uniform(1.0, 3.0), rng.uniform(-0.6, 0.6)]
        )
        q = np.stack([rng.uniform(4.0, 7.0, points), rng.uniform(-2.0, 2.0, points)], axis=1)
        reach = np.hypot(*q.T)
        a = np.stack([np.arctan2(q[:, 1], q[:, 0]), rng.uniform(-0.4, 1.0, points) / reach, 1.0 / reach], axis=1)
        b = np.array([transfer(*p, *self.xi, 0.02 if height_sd else 0.0)[:3] for p in a])
        sd = np.tile([0.004, 0.004, 0.015], points)
        self.cov_a, self.cov_b = (positive(rng, 3 * points, 0.3) * np.outer(sd, sd) for _ in range(2))
        self.a = rng.multivariate_normal(a.ravel(), self.cov_a)
        self.b = rng.multivariate_normal(b.ravel(), self.cov_b)
        self.prior = self.xi + rng.choice([-1, 1], 3) * [1.5, 1.5, 1.0]
        self.prior_cov = np.diag(np.square([1.5, 1.5, 1.0]))

    def problem(self) -> alignment.Problem:
        problem = alignment.make_problem(self.points + 1)
        known = np.ones(self.points, dtype=np.bool_)
        m = alignment.load_maps(problem, self.a, self.cov_a, known, self.b, self.cov_b, known)
        assert m == self.points
        assert alignment.load_prior(problem, 0.0, self.height_sd, self.prior, self.prior_cov)
        return problem

    def residuals(self, y: Float) -> Float:
        size = 3 * self.points
        height = y[size] if self.height_sd else 0.0
        b = np.array([transfer(*p, *y[size + 1 :], height)[:3] for p in y[:size].reshape(-1, 3)]).ravel()

        def white(cov: Float, e: Float) -> Float:
            return np.asarray(np.linalg.solve(np.linalg.cholesky(cov), e))

        parts = [white(self.cov_a, y[:size] - self.a), white(self.cov_b, b - self.b)]
        parts.append(white(self.prior_cov, y[size + 1 :] - self.prior))
        # Where the height is exact, a unit residual keeps SciPy's problem regular.
        parts.append(np.array([y[size] / self.height_sd if self.height_sd else y[size]]))
        return np.concatenate(parts)

    def start(self) -> Float:
        return np.concatenate([self.a, [0.0], self.xi])


@pytest.mark.parametrize("height_sd", [0.0, 0.03])
@pytest.mark.parametrize("points", [1, 2, 4])
def test_the_minimum_and_its_covariance_are_scipys_5_cases_each(points: int, height_sd: float) -> None:
    for seed in range(5):
        case = Case(seed, points, height_sd)
        problem, n = case.problem(), 3 * points + 4
        y = np.concatenate([case.start(), np.zeros(3)])
        cost, log_det, ended = descent.minimise(problem, points, y, n, 100, 1e-14)
        fit = least_squares(case.residuals, case.start(), method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        assert ended
        assert_allclose(cost, 2.0 * fit.cost, rtol=1e-8, atol=1e-9)
        assert_allclose(y[:n], fit.x, atol=1e-5)
        jac: Float = np.asarray(fit.jac, dtype=np.float64)
        hessian = jac.T @ jac
        assert_allclose(log_det, np.linalg.slogdet(hessian)[1], rtol=1e-4)
        covariance = np.empty((3, 3))
        alignment.pose_covariance(problem, points, covariance)
        scale = np.sqrt(np.diag(covariance))
        expected = np.linalg.inv(hessian)[-3:, -3:]
        assert_allclose(covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4)


def test_the_gradient_is_that_of_the_cost_10_cases() -> None:
    for seed in range(10):
        case = Case(seed, 3, 0.03)
        problem, n = case.problem(), 13
        y = case.start() + 0.01 * np.random.default_rng(seed).normal(size=n)
        alignment.evaluate(problem, 3, y)
        alignment.assemble(problem, 3, y)
        gradient = problem.gradient[:n].copy()
        steps = 1e-6 * np.eye(n)
        numeric = [
            (alignment.evaluate(problem, 3, y + s) - alignment.evaluate(problem, 3, y - s)) / 4e-6 for s in steps
        ]
        assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-3)


def test_with_the_heading_fixed_the_rest_is_minimal() -> None:
    case = Case(3, 2, 0.0)
    problem = case.problem()
    y = case.start()
    y[-1] += 0.1
    descent.minimise(problem, 2, y, 9, 100, 1e-14)
    assert y[-1] == pytest.approx(case.xi[2] + 0.1)

    def rest(free: Float) -> Float:
        return case.residuals(np.append(free, y[-1]))

    fit = least_squares(rest, case.start()[:-1], method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert_allclose(y[:-1], fit.x, atol=1e-5)


def test_only_points_known_to_both_count_and_the_rest_is_marginal() -> None:
    rng = np.random.default_rng(8)
    cov_a, cov_b = positive(rng, 12), positive(rng, 12)
    a, b = rng.normal(size=12), rng.normal(size=12)
    known_a, known_b = np.array([1, 1, 0, 1], dtype=np.bool_), np.array([0, 1, 1, 1], dtype=np.bool_)
    problem = alignment.make_problem(4)
    assert alignment.load_maps(problem, a, cov_a, known_a, b, cov_b, known_b) == 2
    both = [3, 4, 5, 9, 10, 11]
    assert_allclose(problem.mean_a[:6], a[both])
    assert_allclose(problem.mean_b[:6], b[both])
    assert_allclose(problem.info_a[:6, :6], np.linalg.inv(cov_a[np.ix_(both, both)]), rtol=1e-8)
    assert_allclose(problem.info_b[:6, :6], np.linalg.inv(cov_b[np.ix_(both, both)]), rtol=1e-8)


def test_a_start_from_the_right_heading_is_the_pose_itself() -> None:
    case = Case(9, 4, 0.0)
    truth = case.start()
    case.b = np.array([transfer(*p, *case.xi, 0.0)[:3] for p in case.a.reshape(-1, 3)]).ravel()
    problem, y = case.problem(), np.zeros(16)
    alignment.start_from_heading(problem, 4, case.xi[2], 0.05, y)
    assert_allclose(y, truth, atol=1e-10)


def test_a_place_on_a_point_costs_infinity() -> None:
    case = Case(10, 2, 0.0)
    y = case.start()
    y[7], y[8] = math.cos(case.a[0]) / case.a[2], math.sin(case.a[0]) / case.a[2]
    assert alignment.evaluate(case.problem(), 2, y) == math.inf
