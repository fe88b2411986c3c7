"""Random scenes to draw, made without the simulator."""

from typing import Any

import numpy as np

from relloc_env.rendering.scene import CameraGeometry, Scene, Strip, target_colours
from relloc_env.samples import Estimate, Float, ordered_pairs

OBSTACLES = np.array([[0.0, 0.6, -1.8, 0.4, 0.0, 0.0, 1.0], [1.0, -1.6, 2.4, 0.9, 0.3, 0.5, 0.6]])


def random_scene(
    seed: int, robots: int = 2, points: int = 4, time: float = 12.35, sd: float = 0.1, **changes: Any
) -> Scene:
    """Robots that look at targets, with estimates off by about one standard deviation; `changes` replace fields."""
    rng = np.random.default_rng(seed)
    camera = CameraGeometry(mount=0.25)
    places = np.stack([rng.uniform(1.0, 4.2, points), rng.uniform(-3.0, 3.0, points), rng.uniform(0.0, 0.8, points)], 1)
    trails, poses = [], np.zeros((robots, 3))
    steps = np.arange(0.0, time + 1e-9, 0.05)
    for robot in range(robots):
        v, w = rng.uniform(0.1, 0.2), 0.04 * rng.normal()
        end = np.array([-2.0 + 1.2 * rng.random(), -1.0 + 2.4 * robot + 0.5 * rng.normal()])
        facing = np.arctan2(*(places[:, :2].mean(axis=0) - end)[::-1]) + 0.1 * rng.normal()
        heading = facing + w * (steps - steps[-1]) + 0.4 * np.sin(0.8 * (steps - steps[-1]))
        travelled = np.cumsum(0.05 * v * np.stack([np.cos(heading), np.sin(heading)], 1), axis=0)
        trails.append(end + travelled - travelled[-1])
        poses[robot] = [*end, facing]
    image, in_view = true_images(poses, places, camera)
    measured = (image + 0.003 * rng.normal(size=image.shape)).astype(np.float32)
    estimate = random_estimate(rng, poses, places, camera.mount, sd)
    given: dict[str, Any] = {
        "time": time,
        "arena": (-5.0, 5.0, -5.0, 5.0),
        "obstacles": OBSTACLES,
        "robot_radius": 0.18,
        "poses": poses,
        "trails": trails,
        "points": places,
        "colours": target_colours(points),
        "cameras": [camera] * robots,
        "true_image": image,
        "in_view": in_view,
        "image": measured,
        "seen": in_view & (rng.random((robots, points)) < 0.95),
        "estimate": estimate,
        "contact": np.zeros(robots, bool),
        "blocked": np.zeros(robots, bool),
        "strips": random_strips(rng, robots, steps[::5]),
        "horizon": 30.0,
        "title": "edge law",
    }
    return Scene(**(given | changes))


def random_strips(rng: np.random.Generator, robots: int, time: Float) -> list[Strip]:
    """Errors that fall, with their bound, and a NEES with its band."""
    falling = np.exp(-0.2 * time + 0.3 * rng.normal(size=(robots, len(time))))
    honest = rng.chisquare(3, (robots, len(time)))
    newest = [f"{value:.2f}" for value in falling[:, -1]]
    return [
        Strip("depth error [m]", time, falling, newest, (0.003, 5.0), bound=np.exp(-0.2 * time)),
        Strip("NEES", time, honest, [f"{value:.1f}" for value in honest[:, -1]], (0.05, 500.0), band=(0.2, 9.0)),
        Strip("excitation [m/s]", time, 0.1 * falling, newest, (0.001, 0.5)),
    ]


def true_images(poses: Float, points: Float, camera: CameraGeometry) -> tuple[Float, Any]:
    """Project by the definition of the camera, with complex numbers for the plane."""
    offset = (points[None, :, 0] + 1j * points[None, :, 1]) - (poses[:, None, 0] + 1j * poses[:, None, 1])
    body = offset * np.exp(-1j * poses[:, None, 2])
    image = np.stack([-body.imag / body.real, (camera.mount - points[None, :, 2]) / body.real], axis=-1)
    u, v = camera.c_x + camera.focal * image[..., 0], camera.c_y + camera.focal * image[..., 1]
    inside = (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
    return image, (body.real > 0.0) & inside


def random_estimate(rng: np.random.Generator, poses: Float, points: Float, mount: float, sd: float) -> Estimate:
    """Beliefs about points (range sd `sd`) and poses (sd `sd` per axis, 0.3 sd rad), drawn from their covariances."""
    robots, number = len(poses), len(points)
    polar, polar_covariance = np.zeros((robots, number, 3)), np.zeros((robots, number, 3, 3))
    for r, (x, y, theta) in enumerate(poses):
        for j, point in enumerate(points):
            reach = float(np.hypot(point[0] - x, point[1] - y))
            bearing = float(np.arctan2(point[1] - y, point[0] - x) - theta)
            deviation = np.array([0.004, 0.004, sd / reach**2])
            polar[r, j] = np.array([bearing, (point[2] - mount) / reach, 1 / reach]) + deviation * rng.normal(size=3)
            polar_covariance[r, j] = np.diag(deviation**2)
    pairs = ordered_pairs(robots)
    pose, covariance = np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3, 3))
    for p, (a, b) in enumerate(pairs):
        r = np.exp(-1j * poses[a, 2]) * complex(*(poses[b, :2] - poses[a, :2]))
        deviation = np.array([1.4 * sd, sd, 0.3 * sd])
        pose[p] = np.array([r.real, r.imag, poses[b, 2] - poses[a, 2]]) + deviation * rng.normal(size=3)
        covariance[p] = np.diag(deviation**2) + np.array([[0, 0.9, 0], [0.9, 0, 0], [0, 0, 0]]) * sd**2
    return Estimate(polar, polar_covariance, np.ones((robots, number), bool), pose, covariance)


def columns_of(part: Any) -> dict[str, list[Any]]:
    """Columns of a chunk but for the time of writing, whose nanoseconds need pandas."""
    batch = part.to_record_batch()
    found: dict[str, list[Any]] = batch.select([name for name in batch.schema.names if name != "log_time"]).to_pydict()
    return found
