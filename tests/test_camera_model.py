"""The camera against an independent pinhole, statistics of what it adds, and line of sight against sampled rays."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.config import CameraConfig, DiscConfig, EnvConfig, load_config
from relloc_env.simulation import Simulation

ROW = np.zeros(1, np.int64)
EXACT = {"field_of_view": 62.2, "pixel_noise": 0.0}


def camera(num_envs: int = 1, *, spec: Any, points: Any, **options: Any) -> Simulation:
    """One robot at the origin that looks along x."""
    given = {
        "robots": 1, "poses": [(0.0, 0.0, 0.0)], "camera": spec, "points": points, "arena": None, "shield": None,
        "estimator": None, "samples_per_action": 1,
    }  # fmt: skip
    simulation = Simulation(load_config(given | options), num_envs)
    rows = np.arange(num_envs)
    simulation.seed(rows, list(range(num_envs)))
    simulation.reset(rows)
    return simulation


def still(simulation: Simulation) -> None:
    """One action at rest."""
    n, r = simulation.num_envs, simulation.config.robots
    simulation.step(np.zeros((n, r, 2)), np.arange(n))


def sees(simulation: Simulation, point: tuple[float, float, float]) -> bool:
    """Whether a target at a place is seen."""
    simulation.reset(ROW, {"points": [point]})
    return bool(simulation.first.seen[0, 0, 0, 0])


def pinhole(pose: NDArray[np.float64], height: float, point: NDArray[np.float64]) -> NDArray[np.float64]:
    """(x, y, depth) by homogeneous matrices: axes of the camera are right, down, ahead."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    to_world = np.array([[sin, 0.0, cos, pose[0]], [-cos, 0.0, sin, pose[1]], [0.0, -1.0, 0.0, height], [0, 0, 0, 1.0]])
    right, down, ahead, _ = np.linalg.solve(to_world, np.append(point, 1.0))
    return np.array([right / ahead, down / ahead, ahead])


def test_projection_and_view_are_those_of_a_pinhole() -> None:
    """400 random poses and points; what is seen is what falls within the image's borders and the depth limits."""
    rng = np.random.default_rng(1)
    spec = {
        "width": 640, "height": 400, "focal_length": 500.0, "principal_point": (300.0, 220.0), "pixel_noise": 0.0,
        "mount_height": 0.42, "near": 0.5, "far": 6.0,
    }  # fmt: skip
    simulation, seen = camera(spec=spec, points=[(3.0, 0.0, 0.3)]), 0
    for _ in range(400):
        pose = np.array([*rng.uniform(-3, 3, 2), rng.uniform(-math.pi, math.pi)])
        ahead = rng.uniform(-1.0, 8.0)
        side = ahead * rng.uniform(-0.9, 0.9)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        place = (pose[0] + cos * ahead - sin * side, pose[1] + sin * ahead + cos * side)
        point = np.array([*place, 0.42 + ahead * rng.uniform(-0.6, 0.6)])
        simulation.reset(ROW, {"poses": [pose], "points": [point]})
        x, y, depth = pinhole(pose, 0.42, point)
        column, row = 500.0 * x + 300.0, 500.0 * y + 220.0
        expected = 0.5 <= depth <= 6.0 and 0.0 <= column <= 640.0 and 0.0 <= row <= 400.0
        assert bool(simulation.first.seen[0, 0, 0, 0]) == expected
        np.testing.assert_allclose(
            simulation.first.image[0, 0, 0, 0], (x, y) if expected else (0.0, 0.0), rtol=1e-6, atol=1e-7
        )
        seen += int(expected)
    assert 100 < seen < 300


