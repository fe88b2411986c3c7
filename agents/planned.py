"""Plans: sampling model-predictive control over the environment's own model, from what the robots believe.

One planner for all robots (they tell each other everything): each second it tries sequences of actions in worlds as
believed (`relloc_env.envs.belief`), and keeps to the best until the next one (`agents.search`). Beside it the open-loop
optimum, which is told the truth and says so.
"""

from typing import Any

import numpy as np

from agents.policy import COSINE, ELEVATION, INVERSE_RANGE, SINE, Task
from agents.search import Search, SearchOptions, interpolation
from relloc_env.envs.onboard import POINT
from relloc_env.metrics import wrap
from relloc_env.samples import Float, Float32, Rows

LEAST_INVERSE_RANGE = 0.05
"""[1/m] believed points are no further than 20 m."""


def believed(task: Task, observations: Float32) -> tuple[Float, Float]:
    """Poses [m, m, rad] (N, R, 3) and points [m] (N, M, 3) as robot A believes them, in its dead reckoning's axes.

    A point that A does not know is taken from the other robot's message; NaN where neither knows it.
    """
    n = len(observations)
    own = reckoned(task, observations)[:, 0]
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


def reckoned(task: Task, observations: Float32) -> Float:
    """Poses [m, m, rad] (N, R, 3) by dead reckoning, each robot's in its own axes, as robot A was told last."""
    parts = [task.field(observations, "dead_reckoning")[:, :1]]
    if task.robots > 1:
        told = task.field(observations, "message_motion")[:, 0]
        parts.append(told.reshape(len(told), task.robots - 1, -1))
    motion = np.concatenate(parts, axis=1)
    return np.stack([motion[..., 0], motion[..., 1], np.arctan2(motion[..., 2], motion[..., 3])], axis=-1)


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
    """Sampling model-predictive control from the estimated state.

    Args:
        task: what the robots know of themselves.
        threads: as for `RellocVectorEnv`.
        options: of `SearchOptions`.
    """

    def __init__(self, task: Task, *, threads: int | None = 1, **options: Any) -> None:
        self._task, self._threads, self._options = task, threads, SearchOptions(**options)

    def reset(self, n: int, seed: int) -> None:
        """Make the models of n beliefs."""
        task = self._task
        self._search = Search(task.config, n, seed, self._options, threads=self._threads)
        self._actions: Float = np.zeros((n, self._search.steps, task.robots, 2))
        self._done: Rows = np.zeros(n, np.int64)
        self._begun: Rows = np.full(n, -1)
        self._reckoned: list[Float] = []
        self._chosen: list[Float] = []

    def act(self, observations: Float32) -> Float:
        """Keep to the plan; make new ones where it is time to."""
        search, rows = self._search, np.arange(len(observations))
        started = (self._task.time(observations) == 0.0) | (self._begun < 0)
        if started.all():
            self._reckoned, self._chosen = [], []
        self._begun[started] = len(self._reckoned)
        self._reckoned.append(reckoned(self._task, observations))
        if started.any() or (self._done >= search.every).any():
            poses, points = believed(self._task, observations)
            if started.any():
                search.start(poses, points, rows[started])
                self._done[started] = 0
            self._retrace(poses, points)
            self._actions = search.actions(self._done)
            self._done[:] = 0
        self._chosen.append(self._actions[rows, np.minimum(self._done, search.steps - 1)])
        self._done += 1
        return self._chosen[-1].copy()

    def _retrace(self, poses: Float, points: Float) -> None:
        """Tell the search of the past: where dead reckoning has the robots, seen from where they are believed now."""
        past, last = np.stack(self._reckoned), self._reckoned[-1]
        turn = poses[..., 2] - last[..., 2]
        cos, sin = np.cos(turn), np.sin(turn)
        x, y = past[..., 0] - last[..., 0], past[..., 1] - last[..., 1]
        was = np.stack([poses[..., 0] + cos * x - sin * y, poses[..., 1] + sin * x + cos * y, past[..., 2] + turn], -1)
        actions = np.array(self._chosen).reshape(-1, *last.shape[:2], 2)
        for first in np.unique(self._begun):
            rows = np.flatnonzero(self._begun == first)
            self._search.now.retrace(was[first:], actions[first:], points, rows)


