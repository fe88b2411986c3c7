"""Plans: sampling model-predictive control over the environment's own model, from what the robots believe.

One planner for all robots (they tell each other everything): each second it draws sequences of actions, plays them in
worlds as believed (`relloc_env.envs.belief`), and keeps to the best until the next one. The cross-entropy method
(R. Rubinstein, "The cross-entropy method for combinatorial and continuous optimization", 1999) with the plan of before
as its start.
"""

import numpy as np

from agents.policy import Task
from relloc_env.envs.belief import BeliefModel
from relloc_env.envs.onboard import POINT
from relloc_env.metrics import wrap
from relloc_env.samples import Bool, Float, Float32, Rows

SEEN, SINE, COSINE, ELEVATION, INVERSE_RANGE = 0, 3, 4, 5, 6
"""Places within a point of the field `points`."""
LEAST_INVERSE_RANGE = 0.05
"""[1/m] believed points are no further than 20 m."""


def believed(task: Task, observations: Float32) -> tuple[Float, Float]:
    """Poses [m, m, rad] (N, R, 3) and points [m] (N, M, 3) as robot A believes them, in its dead reckoning's axes.

    A point that A does not know is taken from the other robot's message; NaN where neither knows it.
    """
    n = len(observations)
    reckoned = task.field(observations, "dead_reckoning")[:, 0]
    own = np.stack([reckoned[:, 0], reckoned[:, 1], np.arctan2(reckoned[:, 2], reckoned[:, 3])], axis=-1)
    poses = np.zeros((n, task.robots, 3))
    poses[:, 0] = own
    points = _placed(task, 0, own, task.field(observations, "points")[:, 0].reshape(n, task.targets, POINT))
    if task.robots > 1:
        pose = task.field(observations, "pose")[:, 0].reshape(n, task.robots - 1, 4)
        cos, sin = np.cos(own[:, 2, None]), np.sin(own[:, 2, None])
        poses[:, 1:, 0] = own[:, 0, None] + cos * pose[..., 0] - sin * pose[..., 1]
        poses[:, 1:, 1] = own[:, 1, None] + sin * pose[..., 0] + cos * pose[..., 1]
        poses[:, 1:, 2] = wrap(own[:, 2, None] + np.arctan2(pose[..., 2], pose[..., 3]))
        told = task.field(observations, "message_points")[:, 0].reshape(n, task.robots - 1, task.targets, POINT)
        for r in range(1, task.robots):
            other = _placed(task, r, poses[:, r], told[:, r - 1])
            points = np.where(np.isfinite(points), points, other)
    return poses, points


def _placed(task: Task, robot: int, pose: Float, fields: Float) -> Float:
    """Points (N, M, 3) of a robot's fields `points`, placed by its pose (N, 3); NaN where not known."""
    sine, cosine = fields[..., SINE], fields[..., COSINE]
    known = sine * sine + cosine * cosine > 0.5
    distance = 1.0 / np.maximum(fields[..., INVERSE_RANGE], LEAST_INVERSE_RANGE)
    angle = np.arctan2(sine, cosine) + pose[:, None, 2]
    height = task.config.camera_of(robot).mount_height + fields[..., ELEVATION] * distance
    placed = np.stack(
        [pose[:, None, 0] + distance * np.cos(angle), pose[:, None, 1] + distance * np.sin(angle), height], axis=-1
    )
    return np.where(known[..., None], placed, np.nan)