@pytest.mark.parametrize("preset", ["pi", "kinect"])
def test_field_of_view_ends_at_its_borders(preset: str) -> None:
    """One part in 10⁹ within the border is seen, one beyond it is not, on all four sides."""
    simulation = camera(spec=preset, points=[(3.0, 0.0, 0.3)])
    config = simulation.config.camera_of(0)
    half_x, half_y = 320.0 / config.focal_length, 240.0 / config.focal_length
    assert math.isclose(config.half_view, math.atan(half_x))
    assert math.isclose(math.degrees(2.0 * config.half_view), {"pi": 62.2, "kinect": 57.0}[preset])
    for depth in (0.7, 3.0, 7.5):
        for share, inside in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
            for side in (-1.0, 1.0):
                assert sees(simulation, (depth, side * share * half_x * depth, 0.3)) == inside
                assert sees(simulation, (depth, 0.0, 0.3 + side * share * half_y * depth)) == inside


def test_depth_limits_are_exact() -> None:
    simulation = camera(spec={"preset": "kinect", "near": 0.4, "far": 8.0}, points=[(3.0, 0.0, 0.3)])
    for share, inside in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
        assert sees(simulation, (8.0 * share, 1.0, 0.3)) == inside
        assert sees(simulation, (0.4 / share, 0.1, 0.3)) == inside
    assert not sees(simulation, (-2.0, 0.0, 0.3))


def test_unlimited_camera_sees_all_that_is_ahead() -> None:
    """300 random points; ahead is seen however far to the side, behind is not."""
    rng = np.random.default_rng(2)
    simulation = camera(spec="unlimited", points=[(3.0, 0.0, 0.3)])
    for _ in range(300):
        x, y, z = rng.uniform(-30, 30, 3)
        if abs(x) > 0.1:
            assert sees(simulation, (x, y, z)) == (x > 0.0)


def test_pixel_noise_has_its_size() -> None:
    """16,000 images of two points: unbiased, of the stated size, and independent of each other."""
    points = [(3.0, 0.5, 0.5), (5.0, -1.0, 0.1)]
    simulation = camera(8, spec={"preset": "pi", "pixel_noise": 2.5}, points=points, samples_per_action=1000)
    config = simulation.config.camera_of(0)
    for _ in range(2):
        still(simulation)
    assert simulation.samples.seen.all()
    truth = np.array([(-0.5 / 3.0, -0.2 / 3.0), (1.0 / 5.0, 0.2 / 5.0)])
    noise = ((simulation.samples.image - truth) * config.focal_length / 2.5).reshape(-1, 4)
    count = len(noise)
    assert (np.abs(noise.mean(axis=0)) < 4.5 / math.sqrt(count)).all()
    assert (np.abs(noise.std(axis=0) - 1.0) < 4.5 / math.sqrt(2 * count)).all()
    assert (np.abs(np.corrcoef(noise.T) - np.eye(4)) < 4.5 / math.sqrt(count)).all()
    assert (np.abs((noise[1:] * noise[:-1]).mean(axis=0)) < 4.5 / math.sqrt(count)).all()
    assert math.isclose(config.image_noise, 2.5 / config.focal_length)


def test_detections_fall_on_the_grid_of_pixels() -> None:
    """1000 exact points: multiples of the step, at most half a step off, and off by step/√12 on average."""
    rng = np.random.default_rng(3)
    simulation = camera(spec={**EXACT, "quantisation": 4.0}, points=[(3.0, 0.0, 0.3)])
    config = simulation.config.camera_of(0)
    focal, errors = config.focal_length, []
    for _ in range(1000):
        x, y = rng.uniform(-0.5, 0.5), rng.uniform(-0.4, 0.4)
        assert sees(simulation, (3.0, -3.0 * x, 0.3 - 3.0 * y))
        found = simulation.first.image[0, 0, 0, 0].astype(np.float64) * focal + (320.0, 240.0)
        np.testing.assert_allclose(found / 4.0, np.round(found / 4.0), atol=1e-5)
        errors.append(found - (np.array([x, y]) * focal + (320.0, 240.0)))
    assert np.abs(errors).max() <= 2.0 + 1e-4
    assert abs(np.std(errors) / focal / config.image_noise - 1.0) < 0.05
    assert math.isclose(config.image_noise, 4.0 / math.sqrt(12.0) / focal)


