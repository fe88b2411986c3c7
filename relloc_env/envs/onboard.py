"""On board of the robots: the estimator, dead reckoning, and what the robots tell each other.

It takes samples alone, never the truth: the environment feeds it from the simulation, a wrapper from observations.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.estimators.config import CascadeConfig, MapAlignmentConfig
from relloc_env.estimators.protocol import Estimator
from relloc_env.estimators.registry import make
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.motion import advance, wrap_angle
from relloc_env.samples import Bool, Estimate, Prior, Rows, Samples, copy_sample, empty_samples, ordered_pairs

FAR = 100.0
"""[m] bound of positions."""
IMAGE = 100.0
"""[-] bound of normalised image coordinates: 89.4 degrees off the axis."""
POINT = 8
"""Numbers a robot tells about each point: seen, x, y, sin and cos of the bearing, elevation, inverse range, log sd."""
BARE_POINT = 3
"""Numbers about each point without an estimator: seen, x, y."""
MOTION = 4
"""Numbers a robot tells about its motion: dead reckoning x, y, sin and cos of the heading."""


class Memory(NamedTuple):
    """What robots remember beside their estimators; C-contiguous arrays, N first."""

    dead_reckoning: Any
    """[m, m, rad] (N, R, 3) odometry summed up since the start, in the frame of the start."""
    tick: Any
    """(N,) samples since the start."""
    outbox: Any
    """(N, R, W, F) what a robot told at the last W ticks: M x the numbers per point, then its motion."""
    inbox: Any
    """(N, P, F) the newest that reached the pair's observer."""
    inbox_tick: Any
    """(N, P) the tick at which that was told; -1 for nothing yet."""


@kernel
def bounded(value, limit):
    """Clip to [-limit, limit]."""
    return min(max(value, -limit), limit)


@kernel
def write_point(out, at, samples, estimate, n, k, r, i, bare):
    """Write what robot r has about point i from `at` on; returns the place after it."""
    seen = samples.seen[n, k, r, i]
    out[at] = 1.0 if seen else 0.0
    for j in range(2):
        value = samples.image[n, k, r, i, j]
        out[at + 1 + j] = bounded(value, IMAGE) if seen and not math.isnan(value) else 0.0
    if bare:
        return at + BARE_POINT
    if not estimate.known[n, r, i]:
        out[at + 3 : at + POINT] = 0.0
        return at + POINT
    bearing, rho = estimate.points[n, r, i, 0], estimate.points[n, r, i, 2]
    out[at + 3] = math.sin(bearing)
    out[at + 4] = math.cos(bearing)
    out[at + 5] = bounded(estimate.points[n, r, i, 1], IMAGE)
    out[at + 6] = bounded(rho, IMAGE)
    relative = math.sqrt(max(estimate.points_covariance[n, r, i, 2, 2], 1e-16)) / max(rho, 1e-6)
    out[at + 7] = bounded(math.log(max(relative, 1e-8)), 20.0)
    return at + POINT


@kernel
def write_motion(out, at, reckoned):
    """Write a dead-reckoned pose."""
    out[at] = bounded(reckoned[0], FAR)
    out[at + 1] = bounded(reckoned[1], FAR)
    out[at + 2] = math.sin(reckoned[2])
    out[at + 3] = math.cos(reckoned[2])
    return at + MOTION


@kernel
def _tell(memory_, samples_, estimate_, pairs, rows, first, bare):
    """Sum up the odometry of all samples; after the last one, each robot tells what it has.

    The newest message that arrives with that sample is put in the inbox. `first`: whether an episode starts.
    """
    memory, samples, estimate = Memory(*memory_), Samples(*samples_), Estimate(*estimate_)
    block, robots, count = samples.period.shape[1], samples.seen.shape[2], samples.seen.shape[3]
    window, last = memory.outbox.shape[2], block - 1
    for n in rows:
        if first:
            memory.inbox_tick[n] = -1
            memory.inbox[n] = 0.0
            memory.dead_reckoning[n] = 0.0
            memory.tick[n] = -1
        memory.tick[n] += block
        tick = memory.tick[n]
        for r in range(robots):
            pose = memory.dead_reckoning[n, r]
            for k in range(block):
                v, lateral, w = samples.odometry[n, k, r, 0], samples.odometry[n, k, r, 1], samples.odometry[n, k, r, 2]
                x, y, theta = advance(
                    pose[0], pose[1], pose[2], np.float64(v), np.float64(lateral), np.float64(w), samples.period[n, k]
                )
                pose[0], pose[1], pose[2] = x, y, wrap_angle(theta)
            told = memory.outbox[n, r, tick % window]
            at = 0
            for i in range(count):
                at = write_point(told, at, samples, estimate, n, last, r, i, bare)
            write_motion(told, at, pose)
        for p in range(pairs.shape[0]):
            arrived = samples.arrived[n, last, p]
            for age in range(min(window, tick + 1)):
                if (arrived >> np.uint64(age)) & np.uint64(1):
                    if tick - age > memory.inbox_tick[n, p]:
                        memory.inbox_tick[n, p] = tick - age
                        told = memory.outbox[n, pairs[p, 1], (tick - age) % window]
                        for j in range(told.shape[0]):
                            memory.inbox[n, p, j] = told[j]
                    break


