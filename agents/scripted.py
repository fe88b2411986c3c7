"""Motions that look at the clock only."""

from collections.abc import Callable

import numpy as np

from agents.policy import Task
from relloc_env.samples import Float, Float32

Law = Callable[[Float, float, int], tuple[Float, Float]]
"""(time [s] (N,), greatest speed [m/s], index of the robot) -> speed [m/s] and yaw rate [rad/s], (N,) each."""

PAPER = ((0.1, 0.02), (0.1, -0.03))
"""[m/s, rad/s] constant commands of robots A and B in the paper's experiment."""


class Scripted:
    """A law of time, the same for all environments."""

    def __init__(self, task: Task, law: Law) -> None:
        self._task, self._law = task, law

    def reset(self, n: int, seed: int) -> None:
        """Nothing is remembered."""

    def act(self, observations: Float32) -> Float:
        """Follow the law at the time of each environment."""
        time, limits = self._task.time(observations), self._task.limits
        laws = [self._law(time, limits[r, 0], r) for r in range(self._task.robots)]
        speed, yaw_rate = (np.stack([np.broadcast_to(law[j], time.shape) for law in laws], axis=1) for j in (0, 1))
        return self._task.shares(speed, yaw_rate)


def stationary(time: Float, _speed: float, _robot: int) -> tuple[Float, Float]:
    """Stand still: no depth can be known."""
    return 0.0 * time, 0.0 * time


def straight(time: Float, speed: float, _robot: int) -> tuple[Float, Float]:
    """Ahead at full speed: nothing is learnt about a point on the optical axis."""
    return speed + 0.0 * time, 0.0 * time


def paper(time: Float, _speed: float, robot: int) -> tuple[Float, Float]:
    """The constant commands of the paper's experiment."""
    v, w = PAPER[robot % len(PAPER)]
    return v + 0.0 * time, w + 0.0 * time


def back_and_forth(time: Float, speed: float, _robot: int, period: float = 16.0) -> tuple[Float, Float]:
    """Straight ahead for half the period [s], and back."""
    return speed * np.where(np.mod(time, period) < 0.5 * period, 1.0, -1.0), 0.0 * time


def arc(time: Float, speed: float, robot: int, yaw_rate: float = 0.04) -> tuple[Float, Float]:
    """A wide arc at full speed; the robots turn to opposite sides."""
    return speed + 0.0 * time, (yaw_rate if robot % 2 == 0 else -yaw_rate) + 0.0 * time


def circle(time: Float, speed: float, _robot: int, radius: float = 0.6) -> tuple[Float, Float]:
    """A circle of the given radius [m]."""
    return speed + 0.0 * time, speed / radius + 0.0 * time


def sinusoid(time: Float, speed: float, _robot: int, period: float = 8.0, swing: float = 0.35) -> tuple[Float, Float]:
    """Ahead at full speed, the heading swinging by `swing` [rad] to both sides."""
    rate = 2.0 * np.pi / period
    return speed + 0.0 * time, swing * rate * np.cos(rate * time)


def figure_eight(time: Float, speed: float, _robot: int, yaw_rate: float = 0.6) -> tuple[Float, Float]:
    """A circle to the left, a circle to the right."""
    turn = 2.0 * np.pi / yaw_rate
    return speed + 0.0 * time, yaw_rate * np.where(np.mod(time, 2.0 * turn) < turn, 1.0, -1.0)


def spiral(time: Float, speed: float, _robot: int, yaw_rate: float = 0.8, growth: float = 8.0) -> tuple[Float, Float]:
    """A spiral outwards: the radius doubles in the first `growth` seconds."""
    return speed + 0.0 * time, yaw_rate / (1.0 + time / growth)


class RandomSmooth:
    """Speed and yaw rate are sums of sines whose periods and phases are drawn anew for each episode and robot."""

    WAVES = 4
    PERIODS = (4.0, 20.0)
    """[s] least and greatest period."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._streams: list[np.random.Generator] = []
        self._rate = self._phase = np.zeros((0, task.robots, 2, self.WAVES))

    def reset(self, n: int, seed: int) -> None:
        """One random stream for each environment, so that neighbours do not matter."""
        self._streams = [np.random.default_rng([seed, row]) for row in range(n)]
        self._rate = np.zeros((n, self._task.robots, 2, self.WAVES))
        self._phase = np.zeros_like(self._rate)
        for row in range(n):
            self._draw(row)

    def act(self, observations: Float32) -> Float:
        """Follow the sines; a row that starts gets new ones."""
        time = self._task.time(observations)
        for row in np.flatnonzero(time == 0.0):
            self._draw(int(row))
        waves = np.sin(self._rate * time[:, None, None, None] + self._phase)
        action: Float = np.clip(waves.sum(axis=-1) / np.sqrt(0.5 * self.WAVES), -1.0, 1.0)
        return action

    def _draw(self, row: int) -> None:
        stream, shape = self._streams[row], self._rate.shape[1:]
        self._rate[row] = 2.0 * np.pi / stream.uniform(*self.PERIODS, size=shape)
        self._phase[row] = stream.uniform(0.0, 2.0 * np.pi, size=shape)
