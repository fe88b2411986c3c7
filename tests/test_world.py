"""Motion, contacts, actuators and shield against closed forms, SciPy's integrator, geometry and momentum."""

import cmath
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from relloc_env.config import EnvConfig, load_config
from relloc_env.simulation import Simulation

ROW = np.zeros(1, np.int64)
FAR_POINTS = [(40.0, 0.0, 0.5), (40.0, 3.0, 0.5)]


def world(num_envs: int = 1, **options: Any) -> Simulation:
    """A simulation without shield and with targets out of the way, reset with the seeds 0, 1, 2 and so on."""
    given = {"shield": None, "points": FAR_POINTS, "estimator": None, "samples_per_action": 1} | options
    simulation = Simulation(load_config(given), num_envs)
    rows = np.arange(num_envs)
    simulation.seed(rows, list(range(num_envs)))
    simulation.reset(rows)
    return simulation


def actions(*values: tuple[float, float]) -> NDArray[np.float64]:
    """One action of each robot of a single environment."""
    return np.array([values], dtype=np.float64)


def arc(pose: NDArray[np.float64], v: float, w: float, dt: float) -> tuple[float, float, float]:
    """Exact unicycle step by complex numbers: z + v e^(i theta) (e^(i w dt) - 1)/(i w)."""
    start = cmath.exp(1j * pose[2])
    step = v * dt * start if w == 0.0 else v * start * (cmath.exp(1j * w * dt) - 1.0) / (1j * w)
    z = complex(pose[0], pose[1]) + step
    return z.real, z.imag, float(pose[2]) + w * dt


def angle_between(a: float, b: float) -> float:
    return abs(cmath.phase(cmath.exp(1j * (a - b))))


def assert_on_arc(before: NDArray[np.float64], after: NDArray[np.float64], v: float, w: float, dt: float) -> None:
    x, y, theta = arc(before, v, w, dt)
    assert abs(after[0] - x) < 1e-12
    assert abs(after[1] - y) < 1e-12
    assert angle_between(after[2], theta) < 1e-12


def gap(config: EnvConfig, poses: NDArray[np.float64]) -> float:
    """Least distance [m] between bodies; negative where they overlap. Boxes by their corners, edges and sides."""
    least = math.inf
    for r, (x, y, _) in enumerate(poses):
        radius = config.robot_of(r).radius
        if config.arena is not None:
            least = min(least, 0.5 * config.arena[0] - abs(x) - radius, 0.5 * config.arena[1] - abs(y) - radius)
        for obstacle in config.obstacles:
            z = complex(x, y) - complex(*obstacle.position)
            if obstacle.shape == "disc":
                least = min(least, abs(z) - obstacle.radius - radius)
            else:
                z *= cmath.exp(-1j * obstacle.angle)
                out = (abs(z.real) - 0.5 * obstacle.size[0], abs(z.imag) - 0.5 * obstacle.size[1])
                outside = math.hypot(max(out[0], 0.0), max(out[1], 0.0))
                least = min(least, (outside if max(out) > 0.0 else max(out)) - radius)
        for other in range(r):
            reach = radius + config.robot_of(other).radius
            least = min(least, math.hypot(x - poses[other, 0], y - poses[other, 1]) - reach)
    return least


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


CLUTTER: dict[str, Any] = {
    "arena": (4.0, 3.0),
    "obstacles": [
        {"shape": "disc", "position": (0.9, 0.2), "radius": 0.3},
        {"shape": "box", "position": (-0.8, -0.4), "size": (0.7, 0.4), "angle": 0.6},
        {"shape": "box", "position": (0.0, 1.2), "size": (0.1, 0.6)},
    ],
    "robot": [{"mass": 5.0, "radius": 0.18}, {"mass": 12.0, "radius": 0.22}],
    "poses": [(-1.5, 1.0, -0.5), (1.5, -1.0, 2.6)],
}


def random_driving(rng: np.random.Generator, num_envs: int) -> NDArray[np.float64]:
    """Full speed forward or backward, random turns."""
    choice = rng.uniform(-1, 1, (num_envs, 2, 2))
    choice[..., 0] = np.sign(choice[..., 0] + 0.3)
    return choice


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


