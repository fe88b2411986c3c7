"""Worlds as the robots believe them to be: for planners, which must not see the truth."""

from typing import Any

import numpy as np

from relloc_env.bound import UNSEEN_SD, read_bound
from relloc_env.config import EnvConfig
from relloc_env.envs.core import Core
from relloc_env.kernels.factors import factorise
from relloc_env.kernels.state_layout import point_of, twist_of
from relloc_env.metrics import wrap
from relloc_env.rewards import BOUND_FIELDS
from relloc_env.samples import Bool, Estimate, Float, Rows

AWAY = 1e3
"""[m] where points are put of which nothing is known: nobody sees them."""
_MOVING = ("pose", "velocity", "wheels", "command", "points", "origin", "visible", "blocked")
"""Fields of `World` from which the motion goes on."""


def believed_config(config: EnvConfig, *, walls: bool = False) -> EnvConfig:
    """The same robots and cameras without an estimator; on an open floor, where what stands on it is not known."""
    changes: dict[str, Any] = {
        "estimator": None,
        "action": "motion",
        "reward_start": 0.0,
        "bound": True,
        "poses": None,
        "points": None,
        "terminate_on_success": False,
        "observation": "flat",
    }
    if not walls:
        changes |= {"arena": None, "obstacles": []}
    data = {
        **config.model_copy(update={"estimator": None}).to_dict(),
        **changes,
        "network": {},
        "targets": config.targets,
    }
    # Plans are compared by what they would gain, not by the luck of their draws.
    data["robot"] = [{**robot, "actuator_noise": (0.0, 0.0)} for robot in data["robot"]]
    data["camera"] = [{**camera, "miss_probability": 0.0, "kind": "analytic"} for camera in data["camera"]]
    return EnvConfig.model_validate({**data, "reward": {}, "start": {**data["start"], "in_view": False}})


