"""The paper's estimator: a depth observer per robot and point, then a filter for the pose of each ordered pair."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.estimators.checks import (
    check_array,
    check_finite,
    check_finite_prior,
    check_prior,
    check_rows,
    check_samples,
)
from relloc_env.estimators.config import CascadeConfig
from relloc_env.kernels import anchors, depth_state, pose_filter, relative_pose
from relloc_env.kernels import cascade as kernels
from relloc_env.kernels.lanes import W, align, aligned, block_count, fill, lanes_of, put_lanes, width_of
from relloc_env.samples import Estimate, Float, Prior, Rows, Samples, Sharing, ordered_pairs

_IN_LANES = ("guess", "depth_sd", "clock", "motion", "point", "anchor")
"""Fields of `kernels.State` whose first axis is blocks."""
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

    trusted = False
    """Whether samples and priors are known to be finite, as the simulator's are: they are not looked through then."""

    def __init__(
        self, num_envs: int, robots: int, points: int, config: CascadeConfig, *, message_window: int = 1
    ) -> None:
        self.config = config
        self._pairs = ordered_pairs(robots)
        n, r, m, p = num_envs, robots, points, len(self._pairs)
        self._gains = np.tile(_gains(config, robots)[:, None], (n, 1, points, 1))
        late = message_window > 1
        self._ring = pose_filter.ring_of(n, r, m, p, message_window) if late else None
        b = block_count(n)
        self._state = kernels.State(
            guess=aligned((b, r, m, W), np.float64),
            depth_sd=aligned((b, W), np.float64),
            clock=aligned(b, anchors.CLOCK),
            motion=aligned((b, r), anchors.MOTION),
            point=aligned((b, r, m), depth_state.POINT),
            anchor=aligned((b, 0 if late else p), anchors.ANCHOR),
            sample=np.full(n, -2, dtype=np.int64),
            received=np.zeros((n, p), dtype=np.uint64),
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
        self._options = fill(np.zeros(1, anchors.OPTIONS), options._asdict())
        self._settings = _settings(config, robots)
        self._estimate = Estimate(
            points=np.zeros((n, r, m, 3)),
            points_covariance=np.zeros((n, r, m, 3, 3)),
            known=np.zeros((n, r, m), dtype=np.bool_),
            pose=np.zeros((n, p, 3)),
            pose_covariance=np.zeros((n, p, 3, 3)),
        )
        self._share()

    def __getstate__(self) -> dict[str, Any]:
        """What a copy has; it makes a handle of its own arrays."""
        return {**self.__dict__, "_checked": None, "_handle": None}

    def _share(self) -> None:
        """What kernels are given."""
        self._state = kernels.State(*(align(array) for array in self._state))
        width = width_of(len(self._state.sample))
        self._setup = kernels.Setup(
            self._pairs, self._options, self._settings, self._gains, self.config.use_unseen, width
        )
        self._checked: Samples | None = None
        self._handle: Any = None

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
        if not self.trusted:
            check_rows(rows, len(self._state.sample))
            check_finite_prior(prior, rows)
        given = (prior.depth, prior.pose, prior.pose_sd)
        status = kernels.reset(given, float(prior.depth_sd), self._state, self._ring, rows)
        if status:
            self._raise(status)
        self._show(rows)

    def update(self, samples: Samples, rows: Rows) -> None:
        """Take the K samples in, in order."""
        if samples is not self._checked:
            check_samples(samples, *self._estimate.known.shape)
            self._handle = kernels.hold(self._state, self._setup, self._estimate, samples)
            self._checked = samples  # last: another thread goes on from here
        if not self.trusted:
            check_rows(rows, len(self._state.sample))
            check_finite(samples, rows)
        status = kernels.update(self._handle, self._ring, rows)
        if status:
            self._raise(status)

    def get_state(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """Copies of all that the estimator remembers of `rows`; every array has the rows as its first axis."""
        state: dict[str, NDArray[Any]] = {name: array[rows] for name, array in self._arrays().items()}
        return state | {name: lanes_of(records, rows) for name, records in self._blocks().items()}

    def set_state(self, state: dict[str, NDArray[Any]], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
        arrays, blocks = self._arrays(), self._blocks()
        if state.keys() != arrays.keys() | blocks.keys():
            known = sorted([*arrays, *blocks])
            raise ValueError(f"Argument `state` must have the keys {known}, but has {sorted(state)}.")
        for name, array in arrays.items():
            check_array(f"state[{name!r}]", state[name], array.dtype, (len(rows), *array.shape[1:]))
        for name, records in blocks.items():
            numbers = lanes_of(records, rows[:0]).shape[1]
            check_array(f"state[{name!r}]", state[name], np.dtype(np.float64), (len(rows), numbers))
        for name, array in arrays.items():
            array[rows] = state[name]
        for name, records in blocks.items():
            put_lanes(records, rows, state[name])
        self._show(rows)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """What is remembered in rows."""
        state = self._state
        arrays: dict[str, NDArray[Any]] = {"sample": state.sample, "gains": self._gains, "received": state.received}
        ring = {} if self._ring is None else self._ring._asdict()
        return arrays | {f"ring_{name}": array for name, array in ring.items()}

    def _blocks(self) -> dict[str, NDArray[Any]]:
        """What is remembered in lanes."""
        return {name: getattr(self._state, name) for name in _IN_LANES}

    def _show(self, rows: Rows) -> None:
        kernels.show(self._state, self._setup, self._ring, self._estimate, rows)

    def _raise(self, status: int) -> None:
        if status == kernels.ROW_OUT_OF_RANGE:
            raise IndexError(f"Argument `rows` must lie in [0, {len(self._state.sample)}), but does not.")
        if status == kernels.NOT_RESET:
            raise RuntimeError("The estimator must be reset before it is updated: some of `rows` never were.")
        if status == kernels.MESSAGE_TOO_OLD:
            window = 1 if self._ring is None else self._ring.clock.shape[1]
            raise ValueError(
                f"Argument `samples.arrived` must have ages below the message window, {window} samples, but has older."
            )


def _settings(config: CascadeConfig, robots: int) -> NDArray[Any]:
    """Return (R,) `depth_state.SETTINGS`."""
    v_sd, w_sd = config.odometry_noise
    settings = {
        "critical": config.damping == "critical",
        "floor": config.h_floor,
        "z_min": config.z_min,
        "z_max": config.z_max,
        "max_gap": config.max_gap,
        "image_sd": config.image_noise,
        "v_sd": v_sd,
        "lateral_sd": 0.0,
        "w_sd": w_sd,
    }
    return fill(np.zeros(robots, depth_state.SETTINGS), settings)


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
