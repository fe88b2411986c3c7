"""The depth observer's equations, against SciPy's integrator, matrix exponentials and published reference times."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from relloc_env.kernels import camera
from relloc_env.kernels import depth_observer as kernels
from tests.kernels.observers import ESTIMATE, SETTINGS, Observers, observer_step

Float = NDArray[np.float64]
PAPER = {"p1": (0.0, 0.0, 5.0), "p2": (0.0, 5.0, 5.0), "p3": (5.0, 0.0, 5.0), "p4": (5.0, 5.0, 5.0)}
"""Points [x, y, z] in the camera frame of the first sample, seen from a camera that drives at 0.1 m/s."""
UNBOUNDED = SETTINGS._replace(z_min=1e-2, z_max=1e9)


def continuous(point: Any, depth: float, u: Any, gains: tuple[float, float], times: Float) -> Float:
    """Solve a static point and its observer together: rows x, y, chi, x_hat, y_hat, chi_hat (section 3)."""
    v, lateral, w = u
    h, alpha_lambda = gains

    def rate(_: float, p: Float) -> list[float]:
        x, y, chi, xh, yh, ch = p
        o_x, o_y = v * x + lateral, v * y
        return [
            w * (1 + x * x) + o_x * chi,
            w * x * y + o_y * chi,
            v * chi * chi + w * x * chi,
            w * (1 + x * x) + o_x * ch + h * (x - xh),
            w * x * y + o_y * ch + h * (y - yh),
            v * ch * ch + w * x * ch + alpha_lambda * (o_x * (x - xh) + o_y * (y - yh)),
        ]

    x, y, z = point
    start = [x / z, y / z, 1 / z, x / z, y / z, 1 / depth]
    solution: Float = solve_ivp(
        rate, (times[0], times[-1]), start, method="DOP853", rtol=1e-11, atol=1e-13, t_eval=times
    ).y
    return solution


def sampled(truth: Float, depth: float, u: Any, gains: tuple[float, float], dt: float) -> Float:
    """Run the observer on the true image coordinates, sample by sample."""
    observers = Observers(1, UNBOUNDED, h=gains[0], alpha_lambda=gains[1], depth=depth)
    states = []
    for k, image in enumerate(truth[:2].T):
        observers.sample(u, dt if k else 0.0, image)
        states.append(observers.numbers[0, ESTIMATE])
    return np.array(states).T


def grid(end: float, dt: float) -> Any:
    return np.arange(round(end / dt) + 1) * dt


@pytest.mark.parametrize("name", ["p2", "p3", "p4"])
@pytest.mark.parametrize("offset", [1.0, -1.0])
def test_follows_the_continuous_observer_at_20_hz(name: str, offset: float) -> None:
    point, u = PAPER[name], (0.1, 0.0, 0.0)
    truth = continuous(point, point[2] + offset, u, (2.5, 120.0), grid(40, 0.05))
    depth = 1 / sampled(truth, point[2] + offset, u, (2.5, 120.0), 0.05)[2]
    assert np.abs(depth - 1 / truth[5]).max() < 1e-4  # required: 5e-3


@pytest.mark.parametrize("offset", [1.0, -1.0])
def test_depth_error_straight_ahead_stays_what_it_was(offset: float) -> None:
    u = (0.1, 0.0, 0.0)
    truth = continuous(PAPER["p1"], 5 + offset, u, (2.5, 120.0), grid(30, 0.05))
    depth = 1 / sampled(truth, 5 + offset, u, (2.5, 120.0), 0.05)[2]
    assert depth - 1 / truth[2] == pytest.approx(offset, abs=1e-9)


@pytest.mark.parametrize(
    ("point", "u", "end"),
    [
        (PAPER["p2"], (0.1, 0.0, 0.0), 10),
        (PAPER["p4"], (0.1, 0.0, 0.0), 10),
        ((1.5, 1.0, 3.0), (0.3, 0.0, 0.3), 2),
        ((-1.5, 1.0, 3.0), (0.3, 0.1, 0.5), 2),
        ((-2.5, 1.0, 3.0), (0.3, 0.1, 1.0), 1.5),
        ((0.5, 0.2, 3.0), (-0.2, -0.1, -0.4), 2),
    ],
)
def test_error_falls_with_the_square_of_the_period(point: Any, u: Any, end: float) -> None:
    errors = []
    for dt in (0.1, 0.05, 0.025, 0.0125):
        truth = continuous(point, point[2] + 0.7, u, (2.5, 120.0), grid(end, dt))
        depth = 1 / sampled(truth, point[2] + 0.7, u, (2.5, 120.0), dt)[2]
        errors.append(np.abs(depth - 1 / truth[5]).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.9).all()
    assert errors[1] < 5e-3


def settling_time(point: Any, offset: float, gains: tuple[float, float]) -> float:
    """Return the time from which |z - z_hat| < 0.1 m holds up to 40 s."""
    u, dt = (0.1, 0.0, 0.0), 0.05
    times = grid(40, dt)
    truth = continuous(point, point[2] + offset, u, (2.5, 120.0), times)
    error = np.abs(1 / sampled(truth, point[2] + offset, u, gains, dt)[2] - 1 / truth[2])
    outside = np.flatnonzero(error >= 0.1)
    return math.inf if outside[-1] == len(times) - 1 else float(times[outside[-1] + 1])


@pytest.mark.parametrize(
    ("name", "offset", "gains", "time"),
    [
        ("p1", 1.0, (2.5, 120.0), math.inf),
        ("p2", 1.0, (2.5, 120.0), 3.75),
        ("p2", -1.0, (2.5, 120.0), 4.2),
        ("p3", 1.0, (2.5, 120.0), 3.75),
        ("p3", -1.0, (2.5, 120.0), 4.2),
        ("p4", 1.0, (2.5, 120.0), 1.85),
        ("p4", -1.0, (2.5, 120.0), 2.0),
        ("p3", 1.0, (1.0, 120.0), 4.05),
        ("p3", 1.0, (5.0, 120.0), 7.4),
        ("p3", 1.0, (10.0, 120.0), 13.05),
        ("p3", 1.0, (2.5, 30.0), 12.9),
        ("p3", 1.0, (2.5, 60.0), 7.25),
        ("p3", 1.0, (2.5, 240.0), 1.85),
        ("p3", 1.0, (2.5, 480.0), 1.05),
    ],
)
def test_reference_times(name: str, offset: float, gains: tuple[float, float], time: float) -> None:
    """docs/equations.md, section 3: continuous time, to 0.05 s, and one sample period beside it."""
    assert settling_time(PAPER[name], offset, gains) == pytest.approx(time, abs=0.1 + 1e-9)


def inverse_depth_error(s: tuple[float, float], v: float, gains: tuple[float, float], times: Float) -> Any:
    """Return chi - chi_hat for a far point, whose image stands still: the linear regime; 1 at the start."""
    far = 1e5
    dt = float(times[1] - times[0])
    truth = continuous((s[0] * far, s[1] * far, far), far, (v, 0.0, 0.0), gains, times)
    chi = sampled(truth, far / 2, (v, 0.0, 0.0), gains, dt)[2]
    return (chi - truth[2]) * far


@pytest.mark.parametrize(("size", "constant"), [(0.3, 22.7), (0.4, 12.6)])
def test_time_constants_of_the_paper(size: float, constant: float) -> None:
    """v = 0.1 m/s, H = 2.5, alpha Lambda = 120; the paper reports 25 s and 13 s."""
    times = grid(60, 0.05)
    error = inverse_depth_error((size * 0.6, size * 0.8), 0.1, (2.5, 120.0), times)
    late = times > 10
    slope = np.polyfit(times[late], np.log(error[late]), 1)[0]
    assert -1 / slope == pytest.approx(constant, abs=0.06)


def test_critical_damping_decays_at_its_rate() -> None:
    """H = 2 sqrt(alpha Lambda) sigma: the error is (1 + r t) exp(-r t), r = sqrt(alpha Lambda) sigma."""
    v, x, y, alpha_lambda = 0.2, 0.5, -0.4, 120.0
    h = kernels.gains(v, 0.0, x, y, 2.5, alpha_lambda, True, 0.1)
    r = math.sqrt(alpha_lambda) * v * math.hypot(x, y)
    times = grid(5, 0.05)
    error = inverse_depth_error((x, y), v, (h, alpha_lambda), times)
    assert error == pytest.approx((1 + r * times) * np.exp(-r * times), abs=1e-4)


def test_critical_gain_makes_the_error_dynamics_a_double_root() -> None:
    """Omega is the derivative of the image flow by chi, lateral speed included."""
    rng = np.random.default_rng(1)
    for _ in range(100):
        x, y, v, lateral, w = rng.uniform(-1, 1, 5)
        alpha_lambda = rng.uniform(10, 1000)
        flow = [np.array(camera.image_flow(x, y, chi, v, lateral, w))[:2] for chi in (0.0, 1.0)]
        omega = flow[1] - flow[0]
        h = kernels.gains(v, lateral, x, y, 2.5, alpha_lambda, True, 0.0)
        assert h * h == pytest.approx(4 * alpha_lambda * omega @ omega, rel=1e-12)
        assert kernels.gains(v, lateral, x, y, 2.5, alpha_lambda, True, h + 1) == h + 1
        assert kernels.gains(v, lateral, x, y, 2.5, alpha_lambda, False, h + 1) == 2.5
        bearing = kernels.gains(v, lateral, x, math.nan, 2.5, alpha_lambda, True, 0.0)
        assert bearing == pytest.approx(2 * math.sqrt(alpha_lambda) * abs(omega[0]), rel=1e-12)


def test_modes_are_the_matrix_exponential_in_every_regime() -> None:
    """3,000 cases from H dt = 1e-6 to 200; a third within 10 % to 1e-12 of critical damping."""
    rng = np.random.default_rng(2)
    for case in range(3000):
        h, k, dt = 10 ** rng.uniform(-3, 2.3), 10 ** rng.uniform(-6, 3.5), 10 ** rng.uniform(-3, 0)
        if case % 3 == 0:
            k = h * h / 4 * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-12, -1))
        root = math.sqrt(k)
        linear = np.array([[-h, -root, 0, 1], [root, 0, 0, 0], [0, 0, -h, 1], [0, 0, 0, 0]])
        exact = expm(linear * dt)
        s_0, s, i = kernels.modes(h, k, dt)
        a, b = h * dt, k * dt * dt
        first = [[1 - a * s - b * i, -root * dt * s], [root * dt * s, 1 - b * i]]
        assert np.array(first) == pytest.approx(exact[:2, :2], abs=2e-9)
        assert np.array([s, root * dt * i, s_0]) * dt == pytest.approx(exact[:3, 3], abs=2e-9 * dt)


def test_a_step_is_that_of_dense_tools_at_any_gain_and_speed() -> None:
    """400 random steps; H dt to 25, stiffness dt² and w x dt far beyond what power series cover."""
    rng, cases = np.random.default_rng(5), 400
    before, chi = rng.uniform(-1, 1, (cases, 2)), rng.uniform(0.1, 1, cases)
    u, dt = rng.uniform(-1, 1, (cases, 3)) * [1, 1, 4], 10 ** rng.uniform(-2.3, -0.6, cases)
    h, alpha_lambda = 10 ** rng.uniform(-0.3, 2, cases), 10 ** rng.uniform(0, 4, cases)
    after = before + rng.uniform(-0.05, 0.05, (cases, 2))
    start = np.column_stack([before + rng.uniform(-0.05, 0.05, (cases, 2)), chi])
    observers = Observers(cases, UNBOUNDED, h=h, alpha_lambda=alpha_lambda, depth=1 / chi)
    observers.sample(np.zeros(3), 0.0, before)
    observers.put("x_hat", start[:, 0])
    observers.put("y_hat", start[:, 1])
    observers.sample(u, dt, after)
    expected = [observer_step(*case) for case in zip(before, after, start, u, dt, h, alpha_lambda, strict=True)]
    inside = np.array([1e-2 < step[2] < 1e2 for step in expected])  # else the bounds of chi matter
    assert inside.sum() > 200
    assert observers.numbers[inside][:, ESTIMATE] == pytest.approx(np.array(expected)[inside], rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("critical", [False, True])
def test_stays_bounded_at_the_extremes(critical: bool) -> None:
    """2,000 runs of 500 steps (a million states): any gain and period, images that jump at random, depths from 0.3 m.

    An image error decays at least by exp(-H dt) across Omega, and is fed by no more than `feed` a step.
    """
    rng, runs = np.random.default_rng(3), 1000
    low, high = 1 / 30, 1 / 0.3
    h, alpha_lambda = 0.5 + 99.5 * rng.random(runs) ** 3, 1e4 * rng.random(runs) ** 3
    u, dt, size = rng.uniform(-1, 1, (runs, 3)), rng.uniform(0.005, 0.2, runs), rng.choice([0.5, 5.0], runs)
    settings = SETTINGS._replace(critical=critical, floor=0.5, z_min=1 / high, z_max=1 / low)
    observers = Observers(runs, settings, h=h, alpha_lambda=alpha_lambda, depth=1 / rng.uniform(low, high, runs))
    v, lateral, w = np.abs(u.T)
    feed = 3 * size + dt * (w * (1 + 2 * size**2) + high * (2 * size * v + lateral))
    bound = 4 * feed / (1 - np.exp(-(0.5 if critical else h) * dt))
    for k in range(501):
        images = size[:, None] * rng.uniform(-1, 1, (runs, 2))
        observers.sample(u, dt if k else 0.0, images)
        states = observers.numbers[:, ESTIMATE]
        assert states[:, 2].min() >= low * (1 - 1e-12)
        assert states[:, 2].max() <= high * (1 + 1e-12)
        assert (np.abs(states[:, :2] - images).max(axis=1) <= bound).all()


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("gains", [(100.0, 1e4), (2.5, 1e4), (100.0, 120.0), (0.5, 120.0)])
def test_follows_the_continuous_observer_at_stiff_gains(gains: tuple[float, float], dt: float) -> None:
    """A point comes as near as 0.3 m, with alpha Lambda sigma² up to 4e3 1/s² (an Euler step diverges from 1/dt²)."""
    u = (0.3, 0.0, 0.0)
    truth = continuous((0.5, 0.4, 1.5), 1.6, u, gains, grid(4, dt))
    depth = 1 / sampled(truth, 1.6, u, gains, dt)[2]
    assert np.abs(depth - 1 / truth[5]).max() < 1e-2
