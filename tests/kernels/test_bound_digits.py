"""The factors of the bound keep their digits: J against 60 digits (`exact_bound`), in configurations of any size."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from relloc_env.kernels import bound, information
from relloc_env.kernels.factors import factorise
from relloc_env.kernels.motion import advance
from relloc_env.kernels.state_layout import size_of
from tests.kernels.exact_bound import Task, exact

TOLERANCE = 1e-9
"""[nat] of J."""


def drawn(seed: int, samples: int = 5, count: int = 2, *, straight: bool = False, **numbers: Any) -> Task:
    """Two robots that see every point in most samples, with these noises and priors."""
    rng = np.random.default_rng(seed)
    told: dict[str, Any] = {
        "image_sd": 0.002, "speed_sd": 0.01, "turn_sd": 0.01, "depth_sd": 1.0, "pose_sd": (1.5, 1.5, np.pi / 3.0),
        "unseen_sd": 100.0,
    }  # fmt: skip
    velocity = rng.uniform([-0.3, -0.8], [0.3, 0.8], (samples, 2, 2))
    if straight:
        velocity[:] = (0.3, 0.0)
    return Task(
        start=np.column_stack([rng.uniform(-1.0, 1.0, 2), [-1.0, 1.0], rng.uniform(-0.3, 0.3, 2)]),
        points=rng.uniform([3.0, -1.5, 0.0], [6.0, 1.5, 0.8], (count, 3)),
        heights=np.array([0.3, 0.35]),
        velocity=velocity,
        visible=(rng.random((samples, 2, count)) < 0.8) | (np.arange(samples) == 0)[:, None, None],
        period=0.05,
        **(told | numbers),
    )


def found(task: Task, origin: tuple[float, float] = (0.0, 0.0)) -> tuple[float, list[float]]:
    """What the kernels make of it, with the bound's twists about `origin`."""
    count = len(task.points)
    size = size_of(2, count)
    sighted = np.zeros((2, count), np.bool_)
    kept = bound.Bound(np.zeros((size, size)), np.zeros(size), sighted, np.zeros((4, size)))
    told = (task.speed_sd, task.turn_sd, task.image_sd, task.depth_sd)
    noise = bound.Noise(*(np.full(2, sd) for sd in told))
    poses = task.start.copy()
    for k, u in enumerate(task.velocity):
        velocity = np.column_stack([u[:, 0], np.zeros(2), u[:, 1]])
        if k > 0:
            poses = np.array([advance(*p, *v, task.period) for p, v in zip(poses, velocity, strict=True)])
        scene = bound.Scene(poses, task.points, task.heights, np.array(origin))
        if k == 0:
            bound.bound_reset(kept, scene, bound.Prior(np.array(task.pose_sd), task.unseen_sd, 0.0, 0.0, 0.0))
        bound.bound_step(kept, scene, noise, task.visible[k], velocity, task.period if k else 0.0, True)
    variances, depths = np.zeros(count), []
    for robot in range(2):
        information.range_variances(kept, scene, robot, variances)
        depths.append(float(information.depth_information(variances)))
    assert kept.variances.min() > 0.0
    return float(information.pose_information(kept, scene, 1)), depths


CASES: dict[str, dict[str, Any]] = {
    "as by default": {},
    "three points": {"count": 3},
    "no odometry noise": {"speed_sd": 0.0, "turn_sd": 0.0},
    "no odometry noise, straight": {"speed_sd": 0.0, "turn_sd": 0.0, "straight": True},
    "least noise": {"speed_sd": 0.0, "turn_sd": 0.0, "image_sd": 1e-4},
    "tiny odometry noise": {"speed_sd": 1e-9, "turn_sd": 1e-9},
    "nothing known of the position": {"pose_sd": (1e6, 1e6, np.pi / 3.0)},
    "nothing known of the heading": {"pose_sd": (1.5, 1.5, np.radians(1e9))},
    "priors of unlike size": {"pose_sd": (1e-6, 1e9, 1e-6)},
    "no prior, no noise, straight": {
        "pose_sd": (1e9, 1e9, 1e9), "depth_sd": 1e9, "speed_sd": 0.0, "turn_sd": 0.0, "image_sd": 1e-4,
        "straight": True,
    },
    "certain priors": {"pose_sd": (1e-6, 1e-6, 1e-6), "depth_sd": 1e-6},
    "useless odometry": {"speed_sd": 1e9, "turn_sd": 1e9},
    "useless images": {"image_sd": 1e9},
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_information_is_exact(case: str) -> None:
    """J of the pose and of both robots' depths, about an origin nearby and one 700 m away."""
    task = drawn(sum(case.encode()), **CASES[case])
    pose, depths = exact(task)
    for origin in ((0.0, 0.0), (500.0, -500.0)):
        found_pose, found_depths = found(task, origin)
        assert found_pose == pytest.approx(pose, rel=0.0, abs=TOLERANCE)
        assert found_depths == pytest.approx(depths, rel=0.0, abs=TOLERANCE)


def sizes(low: int, high: int) -> st.SearchStrategy[float]:
    """Numbers of every magnitude between powers of ten."""
    return st.floats(low, high).map(lambda power: 10.0**power)


@settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 1000),
    straight=st.booleans(),
    image_sd=sizes(-4, 4),
    speed_sd=st.just(0.0) | sizes(-9, 6),
    turn_sd=st.just(0.0) | sizes(-9, 6),
    depth_sd=sizes(-6, 9),
    pose_sd=st.tuples(sizes(-6, 9), sizes(-6, 9), sizes(-6, 9)),
    unseen_sd=sizes(0, 6),
)
def test_information_is_exact_whatever_the_sizes(**numbers: Any) -> None:
    """Twelve combinations of noises and priors of any size, four samples each."""
    task = drawn(samples=4, **numbers)
    pose, depths = exact(task)
    found_pose, found_depths = found(task)
    assert found_pose == pytest.approx(pose, rel=0.0, abs=TOLERANCE)
    assert found_depths == pytest.approx(depths, rel=0.0, abs=TOLERANCE)


def test_factors_of_a_covariance() -> None:
    """U D Uᵀ is the matrix that was factored, of 20 random ones; a singular one gets positive factors that are near."""
    rng = np.random.default_rng(3)
    for case in range(20):
        root = rng.normal(size=(6, 6))
        root[:, 0] *= case % 2  # every other is singular
        covariance = root @ root.T
        factor, variances = np.zeros((6, 6)), np.zeros(6)
        factorise(covariance.copy(), factor, variances)
        np.testing.assert_array_equal(np.tril(factor), np.eye(6))
        assert variances.min() > 0.0
        np.testing.assert_allclose(factor @ np.diag(variances) @ factor.T, covariance, atol=1e-11)
