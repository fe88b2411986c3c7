"""Shapes in the world that the pictures are made of: views, 2 sigma regions, projections. Numbers only."""

import math
from collections.abc import Sequence

import numpy as np

from relloc_env.rendering.scene import CameraGeometry, Scene
from relloc_env.samples import Float

SIGMAS = 2.0
"""Size of every drawn region of uncertainty, in standard deviations."""
_TURN = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
_CIRCLE = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
_HUGE = 1e6


def to_world(pose: Float, points: Float) -> Float:
    """Return (T, 2) [m] points of a robot's body frame in the world."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    placed: Float = pose[:2] + points @ np.array([[cos, sin], [-sin, cos]])
    return placed


def to_body(pose: Float, points: Float) -> Float:
    """Return (T, 2) [m] points of the world in a robot's body frame."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    placed: Float = (points[:, :2] - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])
    return placed


def root(covariance: Float) -> Float:
    """A (2, 2) square root of a covariance, that of the nearest semi-definite matrix of moderate size."""
    a, b, c = (_moderate(float(v)) for v in (covariance[0, 0], covariance[0, 1], covariance[1, 1]))
    turn = 0.5 * math.atan2(2.0 * b, a - c)
    middle, half = 0.5 * (a + c), math.hypot(0.5 * (a - c), b)
    long, short = math.sqrt(max(middle + half, 0.0)), math.sqrt(max(middle - half, 0.0))
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([[cos * long, -sin * short], [sin * long, cos * short]])


def _moderate(value: float) -> float:
    return 0.0 if math.isnan(value) else min(max(value, -_HUGE), _HUGE)


def ellipse(mean: Float, covariance: Float) -> Float:
    """Return (64, 2) corners of the 2 sigma ellipse of a place in the plane."""
    corners: Float = mean + SIGMAS * _CIRCLE @ root(covariance).T
    return corners


def polar_region(point: Float, covariance: Float, reach: float) -> Float:
    """Return (64, 2) [m] corners, body frame, of the 2 sigma region of a point (beta, eta, rho) in the plane.

    The region is an ellipse in (beta, rho); in the plane it is bent about the robot, and longer behind the point than
    before it. Where it includes infinity (rho <= 0) it ends at `reach`.
    """
    region = ellipse(point[::2], covariance[::2, ::2])
    beta = np.clip(region[:, 0], point[0] - np.pi, point[0] + np.pi)
    distance = 1.0 / np.clip(region[:, 1], 1.0 / reach, _HUGE)
    corners = np.empty((len(beta), 2))
    corners[:, 0], corners[:, 1] = distance * np.cos(beta), distance * np.sin(beta)
    return corners


def polar_place(point: Float) -> Float:
    """Return (2,) [m] place in the body frame of a point (beta, eta, rho)."""
    distance = 1.0 / max(float(point[2]), 1.0 / _HUGE)
    return np.array([distance * math.cos(point[0]), distance * math.sin(point[0])])


def in_space(point: Float, covariance: Float) -> tuple[Float, Float]:
    """Place (3,) [m] of a point (beta, eta, rho) from its camera, x ahead and z up; its covariance to first order."""
    beta, eta, rho = point[0], point[1], max(float(point[2]), 1e-3)
    reach, cos, sin = 1.0 / rho, math.cos(beta), math.sin(beta)
    slope = reach * np.array([[-sin, 0.0, -cos * reach], [cos, 0.0, -sin * reach], [0.0, 1.0, -eta * reach]])
    spread: Float = slope @ covariance @ slope.T
    return reach * np.array([cos, sin, eta]), spread


def axes(covariance: Float) -> tuple[Float, Float]:
    """Half axes (3,) [m] of the 2 sigma ellipsoid, and the quaternion x, y, z, w that turns x, y, z onto its axes."""
    finite = np.nan_to_num(0.5 * (covariance + covariance.T), nan=0.0, posinf=1e6, neginf=-1e6)
    values, turn = np.linalg.eigh(finite)
    if np.linalg.det(turn) < 0.0:
        turn[:, 0] *= -1.0
    # The quaternion of a rotation matrix is the main eigenvector of a symmetric one (I. Bar-Itzhack, JGCD 23(6), 2000).
    (a, b, c), (d, e, f), (g, h, i) = turn
    symmetric = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    half: Float = SIGMAS * np.sqrt(np.clip(values, 0.0, 1e4))
    return half, np.linalg.eigh(symmetric)[1][:, -1]


def polar_image(beta: Float, eta: Float) -> Float:
    """Return (T, 2) normalised image of directions (beta, eta); x = -tan beta, y = -eta / cos beta, in front only."""
    image = np.empty((len(beta), 2))
    image[:, 0], image[:, 1] = -np.tan(beta), -eta / np.cos(beta)
    return image


