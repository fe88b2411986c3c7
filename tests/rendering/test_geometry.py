"""Regions and views against their definitions, by counting random points inside them."""

import math

import numpy as np
import pytest
from matplotlib.path import Path

from relloc_env.kernels.camera import crosses_box, crosses_disc
from relloc_env.rendering import geometry
from relloc_env.rendering.canvas import cut
from relloc_env.rendering.scene import CameraGeometry
from tests.rendering.scenes import OBSTACLES, random_scene

INSIDE_TWO_SIGMA = 1.0 - math.exp(-2.0)  # of a Gaussian in the plane


@pytest.mark.parametrize("seed", range(5))
def test_ellipse_holds_what_two_sigma_should(seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(2, 2)) * [[1.0], [0.05]]
    covariance, mean = factor @ factor.T, rng.normal(size=2)
    drawn = rng.multivariate_normal(mean, covariance, size=40_000)
    share = Path(geometry.ellipse(mean, covariance)).contains_points(drawn).mean()
    assert share == pytest.approx(INSIDE_TWO_SIGMA, abs=0.008)


@pytest.mark.parametrize("seed", range(8))
def test_polar_region_is_the_two_sigma_ellipse_seen_in_the_plane(seed: int) -> None:
    rng = np.random.default_rng(seed)
    beta, rho = rng.uniform(-2.5, 2.5), rng.uniform(0.2, 0.8)
    factor = rng.normal(size=(3, 3)) * [[0.05], [0.05], [0.12]]
    covariance, point = factor @ factor.T, np.array([beta, 0.1, rho])
    drawn = rng.multivariate_normal(point, covariance, size=20_000)
    drawn = drawn[drawn[:, 2] > 1.0 / 50.0]  # some regions reach infinity
    off = drawn[:, ::2] - point[::2]
    expected = np.einsum("ti,ij,tj->t", off, np.linalg.inv(covariance[::2, ::2]), off) <= 4.0
    places = np.stack([np.cos(drawn[:, 0]), np.sin(drawn[:, 0])], axis=1) / drawn[:, 2:]
    shown = Path(geometry.polar_region(point, covariance, reach=60.0)).contains_points(places)
    assert 0.8 < expected.mean() < 0.95
    assert (shown != expected).mean() < 0.01


@pytest.mark.parametrize("seed", range(6))
def test_view_is_where_a_point_at_camera_height_would_be_seen(seed: int) -> None:
    camera = CameraGeometry(focal=400.0, c_x=300.0, near=0.4, far=5.0, mount=0.25)
    low = np.array([[0.0, -0.5, 0.5, 0.6, 0.0, 0.0, 0.1]])
    scene = random_scene(seed, cameras=[camera] * 2, obstacles=np.concatenate([OBSTACLES, low]))
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5.5, 5.5, size=(4000, 2))
    for robot, (x, y, theta) in enumerate(scene.poses):
        body = ((places[:, 0] - x) + 1j * (places[:, 1] - y)) * np.exp(-1j * theta)
        column = camera.c_x - camera.focal * body.imag / body.real
        expected = (body.real > camera.near) & (body.real < camera.far) & (column > 0) & (column < camera.width)
        expected &= (np.abs(places) < 5.0).all(axis=1)
        other = scene.poses[1 - robot]
        for k in np.flatnonzero(expected):
            ray = (x, y, *places[k])
            hidden = crosses_disc(*ray, other[0], other[1], scene.robot_radius) >= 0.0
            hidden |= crosses_disc(*ray, *OBSTACLES[0, 1:4]) >= 0.0
            hidden |= crosses_box(*ray, *OBSTACLES[1, 1:5], np.cos(OBSTACLES[1, 5]), np.sin(OBSTACLES[1, 5])) >= 0.0
            expected[k] = not hidden
        shown = Path(geometry.view(scene, robot, reach=30.0)).contains_points(places)
        assert expected.any()
        assert (shown != expected).mean() < 0.002


@pytest.mark.parametrize("seed", range(10))
def test_cut_keeps_what_is_inside_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = geometry.ellipse(rng.uniform(-2.0, 2.0, 2), np.diag(rng.uniform(0.01, 4.0, 2)))
    low, high = np.array([-1.0, -0.7]), np.array([0.8, 1.2])
    kept = cut(shape, low, high)
    places = rng.uniform(-3.0, 3.0, size=(3000, 2))
    expected = Path(shape).contains_points(places) & ((places > low) & (places < high)).all(axis=1)
    shown = Path(kept).contains_points(places) if len(kept) > 2 else np.zeros(3000, bool)
    assert (shown == expected).all()


def test_open_floor_shows_everything_true() -> None:
    scene = random_scene(1, arena=None)
    x_min, x_max, y_min, y_max = geometry.bounds(scene)
    for places in (scene.poses[:, :2], scene.points[:, :2], *scene.trails):
        assert (places > [x_min, y_min]).all()
        assert (places < [x_max, y_max]).all()


def test_open_floor_stays_put_while_robots_move_little() -> None:
    scene = random_scene(1, arena=None)
    poses = scene.poses + np.array([0.01, 0.01, 0.1])
    moved = random_scene(1, arena=None, poses=poses)
    assert geometry.bounds(moved) == geometry.bounds(scene)
