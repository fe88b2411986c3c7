"""Worlds as the robots believe them to be: for planners, which must not see the truth."""

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.envs.core import Core
from relloc_env.samples import Bool, Float, Rows

AWAY = 1e3
"""[m] where points are put of which nothing is known: nobody sees them."""
_MOVING = ("pose", "velocity", "wheels", "command", "points", "visible", "blocked")
"""Fields of `World` from which the motion goes on."""


def believed_config(config: EnvConfig) -> EnvConfig:
    """The same robots and cameras without an estimator, on an open floor: what stands on it is not known."""
    changes = {"arena": None, "obstacles": [], "estimator": None, "bound": True, "poses": None, "points": None}
    data = {**config.to_dict(), **changes, "network": {}, "terminate_on_success": False, "targets": config.targets}
    return EnvConfig.model_validate({**data, "reward": {}, "start": {**data["start"], "in_view": False}})


class BeliefModel:
    """N beliefs, each in some copies: they are moved as the real robots are, and the bound tells what would be known.

    A believed world has the axes of robot A's dead reckoning. Its bound starts from the priors, and is carried along
    what was believed at each action: what the robots may expect to know, without the truth.

    Args:
        config: of the real environments.
        num_envs: number N of beliefs.
        copies: how many worlds each belief has.
        threads: as for `RellocVectorEnv`.
    """

    def __init__(self, config: EnvConfig, num_envs: int, copies: int = 1, threads: int | None = None) -> None:
        self.num_envs, self.copies = num_envs, copies
        self.core = Core(believed_config(config), num_envs * copies, None, threads)

    def start(self, poses: Float, points: Float, rows: Rows) -> None:
        """Begin the episodes of some beliefs anew, from the priors and a first image.

        Args:
            poses: [m, m, rad] (N, R, 3) believed.
            points: [m] (N, M, 3) believed; NaN where nothing is known.
            rows: indices of the beliefs.
        """
        every, world = self._each(rows), self.core.simulation.world
        world.fixed_poses[every] = np.repeat(poses[rows], self.copies, axis=0)
        world.fixed_points[every] = np.repeat(_away(points[rows]), self.copies, axis=0)
        self.core.reset(every)

    def believe(self, poses: Float, points: Float, rows: Rows) -> None:
        """Change what is believed in some of them; the bound stays as it is."""
        every, world = self._each(rows), self.core.simulation.world
        world.pose[every] = np.repeat(poses[rows], self.copies, axis=0)
        world.points[every] = np.repeat(_away(points[rows]), self.copies, axis=0)

    def branch(self, other: "BeliefModel") -> None:
        """Put all copies into the state of another model's beliefs, which have one copy each."""
        mine, theirs = self.core, other.core
        for name in _MOVING:
            _spread(getattr(theirs.simulation.world, name), getattr(mine.simulation.world, name), self.copies)
        for name in ("bound", "sighted", "depth_information", "pose_information", "pose_covariance", "worst_sd"):
            _spread(getattr(theirs.score, name), getattr(mine.score, name), self.copies)

    def step(self, actions: Float) -> None:
        """Hold one action [-] (N, copies, R, 2) in each world."""
        self.core.step(np.ascontiguousarray(actions.reshape(self.num_envs * self.copies, -1, 2)), self.core.everyone)

    @property
    def information(self) -> Float:
        """J [nats] (N, copies): of the pair's pose; of the depths of a robot alone."""
        score = self.core.score
        found = score.pose_information if self.core.config.robots > 1 else score.depth_information[:, 0]
        return found.reshape(self.num_envs, self.copies).copy()

    @property
    def blocked(self) -> Float:
        """Share of the last action during which the shield held a robot, (N, copies), mean over the robots."""
        held = self.core.simulation.world.blocked.mean(axis=1) / self.core.config.samples_per_action
        return held.reshape(self.num_envs, self.copies)

    @property
    def poses(self) -> Float:
        """[m, m, rad] (N, copies, R, 3)"""
        pose: Float = self.core.simulation.world.pose
        return pose.reshape(self.num_envs, self.copies, *pose.shape[1:]).copy()

    def _each(self, rows: Rows) -> Rows:
        """Indices of the worlds of some beliefs."""
        return (rows[:, None] * self.copies + np.arange(self.copies)).ravel()


def _away(points: Float) -> Float:
    """Points with those that nothing is known of put far away, each elsewhere."""
    unknown: Bool = ~np.isfinite(points).all(axis=-1)
    found = points.copy()
    for i in range(points.shape[1]):
        found[unknown[:, i], i] = (AWAY, AWAY + 10.0 * i, 0.0)
    return found


def _spread(source: Float, target: Float, copies: int) -> None:
    target.reshape(len(source), copies, *source.shape[1:])[:] = source[:, None]
