"""The depth observers of a batch, sample by sample: steps, gaps, slow cameras, bearings, points behind."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from relloc_env.kernels import camera
from tests.kernels.observers import (
    COVARIANCE,
    ESTIMATE,
    KNOWN,
    POINT,
    SETTINGS,
    TIME,
    Observers,
    Settings,
    observer_step,
)

Float = NDArray[np.float64]


def body(point: Float, pose: Float) -> Float:
    """Return a point of the world in the body frame of a planar pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    d = point[:2] - pose[:2]
    return np.array([c * d[0] + s * d[1], c * d[1] - s * d[0], point[2]])


def drive(pose: Float, velocity: Float, dt: float) -> Float:
    """Return the pose after an exact arc, from the kinematics in the complex plane."""
    v, w = complex(velocity[0], velocity[1]), velocity[2]
    turn = dt if w == 0 else (np.exp(1j * w * dt) - 1) / (1j * w)
    step = v * turn * np.exp(1j * pose[2])
    return pose + np.array([step.real, step.imag, w * dt])


def poses_along(velocities: Float, dt: float) -> Float:
    poses = [np.zeros(3)]
    for velocity in velocities:
        poses.append(drive(poses[-1], velocity, dt))
    return np.array(poses)


class Follower(Observers):
    """One point."""

    def __init__(self, settings: Settings = SETTINGS, depth: float = 5.0) -> None:
        super().__init__(1, settings, depth=depth)

    def sample(self, velocity: Any, dt: Any, image: Any, seen: Any = True, robot: int = 0) -> Float:
        return super().sample(velocity, dt, image, seen, robot)[0]

    @property
    def row(self) -> Float:
        return self.numbers[0]


def image(q: Float) -> Float:
    return np.array([-q[1] / q[0], -q[2] / q[0]])


def random_walk(rng: np.random.Generator, count: int, dt: float) -> tuple[Float, Float]:
    """Return velocities (slowly varying) and the poses along them."""
    t = np.arange(count) * dt
    phases = rng.uniform(0, 6, 2)
    v = 0.2 + 0.1 * np.sin(1.3 * t + phases[0])
    w = 0.15 * np.sin(0.9 * t + phases[1])
    velocities = np.column_stack([v, 0.05 * np.cos(t), w])
    return velocities, poses_along(velocities, dt)


def test_a_point_seen_in_every_sample_is_one_observer_step_each() -> None:
    rng = np.random.default_rng(1)
    velocities, poses = random_walk(rng, 100, 0.05)
    images = [image(body(np.array([4.0, 1.0, 0.5]), pose)) for pose in poses]
    follower = Follower()
    assert follower.row[KNOWN] == 0
    follower.sample([0, 0, 0], 0.0, images[0])
    state = np.array([*images[0], 1 / 5])
    for velocity, before, now in zip(velocities, images, images[1:], strict=False):
        q = follower.sample(velocity, 0.05, now)
        state = observer_step(before, now, state, velocity, 0.05, 2.5, 120.0)
        assert follower.row[ESTIMATE] == pytest.approx(state, rel=1e-11)
        assert q == pytest.approx(np.array([1, -state[0], -state[1]]) / state[2], rel=1e-11)
        assert follower.row[TIME] == 0
    assert follower.row[KNOWN] == 1
    assert follower.image_now(0.1)[0] == pytest.approx(state)


