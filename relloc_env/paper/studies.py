"""The studies behind the claims: each is run once, and read by the claims and the figures."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from relloc_env.config import EnvConfig, load_config
from relloc_env.estimators import CascadeConfig
from relloc_env.kernels.camera import image_flow
from relloc_env.kernels.motion import arc
from relloc_env.paper.geometries import Geometries, study_geometries
from relloc_env.paper.runs import DURATION, EXPERIMENT, PAPER_GAINS, Run, settle_time, simulate

STRAIGHT = (0.1, 0.0)
"""[m/s, rad/s] input of the paper's simulations."""
IMAGE_NOISE = 0.002
"""[-] standard deviation of an image coordinate where noise is studied."""
ODOMETRY_NOISE = (0.005, 0.005)
"""[m/s, rad/s] of a sample, the same."""
NOISES = (
    f"The paper gives no noise. Image: {IMAGE_NOISE} (normalised) per coordinate and sample; odometry: "
    f"{ODOMETRY_NOISE[0]} m/s and {ODOMETRY_NOISE[1]} rad/s per sample, or none."
)
"""What is assumed, in words."""
REPETITIONS = 64
"""Noisy runs of each study."""

H_STUDY = (1.0, 2.5, 5.0, 10.0)
ALPHA_LAMBDA_STUDY = (30.0, 60.0, 120.0, 240.0, 480.0)
GAINS = (*((h, 120.0) for h in H_STUDY), *((2.5, al) for al in ALPHA_LAMBDA_STUDY if al != 120.0))
"""(H, alpha Lambda) of the gain study."""
RINGS = (0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
"""[-] distances from the middle of the image, of points 5 m ahead."""
WINDOW = (20.0, 25.0)
"""[s] in which steady-state errors are measured: all gains have converged, and the points are still ahead."""
MORE_TARGETS = ((6.6, 4.4, 1.65), (7.45, 4.95, 2.05), (8.3, 5.5, 2.45), (7.0, 4.7, 1.85))
"""[m] targets beside the experiment's two, where more than two are studied."""


def gain_name(gains: tuple[float, float]) -> str:
    """Name of a pair of gains in results."""
    return f"H {gains[0]:g}, αΛ {gains[1]:g}"


def cascades(gains: tuple[tuple[float, float], ...] = GAINS) -> dict[str, CascadeConfig]:
    """One estimator for each pair of gains."""
    return {gain_name(pair): CascadeConfig(h=pair[0], alpha_lambda=pair[1]) for pair in gains}


def pose_models() -> dict[str, CascadeConfig]:
    """One estimator for each observation model, with the paper's gains."""
    return {
        "position": CascadeConfig(pose_model="position"),
        "velocity": CascadeConfig(pose_model="velocity"),
        "printed": CascadeConfig(pose_model="printed"),
    }


def noisy(scenario: str, odometry: tuple[float, float] = ODOMETRY_NOISE, **options: Any) -> EnvConfig:
    """A scenario with noise of image and odometry."""
    pixels = IMAGE_NOISE * load_config(scenario).camera_of(0).focal_length
    return load_config(scenario, camera={"pixel_noise": pixels}, robot={"odometry_noise": odometry}, **options)


@dataclass(frozen=True)
class Studies:
    """Everything that was run."""

    four: Run
    """The four points, each pair of gains, guess 1 m too far."""
    four_near: Run
    """The same, guess 1 m too near, the paper's gains."""
    four_fine: Run
    """The four points at 400 Hz, the paper's gains."""
    four_noisy: Run
    """The four points with noise in the image, each pair of gains."""
    rings: Run
    """Points at the distances `RINGS` from the middle of the image, the paper's gains."""
    simulation: Run
    """Two robots, p1 and p4, each observation model."""
    simulation_off_axis: Run
    """The same with p2 in place of p1."""
    experiment: Run
    """The paper's experiment, each observation model."""
    experiment_near: Run
    """The same, depth guess 1 m too near."""
    experiment_signs: tuple[Run, ...]
    """The same, other signs of the errors of the pose guess."""
    experiment_noisy: Run
    """With noise of image and odometry, each observation model."""
    geometries: Geometries
    """Depths in random places of robots and targets that stay in view."""
    targets: dict[int, Run]
    """The experiment with noise in the image, by number of targets."""
    targets_odometry: dict[int, Run]
    """The same with noisy odometry too."""


def run_studies(report: Callable[[str], None] = lambda _: None) -> Studies:
    """Run them all, some fifteen seconds.

    Args:
        report: told what is about to run.
    """
    depth, simulation, experiment = (load_config(f"paper-{name}") for name in ("depth", "simulation", "experiment"))
    paper, position = cascades((PAPER_GAINS,)), {"position": CascadeConfig()}
    both = (STRAIGHT, STRAIGHT)
    report("four points")
    four = simulate(depth, [STRAIGHT], cascades())
    four_near = simulate(depth, [STRAIGHT], paper, depth_error=-1.0)
    four_fine = simulate(load_config("paper-depth", sample_rate=400.0), [STRAIGHT], paper)
    height = depth.camera_of(0).mount_height
    ring_points = [(5.0, -5.0 * ring, height) for ring in RINGS]
    rings = simulate(load_config("paper-depth", points=ring_points), [STRAIGHT], paper)
    report("gains and noise")
    four_noisy = simulate(noisy("paper-depth", (0.0, 0.0)), [STRAIGHT], cascades(), num_envs=REPETITIONS)
    report("two robots")
    two = simulate(simulation, both, pose_models())
    p2, p4 = (5.0, 0.0, height - 5.0), (5.0, -5.0, height - 5.0)
    off_axis = simulate(load_config("paper-simulation", points=[p2, p4]), both, pose_models())
    report("experiment")
    turn = math.radians(60.0)
    signs = tuple(
        simulate(experiment, EXPERIMENT, position, pose_error=(1.5 * x, 1.5 * y, turn * x))
        for x, y in ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0))
    )
    exact = simulate(experiment, EXPERIMENT, pose_models())
    near = simulate(experiment, EXPERIMENT, position, depth_error=-1.0)
    report("experiment with noise")
    disturbed = simulate(noisy("paper-experiment"), EXPERIMENT, pose_models(), num_envs=REPETITIONS)
    report("number of targets")
    assert experiment.points is not None
    places = (*experiment.points, *MORE_TARGETS)
    targets, targets_odometry = (
        {
            count: simulate(
                noisy("paper-experiment", wheels, points=places[:count]), EXPERIMENT, position, num_envs=REPETITIONS
            )
            for count in counts
        }
        for wheels, counts in (((0.0, 0.0), (1, 2, 5, 6)), (ODOMETRY_NOISE, (2, 5, 6)))
    )
    report("random geometries")
    geometries = study_geometries()
    return Studies(
        four=four,
        four_near=four_near,
        four_fine=four_fine,
        four_noisy=four_noisy,
        rings=rings,
        simulation=two,
        simulation_off_axis=off_axis,
        experiment=exact,
        experiment_near=near,
        experiment_signs=signs,
        experiment_noisy=disturbed,
        geometries=geometries,
        targets=targets,
        targets_odometry=targets_odometry,
    )


