"""Depth observers to drive in tests: any number of points, side by side in the lanes of their workspaces.

And what a step of one should be, by dense tools.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import simpson
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import expm

from relloc_env.kernels import anchors, camera, depth_state
from relloc_env.kernels.lanes import W, aligned, block_count, fill, lanes_of, of_one, put_lanes

Float = NDArray[np.float64]


class Settings(NamedTuple):
    """`depth_state.SETTINGS` of one robot."""

    floor: float = 0.5
    z_min: float = 0.1
    z_max: float = 100.0
    max_gap: float = 0.3
    image_sd: float = 0.002
    v_sd: float = 0.005
    lateral_sd: float = 0.0
    w_sd: float = 0.005
    critical: bool = False


SETTINGS = Settings()


def columns(name: str) -> slice:
    """Where a field of `depth_state.POINT` is among the numbers of a point."""
    fields: Any = of_one(depth_state.POINT).fields
    kind, offset = fields[name][:2]
    return slice(offset // 8, (offset + kind.itemsize) // 8)


POINT = [columns(name).start for name in ("q_x", "q_y", "height")]
ESTIMATE = [columns(name).start for name in ("x_hat", "y_hat", "chi_hat")]
KNOWN, TIME = columns("known").start, columns("time").start
COVARIANCE, BASE_COVARIANCE = columns("covariance"), columns("base_covariance")


@numba.njit
def _observe(points, works, motions, settings, r, width):
    for b in range(points.shape[0]):
        anchors.reckon(motions[b], works[b].interval, 0.0, 0.0, width)
        depth_state.observe(points[b], works[b], settings[r], width)


class Observers:
    """Depth observers of `count` points; arguments hold for all of them, or are arrays with one entry for each."""

    def __init__(
        self,
        count: int,
        *settings: Settings,
        h: Any = 2.5,
        alpha_lambda: Any = 120.0,
        depth: Any = 5.0,
        depth_sd: float = 0.1,
    ) -> None:
        chosen = settings or (SETTINGS,)
        self.settings = np.zeros(len(chosen), depth_state.SETTINGS)
        for i, each in enumerate(chosen):
            fill(self.settings[i : i + 1], each._asdict())
        self.count, self._rows, blocks = count, np.arange(count), block_count(count)
        self.points, self.works = aligned(blocks, depth_state.POINT), aligned(blocks, depth_state.WORK)
        self._motions = aligned(blocks, anchors.MOTION)
        measured = {"gain_h": h, "gain_alpha": alpha_lambda, "guess": depth, "depth_sd": depth_sd}
        for name, values in measured.items():
            self._put(self.works["measured"][name], values)

    @property
    def numbers(self) -> Float:
        """A copy of what is remembered: (count, numbers of a point)."""
        return lanes_of(self.points, self._rows)

    def put(self, name: str, values: Any) -> None:
        """Write a field of each point; `values` are (count,), or (count, 6) for a covariance."""
        field = self.points[name]
        if field.ndim == 2:
            self._put(field, values)
        else:
            for k in range(field.shape[1]):
                self._put(field[:, k], np.asarray(values)[..., k])

    def _put(self, lanes: Any, values: Any) -> None:
        """Write a number (B, W) of each point."""
        padded = np.zeros(lanes.size)
        padded[: self.count] = values
        lanes[:] = padded.reshape(-1, W)

    @property
    def routes(self) -> Float:
        """(count,) which route each point took in the last sample."""
        found: Float = self.works["step"]["route"].reshape(-1)[: self.count]
        return found

    def restore(self, numbers: Float) -> None:
        """Put back what `numbers` gave."""
        put_lanes(self.points, self._rows, numbers)

    def sample(self, velocity: Any, dt: Any, image: Any, seen: Any = True, robot: int = 0) -> Float:
        """Take one sample and return the points now, (count, 3), in the body frame.

        Args:
            velocity: [m/s, m/s, rad/s] (3,) or (count, 3) over the interval before the sample.
            dt: [s] its length.
            image: (2,) or (count, 2).
            seen: whether the points are measured.
            robot: which of the settings to use.
        """
        velocity, image = np.asarray(velocity), np.asarray(image)
        interval, measured = self.works["interval"], self.works["measured"]
        for k, name in enumerate(("v", "lateral", "yaw_rate")):
            self._put(interval[name], velocity[..., k])
        for k, name in enumerate("xy"):
            self._put(measured[name], image[..., k])
        self._put(interval["dt"], dt)
        self._put(measured["seen"], seen)
        _observe(self.points, self.works, self._motions, self.settings, robot, W)
        return self.numbers[:, POINT]

    def image_now(self, z_min: float) -> Float:
        """(count, 3) the estimates in the image now."""
        return np.array([depth_state.image_now(point, i, z_min) for point, i in self._each()])

    def image_covariance_now(self, z_min: float) -> Float:
        """(count, 6) their covariances."""
        return np.array([depth_state.image_covariance_now(point, i, z_min) for point, i in self._each()])

    def _each(self) -> list[tuple[Any, int]]:
        """Record and lane of each point."""
        return [(self.points[n // W], n % W) for n in range(self.count)]


def observer_step(
    s0: Float, s1: Float, state: Float, velocity: Float, dt: float, h: float, alpha_lambda: float
) -> Float:
    """One step by dense tools, without bounds: half the flow of f_u, the exponential of the linear part, half the flow.

    x and Omega are means over the cubic through both samples that has the slopes of the image flow.
    """
    v, lateral, w = velocity
    ends = np.array([s0, s1])
    slopes = [camera.image_flow(*s, state[2], *velocity)[:2] for s in ends]
    path = CubicHermiteSpline([0.0, dt], ends, slopes)(np.array([0.0, 0.5, 1.0]) * dt)
    mean, xx, xy = (simpson(f, dx=0.5, axis=0) for f in (path, path[:, 0] ** 2, path[:, 0] * path[:, 1]))
    omega = v * mean + [lateral, 0.0]

    def half_of_f_u(chi: float) -> float:
        """dz/dt = -v - w x z, which is linear, over half the time."""
        flow = expm(0.5 * dt * np.array([[-w * mean[0], -v], [0.0, 0.0]]))
        return 1.0 / (flow @ [1.0 / chi, 1.0])[0]

    drift = (s1 - s0) / dt - w * np.array([1.0 + xx, xy])
    linear = np.zeros((4, 4))  # of e_x, e_y, chi, 1
    linear[:2, :2], linear[:2, 2], linear[:2, 3], linear[2, :2] = -h * np.eye(2), -omega, drift, alpha_lambda * omega
    *e, chi, _ = expm(linear * dt) @ [*(s0 - state[:2]), half_of_f_u(state[2]), 1.0]
    return np.array([*(s1 - e), half_of_f_u(chi)])
