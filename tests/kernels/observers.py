"""Depth observers to drive in tests: any number of points, side by side in the lanes of their workspaces.

And what a step of one should be, by dense tools.
"""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import simpson
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import expm

from relloc_env.kernels import camera, depth_state
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.lanes import W, blocks
from relloc_env.kernels.motion import arc

Float = NDArray[np.float64]
SETTINGS = depth_state.Settings(
    critical=0.0, floor=0.5, z_min=0.1, z_max=100.0, max_gap=0.3,
    image_sd=0.002, v_sd=0.005, lateral_sd=0.0, w_sd=0.005,
)  # fmt: skip

# Columns of what is remembered.
POINT = [place // W for place in (depth_state.Q_X, depth_state.Q_Y, depth_state.HEIGHT)]
ESTIMATE = [place // W for place in (depth_state.X_HAT, depth_state.Y_HAT, depth_state.CHI_HAT)]
KNOWN, TIME = depth_state.KNOWN // W, depth_state.TIME // W
COVARIANCE = slice(depth_state.COVARIANCE // W, depth_state.COVARIANCE // W + 6)
BASE_COVARIANCE = slice(depth_state.BASE_COVARIANCE // W, depth_state.BASE_COVARIANCE // W + 6)


@numba.njit
def _observe(workspaces, settings, r, width):
    for b in range(workspaces.shape[0]):
        t = workspaces[b]
        for i in range(width):
            v, lateral, w = t[i + depth_state.V], t[i + depth_state.LATERAL], t[i + depth_state.YAW_RATE]
            c_x, c_y, delta = arc(v, lateral, w, t[i + depth_state.DT])
            t[i + depth_state.CHORD_X], t[i + depth_state.CHORD_Y], t[i + depth_state.DELTA] = c_x, c_y, delta
            t[i + depth_state.SIN], t[i + depth_state.COS] = sin_cos(delta)
        depth_state.observe(t, settings, r, width)


class Observers:
    """Depth observers of `count` points; arguments hold for all of them, or are arrays with one entry for each."""

    def __init__(
        self,
        count: int,
        *settings: depth_state.Settings,
        h: Any = 2.5,
        alpha_lambda: Any = 120.0,
        depth: Any = 5.0,
        depth_sd: float = 0.1,
    ) -> None:
        self.settings = np.array(settings or (SETTINGS,))
        self.count = count
        self.workspaces = blocks(count, depth_state.WORKSPACE)
        self.put(depth_state.GAIN_H, h)
        self.put(depth_state.GAIN_ALPHA, alpha_lambda)
        self.put(depth_state.GUESS, depth)
        self.put(depth_state.DEPTH_SD, depth_sd)

    @property
    def numbers(self) -> Float:
        """A copy of what is remembered: (count, SIZE)."""
        return self._lanes()[: self.count, : depth_state.SIZE].copy()

    def put(self, place: int, values: Any) -> None:
        """Write a number of each point."""
        of_blocks = self.workspaces.reshape(len(self.workspaces), -1, W)[:, place // W]
        padded = np.zeros(of_blocks.size)
        padded[: self.count] = values
        of_blocks[:] = padded.reshape(-1, W)

    def get(self, place: int) -> Float:
        """Read a number of each point."""
        return self._lanes()[: self.count, place // W]

    def restore(self, numbers: Float) -> None:
        """Put back what `numbers` gave."""
        for column, values in enumerate(numbers.T):
            self.put(column * W, values)

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
        for k, place in enumerate((depth_state.V, depth_state.LATERAL, depth_state.YAW_RATE)):
            self.put(place, velocity[..., k])
        for k, place in enumerate((depth_state.SEEN_X, depth_state.SEEN_Y)):
            self.put(place, image[..., k])
        self.put(depth_state.DT, dt)
        self.put(depth_state.SEEN, seen)
        _observe(self.workspaces, self.settings, robot, W)
        return self.numbers[:, POINT]

    def image_now(self, z_min: float) -> Float:
        """(count, 3) the estimates in the image now."""
        return np.array([depth_state.image_now(*place, z_min) for place in self._places()])

    def image_covariance_now(self, z_min: float) -> Float:
        """(count, 6) their covariances."""
        return np.array([depth_state.image_covariance_now(*place, z_min) for place in self._places()])

    def _places(self) -> list[tuple[Float, int]]:
        """Workspace and lane of each point."""
        return [(self.workspaces[n // W], n % W) for n in range(self.count)]

    def _lanes(self) -> Float:
        """(lanes, WORKSPACE) copy of all workspaces."""
        table = self.workspaces.reshape(len(self.workspaces), -1, W)
        return np.moveaxis(table, 1, 2).reshape(-1, depth_state.WORKSPACE)


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
