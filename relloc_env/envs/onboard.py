"""On board of the robots: the estimator, dead reckoning, and what the robots tell each other.

It takes samples alone, never the truth: the environment feeds it from the simulation, a wrapper from observations.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from relloc_env.config import ConfigError, EnvConfig
from relloc_env.estimators.checks import trust
from relloc_env.estimators.config import AnyConfig, MapAlignmentConfig, OwnConfig
from relloc_env.estimators.own import check_estimator, check_refreshed
from relloc_env.estimators.protocol import Estimator
from relloc_env.estimators.registry import make
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.elementary import log, sin_cos
from relloc_env.kernels.lanes import W, flat, natural, width_of, workspace
from relloc_env.kernels.motion import advance, wrap_angle
from relloc_env.kernels.tuning import tune
from relloc_env.samples import (
    Bool,
    Estimate,
    Float,
    Prior,
    Rows,
    Samples,
    Sharing,
    copy_sample,
    empty_samples,
    ordered_pairs,
)

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
    """float32 (N, R, W, F) what a robot told at the last W ticks: M x the numbers per point, then its motion."""
    inbox: Any
    """float32 (N, P, F) the newest that reached the pair's observer."""
    inbox_tick: Any
    """(N, P) the tick at which that was told; -1 for nothing yet."""


@inlined
def bounded(value, limit):
    """Clip to [-limit, limit]."""
    return min(max(value, -limit), limit)


# Workspace of `tell`, in lanes: for one robot
_POSE, _VELOCITY, _SIN, _COS = 0 * W, 3 * W, 6 * W, 7 * W
# and for one of its points.
_SEEN, _IMAGE_X, _IMAGE_Y, _BEARING, _ELEVATION, _RHO, _VARIANCE, _KNOWN = (k * W for k in range(8, 16))
_TOLD = 16 * W
_WORK = 24


@kernel
def _reckon(t, dt, width):
    """Carry the dead reckoning of one robot over a sample of `dt` [s]."""
    for i in range(width):
        v, lateral, w = t[i + _VELOCITY], t[i + _VELOCITY + W], t[i + _VELOCITY + 2 * W]
        x, y, theta = advance(t[i + _POSE], t[i + _POSE + W], t[i + _POSE + 2 * W], v, lateral, w, dt)
        t[i + _POSE], t[i + _POSE + W], t[i + _POSE + 2 * W] = x, y, wrap_angle(theta)


@kernel
def _face(t, width):
    """Sine and cosine of the dead-reckoned heading."""
    for i in range(width):
        t[i + _SIN], t[i + _COS] = sin_cos(t[i + _POSE + 2 * W])


@kernel
def _point(t, width):
    """What a robot tells about a point: `POINT` numbers; zeros where it is not seen, or not known."""
    for i in range(width):
        seen, known = t[i + _SEEN] != 0.0, t[i + _KNOWN] != 0.0
        x, y, rho = t[i + _IMAGE_X], t[i + _IMAGE_Y], t[i + _RHO]
        sin, cos = sin_cos(t[i + _BEARING])
        relative = np.sqrt(max(t[i + _VARIANCE], 1e-16)) / max(rho, 1e-6)
        log_sd = bounded(log(max(relative, 1e-8)), 20.0)
        t[i + _TOLD] = t[i + _SEEN]
        t[i + _TOLD + W] = bounded(x, IMAGE) if seen & (not math.isnan(x)) else 0.0
        t[i + _TOLD + 2 * W] = bounded(y, IMAGE) if seen & (not math.isnan(y)) else 0.0
        t[i + _TOLD + 3 * W] = sin if known else 0.0
        t[i + _TOLD + 4 * W] = cos if known else 0.0
        t[i + _TOLD + 5 * W] = bounded(t[i + _ELEVATION], IMAGE) if known else 0.0
        t[i + _TOLD + 6 * W] = bounded(rho, IMAGE) if known else 0.0
        t[i + _TOLD + 7 * W] = log_sd if known else 0.0


