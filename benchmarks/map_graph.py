"""The posterior of a whole episode as a factor graph (GTSAM): every pose of both robots, every point, all the data.

The world is the frame of A's start, at the height of its camera. A robot's poses are tied to each other by its odometry
over exact arcs, a point to each pose that saw it by its projection, and to the first of each robot by the guess of its
depth; B's first pose has the guess of the relative pose. The relative pose is a function of the two last poses.
"""

import math
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from relloc_env.extras import extra
from relloc_env.kernels.motion import arc
from relloc_env.kernels.relative_pose import arc_jacobian, displacement_noise
from relloc_env.samples import Float, Prior, Samples

with extra("gtsam"):
    import gtsam


HEADINGS = 12
"""Headings of B that the search starts from."""
SEARCH = 5.0
"""[s] from the start over which the search runs; what it finds is carried on."""
RIVAL = 12.0
"""[-] optima of the search whose costs are higher by less than this are carried on too."""
SAME = 0.03
"""[rad] optima whose headings differ by less are one."""
TIES = (1e-2, 1e-3, 1e-4, 1e-5)
"""[m, rad] what each sample's motion is free by beside its noise (sideways it has none): from loose, where a trajectory
turns as a whole in few steps, for the search, to 0.3 mm over 800 samples, which is too little to show."""
ORIGIN_SD = 1e-4
"""[m, rad] of A's start in the world; the relative pose does not depend on it."""
ITERATIONS = 20
"""Greatest number of Levenberg-Marquardt steps for each tie."""
CALIBRATION = gtsam.Cal3DS2(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""A camera whose pixels are normalised image coordinates."""
CAMERA = gtsam.Pose3(gtsam.Rot3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])), np.zeros(3))
"""The camera's axes (right, down, forward) in the body."""


class Noise(NamedTuple):
    """What is known of the sensors of both robots."""

    image: float
    """[-] of a normalised image coordinate."""
    speed: float
    """[m/s] of the odometry of a sample."""
    yaw_rate: float
    """[rad/s]."""


class Found(NamedTuple):
    """B's pose in A's frame after one sample, from all samples up to it."""

    pose: Float
    """[m, m, rad] (3,)."""
    covariance: Float
    """(3, 3)."""
    cost: float
    """[-] half the sum of squares."""


class Episode:
    """One run of a batch of two robots with cameras of one height.

    Args:
        samples, prior: of the batch; messages are not looked at.
        n: the run.
        noise: of the sensors.
    """

    def __init__(self, samples: Samples, prior: Prior, n: int, noise: Noise) -> None:
        self._period, self._odometry = samples.period[n].tolist(), samples.odometry[n].astype(float)
        self._image, self._seen = samples.image[n].astype(float), samples.seen[n]
        self._depth, self._depth_sd = prior.depth[n], prior.depth_sd
        self._guess, self._guess_sd, self._noise = prior.pose[n, 0], prior.pose_sd, noise
        self._first = np.where(self._seen.any(axis=0), self._seen.argmax(axis=0), len(self._seen))
        self._reckoned = [self._dead_reckoning(r) for r in range(2)]

    def follow(self, at: Sequence[int]) -> list[Found]:
        """Find the most probable trajectory up to each of the samples `at`, ascending.

        B's start is sought over the first seconds, from headings all around, at the place where the centroids of both
        robots' own maps meet. Each optimum that is nearly as good as the best is carried on.
        """
        search = next(k for k, time in enumerate(np.cumsum(self._period)) if time >= SEARCH or k == at[0])
        own = self._alone(0, search), self._alone(1, search)
        optima = self._solve(search, own, self._starts(search, own), TIES[:1])
        found = []
        for last in at:
            own = self._alone(0, last), self._alone(1, last)
            optima = self._solve(last, own, _apart(optima), TIES[1:])
            values, cost = optima[0]
            found.append(relative(self.graph(last, TIES[-1]), values, last, cost))
        return found

    def graph(self, last: int, tie: float) -> Any:
        """Everything that was measured up to the sample `last`."""
        graph = self._of_robot(0, last, tie)
        graph.push_back(self._of_robot(1, last, tie))
        graph.add(_origin(0))
        graph.add(_guess(_pose(1, 0), self._guess, self._guess_sd))
        return graph

    def _of_robot(self, r: int, last: int, tie: float) -> Any:
        """What one robot measured and was told of depths."""
        graph, pixel = gtsam.NonlinearFactorGraph(), gtsam.noiseModel.Isotropic.Sigma(2, self._noise.image)
        for k in range(1, last + 1):
            graph.add(self._moved(r, k, tie))
        for k, i in np.argwhere(self._seen[: last + 1, r]).tolist():
            image = self._image[k, r, i]
            graph.add(gtsam.PlanarProjectionFactor2(_pose(r, k), _point(i), image, CAMERA, CALIBRATION, pixel))
        for i in self._known(r, last):
            graph.add(_depth(_pose(r, int(self._first[r, i])), _point(i), self._depth[r, i], self._depth_sd))
        return graph

    def _moved(self, r: int, k: int, tie: float) -> Any:
        """Odometry of a sample: the noise of v and w, held over it, in the body frame at its end."""
        (v, _, w), dt, noise = self._odometry[k, r], self._period[k], self._noise
        xx, xy, xt, yy, yt, tt = displacement_noise(*arc_jacobian(v, 0.0, w, dt), dt, noise.speed**2, noise.yaw_rate**2)
        covariance = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]) + tie**2 * np.eye(3)
        model = gtsam.noiseModel.Gaussian.Covariance(covariance)
        return gtsam.BetweenFactorPose2(_pose(r, k - 1), _pose(r, k), gtsam.Pose2(*arc(v, 0.0, w, dt)), model)

    def _dead_reckoning(self, r: int) -> list[Any]:
        """Poses of a robot in the frame of its start, by odometry alone."""
        poses = [gtsam.Pose2()]
        for (v, _, w), dt in zip(self._odometry[1:, r], self._period[1:], strict=True):
            poses.append(poses[-1].compose(gtsam.Pose2(*arc(v, 0.0, w, dt))))
        return poses

    def _known(self, r: int, last: int) -> list[int]:
        """Points that a robot has seen up to a sample."""
        return np.flatnonzero(self._first[r] <= last).tolist()

    def _alone(self, r: int, last: int) -> Any:
        """One robot's trajectory and map by its own data, in the frame of its start."""
        values = gtsam.Values()
        for k in range(last + 1):
            values.insert(_pose(r, k), self._reckoned[r][k])
        for i in self._known(r, last):
            k, z = int(self._first[r, i]), self._depth[r, i]
            x, y = self._image[k, r, i]
            values.insert(_point(i), np.array([*self._reckoned[r][k].transformFrom(np.array([z, -x * z])), -y * z]))
        for tie in TIES[1:]:
            graph = self._of_robot(r, last, tie)
            graph.add(_origin(r))
            values, _ = _minimise(graph, values)
        return values

    def _starts(self, last: int, own: tuple[Any, Any]) -> list[Any]:
        """Starts of B in A's frame for the search: the guess, and headings all around."""
        common = sorted(set(self._known(0, last)) & set(self._known(1, last)))
        centres = [np.mean([values.atPoint3(_point(i))[:2] for i in common], axis=0) for values in own]
        starts = [gtsam.Pose2(*self._guess)]
        for heading in self._guess[2] + math.tau / HEADINGS * np.arange(HEADINGS):
            turn = gtsam.Rot2(heading)
            starts.append(gtsam.Pose2(turn, centres[0] - turn.rotate(centres[1])))
        return starts

    def _solve(
        self, last: int, own: tuple[Any, Any], starts: Sequence[Any], ties: Sequence[float]
    ) -> list[tuple[Any, float]]:
        """Optima and their costs, the best first; a way there that leads through points behind a camera is left.

        Args:
            last: number of the sample.
            own: what each robot finds alone.
            starts: poses of B's start in A's frame.
            ties: one after the other.
        """
        graphs, found = [self.graph(last, tie) for tie in ties], []
        for start in starts:
            values, cost = self._put_together(last, own, start), math.inf
            try:
                for graph in graphs:
                    values, cost = _minimise(graph, values)
            except RuntimeError:
                continue
            found.append((values, cost))
        if not found:
            raise RuntimeError(f"No start leads to an optimum at sample {last}")
        return sorted(found, key=operator.itemgetter(1))

    def _put_together(self, last: int, own: tuple[Any, Any], start: Any) -> Any:
        """Both robots' own trajectories and maps in A's frame, for one start of B."""
        (a, b), values = own, gtsam.Values()
        for k in range(last + 1):
            values.insert(_pose(0, k), a.atPose2(_pose(0, k)))
            values.insert(_pose(1, k), start.compose(b.atPose2(_pose(1, k))))
        for i in self._known(0, last):
            values.insert(_point(i), a.atPoint3(_point(i)))
        for i in set(self._known(1, last)) - set(self._known(0, last)):
            x, y, z = b.atPoint3(_point(i))
            values.insert(_point(i), np.array([*start.transformFrom(np.array([x, y])), z]))
        return values


