"""The projection of whole arrays, against the definition in complex numbers and the kernel of one point."""

import numpy as np
import pytest

from relloc_env.kernels import camera
from relloc_env.pinhole import project
from relloc_env.rendering.scene import CameraGeometry
from tests.rendering.scenes import true_images


def test_points_are_projected_as_defined() -> None:
    rng = np.random.default_rng(0)
    poses, points = rng.uniform(-3.0, 3.0, (5, 4, 3)), rng.uniform(-5.0, 5.0, (5, 6, 3))
    found = project(poses, [0.25] * 4, points[:, None])
    assert found.shape == (5, 4, 6, 3)
    for n in range(5):
        assert found[n, ..., :2] == pytest.approx(true_images(poses[n], points[n], CameraGeometry(mount=0.25))[0])
    heading, d = poses[2, 1, 2], points[2, 3] - [*poses[2, 1, :2], 0.25]
    left = np.cos(heading) * d[1] - np.sin(heading) * d[0]
    x, y, inverse = camera.project(found[2, 1, 3, 2], left, d[2])
    assert found[2, 1, 3] == pytest.approx([x, y, 1.0 / inverse])


def test_a_point_beside_the_camera_has_no_depth() -> None:
    assert project(np.zeros(3), 0.0, np.array([[0.0, 1.0, 0.0]]))[0, 2] == 0.0
