"""A simple baseline: a Kalman filter of inverse range for every point on its own, then a filter for each pose."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.estimators.checks import (
    check_finite,
    check_finite_prior,
    check_prior,
    check_rows,
    check_samples,
    put_state,
)
from relloc_env.estimators.config import LEAST_IMAGE_NOISE, InverseDepthConfig
from relloc_env.kernels import anchors, pose_filter, relative_pose
from relloc_env.kernels.inverse_depth import Filters, Setup, show, take_samples
from relloc_env.kernels.lanes import fill, named, numbers_of
from relloc_env.samples import Estimate, Prior, Rows, Samples, ordered_pairs


class InverseDepth:
    """Point filters and pose filters of N environments; see `estimators.protocol.Estimator`.

    A pose filter takes messages as the cascade's does: each at the time it was made for, whatever its delay.

    Args:
        num_envs: number N of environments.
        robots: number R of robots.
        points: number M of points.
        config: options.
        message_window: [samples] 1 + the greatest age of a message, at most 64.
    """

    trusted = False
    """Whether samples and priors are known to be finite, as the simulator's are: they are not looked through then."""

    def __init__(
        self, num_envs: int, robots: int, points: int, config: InverseDepthConfig, *, message_window: int = 1
    ) -> None:
        self.config = config
        self._shape = num_envs, robots, points
        self._pairs = ordered_pairs(robots)
        n, r, m, p, length = num_envs, robots, points, len(self._pairs), message_window
        self._filters = Filters(
            state=np.zeros((n, r, m, 3)),
            covariance=np.zeros((n, r, m, 3, 3)),
            known=np.zeros((n, r, m), dtype=np.bool_),
            depth=np.zeros((n, r, m)),
            depth_sd=np.zeros(n),
            motion=np.zeros((n, r, numbers_of(anchors.MOTION))),
            clock=np.zeros((n, numbers_of(anchors.CLOCK))),
            sample=np.full(n, -1, dtype=np.int64),
            received=np.zeros((n, p), dtype=np.uint64),
        )
        self._ring = pose_filter.ring_of(n, r, m, p, length)
        (v_sd, w_sd), (hold_v, hold_w) = config.odometry_noise, config.unheard_sd
        options = anchors.FilterOptions(
            model=relative_pose.POSITION,
            from_depth=True,
            variance=config.measurement_sd**2,
            from_odometry=True,
            process=0.0,
            var_v=v_sd**2,
            var_w=w_sd**2,
            hold_v=hold_v**2,
            hold_w=hold_w**2,
        )
        variance = max(config.image_noise, LEAST_IMAGE_NOISE) ** 2
        records = fill(np.zeros(1, anchors.OPTIONS), options._asdict())
        self._setup = Setup(self._pairs, records, variance, config.use_unseen)
        filters = self._filters
        self._estimate = Estimate(
            points=filters.state,
            points_covariance=filters.covariance,
            known=filters.known,
            pose=np.zeros((n, p, 3)),
            pose_covariance=np.zeros((n, p, 3, 3)),
        )

    @property
    def estimate(self) -> Estimate:
        """What is believed after the last sample: live arrays, refreshed in place by `reset` and `update`."""
        return self._estimate

    def reset(self, prior: Prior, rows: Rows) -> None:
        """Forget everything about the environments `rows` and start from `prior`."""
        check_prior(prior, *self._shape)
        check_rows(rows, self._shape[0])
        if not self.trusted:
            check_finite_prior(prior, rows)
        for array in (*self._filters, *self._ring):
            array[rows] = 0
        filters = self._filters
        filters.depth[rows] = prior.depth[rows]
        filters.depth_sd[rows] = prior.depth_sd
        filters.sample[rows] = -1
        named(filters.motion, anchors.MOTION)["at"]["cos"][rows] = 1.0
        pose_filter.start_rings(self._ring, prior.pose, prior.pose_sd, rows)
        self._show(rows)

    def update(self, samples: Samples, rows: Rows) -> None:
        """Take the K samples in, in order."""
        check_samples(samples, *self._shape)
        check_rows(rows, self._shape[0])
        if not self.trusted:
            check_finite(samples, rows)
        if not self._filters.depth_sd[rows].all():
            raise RuntimeError("The estimator must be reset before it is updated: some of `rows` never were.")
        in_time = take_samples(samples, self._setup, self._filters, self._ring, self._estimate, rows)
        if not in_time:
            raise ValueError(
                "Argument `samples.arrived` must have ages below the message window, "
                f"{self._ring.clock.shape[1]} samples, but has older."
            )

    def get_state(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """Copies of all that the estimator remembers of `rows`; every array has the rows as its first axis."""
        return {name: array[rows] for name, array in self._arrays().items()}

    def set_state(self, state: dict[str, NDArray[Any]], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
        check_rows(rows, self._shape[0])
        put_state(self._arrays(), state, rows)
        self._show(rows)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        filters, ring = self._filters._asdict(), self._ring._asdict()
        return {**filters, **{f"ring_{name}": array for name, array in ring.items()}}

    def _show(self, rows: Rows) -> None:
        show(self._setup, self._filters, self._ring, self._estimate, rows)