def bounds(scene: Scene) -> tuple[float, float, float, float]:
    """What the map shows [m]: the arena, or everything true so far, in whole steps so that it rarely changes."""
    if scene.arena is not None:
        x_min, x_max, y_min, y_max = scene.arena
        margin = 0.02 * max(x_max - x_min, y_max - y_min)
        return x_min - margin, x_max + margin, y_min - margin, y_max + margin
    places = [scene.poses[:, :2], scene.points[:, :2], *(trail for trail in scene.trails if len(trail))]
    if scene.obstacles is not None:
        reach = np.hypot(scene.obstacles[:, 3:4], scene.obstacles[:, 4:5])
        places += [scene.obstacles[:, 1:3] - reach, scene.obstacles[:, 1:3] + reach]
    used = np.concatenate(places)
    low, high = np.floor(used.min(axis=0) - 0.6), np.ceil(used.max(axis=0) + 0.6)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def half_views(camera: CameraGeometry) -> tuple[float, float]:
    """Bearings [rad] of the left and right edge of the image, counter-clockwise from the heading."""
    return math.atan(camera.c_x / camera.focal), -math.atan((camera.width - camera.c_x) / camera.focal)


def view(scene: Scene, robot: int, reach: float) -> Float:
    """Return (T, 2) [m] corners, world, of what a camera sees of the plane at its height, its own place first.

    Obstacles, walls and other robots as high as the camera end the view, as does its greatest depth.
    """
    camera, pose = scene.cameras[robot], scene.poses[robot]
    left, right = half_views(camera)
    discs, boxes = _blocking(scene, robot, camera.mount)
    edges = [left, right]
    for x, y, radius in discs:
        distance = math.hypot(x - pose[0], y - pose[1])
        if distance > radius:
            middle, half = math.atan2(y - pose[1], x - pose[0]), math.asin(radius / distance)
            edges += [middle + side * half - pose[2] for side in (-1.0, 1.0)]
    for corners in map(box_corners, boxes):
        edges += list(np.arctan2(corners[:, 1] - pose[1], corners[:, 0] - pose[0]) - pose[2])
    turned = (np.array(edges) + np.pi) % (2.0 * np.pi) - np.pi
    beta = np.concatenate([np.linspace(right, left, 65), turned - 1e-5, turned + 1e-5])
    beta = np.sort(beta[(beta >= right) & (beta <= left)])
    rays = np.stack([np.cos(beta + pose[2]), np.sin(beta + pose[2])], axis=1)
    far = np.minimum(camera.far / np.cos(beta), reach)
    if scene.arena is not None:
        far = np.minimum(far, _to_walls(pose, rays, scene.arena))
    for x, y, radius in discs:
        far = np.minimum(far, _to_disc(pose, rays, x, y, radius))
    for box in boxes:
        far = np.minimum(far, _to_box(pose, rays, box))
    corners = pose[:2] + far[:, None] * rays
    if camera.near > 0.0:
        start = pose[:2] + np.minimum(camera.near / np.cos(beta), far)[:, None] * rays
        return np.concatenate([start[::-1], corners])
    return np.concatenate([pose[None, :2], corners])


def box_corners(box: Float) -> Float:
    """Return (4, 2) [m] corners, world, of an obstacle that is a box."""
    local = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * box[3:5]
    return to_world(box[[1, 2, 5]], local)


def _blocking(scene: Scene, robot: int, height: float) -> tuple[list[tuple[float, float, float]], list[Float]]:
    """Discs (x, y, radius) and boxes that are at least `height` high."""
    discs = [
        (float(pose[0]), float(pose[1]), scene.robot_radius)
        for other, pose in enumerate(scene.poses)
        if other != robot and scene.robot_height >= height
    ]
    boxes = []
    for obstacle in scene.obstacles if scene.obstacles is not None else ():
        if obstacle[6] < height:
            continue
        if obstacle[0] == 0:
            discs.append((float(obstacle[1]), float(obstacle[2]), float(obstacle[3])))
        else:
            boxes.append(obstacle)
    return discs, boxes


def _to_walls(pose: Float, rays: Float, arena: Sequence[float]) -> Float:
    low, high = np.array([arena[0], arena[2]]), np.array([arena[1], arena[3]])
    with np.errstate(divide="ignore", invalid="ignore"):
        each = np.where(rays > 0.0, (high - pose[:2]) / rays, np.where(rays < 0.0, (low - pose[:2]) / rays, np.inf))
    nearest: Float = np.maximum(each.min(axis=1), 0.0)
    return nearest


def _to_disc(pose: Float, rays: Float, x: float, y: float, radius: float) -> Float:
    along = rays @ np.array([x - pose[0], y - pose[1]])
    square = along**2 - ((x - pose[0]) ** 2 + (y - pose[1]) ** 2 - radius**2)
    hit = (square > 0.0) & (along > 0.0)
    return np.where(hit, np.maximum(along - np.sqrt(np.maximum(square, 0.0)), 0.0), np.inf)


def _to_box(pose: Float, rays: Float, box: Float) -> Float:
    start = to_body(box[[1, 2, 5]], pose[None, :2])
    step = to_body(np.array([0.0, 0.0, box[5]]), rays)
    step = np.where(np.abs(step) < 1e-12, 1e-12, step)
    one, two = (-box[3:5] - start) / step, (box[3:5] - start) / step
    enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    return np.where((enter <= leave) & (leave > 0.0), np.maximum(enter, 0.0), np.inf)
