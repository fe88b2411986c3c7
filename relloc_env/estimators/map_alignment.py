"""An estimator at the information bound: a joint map per robot, and the pose from the two maps alone."""

import math
from statistics import NormalDist
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
from relloc_env.estimators.config import LEAST_IMAGE_NOISE, MapAlignmentConfig
from relloc_env.kernels.local_map import CALIBRATION
from relloc_env.kernels.map_alignment import scratch, take_samples
from relloc_env.kernels.map_tracking import Maps, Options, show_maps
from relloc_env.kernels.pair_tracking import Pairs
from relloc_env.samples import Estimate, Prior, Rows, Samples, ordered_pairs

NOMINAL = np.array([1.0, 1.0, 0.0, 0.0, 0.0])
"""Calibration of a robot as built: scales 1, no loss, camera straight ahead, no delay."""
RARE = 10
"""[samples] between two alignments from which on each has several challengers: the search is over sooner."""
CHALLENGERS = 6
"""Their number."""


class MapAlignment:
    """Local joint maps, aligned anew each time (docs/equations.md, section 7). See `estimators.protocol.Estimator`."""

    trusted = False
    """Whether samples and priors are known to be finite, as the simulator's are: they are not looked through then."""

    def __init__(
        self, num_envs: int, robots: int, points: int, config: MapAlignmentConfig, *, message_window: int = 1
    ) -> None:
        """Make the estimator for N environments of R robots and M points.

        Args:
            num_envs: number N of environments.
            robots: number R of robots.
            points: number M of points.
            config: options.
            message_window: [samples] 1 + the greatest age of a message; maps of that many samples are kept.
        """
        heights = config.camera_heights if config.camera_heights is not None else (0.0,) * robots
        if len(heights) != robots:
            raise ValueError(f"Argument `camera_heights` must have one value per robot ({robots}), but has {heights}.")
        self.config = config
        self._shape = num_envs, robots, points
        self._checked: Samples | None = None
        self._heights = np.array(heights)
        self._ends = ordered_pairs(robots)
        self._options = _options(config)
        self._calibration_sd = (*config.scale_sd, config.turn_loss_sd, config.camera_yaw_sd, config.camera_delay_sd)
        self._first = 3 * points
        size = 3 * points + (CALIBRATION if any(self._calibration_sd) else 0)
        n, w, r, m, p = num_envs, message_window, robots, points, len(self._ends)
        self._maps = Maps(
            state=np.zeros((n, w, r, size)),
            covariance=np.zeros((n, w, r, size, size)),
            known=np.zeros((n, w, r, m), dtype=np.bool_),
            confirmed=np.zeros((n, w, r, m), dtype=np.bool_),
            motion=np.zeros((n, w, r, 4)),
            cursor=np.zeros(n, dtype=np.int64),
            ticks=np.zeros(n, dtype=np.int64),
            rejected=np.zeros((n, r, m), dtype=np.int64),
            unseen=np.zeros((n, r, m)),
            depth=np.zeros((n, r, m)),
            depth_sd=np.zeros(n),
        )
        self._pairs = Pairs(
            prior=np.zeros((n, p, 3)),
            prior_covariance=np.zeros((n, p, 3, 3)),
            mode=np.zeros((n, p, 3)),
            second=np.zeros((n, p, 3)),
            has_second=np.zeros((n, p), dtype=np.bool_),
            anchored=np.zeros((n, p, 3)),
            anchored_covariance=np.zeros((n, p, 3, 3)),
            pose=np.zeros((n, p, 3)),
            pose_covariance=np.zeros((n, p, 3, 3)),
            heard=np.zeros((n, p, 3)),
            silence=np.full((n, p), message_window, dtype=np.int64),
            age=np.full((n, p), -1, dtype=np.int64),
            pending=np.zeros((n, p), dtype=np.bool_),
            since_grid=np.zeros((n, p)),
            when=np.full((n, p), -1, dtype=np.int64),
            aligned=np.zeros((n, p), dtype=np.bool_),
            turn=np.zeros((n, p), dtype=np.int64),
        )
        self._estimate = Estimate(
            points=np.zeros((n, r, m, 3)),
            points_covariance=np.zeros((n, r, m, 3, 3)),
            known=np.zeros((n, r, m), dtype=np.bool_),
            pose=self._pairs.pose,
            pose_covariance=self._pairs.pose_covariance,
        )

    def reset(self, prior: Prior, rows: Rows) -> None:
        """Forget everything about the environments `rows` and start from `prior`."""
        check_prior(prior, *self._shape)
        check_rows(rows, self._shape[0])
        if not self.trusted:
            check_finite_prior(prior, rows)
        for array in (*self._maps, *self._pairs):
            array[rows] = 0
        maps, pairs = self._maps, self._pairs
        if any(self._calibration_sd):
            maps.state[rows, ..., self._first :] = NOMINAL
            for index, sd in enumerate(self._calibration_sd, start=self._first):
                maps.covariance[rows, ..., index, index] = sd * sd
        maps.depth[rows] = prior.depth[rows]
        maps.depth_sd[rows] = prior.depth_sd
        pairs.silence[rows] = maps.state.shape[1]
        pairs.age[rows] = pairs.when[rows] = -1
        pairs.since_grid[rows] = math.inf
        covariance = np.diag(np.square(prior.pose_sd))
        for mean in (pairs.prior, pairs.mode, pairs.anchored, pairs.pose):
            mean[rows] = prior.pose[rows]
        for spread in (pairs.prior_covariance, pairs.anchored_covariance, pairs.pose_covariance):
            spread[rows] = covariance
        self._refresh(rows)

    def update(self, samples: Samples, rows: Rows) -> None:
        """Take the K samples in, in order."""
        if samples is not self._checked:
            check_samples(samples, *self._shape)
            self._checked = samples
        check_rows(rows, self._shape[0])
        if not self.trusted:
            check_finite(samples, rows)
        if not self._maps.depth_sd[rows].all():
            raise RuntimeError("The estimator must be reset before it is updated: some of `rows` never were.")
        problem, starts, nodes, work = scratch(self._maps.depth.shape[2], self._maps.state.shape[3])
        in_time = take_samples(
            rows,
            samples.period,
            samples.odometry,
            samples.image,
            samples.seen,
            samples.arrived,
            self._maps,
            self._pairs,
            self._options,
            self._ends,
            self._heights,
            problem,
            starts,
            nodes,
            work,
        )
        if not in_time:
            raise ValueError(
                "Argument `samples.arrived` must have ages below the message window, "
                f"{self._maps.state.shape[1]} samples, but has older."
            )
        self._refresh(rows)

    @property
    def estimate(self) -> Estimate:
        """What is believed after the last sample: live arrays."""
        return self._estimate

    @property
    def aligned(self) -> NDArray[np.bool_]:
        """(N, P) whether the pose rests on an alignment, not on the prior alone."""
        return self._pairs.aligned

    @property
    def calibration(self) -> NDArray[np.float64]:
        """(N, R, 5) estimated (k_v, k_w, kappa, psi, tau), see `kernels.local_map`; a copy."""
        maps = self._maps
        n, _, r, _ = maps.state.shape
        if not any(self._calibration_sd):
            return np.broadcast_to(NOMINAL, (n, r, CALIBRATION)).copy()
        return maps.state[np.arange(n), maps.cursor, :, self._first :].copy()

    def get_state(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """Copies of all that the estimator remembers of `rows`."""
        return {name: array[rows] for name, array in self._arrays().items()}

    def set_state(self, state: dict[str, NDArray[Any]], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows."""
        check_rows(rows, self._shape[0])
        put_state(self._arrays(), state, rows)
        self._refresh(rows)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        maps, pairs = self._maps._asdict(), self._pairs._asdict()
        return {**{f"map_{k}": v for k, v in maps.items()}, **{f"pair_{k}": v for k, v in pairs.items()}}

    def _refresh(self, rows: Rows) -> None:
        show_maps(rows, self._maps, *self._estimate[:3])


def _options(config: MapAlignmentConfig) -> Options:
    rho, rho_sd = config.inverse_range_prior or (0.0, 0.0)
    rare = config.align_every != "update" and config.align_every >= RARE
    return Options(
        image_variance=max(config.image_noise, LEAST_IMAGE_NOISE) ** 2,
        speed_variance=config.odometry_noise[0] ** 2,
        lateral_variance=config.lateral_noise**2,
        yaw_variance=config.odometry_noise[1] ** 2,
        noise_period=config.noise_period or 0.0,
        rest_share=config.rest_share,
        gate=-2.0 * math.log(config.gate_probability),
        bearing_gate=NormalDist().inv_cdf(1.0 - 0.5 * config.gate_probability) ** 2,
        most_rejections=config.most_rejections,
        forget_after=config.forget_after or math.inf,
        rho=rho,
        rho_variance=rho_sd**2,
        height_sd=config.height_sd,
        every=0 if config.align_every == "update" else config.align_every,
        challenger_every=1 if rare else config.challenger_every,
        challengers=CHALLENGERS if rare else 1,
        grid_period=config.grid_period or 0.0,
        mirror=config.mirror,
        iterations=config.iterations,
        tolerance=config.tolerance,
        unheard_speed_variance=config.unheard_sd[0] ** 2,
        unheard_yaw_variance=config.unheard_sd[1] ** 2,
    )
