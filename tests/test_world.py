"""Motion, actuators and odometry against closed forms and SciPy's integrator."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.worlds import FAR_POINTS, ROW, actions, angle_between, assert_on_arc, world


def test_free_motion_is_the_exact_arc() -> None:
    """300 random poses, speeds and yaw rates, of which some are straight and some turn on the spot."""
    rng = np.random.default_rng(1)
    simulation = world(robots=1, arena=None, robot={"max_speed": 2.0, "max_yaw_rate": 3.0})
    dt = simulation.config.sample_period
    for case in range(300):
        pose = np.array([*rng.uniform(-20, 20, 2), rng.uniform(-math.pi, math.pi)])
        simulation.reset(ROW, {"poses": [pose], "points": FAR_POINTS})
        v, w = rng.uniform(-1, 1, 2)
        v, w = (0.0 if case % 7 == 0 else v), (0.0 if case % 5 == 0 else w)
        before = simulation.world.pose[0, 0].copy()
        simulation.step(actions((v, w)), ROW)
        assert_on_arc(before, simulation.world.pose[0, 0], 2.0 * v, 3.0 * w, dt)
        assert -math.pi <= simulation.world.pose[0, 0, 2] < math.pi
        np.testing.assert_allclose(simulation.world.velocity[0, 0], (2.0 * v, 0.0, 3.0 * w), atol=1e-15)


def test_free_motion_follows_the_differential_equation() -> None:
    """Twenty actions of five samples against SciPy's integrator."""
    rng = np.random.default_rng(2)
    simulation = world(robots=1, arena=None, samples_per_action=5, poses=[(1.0, 2.0, 0.3)])
    config = simulation.config
    state, period = np.array([1.0, 2.0, 0.3]), 5 * config.sample_period
    for _ in range(20):
        share = rng.uniform(-1, 1, 2)
        v, w = share[0] * config.robot_of(0).max_speed, share[1] * config.robot_of(0).max_yaw_rate

        def flow(_: float, s: NDArray[np.float64], v: float = v, w: float = w) -> list[float]:
            return [v * math.cos(s[2]), v * math.sin(s[2]), w]

        state = solve_ivp(flow, (0.0, period), state, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        simulation.step(actions((share[0], share[1])), ROW)
        np.testing.assert_allclose(simulation.world.pose[0, 0, :2], state[:2], atol=1e-10)
        assert angle_between(simulation.world.pose[0, 0, 2], state[2]) < 1e-10


def test_free_robot_keeps_to_the_arc_while_the_other_is_in_contact() -> None:
    """Robot A leans on a wall for 100 samples; B drives on arcs."""
    rng = np.random.default_rng(3)
    simulation = world(poses=[(4.81, 0.0, 0.0), (-1.0, 0.0, 1.0)], robot={"mass": 5.0})
    config = simulation.config
    touched = 0
    for _ in range(100):
        share = rng.uniform(-1, 1, 2)
        before = simulation.world.pose[0, 1].copy()
        simulation.step(actions((1.0, 0.0), (share[0], share[1])), ROW)
        touched += int(simulation.world.contact[0, 0])
        robot = config.robot_of(1)
        after, v, w = simulation.world.pose[0, 1], share[0] * robot.max_speed, share[1] * robot.max_yaw_rate
        assert_on_arc(before, after, v, w, config.sample_period)
        np.testing.assert_allclose(simulation.world.velocity[0, 1], (v, 0.0, w), atol=1e-12)
        assert not simulation.world.contact[0, 1]
    assert touched == 100


def test_first_order_lag_is_exact() -> None:
    """Response to a step from rest: u (1 - exp(-t/lag)), sampled; then down to zero again."""
    simulation = world(robots=1, arena=None, robot={"lag": (0.4, 0.15)})
    dt, robot = simulation.config.sample_period, simulation.config.robot_of(0)
    for k in range(1, 30):
        simulation.step(actions((1.0, -1.0)), ROW)
        expected = (robot.max_speed * -math.expm1(-k * dt / 0.4), 0.0, robot.max_yaw_rate * math.expm1(-k * dt / 0.15))
        np.testing.assert_allclose(simulation.world.velocity[0, 0], expected, rtol=1e-12)
    top = simulation.world.velocity[0, 0, 0]
    for k in range(1, 10):
        simulation.step(actions((0.0, 0.0)), ROW)
        np.testing.assert_allclose(simulation.world.velocity[0, 0, 0], top * math.exp(-k * dt / 0.4), rtol=1e-12)


def test_actuator_noise_has_its_size() -> None:
    """20,000 samples: mean, standard deviation, no correlation between the two or in time."""
    simulation = world(
        20, robots=1, arena=None, samples_per_action=1000, robot={"actuator_noise": (0.01, 0.03), "max_yaw_rate": 1.0}
    )
    command = np.tile([0.5, 0.2], (20, 1, 1))
    simulation.step(command, np.arange(20))
    seen = simulation.truth.velocity[:, :, 0][..., [0, 2]]
    noise = (seen - (0.15, 0.2)) / (0.01, 0.03)
    count = noise[..., 0].size
    assert (np.abs(noise.mean(axis=(0, 1))) < 4.0 / math.sqrt(count)).all()
    assert (np.abs(noise.std(axis=(0, 1)) - 1.0) < 4.0 / math.sqrt(2 * count)).all()
    assert abs((noise[..., 0] * noise[..., 1]).mean()) < 4.0 / math.sqrt(count)
    assert (np.abs((noise[:, 1:] * noise[:, :-1]).mean(axis=(0, 1))) < 4.0 / math.sqrt(count)).all()


def test_limits_hold_with_noise_and_actions_beyond_them() -> None:
    simulation = world(8, robots=1, arena=None, samples_per_action=500, robot={"actuator_noise": (0.2, 0.5)})
    robot = simulation.config.robot_of(0)
    simulation.step(np.tile([3.0, -7.0], (8, 1, 1)), np.arange(8))
    v, w = simulation.truth.velocity[:, :, 0, 0], simulation.truth.velocity[:, :, 0, 2]
    assert v.max() == robot.max_speed
    assert w.min() == -robot.max_yaw_rate
    assert np.abs(v).max() <= robot.max_speed
    assert np.abs(w).max() <= robot.max_yaw_rate


def test_reverse_is_a_matter_of_configuration() -> None:
    """With reverse an action of -1 is full speed backward; without it is a stop, and 0 half speed."""
    for reverse, speeds in ((True, (-0.3, 0.0, 0.3)), (False, (0.0, 0.15, 0.3))):
        simulation = world(robots=1, arena=None, robot={"reverse": reverse})
        for share, speed in zip((-1.0, 0.0, 1.0), speeds, strict=True):
            simulation.step(actions((share, 0.0)), ROW)
            assert abs(simulation.world.velocity[0, 0, 0] - speed) < 1e-15
    simulation = world(robots=1, arena=None, robot={"reverse": False, "actuator_noise": (0.1, 0.0)})
    for _ in range(100):
        simulation.step(actions((-1.0, 0.0)), ROW)
        assert simulation.world.velocity[0, 0, 0] >= 0.0


def test_odometry_is_the_true_motion_with_noise() -> None:
    """24,000 samples while robots slide along walls: forward speed and yaw rate, never the slide to the side."""
    simulation = world(
        12, samples_per_action=1000, poses=[(4.82, -4.0, 0.7), (-4.82, 4.0, 3.6)],
        robot={"odometry_noise": (0.02, 0.04)},
    )  # fmt: skip
    simulation.step(np.tile([0.5, 0.02], (12, 2, 1)), np.arange(12))
    measured, true = simulation.samples.odometry.astype(np.float64), simulation.truth.velocity
    assert np.abs(true[..., 1]).max() > 0.01
    assert (measured[..., 1] == 0.0).all()
    noise = (measured - true)[..., [0, 2]] / (0.02, 0.04)
    count = noise[..., 0].size
    assert (np.abs(noise.mean(axis=(0, 1, 2))) < 4.0 / math.sqrt(count)).all()
    assert (np.abs(noise.std(axis=(0, 1, 2)) - 1.0) < 4.0 / math.sqrt(2 * count)).all()
