"""The bound against a dense filter with other states and numerical Jacobians; J, excitation and pose information.

The dense filter (`Dense`) has the states xi of each robot, (x, y, chi) of each point in A's camera and the height
differences; it is written from docs/equations.md, sections 1, 2 and 4, in plain NumPy, differentiates its own
transition and measurements by complex steps and updates in Joseph form. It shares nothing with the kernels.
"""

import numpy as np
import pytest

from relloc_env.kernels import information
from relloc_env.kernels.camera import image_flow
from relloc_env.kernels.motion import relative
from tests.kernels.dense_bound import STEP, Array, Bound, Dense, Noise, World, ahead, jacobian, moved, rotation


def _random_world(rng: np.random.Generator, robots: int, count: int, heights: bool) -> World:
    poses = rng.normal([2.0, -3.0, 0.6], [0.5, 1.0, 0.2], (robots, 3))
    bearings, ranges = rng.uniform(0.1, 1.1, count), rng.uniform(3.0, 8.0, count)
    places = poses[:, :2].mean(axis=0) + ranges[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
    points = np.column_stack([places, rng.uniform(-0.3, 0.8, count)])
    return World(poses, points, rng.normal(0.2, 0.05 * heights, robots))


def _same(found: Array, expected: Array, tolerance: float) -> None:
    """Compare covariances in units of the expected standard deviations."""
    sd = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(sd, sd), expected / np.outer(sd, sd), atol=tolerance, rtol=0.0)


CASES = {
    "one robot": (1, 2, Noise()),
    "one robot, bearings only": (1, 3, Noise(vertical=False)),
    "one robot, one point": (1, 1, Noise(image=0.003, speed=0.01, turn=0.01)),
    "pair": (2, 2, Noise()),
    "pair, depth guesses of A only": (2, 2, Noise(depth=(1.0, np.inf))),
    "pair, many points": (2, 4, Noise(image=0.003, speed=0.01, turn=0.01)),
    "pair, bearings only": (2, 3, Noise(vertical=False)),
    "pair, heights to 3 cm": (2, 2, Noise(height=0.03)),
    "three robots": (3, 2, Noise(depth=(1.0, 0.5, 2.0))),
    "three robots, heights to 10 cm": (3, 3, Noise(height=0.1)),
}


@pytest.mark.parametrize("case", CASES)
def test_bound_is_that_of_a_dense_filter(case: str) -> None:
    """60 samples of random motion (forward, lateral, turning) in 2 random worlds a case; a third of images missed."""
    robots, count, noise = CASES[case]
    rng = np.random.default_rng(sum(case.encode()))
    for _ in range(2):
        world = _random_world(rng, robots, count, noise.height > 0.0)
        dense, kernels, velocity = Dense(world, noise), Bound(world, noise), np.zeros((robots, 3))
        for sample in range(61):
            if sample % 10 < 2:
                velocity = rng.normal(0.0, [0.3, 0.1, 0.2], (robots, 3))
            if sample > 0:
                dense.move(world, velocity)
                world = moved(world, velocity)
            visible = (
                (ahead(world) > 0.5) & (rng.random((robots, count)) < 0.67) & (sample >= 5 * np.eye(robots, count))
            )
            dense.measure(world, visible)
            kernels.step(world, visible, velocity, STEP if sample > 0 else 0.0)
            if sample % 20:
                continue
            for a in range(robots):
                for b in range(robots):
                    if a != b:
                        _same(kernels.pose(world, a, b), dense.pose(world, a, b), 1e-6)
                for i in range(count):
                    _same(kernels.point(world, a, i), dense.point(world, a, i), 1e-6)


REFERENCE = {5: (0.036, 0.175, 1.5), 10: (0.032, 0.103, 1.0), 40: (0.008, 0.009, 0.2)}


