"""A log as a source of what the simulator yields: samples and a prior; the truth lies beside them, for scoring."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from relloc_env.kernels.motion import wrap_angle
from relloc_env.logs.checks import sent_by
from relloc_env.samples import Float, Prior, Samples, ordered_pairs


@dataclass(frozen=True)
class Truth:
    """What was so. For scores (and for a first guess off by a set error); no estimator is given it."""

    poses: Float
    """[m, m, rad] (T, R, 3) of the robots (cameras) in the world at the samples; NaN where not known."""
    points: Float
    """[m] (M, 3) in the world; NaN where not known."""
    sensed_depth: Float | None = None
    """[m] (T, R, M) depth by another sensor (second camera, range), NaN where none: a check that needs no map."""

    @cached_property
    def depth(self) -> Float:
        """[m] (T, R, M) true distance of each point along the optical axis."""
        offset = self.points[None, None, :, :2] - self.poses[:, :, None, :2]
        theta = self.poses[:, :, None, 2]
        depth: Float = np.cos(theta) * offset[..., 0] + np.sin(theta) * offset[..., 1]
        return depth

    @cached_property
    def relative(self) -> Float:
        """[m, m, rad] (T, P, 3) true pose of the observed robot in the observer's frame, per ordered pair."""
        pairs = ordered_pairs(self.poses.shape[1])
        a, b = self.poses[:, pairs[:, 0]], self.poses[:, pairs[:, 1]]
        d, theta = b[..., :2] - a[..., :2], a[..., 2]
        cos, sin = np.cos(theta), np.sin(theta)
        turn = b[..., 2] - theta
        x, y = cos * d[..., 0] + sin * d[..., 1], cos * d[..., 1] - sin * d[..., 0]
        return np.stack([x, y, np.mod(turn + np.pi, 2.0 * np.pi) - np.pi], axis=-1)