def relative(graph: Any, values: Any, last: int, cost: float) -> Found:
    """B's pose in A's frame after a sample, with its covariance from the graph linearised at `values`.

    For small motions d_a, d_b of the two poses, each in its own frame: dr = R(theta) d_b - d_a - J r dtheta_a. At the
    truth the covariance is the posterior Cramér-Rao bound.
    """
    keys, ordering = [_pose(0, last), _pose(1, last)], gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    root, _ = graph.linearize(values).marginal(keys, gtsam.EliminateQR).jacobian(ordering)
    a, b = (values.atPose2(key) for key in keys)
    xi, of_a, of_b = a.between(b), -np.eye(3), np.eye(3)
    of_a[:2, 2] = xi.y(), -xi.x()
    of_b[:2, :2] = xi.rotation().matrix()
    both = np.hstack([of_a, of_b])
    return Found(np.array([xi.x(), xi.y(), xi.theta()]), both @ np.linalg.inv(root.T @ root) @ both.T, cost)


def place(poses: Float, points: Float) -> Any:
    """Values of a graph for poses (K, 2, 3) of both robots and points (M, 3) in any planar frame."""
    values, origin = gtsam.Values(), gtsam.Pose2(*poses[0, 0])
    for r in range(2):
        for k, pose in enumerate(poses[:, r]):
            values.insert(_pose(r, k), origin.between(gtsam.Pose2(*pose)))
    for i, point in enumerate(points):
        values.insert(_point(i), np.array([*origin.transformTo(point[:2]), point[2]]))
    return values


