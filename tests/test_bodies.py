"""Bodies in contact against geometry and momentum; the same alone, in a batch, and after any history."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from relloc_env.simulation import Simulation
from tests.worlds import CLUTTER, ROW, actions, angle_between, gap, random_driving, world


def test_bodies_stay_apart_and_inside() -> None:
    """24 environments, 800 samples each at full speed among obstacles: no overlap beyond 5 mm."""
    rng = np.random.default_rng(4)
    simulation = world(24, **CLUTTER)
    config, rows = simulation.config, np.arange(24)
    contacts, least = 0, math.inf
    for step in range(800):
        if step % 20 == 0:
            held = random_driving(rng, 24)
        simulation.step(held, rows)
        contacts += int(simulation.world.contact.sum())
        least = min(least, *(gap(config, poses) for poses in simulation.world.pose))
        assert np.isfinite(simulation.world.pose).all()
    assert least > -0.005
    assert contacts > 2000


def test_contact_flag_says_what_touches() -> None:
    """A robot that leans on a wall, a disc, a box, or the other robot is in contact at each sample; else it is not."""
    against = {"wall": (1.83, 0.0, 0.0), "disc": (0.0, 0.63, math.pi / 2), "box": (0.0, -0.63, -math.pi / 2)}
    for name, pose in against.items():
        simulation = world(
            robots=1, arena=(4.03, 4.0), poses=[pose],
            obstacles=[{"shape": "disc", "position": (0.0, 1.0), "radius": 0.18},
                       {"shape": "box", "position": (0.0, -1.0), "size": (0.8, 0.36)}],
        )  # fmt: skip
        simulation.step(actions((1.0, 0.0)), ROW)
        for _ in range(20):
            simulation.step(actions((1.0, 0.0)), ROW)
            assert simulation.world.contact[0, 0], name
        for _ in range(5):
            simulation.step(actions((-1.0, 0.0)), ROW)
        assert not simulation.world.contact[0, 0], name


@pytest.mark.parametrize("degrees", [20, 45, 70])
def test_robot_slides_along_a_wall(degrees: int) -> None:
    """The wall stops the part of the speed that goes into it; friction 0.3 takes at most 0.3 times as much."""
    angle = math.radians(degrees)
    simulation = world(robots=1, poses=[(4.82, -3.0, angle)])
    speed, dt = simulation.config.robot_of(0).max_speed, simulation.config.sample_period
    for _ in range(20):
        y, theta = simulation.world.pose[0, 0, 1:].copy()
        simulation.step(actions((1.0, 0.0)), ROW)
        along, into = speed * math.sin(theta), speed * math.cos(theta)
        moved = (simulation.world.pose[0, 0, 1] - y) / dt
        assert along - 0.3 * into - 0.01 <= moved <= along + 0.01
        assert abs(simulation.world.pose[0, 0, 0] - 4.82) < 0.003
    assert simulation.world.pose[0, 0, 1] > -3.0 + 0.5 * math.sin(angle) * speed * 20 * dt


@pytest.mark.parametrize(("mass_a", "mass_b"), [(5.0, 5.0), (2.0, 8.0), (8.0, 2.0), (50.0, 1.0)])
def test_robots_push_by_mass(mass_a: float, mass_b: float) -> None:
    """A drives into B, which rests: in a sample both move at the speed that keeps the momentum, m_A v/(m_A + m_B)."""
    simulation = world(
        arena=None, poses=[(0.0, 0.0, 0.0), (0.36, 0.0, 1.0)], robot=[{"mass": mass_a}, {"mass": mass_b}]
    )
    speed, dt = simulation.config.robot_of(0).max_speed, simulation.config.sample_period
    simulation.step(actions((1.0, 0.0), (0.0, 0.0)), ROW)
    moved = simulation.world.pose[0, :, 0] - (0.0, 0.36)
    expected = mass_a / (mass_a + mass_b) * speed * dt
    np.testing.assert_allclose(mass_a * moved[0] + mass_b * moved[1], mass_a * speed * dt, rtol=1e-6)
    assert abs(moved[1] - expected) < 0.15 * speed * dt
    np.testing.assert_allclose(simulation.world.pose[0, :, 1], 0.0, atol=1e-9)


def drive(simulation: Simulation, rows: NDArray[np.int64], choices: NDArray[np.float64]) -> list[bytes]:
    """Everything that the simulation shows after each step."""
    shown = []
    for choice in choices:
        simulation.step(choice, rows)
        parts = (*simulation.world, *simulation.samples, *simulation.truth)
        shown.append(b"".join(np.ascontiguousarray(part[rows]).tobytes() for part in parts))
    return shown


def test_restored_contact_goes_on_bit_for_bit() -> None:
    """Five states within 200 samples of pushing and sliding, each restored into a used and into a new simulation."""
    rng = np.random.default_rng(5)
    choices = np.stack([random_driving(rng, 1) for _ in range(10)]).repeat(20, axis=0)
    simulation, states = world(**CLUTTER), []
    in_contact = 0
    for step in range(160):
        if step % 35 == 10:
            states.append((step, simulation.get_state(ROW)))
        simulation.step(choices[step], ROW)
        in_contact += int(simulation.world.contact.any())
    assert in_contact > 20
    for step, state in states:
        runs = []
        for again in (simulation, world(**CLUTTER)):
            again.set_state(state, ROW)
            runs.append(drive(again, ROW, choices[step : step + 40]))
        assert runs[0] == runs[1]


def test_environment_moves_alike_alone_and_in_a_batch() -> None:
    """Sixteen environments, 240 samples with contacts, noise and messages: each as alone, to the last bit."""
    noisy = CLUTTER | {
        "robot": [{"lag": (0.1, 0.1), "actuator_noise": (0.02, 0.05)}],
        "network": {"latency": 0.1, "jitter": 0.1, "loss": 0.2},
        "samples_per_action": 3,
    }
    noisy.pop("points", None)
    rng = np.random.default_rng(6)
    choices = np.stack([random_driving(rng, 16) for _ in range(8)]).repeat(10, axis=0)
    batch = world(16, **noisy)
    histories: list[list[bytes]] = [[] for _ in range(16)]
    touched = 0
    for choice in choices:
        batch.step(choice, np.arange(16))
        touched += int(batch.world.collided.sum())
        for n in range(16):
            parts = (*batch.world, *batch.samples, *batch.truth)
            histories[n].append(b"".join(np.ascontiguousarray(part[[n]]).tobytes() for part in parts))
    assert touched > 50
    single = world(**noisy)
    for n in (0, 3, 7, 15):
        single.seed(ROW, [n])
        single.reset(ROW)
        assert drive(single, ROW, choices[:, n : n + 1]) == histories[n]


def test_contact_is_solved_alike_after_any_history() -> None:
    """Two robots and a wall in one contact: the same after 0, 1, 2, ..., 40 earlier solutions of the same solver."""
    options: dict[str, Any] = {
        "poses": [(-4.8, 0.0, math.pi), (-4.43, 0.05, 2.9)], "robot": [{"mass": 5.0}, {"mass": 8.0}],
    }  # fmt: skip
    push = actions((1.0, 0.2), (1.0, 0.0))[None].repeat(8, axis=0)
    simulation = world(**options)
    start = simulation.get_state(ROW)
    fresh = drive(simulation, ROW, push)
    for history in range(1, 41):
        simulation.set_state(start, ROW)
        drive(simulation, ROW, push[:1].repeat(1 + history % 3, axis=0))
        simulation.set_state(start, ROW)
        assert drive(simulation, ROW, push) == fresh


def test_velocity_in_contact_leads_from_pose_to_pose() -> None:
    """The mean velocity over a sample, held constant, gives the pose at its end; SciPy integrates it."""
    rng = np.random.default_rng(8)
    simulation = world(**CLUTTER)
    dt, slides = simulation.config.sample_period, 0
    for step in range(300):
        if step % 20 == 0:
            held = random_driving(rng, 1)
        before = simulation.world.pose[0].copy()
        simulation.step(held, ROW)
        for r in range(2):
            v, lateral, w = simulation.world.velocity[0, r]
            if not simulation.world.contact[0, r]:
                continue
            slides += 1

            def flow(
                _: float, s: NDArray[np.float64], v: float = v, lateral: float = lateral, w: float = w
            ) -> list[float]:
                cos, sin = math.cos(s[2]), math.sin(s[2])
                return [v * cos - lateral * sin, v * sin + lateral * cos, w]

            end = solve_ivp(flow, (0.0, dt), before[r], method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
            np.testing.assert_allclose(simulation.world.pose[0, r, :2], end[:2], atol=1e-11)
            assert angle_between(simulation.world.pose[0, r, 2], end[2]) < 1e-11
    assert slides > 50
