"""The pose of one direction from that of the other, against SciPy's least squares with the right prior."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.optimize import least_squares

from relloc_env.kernels.mirroring import find_back, mirror_pair
from relloc_env.kernels.motion import relative
from relloc_env.kernels.pair_tracking import Pairs

Float = NDArray[np.float64]
NUMBERS = {"has_second": np.bool_, "aligned": np.bool_, "pending": np.bool_, "age": np.int64, "when": np.int64}
SHAPES = {"prior_covariance": (3, 3), "anchored_covariance": (3, 3), "pose_covariance": (3, 3)}
VECTORS = ("prior", "mode", "second", "anchored", "pose", "heard")


def inverse(pose: Float) -> Float:
    return np.array(relative(*pose, 0.0, 0.0, 0.0))


def empty() -> Pairs:
    """One environment, both directions of two robots."""
    shapes = SHAPES | dict.fromkeys(VECTORS, (3,))
    return Pairs._make(np.zeros((1, 2, *shapes.get(name, ())), NUMBERS.get(name, np.float64)) for name in Pairs._fields)


def half(information: Float) -> Float:
    """A square root U with Uᵀ U = information."""
    root: Float = np.asarray(np.linalg.cholesky(information).T, dtype=np.float64)
    return root


def fit(seen: Float, information: Float, prior: Float, prior_sd: Float, *, back: bool) -> tuple[Float, Float]:
    """Minimum, and covariance there, of what maps say of the pose and a prior of it, or of its inverse."""

    def residuals(pose: Float) -> Float:
        forth = inverse(pose) if back else pose
        return np.r_[half(information) @ (forth - seen), (pose - prior) / prior_sd]

    found = least_squares(residuals, inverse(seen) if back else seen, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    jac: Float = np.asarray(found.jac, dtype=np.float64)
    covariance: Float = np.asarray(np.linalg.inv(jac.T @ jac), dtype=np.float64)
    return np.asarray(found.x, dtype=np.float64), covariance


def drawn(seed: int, scale: float) -> tuple[Pairs, Float, Float]:
    """Direction 0 as aligned with its own prior; then what is right for direction 1."""
    rng = np.random.default_rng(seed)
    seen = np.array([rng.uniform(-1.0, 1.0), rng.uniform(1.0, 2.0), rng.uniform(-1.0, 1.0)])
    spread = rng.normal(size=(3, 5)) * scale * np.array([[0.03], [0.03], [0.01]])
    information = np.linalg.inv(spread @ spread.T)
    priors = np.stack([seen, inverse(seen)]) + scale * 0.1 * rng.normal(size=(2, 3))
    sds = scale * rng.uniform(0.1, 0.3, (2, 3))
    pairs = empty()
    pairs.anchored[0, 0], pairs.anchored_covariance[0, 0] = fit(seen, information, priors[0], sds[0], back=False)
    pairs.mode[0, 0] = pairs.anchored[0, 0]
    pairs.prior[0], pairs.prior_covariance[0] = priors, [np.diag(sd**2) for sd in sds]
    pairs.aligned[0, 0] = True
    expected, covariance = fit(seen, information, priors[1], sds[1], back=True)
    return pairs, expected, covariance


@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_each_direction_has_its_own_prior(scale: float) -> None:
    """Exact where all is small; else to a part of a standard deviation."""
    for seed in range(20):
        pairs, expected, covariance = drawn(seed, scale)
        assert mirror_pair(pairs, 0, 1, 0, np.zeros((18, 3)))
        sd = np.sqrt(np.diag(covariance))
        part = 1e-3 if scale < 1.0 else 0.1
        assert_allclose((pairs.anchored[0, 1] - expected) / sd, 0.0, atol=part)
        assert_allclose(pairs.mode[0, 1], pairs.anchored[0, 1], atol=1e-12)
        given = pairs.anchored_covariance[0, 1] / np.outer(sd, sd)
        assert_allclose(given, covariance / np.outer(sd, sd), atol=part)
        assert pairs.aligned[0, 1]


@pytest.mark.parametrize("why", ["heading", "second", "prior"])
def test_where_a_gaussian_will_not_do_nothing_is_changed(why: str) -> None:
    pairs, _, _ = drawn(1, 1.0)
    if why == "heading":
        pairs.anchored_covariance[0, 0] *= 100.0
    elif why == "second":
        pairs.has_second[0, 0] = True
    else:
        pairs.prior[0, 1] += 5.0
    before = [array.copy() for array in pairs]
    assert not mirror_pair(pairs, 0, 1, 0, np.zeros((18, 3)))
    for array, old in zip(pairs, before, strict=True):
        assert_array_equal(array, old)


def test_the_way_back_is_the_other_direction_if_aligned_just_now_at_the_same_time() -> None:
    pairs = empty()
    pairs.when[0, 0], pairs.aligned[0, 0] = 7, True
    assert find_back(pairs, 0, 1, 1, 0, 2, 7) == 0
    assert find_back(pairs, 0, 1, 1, 0, 2, 8) == -1
    pairs.age[0, 1] = 2
    assert find_back(pairs, 0, 1, 1, 0, 2, 7) == -1