class Onboard:
    """What the robots of N environments make of their samples.

    Attributes:
        estimator: None for the bare environment.
        estimate: what it believes, live arrays; nothing is known where there is no estimator.
        memory: dead reckoning and messages, live arrays.
    """

    def __init__(self, config: EnvConfig, num_envs: int, estimator: Estimator | None = None) -> None:
        n, r, m, window = num_envs, config.robots, config.targets, config.message_window
        self.pairs = ordered_pairs(r)
        p = len(self.pairs)
        if estimator is None and config.estimator is not None:
            estimator = make(informed(config), n, r, m, message_window=window)
        self.estimator, self.bare = estimator, estimator is None
        self.estimate = _nothing(n, r, m, p) if estimator is None else estimator.estimate
        told = m * (BARE_POINT if self.bare else POINT) + MOTION
        self.memory = Memory(
            dead_reckoning=np.zeros((n, r, 3)),
            tick=np.full(n, -1, np.int64),
            outbox=np.zeros((n, r, window, told)),
            inbox=np.zeros((n, p, told)),
            inbox_tick=np.full((n, p), -1, np.int64),
        )
        self.memory_, self.estimate_ = tuple(self.memory), tuple(self.estimate)
        self._single: Samples | None = None
        if not config.network.perfect:
            self._single = empty_samples(n, 1, r, m, p)

    def reset(self, prior: Prior, first: Samples, rows: Rows) -> None:
        """Start episodes from what the robots are told and their first sample."""
        if self.estimator is not None:
            self.estimator.reset(prior, rows)
            self.estimator.update(first, rows)
        _tell(self.memory_, tuple(first), self.estimate_, self.pairs, rows, True, self.bare)

    def update(self, samples: Samples, rows: Rows) -> None:
        """Take in the samples of an action.

        Where messages may be late or lost, this goes sample by sample: a late one tells what was known at its time.
        """
        if self._single is None:
            self._take(samples, rows)
            return
        for k in range(samples.period.shape[1]):
            copy_sample(samples, k, self._single, 0, rows)
            self._take(self._single, rows)

    def _take(self, samples: Samples, rows: Rows) -> None:
        if self.estimator is not None:
            self.estimator.update(samples, rows)
        _tell(self.memory_, tuple(samples), self.estimate_, self.pairs, rows, False, self.bare)

    def get_state(self, rows: Rows) -> dict[str, Any]:
        """Copies of everything that is remembered of the environments `rows`."""
        state: dict[str, Any] = {name: value[rows].copy() for name, value in self.memory._asdict().items()}
        state["estimator"] = {} if self.estimator is None else self.estimator.get_state(rows)
        return state

    def set_state(self, state: dict[str, Any], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
        if self.estimator is not None:
            self.estimator.set_state(state["estimator"], rows)
        for name, value in self.memory._asdict().items():
            value[rows] = state[name]


def informed(
    config: EnvConfig, estimator: CascadeConfig | MapAlignmentConfig | None = None
) -> CascadeConfig | MapAlignmentConfig:
    """An estimator's configuration, which takes what is known of the robots' sensors where it does not state its own.

    Args:
        config: of the environment, with the robots and cameras.
        estimator: the one to inform; None for the environment's own.
    """
    chosen = estimator or config.estimator
    assert chosen is not None
    known: dict[str, object] = {
        "image_noise": max(config.camera_of(r).image_noise for r in range(config.robots)),
        "odometry_noise": tuple(
            max(config.robot_of(r).odometry_noise[j] for r in range(config.robots)) for j in (0, 1)
        ),
    }
    if isinstance(chosen, MapAlignmentConfig):
        known["camera_heights"] = tuple(config.camera_of(r).mount_height for r in range(config.robots))
    unstated = {name: value for name, value in known.items() if name not in chosen.model_fields_set}
    return chosen.model_copy(update=unstated)


def _nothing(n: int, r: int, m: int, p: int) -> Estimate:
    """The estimate of a bare environment: nothing is known."""
    known: Bool = np.zeros((n, r, m), np.bool_)
    points, covariance = np.zeros((n, r, m, 3)), np.zeros((n, r, m, 3, 3))
    return Estimate(points, covariance, known, np.zeros((n, p, 3)), np.zeros((n, p, 3, 3)))