def settle_times(run: Run, name: str, robot: int = 0) -> list[float]:
    """[s] settling time of each point's depth in the first repetition."""
    error = run.tracks[name].depth[0, :, robot]
    return [settle_time(run.time, error[:, i]) for i in range(error.shape[1])]


def steady_state(run: Run, name: str, point: int, robot: int = 0) -> float:
    """[m] standard deviation of a depth over the repetitions, in `WINDOW`."""
    inside = (run.time >= WINDOW[0]) & (run.time <= WINDOW[1])
    spread = run.tracks[name].depth[:, inside, robot, point].std(axis=0, ddof=1)
    return float(np.sqrt(np.mean(spread**2)))


def steady_state_theory(run: Run, gains: tuple[float, float], point: int) -> float:
    """[m] the same by linear theory: sd(z) = z² αΛσ sd(s) sqrt(dt / 2H), from white noise through the observer."""
    inside = (run.time >= WINDOW[0]) & (run.time <= WINDOW[1])
    z = run.depth[0, inside, 0, point]
    sigma = STRAIGHT[0] * np.hypot(*np.moveaxis(run.image[:, inside, 0, point].mean(axis=0), -1, 0))
    period = run.time[1] - run.time[0]
    sd = z**2 * gains[1] * sigma * IMAGE_NOISE * math.sqrt(period / (2.0 * gains[0]))
    return float(np.sqrt(np.mean(sd**2)))


def euler_errors(studies: Studies, point: int, gains: tuple[float, float] = PAPER_GAINS) -> float:
    """[m] greatest depth difference between a plain Euler step of the observer at 20 Hz and the 400 Hz solution."""
    run = studies.four
    v, w = STRAIGHT
    h, alpha_lambda = gains
    dt = float(run.time[1] - run.time[0])
    xh, yh = run.image[0, 0, 0, point]
    chi = 1.0 / (run.depth[0, 0, 0, point] + 1.0)
    depth = np.empty(len(run.time))
    for k, (x, y) in enumerate(run.image[0, :, 0, point]):
        depth[k] = 1.0 / chi
        e_x, e_y = x - xh, y - yh
        flow_x, flow_y, flow_chi = image_flow(x, y, chi, v, 0.0, w)
        xh, yh = xh + dt * (flow_x + h * e_x), yh + dt * (flow_y + h * e_y)
        chi += dt * (flow_chi + alpha_lambda * v * (x * e_x + y * e_y))
    fine = studies.four_fine
    exact = fine.tracks[gain_name(gains)].depth[0, :: (len(fine.time) - 1) // (len(run.time) - 1), 0, point]
    return float(np.abs(depth - run.depth[0, :, 0, point] - exact).max())


def narrowest_view(yaw_rate: float, places: int = 40_000, seed: int = 0) -> float:
    """[deg] least half-view that keeps some place in view for 40 s, over random places 3 to 10 m ahead within 57°."""
    rng = np.random.default_rng(seed)
    depth, bearing = rng.uniform(3.0, 10.0, places), np.radians(rng.uniform(-57.0, 57.0, places))
    q_x, q_y = depth, depth * np.tan(bearing)
    widest = np.abs(bearing)
    for time in np.linspace(0.0, DURATION, 81):
        chord_x, chord_y, turn = arc(EXPERIMENT[0][0], 0.0, yaw_rate, time)
        ahead = np.cos(turn) * (q_x - chord_x) + np.sin(turn) * (q_y - chord_y)
        left = np.cos(turn) * (q_y - chord_y) - np.sin(turn) * (q_x - chord_x)
        widest = np.maximum(widest, np.abs(np.arctan2(left, ahead)))
    return float(np.degrees(widest.min()))
