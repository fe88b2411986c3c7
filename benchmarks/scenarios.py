"""Random scenes for two robots, what they measure in them, and the bound of each: truth for `benchmarks.estimators`.

The scenes are those of docs/estimator.md, "Measured". N runs at once, K samples 0.05 s apart, R = 2 robots, M = 4
places for points, of which a run uses the first 2 to 4; the others are never seen.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from relloc_env.kernels import bound as pcrb
from relloc_env.kernels.information import pose_covariance
from relloc_env.kernels.state_layout import size_of
from relloc_env.metrics import relative_poses, wrap
from relloc_env.samples import Bool, Float, Prior, Samples

Int = NDArray[np.int64]
DT = 0.05
"""[s] between two samples."""
POINTS = 4
"""Places for points."""
DEPTH_SD = 1.0
"""[m] initial error of every depth, of random sign."""
POSE_SD = np.array([1.5, 1.5, math.pi / 3.0])
"""[m, m, rad] initial error of the pose, each of random sign."""
NO_PRIOR_SD = np.array([100.0, 100.0, 30.0])
"""[m, m, rad] prior of a pose of which nothing is known."""
PAPER_STARTS = ((0.0, -0.8, -0.1), (0.0, 1.0, 0.25))
"""[m, m, rad] of A and B in the paper-like geometry."""
PAPER_INPUTS = ((0.1, 0.0, 0.02), (0.1, 0.0, -0.03))
"""[m/s, m/s, rad/s] of A and B there."""
PAPER_POINTS = ((7.0, 0.8, 0.4), (7.0, -1.2, 0.3))
"""[m] over the cameras."""
HALF_VIEW = 1.0
"""[-] greatest |x| and |y| in the image: 45° to either side."""
NEAREST = 0.5
"""[m] least depth at which a point is seen."""
LEAST_SEEN = 0.75
"""Part of the time that each robot sees each point in a scene that is kept."""
WHOLE = 40.0
"""[s] time over which that is counted."""
APART = 0.7
"""[m] least distance of two points on the plan."""
BURST = 1.0
"""[s] mean length of a burst of missed detections."""


@dataclass(frozen=True)
class Scene:
    """What is drawn, and how it is measured."""

    image_noise: float = 0.002
    """[-] of each normalised image coordinate."""
    odometry_noise: float = 0.005
    """[m/s, rad/s] of each sample."""
    paper: bool = False
    """The paper-like geometry of docs/equations.md, section 5, in place of random ones; every image is in view."""
    missed: float = 0.2
    """Part of the detections that is missed: half of them single, half in bursts."""
    outliers: float = 0.0
    """Part of the images that lies anywhere."""
    still_a: bool = False
    """Robot A does not turn."""
    straight: bool = False
    """Neither robot turns."""
    no_prior: bool = False
    """Nothing is known about the pose at the start."""
    height: float = 0.0
    """[m] difference of the camera heights, of random sign, that the estimator takes to be 0."""
    scale: float = 0.0
    """[-] error of the odometry's scales, of random sign, both robots' speeds and yaw rates."""


class Truth(NamedTuple):
    """N runs as they were; no estimator sees this."""

    poses: Float
    """[m, m, rad] (N, K, 2, 3), {W}."""
    velocity: Float
    """[m/s, m/s, rad/s] (N, K, 2, 3) over the interval before each sample."""
    points: Float
    """[m] (N, M, 3), {W}."""
    used: Int
    """(N,) number of points in use."""
    heights: Float
    """[m] (N, 2) of the cameras."""


class Runs(NamedTuple):
    """N runs of a scene: what the robots measured and are told, and what the errors are held against."""

    samples: Samples
    prior: Prior
    truth: Truth
    informative: Bool
    """(N, K, 2, M) images that tell of their point: seen, and no outlier."""


def draw(scene: Scene, runs: int, seconds: float, rng: Generator) -> Runs:
    """Draw runs of a scene.

    Args:
        scene: which.
        runs: their number N.
        seconds: how long each is.
        rng: all the randomness there is.
    """
    steps = round(seconds / DT) + 1
    truth = _paper_like(runs, steps) if scene.paper else _random(scene, runs, steps, rng)
    truth.heights[:, 1] += scene.height * rng.choice([-1.0, 1.0], runs)
    image, inside, depth = _project(truth, math.inf if scene.paper else HALF_VIEW)
    seen = inside & ~_missed(scene.missed, inside.shape, rng)
    wild = seen & (rng.random(seen.shape) < scene.outliers)
    image += scene.image_noise * rng.standard_normal(image.shape)
    image[wild] = rng.uniform(-HALF_VIEW, HALF_VIEW, (int(wild.sum()), 2))
    odometry = truth.velocity / (1.0 + scene.scale * rng.choice([-1.0, 1.0], (runs, 1, 2, 3)))
    odometry[:, 1:, :, ::2] += scene.odometry_noise * rng.standard_normal((runs, steps - 1, 2, 2))
    period = np.full((runs, steps), DT)
    period[:, 0] = 0.0
    samples = Samples(
        period=period,
        odometry=odometry.astype(np.float32),
        image=np.where(seen[..., None], image, 0.0).astype(np.float32),
        seen=seen,
        arrived=np.ones((runs, steps, 2), np.uint64),
    )
    guess = depth[:, 0] + DEPTH_SD * rng.choice([-1.0, 1.0], depth[:, 0].shape)
    pose = relative_poses(truth.poses[:, 0]) + POSE_SD * rng.choice([-1.0, 1.0], (runs, 2, 3))
    if scene.no_prior:
        pose = np.zeros((runs, 2, 3))
        pose[..., 2] = rng.uniform(-math.pi, math.pi, (runs, 2))
    pose[..., 2] = wrap(pose[..., 2])
    prior = Prior(np.maximum(guess, NEAREST), pose, DEPTH_SD, NO_PRIOR_SD if scene.no_prior else POSE_SD)
    return Runs(samples, prior, truth, seen & ~wild)


def bounds(runs: Runs, scene: Scene, at: list[int]) -> Float:
    """Covariance (T, N, 3, 3) that no estimate of B's pose in A's frame can be below, after the samples `at`.

    The priors are the estimator's: the depths of both robots, the pose, and where the scene has them the difference of
    the camera heights and the scales of the odometry. Outliers tell nothing.
    """
    truth, found = runs.truth, np.zeros((len(at), len(runs.truth.points), 3, 3))
    odometry, image, guess = (np.full(2, sd) for sd in (scene.odometry_noise, scene.image_noise, runs.prior.depth_sd))
    noise = pcrb.Noise(odometry, odometry, image, guess)
    prior = pcrb.Prior(runs.prior.pose_sd, 100.0, scene.height, scene.scale, scene.scale)
    for n, count in enumerate(truth.used):
        points, size = truth.points[n, :count], size_of(2, count, heights=scene.height > 0.0, scales=scene.scale > 0.0)
        sighted, visible = np.zeros((2, count), np.bool_), np.ascontiguousarray(runs.informative[n, :, :, :count])
        bound = pcrb.Bound(np.zeros((size, size)), np.zeros(size), sighted, np.zeros((4, size)))
        for k in range(at[-1] + 1):
            here = pcrb.Scene(truth.poses[n, k], points, truth.heights[n], np.zeros(2))
            if k == 0:
                pcrb.bound_reset(bound, here, prior)
            pcrb.bound_step(bound, here, noise, visible[k], truth.velocity[n, k], DT if k else 0.0, True)
            if k in at:
                pose_covariance(bound, here, 0, 1, found[at.index(k), n])
    return found


def _paper_like(runs: int, steps: int) -> Truth:
    velocity = np.zeros((runs, steps, 2, 3))
    velocity[:, 1:] = PAPER_INPUTS
    start = np.broadcast_to(PAPER_STARTS, (runs, 2, 3))
    points = np.full((runs, POINTS, 3), 1e3)
    points[:, :2] = PAPER_POINTS
    return Truth(_integrate(start, velocity), velocity, points, np.full(runs, 2), np.zeros((runs, 2)))


def _random(scene: Scene, runs: int, steps: int, rng: Generator) -> Truth:
    """Draw how many points each run has, then candidates until as many were kept; runs are in the order of points."""
    whole, kept = max(steps, round(WHOLE / DT) + 1), []
    for m, missing in enumerate(np.bincount(rng.integers(2, POINTS + 1, runs)).tolist()):
        while missing > 0:
            truth = _candidates(scene, 3 * missing + 5, m, whole, rng)
            good = np.flatnonzero(_is_kept(truth))[:missing]
            kept.append(Truth._make(field[good] for field in truth))
            missing -= len(good)  # noqa: PLW2901
    truth = Truth._make(np.concatenate(fields) for fields in zip(*kept, strict=True))
    return truth._replace(poses=truth.poses[:, :steps].copy(), velocity=truth.velocity[:, :steps].copy())


def _is_kept(truth: Truth) -> Bool:
    """(N,) whether each robot sees each point at first and long enough, and the points are apart on the plan."""
    _, inside, _ = _project(truth, HALF_VIEW)
    unused = np.arange(POINTS) >= truth.used[:, None]
    enough = (inside.mean(axis=1) >= LEAST_SEEN) & inside[:, 0]
    apart = np.linalg.norm(truth.points[:, :, None, :2] - truth.points[:, None, :, :2], axis=-1) > APART
    alike = np.eye(POINTS, dtype=np.bool_) | unused[:, :, None] | unused[:, None]
    good: Bool = (enough | unused[:, None]).all(axis=(1, 2)) & (apart | alike).all(axis=(1, 2))
    return good


def _candidates(scene: Scene, n: int, m: int, steps: int, rng: Generator) -> Truth:
    ahead, bearing = rng.uniform(3.0, 7.0, (n, POINTS)), rng.uniform(-0.6, 0.6, (n, POINTS))
    points = np.stack([ahead, ahead * np.tan(bearing), rng.uniform(-0.4, 1.0, (n, POINTS))], axis=-1)
    centre = points[:, :m].mean(axis=1)
    start = np.zeros((n, 2, 3))
    start[:, 1, 0] = rng.uniform(-1.5, 1.0, n)
    start[:, 1, 1] = rng.uniform(1.0, 3.0, n) * rng.choice([-1.0, 1.0], n)
    to = centre[:, :2] - start[:, 1, :2]
    start[:, 1, 2] = np.arctan2(to[:, 1], to[:, 0]) + rng.uniform(-0.3, 0.3, n)
    time = DT * np.arange(steps)[None, :, None]

    def drawn(low: float, high: float) -> Float:
        return rng.uniform(low, high, (n, 1, 2))

    def wave(amplitude: Float, period: Float) -> Float:
        return amplitude * np.sin(2.0 * math.pi * (time / period + drawn(0.0, 1.0)))

    velocity, speed = np.zeros((n, steps, 2, 3)), drawn(0.03, 0.1)
    constant = rng.random((n, 1, 2)) < 0.5
    velocity[..., 0] = np.where(constant, speed, 0.6 * speed + wave(drawn(0.05, 0.2), drawn(12.0, 30.0)))
    velocity[..., 2] = np.where(constant, drawn(-0.03, 0.03), wave(drawn(0.05, 0.25), drawn(6.0, 15.0)))
    if scene.straight:
        velocity[..., 2] = 0.0
    if scene.still_a:
        velocity[:, :, 0, 2] = 0.0
    velocity[:, 0] = 0.0
    return Truth(_integrate(start, velocity), velocity, points, np.full(n, m), np.zeros((n, 2)))


def _integrate(start: Float, velocity: Float) -> Float:
    """Poses (N, K, 2, 3) along exact arcs from `start` (N, 2, 3)."""
    turn = DT * velocity[..., 2]
    heading = start[:, None, :, 2] + np.cumsum(turn, axis=1)
    chord = DT * velocity[..., 0] * np.sinc(turn / (2.0 * math.pi))
    middle = heading - 0.5 * turn
    x = start[:, None, :, 0] + np.cumsum(chord * np.cos(middle), axis=1)
    y = start[:, None, :, 1] + np.cumsum(chord * np.sin(middle), axis=1)
    return np.stack([x, y, heading], axis=-1)


def _project(truth: Truth, half_view: float) -> tuple[Float, Bool, Float]:
    """Ideal images (N, K, 2, M, 2), which of them lie in the view, and the depths (N, K, 2, M) [m]."""
    pose = truth.poses[:, :, :, None]
    d = truth.points[:, None, None, :, :2] - pose[..., :2]
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    depth, left = cos * d[..., 0] + sin * d[..., 1], cos * d[..., 1] - sin * d[..., 0]
    up = truth.points[:, None, None, :, 2] - truth.heights[:, None, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        image = np.stack([-left / depth, -up / depth], axis=-1)
    used = np.arange(POINTS) < truth.used[:, None, None, None]
    return image, used & (depth > NEAREST) & (np.abs(image) < half_view).all(axis=-1), depth


def _missed(part: float, shape: tuple[int, ...], rng: Generator) -> Bool:
    """Which detections (N, K, R, M) are missed: half alone, half in bursts; none at the first sample."""
    rate = 1.0 - math.sqrt(1.0 - part)
    missed = rng.random(shape) < rate
    end = DT / BURST
    begin = end * rate / (1.0 - rate)
    burst = rng.random((shape[0], *shape[2:])) < rate
    for k in range(shape[1]):
        change = rng.random(burst.shape)
        burst = np.where(burst, change >= end, change < begin)
        missed[:, k] |= burst
    missed[:, 0] = False
    return missed
