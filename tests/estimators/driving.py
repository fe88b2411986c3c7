"""Two robots driving before three points: what they measure, and a cascade fed with it."""

from typing import Any

import numpy as np

from relloc_env.estimators import CascadeConfig, make
from relloc_env.estimators.cascade import Cascade
from relloc_env.kernels import camera, motion
from relloc_env.samples import Float, Prior, Samples

arc: Any = motion.arc
advance: Any = motion.advance
relative: Any = motion.relative

PERIOD = 0.05
POINTS = np.array([[4.0, 0.6, 0.5], [4.5, -1.0, -0.3], [5.0, 0.2, 0.8]])
NOW = np.uint64(1)


def simulate(
    steps: int, *, envs: int = 1, seed: int = 0, noise: float = 1.0, seen: float = 0.9
) -> tuple[Samples, Float]:
    """Two robots moving at random before three points: samples (K = steps + 1), and the true poses (N, K, 2, 3)."""
    rng = np.random.default_rng(seed)
    k = steps + 1
    period = np.full((envs, k), PERIOD)
    period[:, 0] = 0.0
    speed = np.repeat(rng.uniform([0.0, 0.0, -0.1], [0.2, 0.0, 0.1], (envs, k // 10 + 1, 2, 3)), 10, axis=1)[:, :k]
    poses, image = np.zeros((envs, k, 2, 3)), np.zeros((envs, k, 2, len(POINTS), 2), dtype=np.float32)
    for n in range(envs):
        pose = [(0.0, 0.8, -0.1), (0.3, -1.0, 0.3)]
        for j in range(k):
            pose = [advance(*pose[i], *speed[n, j, i], period[n, j]) for i in range(2)]
            for i in range(2):
                poses[n, j, i] = pose[i]
                for m, (x, y, height) in enumerate(POINTS):
                    q = relative(*pose[i], x, y, 0.0)
                    image[n, j, i, m] = camera.project(q[0], q[1], height)[:2]
    odometry = speed + noise * rng.normal(0.0, [0.01, 0.0, 0.01], speed.shape)
    image += (noise * rng.normal(0.0, 0.003, image.shape)).astype(np.float32)
    visible = rng.random((envs, k, 2, len(POINTS))) < seen
    image[~visible] = 0.0
    samples = Samples(
        period=period,
        odometry=odometry.astype(np.float32),
        image=image,
        seen=visible,
        arrived=np.full((envs, k, 2), NOW),
    )
    return samples, poses


def take(samples: Samples, first: int, last: int) -> Samples:
    """Samples first..last (not included)."""
    fields: Any = [np.ascontiguousarray(field[:, first:last]) for field in samples]
    return Samples(*fields)


def prior(envs: int, depth: float = 4.0) -> Prior:
    pose = np.tile([[0.5, -1.2, 0.2], [0.3, 1.5, -0.6]], (envs, 1, 1))
    return Prior(np.full((envs, 2, len(POINTS)), depth), pose, 1.0, np.array([1.5, 1.5, 1.0]))


def run(
    samples: Samples, config: CascadeConfig | str = "cascade-critical", window: int = 1, *, block: int = 1
) -> Cascade:
    envs, k = samples.period.shape
    estimator = make(config, envs, 2, len(POINTS), message_window=window)
    assert isinstance(estimator, Cascade)
    rows = np.arange(envs)
    estimator.reset(prior(envs), rows)
    for first in range(0, k, block):
        estimator.update(take(samples, first, min(first + block, k)), rows)
    return estimator


def late(samples: Samples, window: int, seed: int, loss: float = 0.0) -> Samples:
    """The same samples, each message delayed at random by less than `window` samples; at the end all have come."""
    rng = np.random.default_rng(seed)
    envs, k, pairs = samples.arrived.shape
    arrived = np.zeros_like(samples.arrived)
    for n in range(envs):
        for p in range(pairs):
            for made in range(k):
                if rng.random() >= loss:
                    at = min(made + int(rng.integers(window)), k - 1)
                    arrived[n, at, p] |= NOW << np.uint64(at - made)
    return samples._replace(arrived=arrived)