def _paper_like(noise: Noise, seconds: int) -> dict[int, Array]:
    """Standard deviations [m, m, deg] at 5, 10, 40 s on the geometry of docs/equations.md, section 5."""
    points = np.array([[7.0, 0.8, 0.4], [7.0, -1.2, 0.3]])
    world = World(np.array([[0.0, -0.8, -0.1], [0.0, 1.0, 0.25]]), points, np.zeros(2))
    velocity = np.array([[0.1, 0.0, 0.02], [0.1, 0.0, -0.03]])
    kernels, visible, found = Bound(world, noise), np.ones((2, 2), dtype=bool), {}
    kernels.step(world, visible, velocity, 0.0)
    for sample in range(1, 20 * seconds + 1):
        world = moved(world, velocity)
        kernels.step(world, visible, velocity, STEP)
        if sample in (100, 200, 800):
            found[sample // 20] = np.sqrt(np.diag(kernels.pose(world, 0, 1))) * [1.0, 1.0, 180.0 / np.pi]
    return found


def test_published_bound() -> None:
    """docs/equations.md, section 5, to the digits printed there, with the depth guesses of both robots."""
    found = _paper_like(Noise(depth=(1.0, 1.0), unseen=100.0), 40)
    for seconds, expected in REFERENCE.items():
        assert np.all(np.abs(found[seconds] - expected) <= [0.0005, 0.0005, 0.05])


def test_published_bound_with_the_guesses_of_one_robot() -> None:
    """The same with the guesses of A only: the second figure after 5 s is 0.1757, a unit of the last digit higher."""
    found = _paper_like(Noise(depth=(1.0, np.inf), unseen=100.0), 40)
    for seconds, expected in REFERENCE.items():
        assert np.all(np.abs(found[seconds] - expected) <= [0.0005, 0.001, 0.05])


def test_published_bound_with_a_height_difference() -> None:
    """Camera heights to 3 cm: [0.12, 0.20, 1.6°] after 10 s."""
    found = _paper_like(Noise(depth=(1.0, 1.0), height=0.03, unseen=100.0), 10)
    assert np.all(np.abs(found[10] - [0.12, 0.20, 1.6]) <= [0.005, 0.005, 0.05])


def test_bound_does_not_depend_on_the_place_of_the_world() -> None:
    """The same scene turned by 2 rad and moved by (20, -30) m, 100 samples."""
    noise, rng = Noise(), np.random.default_rng(4)
    world = _random_world(rng, 2, 2, heights=False)
    turned_poses = np.column_stack(
        [world.poses[:, :2] @ rotation(2.0).T + np.array([20.0, -30.0]), world.poses[:, 2] + 2.0]
    )
    turned_points = np.column_stack([world.points[:, :2] @ rotation(2.0).T + [20.0, -30.0], world.points[:, 2]])
    other = World(turned_poses, turned_points, world.heights)
    here, there = Bound(world, noise), Bound(other, noise)
    velocity = np.array([[0.2, 0.0, 0.1], [-0.1, 0.05, -0.2]])
    for sample in range(101):
        if sample > 0:
            world, other = moved(world, velocity), moved(other, velocity)
        visible = ahead(world) > 0.3
        here.step(world, visible, velocity, STEP if sample else 0.0)
        there.step(other, visible, velocity, STEP if sample else 0.0)
    _same(there.pose(other, 0, 1), here.pose(world, 0, 1), 1e-8)
    _same(there.point(other, 1, 0), here.point(world, 1, 0), 1e-8)


def test_bound_of_a_straight_step_is_the_limit_of_an_arc() -> None:
    """w = 0 and w = 1e-4 rad/s, either side of the series of the arc, give the same noise."""
    found = []
    for w in (0.0, 1e-4):
        world = World(np.array([[0.0, 0.0, 0.3]]), np.array([[4.0, 1.0, 0.2]]), np.zeros(1))
        kernels = Bound(world, Noise(unseen=0.01))
        for _ in range(10):
            kernels.step(world, np.zeros((1, 1), dtype=bool), np.array([[0.3, 0.1, w]]), STEP)
        found.append(kernels.covariance)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-5, atol=1e-12)