def distances(config: EnvConfig, poses: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[float, float, float]:
    """Least distance of robots' centres to targets, to one another, and to walls and obstacles."""
    target = min(math.hypot(x - p[0], y - p[1]) for x, y, _ in poses for p in points)
    pair = math.hypot(*(poses[0] - poses[1])[:2])
    return target, pair, gap(config, poses[:1]) + config.robot_of(0).radius


def test_shield_keeps_its_distances() -> None:
    """24 environments, 800 samples at full speed; random starts, obstacles, lag and noise."""
    rng = np.random.default_rng(7)
    simulation = world(
        24, shield={}, points=None, arena=(5.0, 5.0),
        start={"target_distance": (0.8, 4.0), "in_view": False, "heading_error": 180.0},
        obstacles=[{"shape": "disc", "position": (0.5, 0.5), "radius": 0.2}],
        robot={"lag": (0.1, 0.1), "actuator_noise": (0.02, 0.05)},
    )  # fmt: skip
    config, rows = simulation.config, np.arange(24)
    held_back, least = 0, np.full(3, math.inf)
    for step in range(800):
        if step % 20 == 0:
            held = random_driving(rng, 24)
        simulation.step(held, rows)
        held_back += int(simulation.world.blocked.sum())
        for n in range(24):
            for r in range(2):
                poses = simulation.world.pose[n, [r, 1 - r]]
                least = np.minimum(least, distances(config, poses, simulation.world.points[n]))
        assert not simulation.world.contact.any()
    assert (least >= np.array([0.5, 0.6, 0.3]) - 1e-12).all()
    assert held_back > 1000


@pytest.mark.parametrize("seed", range(4))
def test_shield_holds_between_robots_side_by_side(seed: int) -> None:
    """Robots abreast and a little inward: each alone would get ahead of the other, both together close in."""
    rng = np.random.default_rng(seed)
    inward = rng.uniform(0.001, 0.03, 2)
    simulation = world(
        arena=None, shield={}, poses=[(0.0, 0.0, inward[0]), (0.0, 0.6001, -inward[1])], samples_per_action=5
    )
    for _ in range(100):
        simulation.step(actions((1.0, 0.0), (1.0, 0.0)), ROW)
        poses = simulation.truth.pose[0]
        assert np.hypot(*(poses[:, 0] - poses[:, 1])[:, :2].T).min() >= 0.6 - 1e-12


START_INSIDE: dict[str, dict[str, Any]] = {
    "target": {"points": [(0.3, 0.0, 0.5), (9.0, 9.0, 0.5)], "arena": None, "robots": 1, "poses": [(0.0, 0.0, 0.0)]},
    "wall": {"poses": [(4.8, 0.0, 0.0)], "robots": 1},
    "box": {
        "poses": [(0.0, 0.0, 0.0)], "robots": 1,
        "obstacles": [{"shape": "box", "position": (0.5, 0.0), "size": (0.5, 1.0)}],
    },
    "robot": {"poses": [(0.0, 0.0, 0.0), (0.5, 0.0, 1.0)], "arena": None},
}  # fmt: skip


@pytest.mark.parametrize("name", START_INSIDE)
def test_shield_lets_out_whoever_starts_within_it(name: str) -> None:
    """Towards the thing nothing moves but the heading, and each sample counts as blocked; away it is free."""
    simulation = world(shield={}, samples_per_action=5, **START_INSIDE[name])
    robots = simulation.config.robots
    start = simulation.world.pose[0].copy()
    still = [(0.0, 0.0)] * (robots - 1)
    simulation.step(actions((1.0, 0.1), *still), ROW)
    np.testing.assert_array_equal(simulation.world.pose[0, :, :2], start[:, :2])
    assert angle_between(simulation.world.pose[0, 0, 2], start[0, 2] + 0.1 * 0.8 * 0.25) < 1e-12
    assert simulation.world.blocked[0, 0] == 5
    simulation.step(actions((-1.0, 0.0), *still), ROW)
    assert simulation.world.blocked[0, 0] == 0
    assert abs(math.hypot(*(simulation.world.pose[0, 0] - start[0])[:2]) - 0.3 * 0.25) < 1e-12


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