def test_noise_and_rounding_add_up() -> None:
    config = CameraConfig.model_validate(
        {"focal_length": 400.0, "pixel_noise": 3.0, "quantisation": 4.0 * math.sqrt(12)}
    )
    assert math.isclose(config.image_noise, 5.0 / 400.0)


@pytest.mark.parametrize("rate", [20.0, 15.0, 10.0, 8.0, 5.0, 3.0, 0.5])
def test_frames_come_at_the_rate_of_the_camera(rate: float) -> None:
    """In 200 s at 20 Hz: the first sample is a frame, and any window of T seconds has rate T of them, to within one."""
    simulation = camera(spec={**EXACT, "frame_rate": rate}, points=[(3.0, 0.0, 0.3)], samples_per_action=1000)
    assert simulation.first.seen.all()
    frames = [np.array([True])]
    for _ in range(4):
        still(simulation)
        frames.append(simulation.samples.seen[0, :, 0, 0].copy())
    taken = np.cumsum(np.concatenate(frames))
    due = rate / 20.0 * np.arange(len(taken))
    assert np.abs(taken - 1 - due).max() <= 1.0 + 1e-9
    gaps = np.diff(np.flatnonzero(np.concatenate(frames)))
    assert gaps.min() >= math.floor(20.0 / rate + 1e-9)
    assert gaps.max() <= math.ceil(20.0 / rate - 1e-9)


def test_missed_detections_are_as_many_as_said() -> None:
    """16,000 looks at two points: each missed with probability 0.3, independently; what is missed reads as zero."""
    spec = {**EXACT, "miss_probability": 0.3}
    simulation = camera(8, spec=spec, points=[(3.0, 0.5, 0.5), (5.0, -1.0, 0.1)], samples_per_action=1000)
    still(simulation)
    seen = simulation.samples.seen[:, :, 0]
    missed = ~seen.reshape(-1, 2)
    sd = math.sqrt(0.3 * 0.7 / len(missed))
    assert (np.abs(missed.mean(axis=0) - 0.3) < 4.0 * sd).all()
    assert abs((missed[:, 0] & missed[:, 1]).mean() - 0.09) < 4.0 * math.sqrt(0.09 * 0.91 / len(missed))
    assert (simulation.samples.image[:, :, 0][~seen] == 0.0).all()
    assert simulation.world.visible.all()
    for probability, expected in ((0.0, True), (1.0, False)):
        simulation = camera(spec={**EXACT, "miss_probability": probability}, points=[(3.0, 0.0, 0.3)])
        still(simulation)
        assert bool(simulation.samples.seen.all()) == expected


def blocked_by_sampling(
    config: EnvConfig, poses: NDArray[np.float64], point: NDArray[np.float64]
) -> tuple[bool, float]:
    """(whether, how clearly): depth [m] of the deepest of 4000 places on the ray in any body, negative for a miss."""
    eye = np.array([*poses[0, :2], config.camera_of(0).mount_height])
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    ray = eye + share * (point - eye)
    inside = []
    bodies = [*config.obstacles]
    other = config.robot_of(1)
    x, y, _ = poses[1]
    bodies.append(DiscConfig(position=(float(x), float(y)), radius=other.radius, height=other.height))
    for body in bodies:
        d = ray[:, :2] - body.position
        if body.shape == "disc":
            depth = body.radius - np.hypot(d[:, 0], d[:, 1])
        else:
            cos, sin = math.cos(body.angle), math.sin(body.angle)
            u, v = cos * d[:, 0] + sin * d[:, 1], cos * d[:, 1] - sin * d[:, 0]
            depth = np.minimum(0.5 * body.size[0] - np.abs(u), 0.5 * body.size[1] - np.abs(v))
        inside.append(np.minimum(depth, body.height - ray[:, 2]).max())
    return max(inside) > 0.0, abs(max(inside))