def test_bound_stays_triangular_and_positive() -> None:
    """20,000 samples of a pair that circles and sees everything half the time."""
    world = World(
        np.array([[0.0, 0.0, 0.0], [0.5, -1.0, 0.1]]), np.array([[3.0, 0.5, 0.2], [3.0, -1.0, 0.5]]), np.zeros(2)
    )
    kernels = Bound(world, Noise(unseen=100.0))
    velocity = np.array([[0.3, 0.0, 0.8], [0.3, 0.0, -0.6]])
    for sample in range(20_000):
        world = moved(world, velocity)
        kernels.step(world, (ahead(world) > 0.3) & (sample // 100 % 2 == 0), velocity, STEP)
    np.testing.assert_array_equal(np.tril(kernels.kept.factor), np.eye(len(kernels.kept.factor)))
    assert kernels.kept.variances.min() > 0.0


def test_information_j() -> None:
    """J of pose and depths from their definitions, after 40 samples of a random pair (10 cases)."""
    rng = np.random.default_rng(8)
    for _ in range(10):
        world = _random_world(rng, 2, 3, heights=False)
        kernels, velocity = Bound(world, Noise()), rng.normal(0.0, 0.2, (2, 3))
        for _ in range(40):
            world = moved(world, velocity)
            kernels.step(world, ahead(world) > 0.3, velocity, STEP)
        j = kernels.j(world)
        assert j == pytest.approx(-np.linalg.slogdet(kernels.pose(world, 0, 1))[1] / 6.0, abs=1e-9)
        assert j == pytest.approx(-np.linalg.slogdet(kernels.pose(world, 1, 0))[1] / 6.0, abs=1e-9)
        for robot in (0, 1):
            expected = []
            for i in range(3):
                q_x, q_y, _ = relative(*(*world.poses[robot], *world.points[i, :2], 0.0))
                ray = np.array([q_x, q_y, 0.0]) / np.hypot(q_x, q_y)
                expected.append(-np.log(np.sqrt(ray @ kernels.point(world, robot, i) @ ray) / 0.1))
            found = kernels.depth_j(world, robot)
            assert found == pytest.approx(np.mean(expected), abs=1e-9)


def test_information_of_a_first_glance() -> None:
    """Straight ahead, only the guess of 1 m tells the depth: J = -log(1 m / 0.1 m), up to the width of the prior."""
    world = World(
        np.array([[1.0, 2.0, 0.5]]), np.array([[1.0 + 5.0 * np.cos(0.5), 2.0 + 5.0 * np.sin(0.5), 0.0]]), np.zeros(1)
    )
    kernels = Bound(world, Noise(unseen=1e3))
    kernels.step(world, np.ones((1, 1), dtype=bool), np.zeros((1, 3)), 0.0)
    j = kernels.depth_j(world, 0)
    assert j == pytest.approx(-np.log(10.0), abs=1e-6)


def test_excitation() -> None:
    """sigma² = ‖d(image flow)/dchi‖² in 100 random cases, and the paper's four points at v = 0.1 m/s."""
    rng = np.random.default_rng(1)
    for x, y, v, lateral, w in rng.normal(size=(100, 5)):
        high, low = (np.array(image_flow(x, y, chi, v, lateral, w)[:2]) for chi in (0.7, 0.2))
        expected = np.sum(((high - low) / 0.5) ** 2)
        assert information.excitation(x, y, v, lateral) == pytest.approx(expected, rel=1e-9)
    places = [(0.0, 0.0, 0.0), (0.0, 1.0, 0.01), (1.0, 0.0, 0.01), (1.0, 1.0, 0.02)]
    for x, y, expected in places:
        assert information.excitation(x, y, 0.1, 0.0) == pytest.approx(expected, abs=1e-15)


def test_pose_gramian() -> None:
    """Against the Jacobian of R(theta)ᵀ (q_A - r), and sum ‖q_B - mean‖² / sd² for theta alone (20 random cases)."""
    rng = np.random.default_rng(6)
    for count in (2, 5) * 10:
        q_b, theta, sd = rng.normal(3.0, 2.0, (count, 2)), rng.uniform(-3.0, 3.0), 0.05
        xi = np.array([*rng.normal(size=2), theta])
        q_a = q_b @ rotation(theta).T + xi[:2]
        h = jacobian(lambda s, q_a=q_a: np.ravel((q_a - s[:2]) @ rotation(s[2])), xi)  # type: ignore[misc]
        gramian = np.zeros((3, 3))
        information.pose_gramian(q_b, theta, sd, gramian)
        np.testing.assert_allclose(gramian, h.T @ h / sd**2, rtol=1e-10, atol=1e-9)
        expected = np.sum((q_b - q_b.mean(axis=0)) ** 2) / sd**2
        assert 1.0 / np.linalg.inv(gramian)[2, 2] == pytest.approx(expected, rel=1e-9)
