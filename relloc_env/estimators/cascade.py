"""The paper's estimator: a depth observer per robot and point, then a filter for the pose of each ordered pair."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.estimators.checks import check_array, check_prior, check_samples
from relloc_env.estimators.config import CascadeConfig
from relloc_env.kernels import anchors, depth_state, pose_filter, relative_pose
from relloc_env.kernels import cascade as kernels
from relloc_env.kernels.lanes import W, blocks, flat, gather, scatter
from relloc_env.samples import Estimate, Float, Prior, Rows, Samples, Sharing, ordered_pairs

_MODELS = {
    "position": relative_pose.POSITION,
    "velocity": relative_pose.VELOCITY,
    "printed": relative_pose.PRINTED,
}


class Cascade(Sharing):
    """Depth observers and pose filters of N environments; see `estimators.protocol.Estimator`.

    Args:
        num_envs: number N of environments.
        robots: number R of robots.
        points: number M of points.
        config: options.
        message_window: [samples] 1 + the greatest age at which a message may arrive, at most 64.
    """

    def __init__(
        self, num_envs: int, robots: int, points: int, config: CascadeConfig, *, message_window: int = 1
    ) -> None:
        self.config = config
        self._pairs = ordered_pairs(robots)
        n, pairs = num_envs, len(self._pairs)
        length = message_window if message_window > 1 else 0
        shape = kernels.shape(
            robots, points, pairs, n, length,
            use_unseen=config.use_unseen, from_odometry=config.process == "odometry",
        )  # fmt: skip
        self._sizes = np.array(shape, dtype=np.int64)
        self._settings = _settings(config, robots)
        self._gains = np.tile(_gains(config, robots)[:, None], (n, 1, points, 1))
        self._sample = np.full(n, -2, dtype=np.int64)
        self._table = blocks(n, shape.size)
        self._received = np.zeros((n, pairs), dtype=np.uint64)
        self._ring: pose_filter.Ring | None = None
        if length:
            self._ring = pose_filter.Ring(
                motion=np.zeros((n, length, robots, anchors.MOTION)),
                clock=np.zeros((n, length, anchors.CLOCK)),
                point=np.zeros((n, length, robots, points, anchors.POINT)),
                anchor=np.zeros((n, pairs, length + 1, anchors.ANCHOR)),
            )
        v_sd, w_sd = config.odometry_noise
        options = anchors.FilterOptions(
            model=_MODELS[config.pose_model],
            from_depth=config.measurement == "depth",
            variance=config.measurement_sd**2,
            from_odometry=config.process == "odometry",
            process=config.process_sd**2,
            var_v=v_sd**2,
            var_w=w_sd**2,
            hold_v=config.unheard_sd[0] ** 2,
            hold_w=config.unheard_sd[1] ** 2,
        )
        self._options = np.array(options, dtype=np.float64)
        self._estimate = Estimate(
            points=np.zeros((n, robots, points, 3)),
            points_covariance=np.zeros((n, robots, points, 3, 3)),
            known=np.zeros((n, robots, points), dtype=np.bool_),
            pose=np.zeros((n, pairs, 3)),
            pose_covariance=np.zeros((n, pairs, 3, 3)),
        )
        self._share()

    def _share(self) -> None:
        """What kernels are given, flat."""
        self._remembered: Any = (
            self._sizes,
            self._sample,
            self._table,
            self._received.reshape(-1),
            self._ring,
        )
        self._shown: Any = flat(self._estimate)
        self._updated: Any = (
            self._pairs, self._options, self._settings, self._gains.reshape(-1), *self._remembered, *self._shown,
        )  # fmt: skip
        self._checked: Samples | None = None
        self._flat: Any = ()

    @property
    def gains(self) -> Float:
        """(N, R, M, 2) H [1/s] and alpha Lambda [1/m²] of each observer, a live array: write to it to change them."""
        return self._gains

    @property
    def estimate(self) -> Estimate:
        """What is believed after the last sample: live arrays, refreshed in place by `reset` and `update`."""
        return self._estimate

    def reset(self, prior: Prior, rows: Rows) -> None:
        """Forget everything about the environments `rows`, gains apart, and start from `prior`."""
        check_prior(prior, *self._estimate.known.shape)
        told = (prior.depth, prior.pose, float(prior.depth_sd), prior.pose_sd)
        status = kernels.reset(*(*told, *self._remembered, rows))
        if status:
            self._raise(status)
        self._show(rows)

    def update(self, samples: Samples, rows: Rows) -> None:
        """Take the K samples in, in order."""
        if samples is not self._checked:
            check_samples(samples, *self._estimate.known.shape)
            self._checked, self._flat = samples, (*flat(samples), samples.period.shape[1])
        status = kernels.update(*(*self._flat, *self._updated, rows))
        if status:
            self._raise(status)

    def get_state(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """Copies of all that the estimator remembers of `rows`; every array has the rows as its first axis."""
        state: dict[str, NDArray[Any]] = {name: array[rows] for name, array in self._arrays().items()}
        return state | {"numbers": gather(self._table, rows)}

    def set_state(self, state: dict[str, NDArray[Any]], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
        arrays = self._arrays()
        if state.keys() != arrays.keys() | {"numbers"}:
            known = sorted([*arrays, "numbers"])
            raise ValueError(f"Argument `state` must have the keys {known}, but has {sorted(state)}.")
        for name, array in arrays.items():
            check_array(f"state[{name!r}]", state[name], array.dtype, (len(rows), *array.shape[1:]))
        numbers = state["numbers"]
        check_array("state['numbers']", numbers, self._table.dtype, (len(rows), self._table.shape[1] // W))
        for name, array in arrays.items():
            array[rows] = state[name]
        scatter(self._table, rows, numbers)
        self._show(rows)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """What is remembered beside the blocks."""
        arrays: dict[str, NDArray[Any]] = {"sample": self._sample, "gains": self._gains, "received": self._received}
        return arrays if self._ring is None else arrays | self._ring._asdict()

    def _show(self, rows: Rows) -> None:
        kernels.show(*(self._pairs, self._options, *self._remembered, *self._shown, rows))

    def _raise(self, status: int) -> None:
        if status == kernels.ROW_OUT_OF_RANGE:
            raise IndexError(f"Argument `rows` must lie in [0, {len(self._sample)}), but does not.")
        if status == kernels.NOT_RESET:
            raise RuntimeError("The estimator must be reset before it is updated: some of `rows` never were.")
        if status == kernels.MESSAGE_TOO_OLD:
            window = max(1, self._sizes[4])
            raise ValueError(
                f"Argument `samples.arrived` must have ages below the message window, {window} samples, but has older."
            )


def _settings(config: CascadeConfig, robots: int) -> Float:
    """Return the (R, 9) settings of the depth observers."""
    v_sd, w_sd = config.odometry_noise
    settings = depth_state.Settings(
        critical=float(config.damping == "critical"),
        floor=config.h_floor,
        z_min=config.z_min,
        z_max=config.z_max,
        max_gap=config.max_gap,
        image_sd=config.image_noise,
        v_sd=v_sd,
        lateral_sd=0.0,
        w_sd=w_sd,
    )
    return np.array([settings] * robots, dtype=np.float64)


def _gains(config: CascadeConfig, robots: int) -> Float:
    """Return the (R, 2) gains H and alpha Lambda that the observers of each robot start with."""
    pairs = zip(_each("h", config.h, robots), _each("alpha_lambda", config.alpha_lambda, robots), strict=True)
    return np.array(list(pairs), dtype=np.float64)


def _each(name: str, gain: float | tuple[float, ...], robots: int) -> tuple[float, ...]:
    """Return one gain per robot."""
    if not isinstance(gain, tuple):
        return (gain,) * robots
    if len(gain) != robots:
        raise ValueError(f"Argument `{name}` must be one value, or one for each of {robots} robots, but is {gain!r}.")
    return gain