class Planner:
    """Sampling model-predictive control by the cross-entropy method.

    Args:
        task: what the robots know of themselves.
        horizon: [s] how far a plan looks.
        knots: in a plan: between two knots actions are interpolated.
        samples: plans that are tried at a time.
        iterations: times that plans are drawn around the best of before.
        every: [s] between two plans.
        mean_weight: [-] part of the time-mean of J in the objective; the rest is J at the end of the horizon.
        blocked_weight: [nats] cost of a whole horizon in which the shield holds a robot.
        threads: as for `RellocVectorEnv`.
    """

    ELITE = 0.12
    """Share of the plans around which the next ones are drawn."""
    SPREAD = (0.8, 0.15)
    """[-] first and least standard deviation of a knot."""

    def __init__(
        self,
        task: Task,
        horizon: float = 6.0,
        knots: int = 5,
        samples: int = 48,
        iterations: int = 3,
        every: float = 1.0,
        mean_weight: float = 0.3,
        blocked_weight: float = 0.5,
        threads: int | None = 1,
    ) -> None:
        self._task, self._samples, self._iterations, self._threads = task, samples, iterations, threads
        self._steps = max(1, round(horizon / task.action_period))
        self._every = max(1, round(every / task.action_period))
        self._mean_weight, self._blocked_weight = mean_weight, blocked_weight
        at = np.linspace(0.0, knots - 1.0, self._steps)
        low = np.minimum(at.astype(np.int64), knots - 2)
        self._basis = np.zeros((self._steps, knots))
        self._basis[np.arange(self._steps), low] = 1.0 - (at - low)
        self._basis[np.arange(self._steps), low + 1] = at - low
        self._knots = knots
        self._n = 0

    def reset(self, n: int, seed: int) -> None:
        """Make the models, one for what has been done and one for what might be."""
        if n != self._n and n:
            self._now = BeliefModel(self._task.config, n, 1, self._threads)
            self._tried = BeliefModel(self._task.config, n, self._samples, self._threads)
        self._n = n
        self._stream = np.random.default_rng(seed)
        shape = (n, self._knots, self._task.robots, 2)
        self._plan: Float = np.zeros(shape)
        self._actions: Float = np.zeros((n, self._steps, *shape[2:]))
        self._done: Rows = np.zeros(n, np.int64)
        self._running: Bool = np.zeros(n, np.bool_)

    def act(self, observations: Float32) -> Float:
        """Keep to the plan; make a new one where it is time to."""
        task, rows = self._task, np.arange(self._n)
        started = (task.time(observations) == 0.0) | ~self._running
        poses, points = believed(task, observations)
        if not started.all():
            self._now.core.step(np.ascontiguousarray(self._last), rows[~started])
            self._now.believe(poses, points, rows[~started])
        if started.any():
            self._now.start(poses, points, rows[started])
            self._plan[started] = 0.0
            self._plan[started, ..., 0] = 0.8
            self._done[started] = self._every
            self._running[started] = True
        if (self._done >= self._every).any():
            self._replan()
        chosen: Float = self._actions[rows, np.minimum(self._done, self._steps - 1)]
        self._done += 1
        self._last = chosen.copy()
        return chosen

    def _replan(self) -> None:
        """Improve the plans of all, from the plan of before moved on in time."""
        moved = np.minimum(np.linspace(0.0, self._knots - 1.0, self._knots) + self._passed(), self._knots - 1.0)
        low = np.minimum(moved.astype(np.int64), self._knots - 2)
        share = (moved - low)[:, None, None]
        mean = (1.0 - share) * self._plan[:, low] + share * self._plan[:, low + 1]
        spread = np.full(mean.shape, self.SPREAD[0])
        best, best_value = mean, np.full(self._n, -np.inf)
        few = max(2, round(self.ELITE * self._samples))
        for _ in range(self._iterations):
            plans = mean[:, None] + spread[:, None] * self._stream.standard_normal(
                (self._n, self._samples, *mean.shape[1:])
            )
            plans[:, 0] = best
            np.clip(plans, -1.0, 1.0, out=plans)
            value = self.value(plans)
            order = np.argsort(-value, axis=1)
            elite = np.take_along_axis(plans, order[:, :few, None, None, None], axis=1)
            mean, spread = elite.mean(axis=1), np.maximum(elite.std(axis=1), self.SPREAD[1])
            top = np.take_along_axis(value, order[:, :1], axis=1)[:, 0]
            better = top > best_value
            best = np.where(better[:, None, None, None], elite[:, 0], best)
            best_value = np.maximum(top, best_value)
        self._plan = best
        self._actions = np.einsum("tk,nkrd->ntrd", self._basis, best)
        self._done[:] = 0

    def _passed(self) -> float:
        """Knots that go by between two plans."""
        return self._every * (self._knots - 1.0) / max(1, self._steps - 1)

    def value(self, plans: Float) -> Float:
        """Objective (N, S) of plans (N, S, knots, R, 2), played in worlds as believed."""
        self._tried.branch(self._now)
        total, held = np.zeros(plans.shape[:2]), np.zeros(plans.shape[:2])
        for k in range(self._steps):
            self._tried.step(np.einsum("k,nskrd->nsrd", self._basis[k], plans))
            total += self._tried.information
            held += self._tried.blocked
        mean = total / self._steps
        return (
            self._mean_weight * mean
            + (1.0 - self._mean_weight) * self._tried.information
            - self._blocked_weight * held / self._steps
        )