class BeliefModel:
    """N beliefs, each in some copies: they are moved as the real robots are, and the bound tells what would be known.

    A believed world has the axes of robot A's dead reckoning. Its bound starts from the priors, and is carried along
    what is believed of the past: what the robots may expect to know, without the truth.

    Args:
        config: of the real environments.
        num_envs: number N of beliefs.
        copies: how many worlds each belief has.
        threads: as for `RellocVectorEnv`.
        walls: whether walls and obstacles are known; positions are the real ones then.
    """

    def __init__(
        self, config: EnvConfig, num_envs: int, copies: int = 1, threads: int | None = None, *, walls: bool = False
    ) -> None:
        self.num_envs, self.copies = num_envs, copies
        self.core = Core(believed_config(config, walls=walls), num_envs * copies, None, threads)
        self.core.seed(self.core.everyone, range(num_envs * copies))

    def start(self, poses: Float, points: Float, rows: Rows) -> None:
        """Begin the episodes of some beliefs anew, from the priors and a first image.

        Args:
            poses: [m, m, rad] (N, R, 3) believed.
            points: [m] (N, M, 3) believed; NaN where nothing is known.
            rows: indices of the beliefs.

        Raises:
            ValueError: poses that are not finite.
        """
        if not np.isfinite(poses[rows]).all():
            raise ValueError("Argument `poses` must be finite, but is not: the estimator gave no pose")
        every, world = self._each(rows), self.core.simulation.world
        world.fixed_poses[every] = np.repeat(poses[rows], self.copies, axis=0)
        world.fixed_points[every] = np.repeat(_away(points[rows]), self.copies, axis=0)
        self.core.reset(every)

    def believe(self, poses: Float, points: Float, rows: Rows) -> None:
        """Change what is believed in some of them; the bound stays as it is."""
        every, world = self._each(rows), self.core.simulation.world
        world.pose[every] = np.repeat(poses[rows], self.copies, axis=0)
        world.points[every] = np.repeat(_away(points[rows]), self.copies, axis=0)

    def retrace(self, poses: Float, actions: Float, points: Float, rows: Rows) -> None:
        """Begin some of them anew and go through their past as it is believed now: the bound is what came of it.

        Args:
            poses: [m, m, rad] (T + 1, N, R, 3) at the start and after each action.
            actions: [-] (T, N, R, 2)
            points: [m] (N, M, 3) believed; NaN where nothing is known.
            rows: indices of the beliefs.
        """
        self.start(poses[0], points, rows)
        for action, pose in zip(actions, poses[1:], strict=True):
            self.core.step(np.repeat(action, self.copies, axis=0), self._each(rows))
            self.believe(pose, points, rows)

    def inform(self, estimate: Estimate) -> None:
        """Take over the covariances of an estimate as the bound, each for itself: what ties them is not in it.

        Points are those of robot A, the pose that of each other robot in {A}; worlds must be as it believes them.
        """
        core, copies = self.core, self.copies
        world, score = core.simulation.world, core.score
        pose, points, origin = world.pose[::copies], world.points[::copies], world.origin[::copies]
        cos, sin = np.cos(pose[:, 0, 2]), np.sin(pose[:, 0, 2])
        turn = np.zeros((self.num_envs, 3, 3))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, -sin, sin, cos, 1.0
        count, robots = points.shape[1], pose.shape[1]
        every = np.zeros((self.num_envs, *score.bound_factor.shape[1:]))
        for i in range(count):
            beta, eta, rho = np.moveaxis(estimate.points[:, 0, i], -1, 0)
            r = 1.0 / np.maximum(rho, 1e-3)
            zero = np.zeros_like(r)
            by = np.stack(
                [
                    np.stack([-r * np.sin(beta), zero, -r * r * np.cos(beta)], -1),
                    np.stack([r * np.cos(beta), zero, -r * r * np.sin(beta)], -1),
                    np.stack([zero, r, -r * r * eta], -1),
                ],
                1,
            )
            by = turn @ by
            known = estimate.known[:, 0, i, None, None]
            wide = UNSEEN_SD**2 * np.eye(3)
            part = slice(point_of(robots, i), point_of(robots, i + 1))
            every[:, part, part] = np.where(
                known, by @ estimate.points_covariance[:, 0, i] @ np.swapaxes(by, 1, 2), wide
            )
        for k in range(1, robots):
            # R δr = rho + J r theta: the twist from the pose's error.
            by = turn.copy()
            by[:, 0, 2], by[:, 1, 2] = pose[:, k, 1] - origin[:, 1], origin[:, 0] - pose[:, k, 0]
            part = slice(twist_of(k), twist_of(k + 1))
            every[:, part, part] = by @ estimate.pose_covariance[:, k - 1] @ np.swapaxes(by, 1, 2)
        factor, variances = np.zeros_like(every), np.zeros(every.shape[:2])
        for n in range(self.num_envs):
            factorise(every[n], factor[n], variances[n])
        _spread(factor, score.bound_factor, copies)
        _spread(variances, score.bound_variances, copies)
        core.score.sighted[:] = np.repeat(estimate.known, copies, axis=0)
        kept: tuple[Any, ...] = core.score[:BOUND_FIELDS]
        places: tuple[Any, ...] = (world.pose, world.points, world.origin, core.everyone)
        read_bound(*kept, *places)

    def branch(self, other: "BeliefModel") -> None:
        """Put all copies into the state of another model's beliefs, which have one copy each."""
        mine, theirs = self.core, other.core
        for name in _MOVING:
            _spread(getattr(theirs.simulation.world, name), getattr(mine.simulation.world, name), self.copies)
        for name in mine.score._fields[:BOUND_FIELDS]:
            _spread(getattr(theirs.score, name), getattr(mine.score, name), self.copies)

    def step(self, actions: Float) -> None:
        """Hold one action [-] (N, copies, R, 2) in each world."""
        self.core.step(np.ascontiguousarray(actions.reshape(self.num_envs * self.copies, -1, 2)), self.core.everyone)

    @property
    def information(self) -> Float:
        """J [nats] (N, copies): of the pair's pose; of the depths of a robot alone."""
        score = self.core.score
        found = score.pose_information if self.core.config.robots > 1 else score.depth_information[:, 0]
        gained: Float = found.reshape(self.num_envs, self.copies).copy()
        return gained

    @property
    def blocked(self) -> Float:
        """Share of the last action during which the shield held a robot, (N, copies), mean over the robots."""
        held: Float = self.core.simulation.world.blocked.mean(axis=1) / self.core.config.samples_per_action
        return held.reshape(self.num_envs, self.copies)

    @property
    def poses(self) -> Float:
        """Of the robots, [m, m, rad] (N, copies, R, 3)."""
        pose: Float = self.core.simulation.world.pose
        return pose.reshape(self.num_envs, self.copies, *pose.shape[1:]).copy()

    @property
    def points(self) -> Float:
        """Points [m] (N, copies, M, 3)."""
        points: Float = self.core.simulation.world.points
        return points.reshape(self.num_envs, self.copies, *points.shape[1:]).copy()

    def _each(self, rows: Rows) -> Rows:
        """Indices of the worlds of some beliefs."""
        return (rows[:, None] * self.copies + np.arange(self.copies)).ravel()


def believed_places(estimate: Estimate, heights: Float) -> tuple[Float, Float]:
    """Poses [m, m, rad] (N, R, 3) and points [m] (N, M, 3) of an estimate, robot A at the origin.

    Args:
        estimate: of N environments.
        heights: [m] (R,) of the cameras.
    """
    n, robots = estimate.known.shape[:2]
    poses = np.zeros((n, robots, 3))
    poses[:, 1:] = estimate.pose[:, : robots - 1]
    points = np.full((n, estimate.known.shape[2], 3), np.nan)
    for r in range(robots):
        beta, eta, rho = np.moveaxis(estimate.points[:, r], -1, 0)
        distance, angle = 1.0 / np.maximum(rho, 1e-2), beta + wrap(poses[:, r, 2])[:, None]
        x, y = (poses[:, r, j, None] + distance * part(angle) for j, part in ((0, np.cos), (1, np.sin)))
        placed = np.stack([x, y, heights[r] + eta * distance], axis=-1)
        take = estimate.known[:, r] & np.isnan(points[..., 0])
        points = np.where(take[..., None], placed, points)
    return poses, points


def _away(points: Float) -> Float:
    """Points with those that nothing is known of put far away, each elsewhere."""
    unknown: Bool = np.asarray(np.isnan(points).any(axis=-1))
    found = points.copy()
    for i in range(points.shape[1]):
        found[unknown[:, i], i] = (AWAY, AWAY + 10.0 * i, 0.0)
    return found


def _spread(source: Float, target: Float, copies: int) -> None:
    target.reshape(len(source), copies, *source.shape[1:])[:] = source[:, None]
