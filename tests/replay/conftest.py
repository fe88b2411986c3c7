"""Small logs with a known truth."""

from collections.abc import Callable

import numpy as np
import pytest

from relloc_env.kernels.motion import advance
from relloc_env.logs import Log, Truth
from relloc_env.logs.source import perfect_network
from relloc_env.samples import Prior, Samples

MakeLog = Callable[..., Log]


@pytest.fixture
def make_log() -> MakeLog:
    """Two robots that drive arcs past three points for 30 s at 5 Hz, with exact measurements."""

    def make(seconds: float = 30.0, *, noise: float = 0.0) -> Log:
        rng = np.random.default_rng(4)
        count = round(5 * seconds) + 1
        period = np.full((1, count), 0.2)
        period[0, 0] = 0.0
        odometry = np.zeros((1, count, 2, 3), dtype=np.float32)
        odometry[0, 1:, 0], odometry[0, 1:, 1] = (0.08, 0.0, 0.02), (0.06, 0.0, -0.02)
        poses = np.zeros((count, 2, 3))
        poses[0] = [[0.0, 0.0, 0.1], [0.2, -1.0, 0.4]]
        for k in range(1, count):
            for r in range(2):
                poses[k, r] = advance(*poses[k - 1, r], *(float(u) for u in odometry[0, k, r]), 0.2)
        points = np.array([[4.0, 1.5, 0.3], [4.5, -0.5, 0.6], [5.0, 0.7, -0.2]])
        truth = Truth(poses, points)
        side = points[None, None, :, :2] - poses[:, :, None, :2]
        theta = poses[:, :, None, 2]
        left = -np.sin(theta) * side[..., 0] + np.cos(theta) * side[..., 1]
        image = np.stack([-left, np.broadcast_to(-points[:, 2], left.shape)], axis=-1) / truth.depth[..., None]
        image += noise * rng.standard_normal(image.shape)
        pose = truth.relative[0] + [0.5, -0.5, 0.3]
        return Log(
            name="arcs",
            kind="relloc",
            robots=("robot_a", "robot_b"),
            points=("p1", "p2", "p3"),
            samples=Samples(
                period,
                odometry,
                np.ascontiguousarray(image[None], dtype=np.float32),
                np.ones((1, count, 2, 3), dtype=np.bool_),
                perfect_network(count, 2),
            ),
            prior=Prior(truth.depth[None, 0] + 0.5, pose[None], 0.5, np.array([0.5, 0.5, 0.3])),
            truth=truth,
            velocity="odometry",
        )

    return make