def test_line_of_sight_against_sampled_rays() -> None:
    """600 random scenes with a disc, a turned box and another robot, low and high; rays up and down."""
    rng = np.random.default_rng(4)
    hidden = clear = 0
    for _ in range(30):
        obstacles = [
            {"shape": "disc", "position": tuple(rng.uniform(1.0, 3.0, 2)), "radius": 0.4,
             "height": rng.uniform(0.1, 0.9)},
            {"shape": "box", "position": tuple(rng.uniform(1.0, 3.0, 2) * (1, -1)), "size": (0.9, 0.4),
             "angle": rng.uniform(-3, 3), "height": rng.uniform(0.1, 0.9)},
        ]  # fmt: skip
        simulation = Simulation(
            load_config(
                poses=[(0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)], camera={"preset": "unlimited", "mount_height": 0.5},
                robot={"height": float(rng.uniform(0.2, 0.8))}, points=[(5.0, 0.0, 0.3)], arena=None, shield=None,
                obstacles=obstacles, estimator=None,
            )
        )  # fmt: skip
        for _ in range(20):
            point = np.array([rng.uniform(3.0, 5.0), rng.uniform(-4.0, 4.0), rng.uniform(0.0, 1.2)])
            poses = np.array([(0.0, 0.0, 0.0), (*rng.uniform(0.8, 2.8, 1), rng.uniform(-0.6, 0.6), 0.0)])
            blocked, margin = blocked_by_sampling(simulation.config, poses, point)
            if margin < 0.005:
                continue
            simulation.world.fixed_poses[0] = poses
            simulation.world.fixed_points[0] = point
            simulation.reset(ROW)
            assert bool(simulation.first.seen[0, 0, 0, 0]) != blocked
            hidden, clear = hidden + blocked, clear + (not blocked)
    assert hidden > 80
    assert clear > 80


def test_looking_over_a_low_obstacle() -> None:
    """Camera at 0.5 m, box 0.4 m high from 2 to 4 m away: a point at 6 m is hidden below 0.35 m, where the line of
    sight to it leaves the box at its far edge lower than 0.4 m."""
    box = {"shape": "box", "position": (3.0, 0.0), "size": (2.0, 1.0), "height": 0.4}
    spec = {"preset": "unlimited", "mount_height": 0.5}
    simulation = camera(spec=spec, points=[(6.0, 0.0, 0.5)], obstacles=[box])
    for height, seen in ((0.5, True), (0.36, True), (0.34, False), (0.1, False)):
        assert sees(simulation, (6.0, 0.0, height)) == seen
    assert sees(simulation, (1.9, 0.0, 0.0))
    low = camera(spec={**spec, "mount_height": 0.3}, points=[(6.0, 0.0, 0.5)], obstacles=[box])
    for height, seen in ((0.61, True), (0.59, False)):  # at 2 m the line from 0.3 m has to be at 0.4 m
        assert sees(low, (6.0, 0.0, height)) == seen


def test_presets() -> None:
    """A preset may be named alone, or changed in part."""
    pi, kinect, unlimited = (CameraConfig.model_validate(name) for name in ("pi", "kinect", "unlimited"))
    assert pi.limited
    assert (kinect.near, kinect.far) == (0.4, 8.0)
    assert not unlimited.limited
    assert unlimited.image_noise == 0.0
    changed = CameraConfig.model_validate({"preset": "kinect", "far": 5.0})
    assert changed.far == 5.0
    assert changed.focal_length == kinect.focal_length
    narrow = CameraConfig.model_validate({"preset": "pi", "focal_length": 900.0})
    assert narrow.focal_length == 900.0
    assert narrow.pixel_noise == pi.pixel_noise
