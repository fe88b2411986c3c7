"""The information bound by dense matrices and finite differences, to hold the kernels against."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels import bound, information
from relloc_env.kernels.motion import advance
from relloc_env.kernels.state_layout import size_of

Array = NDArray[Any]


POSE_SD = np.array([1.5, 1.5, np.pi / 3])


STEP = 0.05


def jacobian(function: Callable[[Array], Array], at: Array) -> Array:
    columns = [function(at + 1e-30j * direction).imag / 1e-30 for direction in np.eye(at.size)]
    return np.array(columns).T


def rotation(angle: Any) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def chord(v: Any, lateral: Any, w: Any) -> Array:
    """Integral of R(w t) [v, l] over a step; w must not vanish."""
    along, across = np.sin(w * STEP) / w, 2.0 * np.sin(w * STEP / 2.0) ** 2 / w
    return np.array([along * v - across * lateral, across * v + along * lateral])


class World(NamedTuple):
    poses: Array
    points: Array
    heights: Array


class Noise(NamedTuple):
    image: float = 0.002
    speed: float = 0.005
    turn: float = 0.005
    depth: tuple[float, ...] = (1.0, 1.0, 1.0)
    height: float = 0.0
    unseen: float = 30.0
    vertical: bool = True


class Dense:
    """State: xi (3 for each robot k > 0), then (x, y, chi) of each point in A's camera, then d for each robot k > 0."""

    def __init__(self, world: World, noise: Noise) -> None:
        self.robots, self.count, self.noise = len(world.poses), len(world.points), noise
        self.sighted = np.zeros((self.robots, self.count), dtype=bool)
        state = self.state(world)
        others = self.robots - 1
        cartesian = np.full(3 * self.count, noise.unseen**2)
        prior = np.concatenate([np.tile(POSE_SD**2, others), cartesian, np.full(others, noise.height**2)])
        change = np.linalg.inv(jacobian(self.cartesian, state))
        self.covariance = change @ np.diag(prior) @ change.T

    def split(self, state: Array) -> tuple[Array, Array, Array]:
        ends = [3 * (self.robots - 1), 3 * (self.robots - 1 + self.count)]
        poses, points, heights = np.split(state, ends)
        return poses.reshape(-1, 3), points.reshape(-1, 3), heights

    def state(self, world: World) -> Array:
        (x, y, theta), heights = world.poses[0], world.heights
        poses = [[*rotation(-theta) @ (p[:2] - [x, y]), p[2] - theta] for p in world.poses[1:]]
        points = []
        for p in world.points:
            q = rotation(-theta) @ (p[:2] - [x, y])
            points.append([-q[1] / q[0], -(p[2] - heights[0]) / q[0], 1.0 / q[0]])
        return np.concatenate([np.ravel(poses), np.ravel(points), heights[0] - heights[1:]])

    def cartesian(self, state: Array) -> Array:
        poses, points, heights = self.split(state)
        q = np.array([[1.0 / chi, -x / chi, -y / chi] for x, y, chi in points])
        return np.concatenate([poses.ravel(), q.ravel(), heights])

    def move(self, world: World, velocity: Array) -> None:
        """`world` is the truth before the step."""

        def transition(state: Array, slip: Array) -> Array:
            poses, points, heights = self.split(state)
            u = velocity + np.column_stack([slip[0::2], 0 * slip[0::2], slip[1::2]])
            back, c = rotation(-u[0, 2] * STEP), chord(*u[0])
            moved_poses = []
            for k, (r_x, r_y, theta) in enumerate(poses, start=1):
                r = back @ (np.array([r_x, r_y]) + rotation(theta) @ chord(*u[k]) - c)
                moved_poses.append([*r, theta + (u[k, 2] - u[0, 2]) * STEP])
            moved = []
            for x, y, chi in points:
                q = back @ (np.array([1.0, -x]) / chi - c)
                moved.append([-q[1] / q[0], y / chi / q[0], 1.0 / q[0]])
            return np.concatenate([np.ravel(moved_poses), np.ravel(moved), heights])

        state, still = self.state(world), np.zeros(2 * self.robots)
        f = jacobian(lambda s: transition(s, still), state)
        g = jacobian(lambda n: transition(state, n), still)
        variances = np.diag(np.tile([self.noise.speed**2, self.noise.turn**2], self.robots))
        self.covariance = f @ self.covariance @ f.T + g @ variances @ g.T

    def seen(self, state: Array, robot: int, i: int) -> Array:
        """Depth and image (x, y) of a point in a robot's camera."""
        poses, points, heights = self.split(state)
        x, y, chi = points[i]
        q, height = np.array([1.0, -x]) / chi, -y / chi
        if robot > 0:
            r_x, r_y, theta = poses[robot - 1]
            q, height = rotation(theta).T @ (q - np.array([r_x, r_y])), height + heights[robot - 1]
        return np.array([q[0], -q[1] / q[0], -height / q[0]])

    def measure(self, world: World, visible: Array) -> None:
        state = self.state(world)
        for robot, i in np.argwhere(visible):
            rows = jacobian(lambda s, robot=robot, i=i: self.seen(s, robot, i), state)  # type: ignore[misc]
            taken = [(rows[1], self.noise.image)]
            if self.noise.vertical:
                taken.append((rows[2], self.noise.image))
            if not self.sighted[robot, i] and np.isfinite(self.noise.depth[robot]):
                taken.append((rows[0], self.noise.depth[robot]))
            self.sighted[robot, i] = True
            for h, sd in taken:
                p = self.covariance
                gain = p @ h / (h @ p @ h + sd**2)
                keep = np.eye(h.size) - np.outer(gain, h)
                self.covariance = keep @ p @ keep.T + np.outer(gain, gain) * sd**2

    def pose(self, world: World, a: int, b: int) -> Array:
        """Covariance of the pose of b in {a}."""

        def pose_in(state: Array) -> Array:
            poses = np.vstack([np.zeros(3), self.split(state)[0]])
            r = rotation(poses[a, 2]).T @ (poses[b, :2] - poses[a, :2])
            return np.array([*r, poses[b, 2] - poses[a, 2]])

        change = jacobian(pose_in, self.state(world))
        covariance: Array = change @ self.covariance @ change.T
        return covariance

    def point(self, world: World, robot: int, i: int) -> Array:
        """Covariance of (q_x, q_y, height) in the body frame of the robot."""

        def body(state: Array) -> Array:
            z, x, y = self.seen(state, robot, i)
            return np.array([z, -x * z, -y * z])

        change = jacobian(body, self.state(world))
        covariance: Array = change @ self.covariance @ change.T
        return covariance