def test_unseen_it_is_the_image_flow_in_open_loop() -> None:
    """60 random cases against the integrated image flow."""
    rng = np.random.default_rng(4)
    for _ in range(60):
        x, y, chi = rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(0.1, 1)
        u, dt = rng.uniform(-0.5, 0.5, 3), rng.uniform(0.05, 0.5)

        def rate(_: float, s: Float, u: Float = u) -> Any:
            return camera.image_flow(*s, *u)

        expected = solve_ivp(rate, (0, dt), (x, y, chi), method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        follower = Follower(depth=1 / chi)
        follower.sample([0, 0, 0], 0.0, [x, y])
        follower.sample(u, dt, [0, 0], seen=False)
        assert follower.image_now(0.05)[0] == pytest.approx(expected, rel=1e-9, abs=1e-11)


def test_past_the_camera_its_image_stays_finite_and_on_its_side() -> None:
    """0.5 m ahead and 0.25 m to the right, 2 m driven: put at 0.1 m."""
    follower = Follower(depth=0.5)
    follower.sample([0, 0, 0], 0.0, [0.5, 0.2])
    follower.sample([1, 0, 0], 2.0, [0, 0], seen=False)
    assert follower.image_now(0.1)[0] == pytest.approx([2.5, 1.0, 10.0], rel=1e-12)


def test_unseen_it_moves_as_a_static_point_does_also_behind_the_camera() -> None:
    """A full turn on the spot and a drive past: the remembered point is the rigid motion of the one last seen."""
    rng = np.random.default_rng(2)
    follower = Follower()
    seen = follower.sample([0, 0, 0], 0.0, [0.2, -0.1])
    assert seen == pytest.approx([5.0, -1.0, 0.5])
    velocities = np.vstack([np.tile([0.0, 0.0, 1.0], (126, 1)), rng.uniform([0, -1, -1], [2, 1, 1], (300, 3))])
    for velocity, pose in zip(velocities, poses_along(velocities, 0.05)[1:], strict=True):
        q = follower.sample(velocity, 0.05, [0.0, 0.0], seen=False)
        assert q == pytest.approx(body(seen, pose), abs=1e-11)
        x, y, chi = follower.image_now(0.1)[0]
        assert np.isfinite([x, y, chi]).all()
        assert 0 < chi <= 10
    assert follower.row[TIME] == pytest.approx(426 * 0.05)


def test_never_seen_stays_unknown() -> None:
    follower = Follower()
    for _ in range(5):
        follower.sample([0.1, 0, 0.1], 0.05, [0, 0], seen=False)
    assert not follower.row.any()


def test_depth_guess_is_clipped() -> None:
    assert Follower(depth=500.0).sample([0, 0, 0], 0.0, [0, 0])[0] == pytest.approx(100)
    assert Follower(depth=-1.0).sample([0, 0, 0], 0.0, [0, 0])[0] == pytest.approx(0.1)


def observe_walk(period: float, every: int, gap: tuple[float, float] = (0, 0)) -> tuple[Any, Any, Any]:
    """Drive 6 s with a smooth motion, camera at every so many samples: estimates, truth, times."""
    count = round(6 / period)
    middle = (np.arange(count) + 0.5) * period
    velocities = np.column_stack([0.25 + 0.1 * np.sin(middle), 0 * middle, 0.2 * np.cos(0.8 * middle)])
    poses = poses_along(velocities, period)
    point = np.array([4.0, 1.6, 0.8])
    follower = Follower(depth=4.5)
    estimates, truth = [], []
    for k, pose in enumerate(poses):
        q = body(point, pose)
        seen = k % every == 0 and not gap[0] < k * period < gap[1]
        velocity = velocities[k - 1] if k else np.zeros(3)
        estimates.append(follower.sample(velocity, period if k else 0.0, image(q), seen))
        truth.append(q)
    return np.array(estimates), np.array(truth), np.arange(count + 1) * period


def test_a_slow_camera_is_followed_at_second_order() -> None:
    """Odometry at 80 Hz, camera at 5, 10, 20 Hz, varying velocity: depth against the continuous observer."""
    point = np.array([4.0, 1.6, 0.8])

    def rate(t: float, p: Float) -> list[float]:
        v, w = 0.25 + 0.1 * math.sin(t), 0.2 * math.cos(0.8 * t)
        x, y, chi, xh, yh, ch = p
        excitation = v * (x * (x - xh) + y * (y - yh))
        return [
            w * (1 + x * x) + v * x * chi,
            w * x * y + v * y * chi,
            v * chi * chi + w * x * chi,
            w * (1 + x * x) + v * x * ch + 2.5 * (x - xh),
            w * x * y + v * y * ch + 2.5 * (y - yh),
            v * ch * ch + w * x * ch + 120 * excitation,
        ]

    s = image(point)
    start = [*s, 1 / point[0], *s, 1 / 4.5]
    errors = []
    for every in (16, 8, 4):
        estimates, _, times = observe_walk(1 / 80, every)
        exact = solve_ivp(rate, (0, 6), start, method="DOP853", rtol=1e-10, atol=1e-12, t_eval=times).y
        errors.append(np.abs(estimates[::every, 0] - 1 / exact[5, ::every]).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.8).all()
    assert errors[-1] < 5e-3


def test_between_frames_the_point_is_the_prediction_from_the_last_one() -> None:
    estimates, _, _ = observe_walk(0.05, 4)
    middle = (np.arange(120) + 0.5) * 0.05
    velocities = np.column_stack([0.25 + 0.1 * np.sin(middle), 0 * middle, 0.2 * np.cos(0.8 * middle)])
    for k in range(121):
        last = k - k % 4
        pose = poses_along(velocities[last:k], 0.05)[-1]
        assert estimates[k] == pytest.approx(body(estimates[last], pose), abs=1e-12)


def test_a_gap_keeps_the_prediction_and_then_the_error_falls_on() -> None:
    estimates, truth, times = observe_walk(0.05, 1, gap=(2.02, 3.98))
    error = np.abs(estimates - truth)
    distance = np.linalg.norm(estimates[:, :2] - truth[:, :2], axis=1)
    inside = (times > 2.02) & (times < 4.02)  # the first sample after the gap still shows the prediction
    assert np.ptp(distance[inside]) < 1e-9
    assert error[-1, 0] < 0.5 * error[inside, 0].max() < error[0, 0]


def test_a_point_predicted_behind_the_camera_starts_anew_where_it_is_seen() -> None:
    follower = Follower(depth=1.0)
    follower.sample([0, 0, 0], 0.0, [0.5, 0.0])
    for _ in range(40):
        follower.sample([1, 0, 0], 0.05, [0.0, 0.0], seen=False)
    assert follower.numbers[0, POINT[0]] == pytest.approx(-1)
    q = follower.sample([1, 0, 0], 0.05, [0.75, 0.2])
    distance = math.hypot(-1.05, 0.5)
    assert q == pytest.approx(np.array([1, -0.75, -0.2]) * distance / math.hypot(1, 0.75))
    assert np.isfinite(follower.row).all()


def test_bearings_without_height_use_the_horizontal_part_alone() -> None:
    """The same depth as a sensor gives that sees the point at the height of the camera; y stays 0."""
    rng = np.random.default_rng(3)
    velocities, poses = random_walk(rng, 100, 0.05)
    for critical in (False, True):
        bearing = Follower(SETTINGS._replace(critical=critical))
        level = Follower(SETTINGS._replace(critical=critical))
        for k, pose in enumerate(poses):
            x = image(body(np.array([4.0, 1.0, 0.5]), pose))[0]
            velocity, dt = (velocities[k - 1], 0.05) if k else (np.zeros(3), 0.0)
            q = bearing.sample(velocity, dt, [x, math.nan], seen=k % 7 != 6)
            assert q == pytest.approx(level.sample(velocity, dt, [x, 0.0], seen=k % 7 != 6), rel=1e-14)
            assert q[2] == 0
        p, expected = bearing.row[COVARIANCE], level.row[COVARIANCE]
        assert p[[0, 1, 3]] == pytest.approx(expected[[0, 1, 3]], rel=1e-12)
        assert (p[[2, 4, 5]] == 0).all()


def random_samples(count: int, samples: int) -> list[tuple[Any, ...]]:
    rng = np.random.default_rng(4)
    odometry = rng.uniform(-0.5, 0.5, (samples, count, 3))
    images, seen = rng.uniform(-0.6, 0.6, (samples, count, 2)), rng.random((samples, count)) < 0.6
    return [(u, 0.05, s, there) for u, s, there in zip(odometry, images, seen, strict=True)]


def test_copied_numbers_go_on_alike() -> None:
    """What is remembered is all that there is: put back where something else was, it goes on with the same bits."""
    samples = random_samples(13, 40)
    settings = SETTINGS._replace(critical=True)
    first, second = Observers(13, settings), Observers(13, settings)
    for k in range(20):
        first.sample(*samples[k])
        second.sample(*samples[39 - k])
    saved = first.numbers
    assert not (saved == second.numbers).all()
    second.restore(saved)
    for sample in samples[20:]:
        np.testing.assert_array_equal(first.sample(*sample), second.sample(*sample))
    np.testing.assert_array_equal(first.numbers, second.numbers)
    assert not (saved == first.numbers).all()


def test_each_robot_has_settings_of_its_own() -> None:
    samples, critical = random_samples(8, 20), SETTINGS._replace(critical=True)
    pair, usual, other = Observers(8, SETTINGS, critical), Observers(8, SETTINGS), Observers(8, critical)
    for velocity, dt, images, seen in samples:
        q = pair.sample(velocity, dt, images, seen, robot=1)
        np.testing.assert_array_equal(q, other.sample(velocity, dt, images, seen))
        usual.sample(velocity, dt, images, seen)
    assert not (pair.numbers == usual.numbers).all()