@kernel
def _tell(
    reckoned, ticks, outbox, inbox, inbox_tick, window, period, odometry, image, seen, arrived,
    points, points_covariance, known, pairs, rows, first, bare, width,
):  # fmt: skip
    """Sum up the odometry of all samples; after the last one, each robot tells what it has.

    The newest message that arrives with that sample is put in the inbox.

    Args:
        reckoned, ticks, outbox, inbox, inbox_tick: `Memory`, flat, changed in place.
        window: W of `Memory`.
        period, ..., arrived: `Samples`, of one length for all `rows`.
        points, points_covariance, known: of `Estimate`.
        pairs: (P, 2) ordered pairs.
        rows: environments to work on.
        first: whether an episode starts.
        bare: whether there is no estimator.
        width: lanes of a block.
    """
    block, robots, count = period.shape[1], seen.shape[2], seen.shape[3]
    last, size, ends = block - 1, (BARE_POINT if bare else POINT), pairs.shape[0]
    told = count * size + MOTION
    odometry, image, seen, arrived = odometry.ravel(), image.ravel(), seen.ravel(), arrived.ravel()
    points, points_covariance, known = points.ravel(), points_covariance.ravel(), known.ravel()
    t, slots = workspace(_WORK, width), np.zeros(W, np.int64)
    for begin in range(0, rows.shape[0], W):
        end = min(begin + W, rows.shape[0])
        for j in range(begin, end):
            n = natural(rows[j])
            if first:
                ticks[n] = -1
                inbox_tick[n * ends : (n + 1) * ends] = -1
                inbox[n * ends * told : (n + 1) * ends * told] = 0.0
                reckoned[3 * n * robots : 3 * (n + 1) * robots] = 0.0
            ticks[n] += block
            slots[j - begin] = ticks[n] % window if window > 1 else 0
        for r in range(robots):
            for j in range(begin, end):
                i, at = j - begin, natural(3 * (rows[j] * robots + r))
                for k in range(3):
                    t[_POSE + k * W + i] = reckoned[at + k]
            for k in range(block):
                for j in range(begin, end):
                    i, at = j - begin, natural(3 * ((rows[j] * block + k) * robots + r))
                    for d in range(3):
                        t[_VELOCITY + d * W + i] = odometry[at + d]
                _reckon(t, period[rows[begin], k], width)
            _face(t, width)
            for j in range(begin, end):
                i, robot = j - begin, natural(rows[j] * robots + r)
                for k in range(3):
                    reckoned[3 * robot + k] = t[_POSE + k * W + i]
                to = natural((robot * window + slots[i]) * told + count * size)
                outbox[to] = bounded(t[_POSE + i], FAR)
                outbox[to + 1] = bounded(t[_POSE + W + i], FAR)
                outbox[to + 2] = t[_SIN + i]
                outbox[to + 3] = t[_COS + i]
            for m in range(count):
                for j in range(begin, end):
                    i, n = j - begin, rows[j]
                    at = natural(((n * block + last) * robots + r) * count + m)
                    t[_SEEN + i] = 1.0 if seen[at] else 0.0
                    t[_IMAGE_X + i], t[_IMAGE_Y + i] = image[2 * at], image[2 * at + 1]
                    at = natural((n * robots + r) * count + m)
                    t[_BEARING + i], t[_ELEVATION + i] = points[3 * at], points[3 * at + 1]
                    t[_RHO + i], t[_VARIANCE + i] = points[3 * at + 2], points_covariance[9 * at + 8]
                    t[_KNOWN + i] = 1.0 if known[at] else 0.0
                _point(t, width)
                for j in range(begin, end):
                    i = j - begin
                    to = natural(((rows[j] * robots + r) * window + slots[i]) * told + m * size)
                    if bare:
                        for k in range(BARE_POINT):
                            outbox[to + k] = t[_TOLD + k * W + i]
                    else:
                        for k in range(POINT):
                            outbox[to + k] = t[_TOLD + k * W + i]
        for j in range(begin, end):
            n = natural(rows[j])
            tick = ticks[n]
            for p in range(ends):
                pair, bits = n * ends + p, arrived[natural((n * block + last) * ends + p)]
                for age in range(min(window, tick + 1)):
                    if (bits >> np.uint64(age)) & np.uint64(1):
                        if tick - age > inbox_tick[pair]:
                            inbox_tick[pair] = tick - age
                            slot = (tick - age) % window if window > 1 else 0
                            at = natural(((n * robots + pairs[p, 1]) * window + slot) * told)
                            to = natural(pair * told)
                            for k in range(told):
                                inbox[to + k] = outbox[at + k]
                        break