class Bound:
    """The kernels, for one environment."""

    def __init__(self, world: World, noise: Noise) -> None:
        robots, count = len(world.poses), len(world.points)
        size = size_of(robots, count, heights=noise.height > 0.0)
        self.noise, sighted, self.origin = noise, np.zeros((robots, count), dtype=bool), world.poses[0, :2].copy()
        self.kept = bound.Bound(np.zeros((size, size)), np.zeros(size), sighted, np.zeros((4, size)))
        self.told = bound.Noise(
            *(np.full(robots, sd) for sd in (noise.speed, noise.turn, noise.image)), np.array(noise.depth[:robots])
        )
        bound.bound_reset(self.kept, self.scene(world), bound.Prior(POSE_SD, noise.unseen, noise.height, 0.0, 0.0))

    def scene(self, world: World) -> bound.Scene:
        return bound.Scene(*world, self.origin)

    def step(self, world: World, visible: Array, velocity: Array, dt: float) -> None:
        """`world` is the truth after the step."""
        bound.bound_step(self.kept, self.scene(world), self.told, visible, velocity, dt, self.noise.vertical)

    @property
    def covariance(self) -> Array:
        factor = self.kept.factor
        covariance: Array = factor @ np.diag(self.kept.variances) @ factor.T
        return covariance

    def pose(self, world: World, a: int, b: int) -> Array:
        out = np.zeros((3, 3))
        information.pose_covariance(self.kept, self.scene(world), a, b, out)
        return out

    def point(self, world: World, robot: int, i: int) -> Array:
        out = np.zeros((3, 3))
        information.point_covariance(self.kept, self.scene(world), robot, i, out)
        return out

    def j(self, world: World, robot: int = 1) -> float:
        """J of the pair of A and a robot."""
        return float(information.pose_information(self.kept, self.scene(world), robot))

    def depth_j(self, world: World, robot: int) -> float:
        """J of a robot's depths."""
        variances = np.zeros(len(world.points))
        information.range_variances(self.kept, self.scene(world), robot, variances)
        return float(information.depth_information(variances))


def ahead(world: World) -> Array:
    """(R, M) depth of each point for each robot."""
    to = world.points[None, :, :2] - world.poses[:, None, :2]
    depth: Array = to[..., 0] * np.cos(world.poses[:, 2:]) + to[..., 1] * np.sin(world.poses[:, 2:])
    return depth


def moved(world: World, velocity: Array) -> World:
    poses = np.array([advance(*(*pose, *u, STEP)) for pose, u in zip(world.poses, velocity, strict=True)])
    return world._replace(poses=poses)