@dataclass(frozen=True)
class Log:
    """One recorded run: N = 1 environment, T samples, R robots, M points, P ordered pairs."""

    name: str
    kind: str
    """Which reader made it: "mrclam", "starloc" or "relloc"."""
    robots: tuple[str, ...]
    points: tuple[str, ...]
    samples: Samples
    """All T samples, as the simulator would give them in one block: (1, T, …)."""
    prior: Prior
    truth: Truth | None
    velocity: str
    """Where the odometry comes from: "commands", "mocap" (said wherever it is used) or "odometry"."""
    start: float = 0.0
    """[s] time of the first sample since the recording began."""
    configuration: Mapping[str, Any] = field(default_factory=dict)
    """How the log was made or read, as plain data."""
    warnings: tuple[str, ...] = ()
    """What is odd about the recording, in words; results say it."""

    @cached_property
    def time(self) -> Float:
        """[s] (T,) of the samples since the recording began."""
        return self.start + np.cumsum(self.samples.period[0])

    def __len__(self) -> int:
        """Return the number of samples T."""
        return int(self.samples.period.shape[1])

    def blocks(self, size: int = 1) -> Iterator[Samples]:
        """Yield the samples in order, `size` of them (the last block: what is left) at a time."""
        for k in range(0, len(self), size):
            s, part = self.samples, slice(k, k + size)
            yield Samples(
                np.ascontiguousarray(s.period[:, part]),
                np.ascontiguousarray(s.odometry[:, part]),
                np.ascontiguousarray(s.image[:, part]),
                np.ascontiguousarray(s.seen[:, part]),
                np.ascontiguousarray(s.arrived[:, part]),
            )

    def cut(self, start: float | None = None, stop: float | None = None) -> "Log":
        """Return the part from `start` to `stop` [s], with the points seen in it; it begins anew, with period 0."""
        time = self.time
        low = -np.inf if start is None else start
        high = np.inf if stop is None else stop
        if not low < high:
            raise ValueError(f"Argument `start` must be before `stop`, but is {start} and {stop}")
        kept = np.flatnonzero((time >= low) & (time <= high))
        if kept.size == 0:
            raise ValueError(
                f"Arguments `start`, `stop` must enclose samples of the log ({time[0]:.1f} to {time[-1]:.1f} s), "
                f"but are {start} and {stop}"
            )
        s = self.samples
        part = slice(int(kept[0]), int(kept[-1]) + 1)
        seen = np.flatnonzero(s.seen[0, part].any(axis=(0, 1)))
        period, odometry = s.period[:, part].copy(), s.odometry[:, part].copy()
        period[:, 0], odometry[:, 0] = 0.0, 0.0
        image, visible = np.ascontiguousarray(s.image[:, part][:, :, :, seen]), s.seen[:, part][:, :, :, seen].copy()
        arrived = s.arrived[:, part] & sent_by(len(kept))[:, None]
        truth = self.truth
        if truth is not None:
            sensed = None if truth.sensed_depth is None else truth.sensed_depth[part][:, :, seen]
            truth = Truth(truth.poses[part], truth.points[seen], sensed)
        return replace(
            self,
            points=tuple(self.points[m] for m in seen),
            samples=Samples(period, odometry, image, visible, arrived),
            prior=self.prior._replace(depth=np.ascontiguousarray(self.prior.depth[:, :, seen])),
            truth=truth,
            start=float(time[kept[0]]),
        )

    def first_sight(self) -> "np.ndarray[tuple[int, int], np.dtype[np.int64]]":
        """(R, M) sample of the first sight of each point by each robot; -1 where there is none."""
        seen = self.samples.seen[0]
        return np.where(seen.any(axis=0), seen.argmax(axis=0), -1)

    def with_initial_error(
        self, *, depth: float | None = None, pose: tuple[float, float, float] | None = None
    ) -> "Log":
        """Return the log with first guesses that are the truth plus a set error, as in the paper's experiments.

        Args:
            depth: [m] added to the true depth at a point's first sight; its size is the guess's standard deviation.
            pose: [m, m, rad] added to the true pose (of each ordered pair); sizes as standard deviations.
        """
        truth = self.truth
        if truth is None:
            raise ValueError("Arguments `depth`, `pose` must be None for a log without truth, but are not")
        prior = self.prior
        if depth is not None:
            first = self.first_sight()
            r, m = np.nonzero(first >= 0)
            guess = prior.depth.copy()
            true = truth.depth[first[r, m], r, m]
            guess[0, r, m] = np.where(np.isfinite(true), np.maximum(true + depth, 0.1), guess[0, r, m])
            prior = prior._replace(depth=guess, depth_sd=max(abs(depth), 1e-3))
        if pose is not None and truth.poses.shape[1] > 1:
            if not np.isfinite(truth.relative[0]).all():
                raise ValueError("Argument `pose` must be None where the truth of the first sample is not known")
            start = truth.relative[0] + np.asarray(pose)
            start[:, 2] = [wrap_angle(angle) for angle in start[:, 2]]
            prior = prior._replace(pose=start[None], pose_sd=np.maximum(np.abs(np.asarray(pose)), 1e-3))
        return replace(self, prior=prior)

    def with_depth_guess(self, guess: float, sd: float) -> "Log":
        """Return the log with one first guess for the depth of every point; no truth is used.

        Args:
            guess: [m] of each depth at a point's first sight.
            sd: [m] the guess's standard deviation.
        """
        for value in (guess, sd):
            if not (value > 0.0 and np.isfinite(value)):
                raise ValueError(f"Arguments `guess`, `sd` must be positive, but are {guess} and {sd}")
        depth = np.full_like(self.prior.depth, guess)
        return replace(self, prior=self.prior._replace(depth=depth, depth_sd=float(sd)))


def perfect_network(count: int, robots: int) -> "np.ndarray[tuple[int, int, int], np.dtype[np.uint64]]":
    """`Samples.arrived` (1, T, P) of a network that delivers every message at once."""
    return np.ones((1, count, len(ordered_pairs(robots))), dtype=np.uint64)
