"""The best that can be done with hindsight: the whole episode's posterior beside map-alignment and the bound.

Runs of the paper-like geometry of docs/equations.md, section 5, with initial errors of fixed size and random sign.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from benchmarks.map_graph import Episode, Noise
from benchmarks.scenarios import DEPTH_SD, DT, PAPER_INPUTS, PAPER_POINTS, PAPER_STARTS, POSE_SD
from relloc_env.estimators import MapAlignmentConfig, make
from relloc_env.files import write_json
from relloc_env.folders import open_folder
from relloc_env.kernels.motion import advance
from relloc_env.metrics import nees, relative_poses, trajectory_bound, whitened_error, wrap
from relloc_env.samples import Float, Prior, Samples

TIMES = (5.0, 10.0, 20.0, 40.0)
"""[s] at which the errors are looked at."""
POINTS = np.array(PAPER_POINTS)
"""[m] over the cameras."""
NOISE = Noise(image=0.002, speed=0.005, yaw_rate=0.005)


class Runs(NamedTuple):
    """N runs, K samples each."""

    samples: Samples
    prior: Prior
    poses: Float
    """[m, m, rad] (K, 2, 3) true, the same in all."""
    bound: Float
    """(K, 3, 3) of B's pose in A's frame."""


def simulate(runs: int, seconds: float, seed: int) -> Runs:
    """Draw runs: what the robots measure, and what is so."""
    rng, steps = np.random.default_rng(seed), round(seconds / DT) + 1
    poses, velocity = np.zeros((steps, 2, 3)), np.zeros((steps, 2, 3))
    poses[0], velocity[1:] = PAPER_STARTS, PAPER_INPUTS
    for k in range(1, steps):
        for r in range(2):
            poses[k, r] = advance(*poses[k - 1, r], *PAPER_INPUTS[r], DT)
    d, heading = POINTS[:, :2] - poses[:, :, None, :2], poses[:, :, None, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    depth = cos * d[..., 0] + sin * d[..., 1]
    ideal = np.stack([(sin * d[..., 0] - cos * d[..., 1]) / depth, -POINTS[:, 2] / depth], axis=-1)
    image = ideal + NOISE.image * rng.standard_normal((runs, *ideal.shape))
    odometry = np.repeat(velocity[None], runs, axis=0)
    odometry[:, 1:, :, 0] += NOISE.speed * rng.standard_normal((runs, steps - 1, 2))
    odometry[:, 1:, :, 2] += NOISE.yaw_rate * rng.standard_normal((runs, steps - 1, 2))
    period = np.full((runs, steps), DT)
    period[:, 0] = 0.0
    seen = np.ones(image.shape[:-1], np.bool_)
    arrived = np.ones((runs, steps, 2), np.uint64)
    samples = Samples(period, odometry.astype(np.float32), image.astype(np.float32), seen, arrived)
    guess = relative_poses(poses[0]) + POSE_SD * rng.choice([-1.0, 1.0], (runs, 2, 3))
    prior = Prior(depth[0] + DEPTH_SD * rng.choice([-1.0, 1.0], (runs, *depth[0].shape)), guess, DEPTH_SD, POSE_SD)
    bound = trajectory_bound(
        period[0], poses, POINTS, velocity, seen[0], np.zeros(2), image_sd=NOISE.image, speed_sd=NOISE.speed,
        turn_sd=NOISE.yaw_rate, depth_sd=DEPTH_SD, pose_sd=POSE_SD,
    )  # fmt: skip
    return Runs(samples, prior, poses, bound.pose[:, 0])


def run(
    out: Path, *, runs: int = 20, seconds: float = 40.0, seed: int = 0,
    tell: Callable[[float, str], object] = lambda *_: None,
) -> dict[str, Any]:  # fmt: skip
    """Compare, and write `map-reference.json` into a folder.

    Args:
        out: folder, made where it is missing.
        runs: how many.
        seconds: how long each is.
        seed: of everything random.
        tell: told the part that is done.

    Returns:
        What the file holds: for each time, what is said of both.
    """
    out = open_folder(out)
    drawn = simulate(runs, seconds, seed)
    times = [time for time in TIMES if time <= seconds] or [seconds]
    at = [round(time / DT) for time in times]
    truth = relative_poses(drawn.poses[at])[:, 0]
    found = {"posterior": posterior(drawn, at, tell), "map-alignment": alignment(drawn, at)}
    results: dict[str, Any] = {"settings": {"runs": runs, "seconds": seconds, "seed": seed}, "times": times}
    for name, (poses, covariances) in found.items():
        errors = poses - truth
        errors[..., 2] = wrap(errors[..., 2])
        results[name] = {
            "whitened": whitened_error(errors, drawn.bound[at], axis=0).tolist(),
            "nees": nees(errors, covariances).mean(axis=0).tolist(),
            "rmse": np.sqrt(np.mean(errors**2, axis=0)).tolist(),
        }
    results["bound"] = np.sqrt(np.diagonal(drawn.bound[at], axis1=1, axis2=2)).tolist()
    write_json(out / "map-reference.json", results)
    return results


def posterior(drawn: Runs, at: Sequence[int], tell: Callable[[float, str], object]) -> tuple[Float, Float]:
    """Poses (N, T, 3) and covariances (N, T, 3, 3) from all samples up to each of those at `at`."""
    runs, found = len(drawn.samples.seen), []
    for n in range(runs):
        tell(n / runs, f"run {n + 1} of {runs}")
        found.append(Episode(drawn.samples, drawn.prior, n, NOISE).follow(at))
    return np.array([[x.pose for x in one] for one in found]), np.array([[x.covariance for x in one] for one in found])


def alignment(drawn: Runs, at: Sequence[int]) -> tuple[Float, Float]:
    """The same by map-alignment, sample by sample."""
    runs, (_, _, robots, points) = len(drawn.samples.seen), drawn.samples.seen.shape
    config = MapAlignmentConfig(image_noise=NOISE.image, odometry_noise=(NOISE.speed, NOISE.yaw_rate))
    estimator, rows, first = make(config, runs, robots, points), np.arange(runs), 0
    estimator.reset(drawn.prior, rows)
    poses, covariances = [], []
    for k in at:
        estimator.update(Samples._make(np.ascontiguousarray(x[:, first : k + 1]) for x in drawn.samples), rows)
        first = k + 1
        poses.append(estimator.estimate.pose[:, 0].copy())
        covariances.append(estimator.estimate.pose_covariance[:, 0].copy())
    return np.stack(poses, axis=1), np.stack(covariances, axis=1)


def table(results: dict[str, Any]) -> Table:
    """What was found, one row for each time."""
    words = f"Paper-like geometry, {results['settings']['runs']} runs: error over the bound (1 is right), NEES (3)"
    shown = Table(title=words, title_justify="left")
    for head in ("[s]", "bound", "posterior", "NEES", "map-alignment", "NEES"):
        shown.add_column(head, justify="right")
    for i, time in enumerate(results["times"]):
        x, y, turn = results["bound"][i]
        cells = [f"{time:g}", f"{x:.3f} m, {y:.3f} m, {math.degrees(turn):.2f}°"]
        for name in ("posterior", "map-alignment"):
            cells += [f"{results[name]['whitened'][i]:.2f}", f"{results[name]['nees'][i]:.2f}"]
        shown.add_row(*cells)
    return shown
