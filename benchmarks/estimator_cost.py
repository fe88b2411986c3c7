"""How long one sample takes map-alignment: the local filter, and each alignment by itself."""

import time
from typing import Any

import numpy as np

from benchmarks.scenarios import POINTS, Runs, Scene, draw
from relloc_env.estimators.config import MapAlignmentConfig
from relloc_env.estimators.map_alignment import MapAlignment
from relloc_env.samples import Float, Prior, Samples

SCENE = Scene()
REPEATS = 3
"""Times that each sample is measured; the least counts, since nothing but other processes makes them differ."""


def cost(seed: int, runs: int, seconds: float) -> dict[str, Any]:
    """Time of a sample [µs] for 2, 3 and 4 points: the local filter of a robot, and the alignment of a direction.

    Args:
        seed: of the runs.
        runs: of each number of points.
        seconds: how long each run is.
    """
    drawn = draw(SCENE, 12 * runs, seconds, np.random.default_rng([seed, 1]))
    config = MapAlignmentConfig(image_noise=SCENE.image_noise, odometry_noise=(SCENE.odometry_noise,) * 2)
    found = {}
    for m in range(2, POINTS + 1):
        chosen = np.flatnonzero(drawn.truth.used == m)[:runs]
        local = [min(_filter(drawn, n, m, config) for _ in range(REPEATS)) for n in chosen]
        align = np.concatenate([_alignments(drawn, n, m, config) for n in chosen])
        found[str(m)] = {
            "filter": float(np.mean(local)),
            "median": float(np.median(align)),
            "mean": float(np.mean(align)),
            "p99": float(np.quantile(align, 0.99)),
        }
    return found


def _part(runs: Runs, n: int, robots: int, m: int) -> tuple[Samples, Prior]:
    """Run n alone, of the first robots and points."""
    one, pairs = slice(n, n + 1), robots * (robots - 1)
    period, odometry, image, seen, arrived = (field[one] for field in runs.samples)
    samples = (period, odometry[:, :, :robots], image[:, :, :robots, :m], seen[:, :, :robots, :m], arrived[..., :pairs])
    prior = runs.prior._replace(
        depth=np.ascontiguousarray(runs.prior.depth[one, :robots, :m]),
        pose=np.ascontiguousarray(runs.prior.pose[one, :pairs]),
    )
    return Samples._make(np.ascontiguousarray(field) for field in samples), prior


def _filter(runs: Runs, n: int, m: int, config: MapAlignmentConfig) -> float:
    """Time of a sample [µs] of one robot alone: it has nobody to be aligned with."""
    samples, prior = _part(runs, n, 1, m)
    estimator, rows = MapAlignment(1, 1, m, config), np.arange(1)
    estimator.reset(prior, rows)
    begin = time.perf_counter()
    estimator.update(samples, rows)
    return 1e6 * (time.perf_counter() - begin) / len(samples.period[0])


def _alignments(runs: Runs, n: int, m: int, config: MapAlignmentConfig) -> Float:
    """Time [µs] of each alignment of one direction: what an update takes longer than one without a message."""
    samples, prior = _part(runs, n, 2, m)
    samples.arrived[..., 1] = 0
    steps = [Samples._make(field[:, k : k + 1].copy() for field in samples) for k in range(samples.period.shape[1])]
    silent = [step._replace(arrived=np.zeros_like(step.arrived)) for step in steps]
    heard, unheard = (
        np.min([_updates(given, prior, m, config) for _ in range(REPEATS)], axis=0) for given in (steps, silent)
    )
    found: Float = heard - np.median(unheard)
    return found


def _updates(steps: list[Samples], prior: Prior, m: int, config: MapAlignmentConfig) -> Float:
    estimator, rows = MapAlignment(1, 2, m, config), np.arange(1)
    estimator.reset(prior, rows)
    found = np.zeros(len(steps))
    for k, step in enumerate(steps):
        begin = time.perf_counter()
        estimator.update(step, rows)
        found[k] = 1e6 * (time.perf_counter() - begin)
    return found