def _apart(optima: Sequence[tuple[Any, float]]) -> list[Any]:
    """B's start in each optimum that is nearly as good as the first, the best, once for each heading."""
    found: list[Any] = []
    for values, cost in optima:
        start = values.atPose2(_pose(1, 0))
        known = any(abs(math.remainder(start.theta() - one.theta(), math.tau)) < SAME for one in found)
        if cost < optima[0][1] + RIVAL and not known:
            found.append(start)
    return found


def _minimise(graph: Any, values: Any) -> tuple[Any, float]:
    options = gtsam.LevenbergMarquardtParams()
    options.setMaxIterations(ITERATIONS)
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values, options)
    return optimiser.optimize(), optimiser.error()


def _pose(r: int, k: int) -> int:
    return int(gtsam.symbol("ab"[r], k))


def _point(i: int) -> int:
    return int(gtsam.symbol("l", i))


def _origin(r: int) -> Any:
    """A robot's start is the origin."""
    return gtsam.PriorFactorPose2(_pose(r, 0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, ORIGIN_SD))


def _guess(key: int, guess: Float, sd: Float) -> Any:
    """The guess of B's start in A's frame, Gaussian in (x, y, theta)."""

    def error(this: Any, values: Any, jacobians: list[Float] | None) -> Float:
        pose = values.atPose2(this.keys()[0])
        if jacobians is not None:
            jacobians[0] = np.eye(3, order="F")
            jacobians[0][:2, :2] = pose.rotation().matrix()
        turn = math.remainder(pose.theta() - guess[2], math.tau)
        return np.array([pose.x() - guess[0], pose.y() - guess[1], turn])

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sd)), [key], error)


def _depth(pose: int, point: int, guess: float, sd: float) -> Any:
    """The guess of the depth of a point along the optical axis, Gaussian."""

    def error(this: Any, values: Any, jacobians: list[Float] | None) -> Float:
        robot, place = values.atPose2(this.keys()[0]), values.atPoint3(this.keys()[1])
        ahead, left = robot.transformTo(place[:2])
        if jacobians is not None:
            jacobians[0] = np.array([[-1.0, 0.0, left]], order="F")
            jacobians[1] = np.array([[math.cos(robot.theta()), math.sin(robot.theta()), 0.0]], order="F")
        return np.array([ahead - guess])

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sd), [pose, point], error)