class OpenLoop:
    """The best sequence of actions that was found with the truth at hand: a near-upper bound, not for use.

    Plans of the planner, made in the real world without noise, put one behind the other; then a random search changes
    stretches of the whole, and keeps what raises J at the end.

    Args:
        task: what the robots know of themselves.
        rounds: of the random search.
        knots: of a whole episode, in it.
        threads: as for `RellocVectorEnv`.
        options: of `SearchOptions`.
    """

    knows_truth = True

    def __init__(
        self, task: Task, *, rounds: int = 12, knots: int = 41, threads: int | None = 1, **options: Any
    ) -> None:
        self._task, self._rounds, self._knots = task, rounds, knots
        self._threads, self._options = threads, SearchOptions(**options)

    def reset(self, n: int, seed: int) -> None:
        """Make ready for n episodes."""
        self._n, self._seed, self._at = n, seed, -1
        self._actions: Float = np.zeros((n, 0, self._task.robots, 2))
        self.value: Float = np.zeros(n)

    def see(self, poses: Float, points: Float) -> None:
        """Take in the truth at the start of all episodes: [m, m, rad] (N, R, 3), [m] (N, M, 3); then search."""
        task, rows = self._task, np.arange(self._n)
        search = Search(task.config, self._n, self._seed, self._options, walls=True, threads=self._threads)
        search.start(poses, points, rows)
        length = task.config.max_cycles
        actions: Float = np.zeros((self._n, length, task.robots, 2))
        for k in range(0, length, search.every):
            part = search.actions(np.full(self._n, search.every if k else 0))[:, : search.every]
            for j in range(min(search.every, length - k)):
                actions[:, k + j] = part[:, j]
                search.now.step(part[:, j])
        self._actions = self._refined(search, actions, search.now.information[:, 0], poses, points)
        self._at = 0

    def _refined(self, search: Search, actions: Float, value: Float, poses: Float, points: Float) -> Float:
        """Change stretches of the actions (N, T, R, 2) at random, where it raises J at the end."""
        stream, tried, now = np.random.default_rng([self._seed, 1]), search.tried, search.now
        length, samples, rows = actions.shape[1], self._options.samples, np.arange(self._n)
        basis = interpolation(length, self._knots)
        now.start(poses, points, rows)
        for _ in range(self._rounds):
            width = stream.integers(1, 6, (self._n, samples, 1))
            first = stream.integers(1 - width, self._knots)
            at = np.arange(self._knots)
            where = (at >= first) & (at < first + width)
            size = stream.choice([0.1, 0.3, 0.8], (self._n, samples, 1, 1, 1))
            change = size * stream.standard_normal((self._n, samples, self._knots, *actions.shape[2:]))
            change *= where[..., None, None]
            change[:, 0] = 0.0
            tried.branch(now)
            plans = np.empty((self._n, samples, *actions.shape[2:]))
            for k in range(length):
                np.einsum("k,nskrd->nsrd", basis[k], change, out=plans)
                plans += actions[:, None, k]
                tried.step(np.clip(plans, -1.0, 1.0))
            found = tried.information
            best = found.argmax(axis=1)
            better = found[rows, best] > value
            value = np.where(better, found[rows, best], value)
            added = np.einsum("tk,nkrd->ntrd", basis, change[rows, best])
            actions = np.where(better[:, None, None, None], np.clip(actions + added, -1.0, 1.0), actions)
        self.value = value
        return actions

    def act(self, observations: Float32) -> Float:  # noqa: ARG002 - that is what open loop means
        """The next action of each sequence; the episodes run side by side.

        Raises:
            RuntimeError: where the truth was not shown, or the episodes are over.
        """
        if not 0 <= self._at < self._actions.shape[1]:
            raise RuntimeError("`see` must be called at the start of the episodes, and again for the next ones")
        chosen: Float = self._actions[:, self._at]
        self._at += 1
        return chosen.copy()
