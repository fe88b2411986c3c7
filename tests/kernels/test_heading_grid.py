"""Moments over headings against a sum over very many headings, each minimised by SciPy; and valleys that are narrow."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.optimize import least_squares

from relloc_env.kernels import alignment, descent
from relloc_env.kernels.heading_grid import COST, heading_grid, make_nodes
from relloc_env.kernels.local_map import transfer

Float = NDArray[np.float64]
POINTS = 2
PRIOR_SD = np.array([1.5, 1.5, 1.0])


class Case:
    """Two points as two robots have them: bearings and elevations known well, ranges badly."""

    def __init__(self, seed: int, bearing_sd: float, rho_sd: float) -> None:
        rng = np.random.default_rng(seed)
        self.xi = np.array([rng.uniform(-1.0, 0.5), rng.uniform(1.0, 2.0), rng.uniform(-0.5, 0.0)])
        q = np.array([[4.0, -1.0], [5.5, 1.5]]) + rng.uniform(-0.5, 0.5, (2, 2))
        reach = np.hypot(*q.T)
        a = np.stack([np.arctan2(q[:, 1], q[:, 0]), rng.uniform(-0.1, 0.2, 2), 1.0 / reach], axis=1)
        b = np.array([transfer(*p, *self.xi, 0.0)[:3] for p in a])
        self.sd = np.tile([bearing_sd, bearing_sd, rho_sd], POINTS)
        self.a, self.b = (truth.ravel() + self.sd * rng.normal(size=6) for truth in (a, b))
        self.prior = self.xi + 0.5 * PRIOR_SD * rng.choice([-1.0, 1.0], 3)

    def problem(self) -> alignment.Problem:
        problem, known, cov = alignment.make_problem(POINTS), np.ones(POINTS, np.bool_), np.diag(self.sd**2)
        assert alignment.load_maps(problem, self.a, cov, known, self.b, cov, known) == POINTS
        assert alignment.load_prior(problem, 0.0, 0.0, self.prior, np.diag(PRIOR_SD**2))
        return problem

    def residuals(self, free: Float, theta: float) -> Float:
        b = np.array([transfer(*p, free[6], free[7], theta, 0.0)[:3] for p in free[:6].reshape(-1, 3)]).ravel()
        xi = np.array([free[6], free[7], theta])
        return np.concatenate([(free[:6] - self.a) / self.sd, (b - self.b) / self.sd, (xi - self.prior) / PRIOR_SD])

    def moments(self, best: Float, reach: float) -> tuple[Float, Float]:
        """Mean and covariance over 241 headings within `reach` of the best one."""
        found, at = [], np.r_[best[:6], best[7:9]]
        headings = best[9] + np.linspace(-reach, reach, 241)
        for part in (headings[120:], headings[119::-1]):
            at = np.r_[best[:6], best[7:9]]
            for theta in part:
                fit = least_squares(self.residuals, at, args=(theta,), method="lm", x_scale=np.r_[self.sd, 1.0, 1.0])
                jac: Float = np.asarray(fit.jac, dtype=np.float64)
                at, hessian = fit.x, jac.T @ jac
                weight = -fit.cost - 0.5 * np.linalg.slogdet(hessian)[1]
                found.append((weight, np.r_[at[6:], theta], np.linalg.inv(hessian)[6:, 6:]))
        weights = np.exp(np.array([f[0] for f in found]) - max(f[0] for f in found))
        weights /= weights.sum()
        poses = np.array([f[1] for f in found])
        mean = weights @ poses
        covariance = np.einsum("n,ni,nj->ij", weights, poses - mean, poses - mean)
        covariance[:2, :2] += np.einsum("n,nij->ij", weights, np.array([f[2] for f in found]))
        return mean, covariance


@pytest.mark.parametrize(("bearing_sd", "rho_sd"), [(0.002, 0.03), (0.002, 0.01), (0.0005, 0.001)])
def test_moments_are_those_of_many_headings_however_wide_the_posterior_was_thought_to_be(
    bearing_sd: float, rho_sd: float
) -> None:
    """2 cases each; a peak much narrower than the first nodes' spacing, or wider than what they span, is found out."""
    for seed in range(2):
        case = Case(seed, bearing_sd, rho_sd)
        problem, y = case.problem(), np.r_[case.a, 0.0, case.xi]
        descent.settle(problem, POINTS, y, 10, 30, 1e-8)
        covariance = np.zeros((3, 3))
        alignment.pose_covariance(problem, POINTS, covariance)
        laplace = float(np.sqrt(covariance[2, 2]))
        expected_mean, expected = case.moments(y, min(6.0 * laplace, np.pi))
        scale = np.sqrt(np.diag(expected))
        for sd in (0.3 * laplace, laplace, 0.3):
            mean, nodes = np.zeros(3), make_nodes(POINTS)
            best, none = y.copy(), np.zeros(3)
            node = heading_grid(problem, POINTS, best, none, False, sd, 30, 1e-8, nodes, mean, covariance)
            assert nodes[node, COST] >= alignment.evaluate(problem, POINTS, y) - 1e-6
            assert_allclose((mean - expected_mean) / scale, 0.0, atol=0.05)
            assert_allclose(covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.1)


def test_where_a_minimum_is_not_found_soon_holding_the_pose_first_helps() -> None:
    """600 cases: ranges of A's own map are far from where both maps agree, bearings are known to 1e-4 to 1e-3."""
    gains = []
    for seed in range(600):
        case = Case(10 + seed, (1e-4, 1e-3)[seed % 2], 0.08)
        problem, start = case.problem(), np.r_[case.a, 0.0, case.xi + 0.2]
        *_, ended = descent.minimise(problem, POINTS, start.copy(), 10, 12, 1e-6)
        if not ended:
            plain, _, _ = descent.minimise(problem, POINTS, start.copy(), 10, 30, 1e-6)
            gains.append(plain - descent.settle(problem, POINTS, start.copy(), 10, 30, 1e-6)[0])
    assert len(gains) >= 10
    assert sum(gain > 0.1 for gain in gains) > 2 * sum(gain < -0.1 for gain in gains)
    assert np.mean(gains) > 1.0