class Onboard(Sharing):
    """What the robots of N environments make of their samples.

    Attributes:
        estimator: None for the bare environment.
        estimate: what it believes, live arrays; nothing is known where there is no estimator.
        memory: dead reckoning and messages, live arrays.
        gains: [-] (N, R, G) of the depth observers, as the last action set them; G = 0 where actions set none.
        messages: fields of `memory` from `tick` on, flat, and the length of the window: what `observe` reads.
    """

    def __init__(self, config: EnvConfig, num_envs: int, estimator: Estimator | None = None) -> None:
        n, r, m, window = num_envs, config.robots, config.targets, config.message_window
        self.pairs = ordered_pairs(r)
        p = len(self.pairs)
        self._own = estimator is not None or isinstance(config.estimator, OwnConfig)
        if estimator is None and config.estimator is not None:
            estimator = make(informed(config), n, r, m, message_window=window)
            trust(estimator)
        elif estimator is not None:
            check_estimator(estimator, n, r, m)
        self.estimator, self.bare = estimator, estimator is None
        self.gains: Float = np.zeros((n, r, config.action_size - 2))
        self._tuned = bool(config.gain_names)
        bounds = config.gains
        self._log_bounds = np.log([bounds.h, bounds.alpha_lambda])
        self._first_gain = 2 - len(config.gain_names)
        self._middle = np.zeros((n, r, config.action_size))
        if self._tuned:
            _check_gains(estimator, (n, r, m, 2))
        self.estimate = _nothing(n, r, m, p) if estimator is None else estimator.estimate
        told = m * (BARE_POINT if self.bare else POINT) + MOTION
        self.memory = Memory(
            dead_reckoning=np.zeros((n, r, 3)),
            tick=np.full(n, -1, np.int64),
            outbox=np.zeros((n, r, window, told), np.float32),
            inbox=np.zeros((n, p, told), np.float32),
            inbox_tick=np.full((n, p), -1, np.int64),
        )
        self._window = window
        self._share()
        self._told = (self.estimate.points, self.estimate.points_covariance, self.estimate.known, self.pairs)
        self._width = width_of(n)
        self._single: Samples | None = None
        if not config.network.perfect:
            self._single = empty_samples(n, 1, r, m, p)

    def _share(self) -> None:
        """Memory as kernels are given it."""
        reckoned, *messages = flat(self.memory)
        self.messages: Any = (*messages, self._window)
        self._flat: Any = (reckoned, *self.messages)

    def reset(self, prior: Prior, first: Samples, rows: Rows) -> None:
        """Start episodes from what the robots are told and their first sample."""
        if self.estimator is not None:
            if self._tuned:
                self.tune(self._middle, rows)
            self.estimator.reset(prior, rows)
            self.estimator.update(first, rows)
            self._look(rows)
        self.tell(first, rows, first=True)

    def tell(self, samples: Samples, rows: Rows, *, first: bool) -> None:
        """Sum up odometry and pass messages on; `first` where an episode starts."""
        _tell(*(*self._flat, *samples, *self._told, rows, first, self.bare, self._width))

    def tune(self, actions: Float, rows: Rows) -> None:
        """Set the gains that `actions` (N, R, 2 + G) choose, until the next action."""
        live: Any = self.estimator
        tune(live.gains, self.gains, actions, self._log_bounds, self._first_gain, rows)

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
            self._look(rows)
        self.tell(samples, rows, first=False)

    def _look(self, rows: Rows) -> None:
        """Look at what an estimator of the user's own has done."""
        if self._own and self.estimator is not None:
            check_refreshed(self.estimator, self.estimate, rows)

    def get_state(self, rows: Rows) -> dict[str, Any]:
        """Copies of everything that is remembered of the environments `rows`."""
        state: dict[str, Any] = {name: value[rows].copy() for name, value in self.memory._asdict().items()}
        state["gains"] = self.gains[rows].copy()
        state["estimator"] = {} if self.estimator is None else self.estimator.get_state(rows)
        return state

    def set_state(self, state: dict[str, Any], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
        if self.estimator is not None:
            self.estimator.set_state(state["estimator"], rows)
        for name, value in self.memory._asdict().items():
            value[rows] = state[name]
        self.gains[rows] = state["gains"]


def informed(config: EnvConfig, estimator: AnyConfig | None = None) -> AnyConfig:
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
    unstated = {
        name: value
        for name, value in known.items()
        if name in type(chosen).model_fields and name not in chosen.model_fields_set
    }
    return chosen.model_copy(update=unstated)


def _check_gains(estimator: Any, shape: tuple[int, ...]) -> None:
    """Raise where an estimator has no gains for actions to set."""
    gains = getattr(estimator, "gains", None)
    if not isinstance(gains, np.ndarray) or gains.shape != shape:
        raise ConfigError(
            f'Argument `estimator` must have an array `gains` of {shape} for `action` "motion+gains", '
            f"but {type(estimator).__name__} has not"
        )


def _nothing(n: int, r: int, m: int, p: int) -> Estimate:
    """The estimate of a bare environment: nothing is known."""
    known: Bool = np.zeros((n, r, m), np.bool_)
    points, covariance = np.zeros((n, r, m, 3)), np.zeros((n, r, m, 3, 3))
    return Estimate(points, covariance, known, np.zeros((n, p, 3)), np.zeros((n, p, 3, 3)))
