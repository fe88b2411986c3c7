"""What a robot's camera sees: a sketch of the world in perspective, and true, measured and predicted points."""

import math
from dataclasses import dataclass

import numpy as np

from relloc_env.pinhole import project
from relloc_env.rendering import geometry
from relloc_env.rendering.canvas import Box, Canvas
from relloc_env.rendering.scene import CameraGeometry, Scene
from relloc_env.rendering.theme import Colour, Theme, mix
from relloc_env.samples import Float

_ON_PICTURE: Colour = (24, 24, 24)
"""Of numbers on pictures, which are grey in any theme."""
_NEAREST = 0.05
_GRID_REACH = 12
_ARC = np.linspace(-1.0, 1.0, 16)


@dataclass(frozen=True)
class ImageFrame:
    """Where a camera image is on the picture.

    Args:
        box: [px] where to draw, of the proportions of the image.
        camera: its geometry.
        shrink: how much more than the image is shown (1: just the image), for cameras without limits.
    """

    box: Box
    camera: CameraGeometry
    shrink: float = 1.0

    @property
    def scale(self) -> float:
        """Pixels of the picture per unit of normalised image coordinates."""
        return self.camera.focal * self.box[2] / self.camera.width / self.shrink

    def pixels(self, image: Float) -> Float:
        """Return (T, 2) [px] of (T, 2) normalised image coordinates."""
        left, top, width, height = self.box
        centre_x = left + (0.5 + (self.camera.c_x / self.camera.width - 0.5) / self.shrink) * width
        centre_y = top + (0.5 + (self.camera.c_y / self.camera.height - 0.5) / self.shrink) * height
        return np.array([centre_x, centre_y]) + self.scale * image

    def pixel(self, image: Float) -> tuple[float, float]:
        """Return x, y [px] of one image point."""
        x, y = self.pixels(image[None])[0].tolist()
        return x, y


def image_frame(box: Box, scene: Scene, robot: int) -> ImageFrame:
    """Return the frame of a robot's image; without limits it grows in powers of √2 to hold what is in view."""
    camera = scene.cameras[robot]
    frame = ImageFrame(box, camera)
    if camera.limited or not scene.in_view[robot].any():
        return frame
    shown = np.abs(
        frame.pixels(scene.true_image[robot, scene.in_view[robot]]) - np.add(box[:2], box[2:]) + 0.5 * np.array(box[2:])
    )
    excess = 1.1 * float((shown / (0.5 * np.array(box[2:]))).max())
    return ImageFrame(box, camera, 2.0 ** (0.5 * math.ceil(2.0 * math.log2(min(max(excess, 1.0), 16.0)))))


def draw_camera(
    canvas: Canvas, frame: ImageFrame, scene: Scene, robot: int, theme: Theme, ui: float, letters: float
) -> None:
    """Draw one camera image with its frame: what the camera took, or else a sketch of what it would.

    Measured points have the numbers of those they are taken for, as in the world.
    """
    box, colour = frame.box, theme.robot(robot)
    left, top, width, height = box
    taken = scene.pictures[robot] if len(scene.pictures) else None
    with canvas.inside(box):
        if taken is not None:
            canvas.picture(box, taken)
        else:
            _draw_sketch(canvas, frame, scene, robot, theme, ui)
        if scene.estimate is not None:
            _draw_predicted(canvas, frame, scene, robot, theme, ui)
        for place in np.flatnonzero(scene.seen[robot]).tolist():
            _draw_measured(canvas, frame, scene.image[robot, place], theme, ui)
            shade = theme.muted if taken is None else _ON_PICTURE
            _write_number(canvas, frame, scene.image[robot, place], place + 1, shade, ui, letters)
    edge = max(1.5, 2.0 * ui)
    canvas.rectangle((left - edge, top - edge, width + 2.0 * edge, height + 2.0 * edge), colour, edge)


def _draw_sketch(canvas: Canvas, frame: ImageFrame, scene: Scene, robot: int, theme: Theme, ui: float) -> None:
    left, top, width, height = frame.box
    horizon = frame.pixel(np.zeros(2))[1]
    canvas.rectangle(frame.box, theme.floor)
    canvas.rectangle((left, horizon, width, max(top + height - horizon, 0.0)), theme.outside)
    _draw_floor(canvas, frame, scene, robot, theme)
    canvas.line((left, horizon), (left + width, horizon), theme.edge, 1.0)
    _draw_bodies(canvas, frame, scene, robot, theme)
    for place in range(len(scene.points)):
        _draw_true(canvas, frame, scene, robot, place, theme, ui)


def _draw_floor(canvas: Canvas, frame: ImageFrame, scene: Scene, robot: int, theme: Theme) -> None:
    """Draw lines every metre on the floor, in perspective."""
    pose, mount = scene.poses[robot], scene.cameras[robot].mount
    x_min, x_max, y_min, y_max = scene.arena or (
        round(pose[0]) - _GRID_REACH,
        round(pose[0]) + _GRID_REACH,
        round(pose[1]) - _GRID_REACH,
        round(pose[1]) + _GRID_REACH,
    )
    x, y = np.arange(math.ceil(x_min), math.floor(x_max) + 1), np.arange(math.ceil(y_min), math.floor(y_max) + 1)
    start = np.concatenate([np.stack([x, np.full(len(x), y_min)], 1), np.stack([np.full(len(y), x_min), y], 1)])
    end = np.concatenate([np.stack([x, np.full(len(x), y_max)], 1), np.stack([np.full(len(y), x_max), y], 1)])
    one, two = geometry.to_body(pose, start.astype(float)), geometry.to_body(pose, end.astype(float))
    visible = (one[:, 0] > _NEAREST) | (two[:, 0] > _NEAREST)
    one, two = one[visible], two[visible]
    for near, far in ((one, two), (two, one)):
        behind = near[:, 0] < _NEAREST
        share = (_NEAREST - near[behind, 0]) / (far[behind, 0] - near[behind, 0])
        near[behind] += share[:, None] * (far[behind] - near[behind])
    below = mount / one[:, 0], mount / two[:, 0]
    ends = [np.stack([-body[:, 1] / body[:, 0], y], axis=1) for body, y in zip((one, two), below, strict=True)]
    canvas.hairlines(frame.pixels(ends[0]), frame.pixels(ends[1]), mix(theme.outside, theme.edge, 0.2))


def _draw_bodies(canvas: Canvas, frame: ImageFrame, scene: Scene, robot: int, theme: Theme) -> None:
    """Draw silhouettes of obstacles and of the other robots, far ones first."""
    pose, mount = scene.poses[robot], scene.cameras[robot].mount
    bodies: list[tuple[float, Float, Colour]] = []
    for other, at in enumerate(scene.poses):
        if other != robot:
            shape = _silhouette_of_disc(pose, mount, at, scene.robot_radius, scene.robot_height)
            bodies.append((_range(pose, at), shape, mix(theme.robot(other), theme.floor, 0.25)))
    for obstacle in scene.obstacles if scene.obstacles is not None else ():
        if obstacle[0] == 0:
            shape = _silhouette_of_disc(pose, mount, obstacle[1:3], obstacle[3], obstacle[6])
        else:
            shape = _silhouette_of_box(pose, mount, obstacle)
        bodies.append((_range(pose, obstacle[1:3]), shape, theme.obstacle))
    for _, shape, colour in sorted(bodies, key=lambda body: -body[0]):
        if len(shape):
            corners = frame.pixels(shape)
            canvas.polygon(corners, colour)
            canvas.outline(corners, mix(colour, theme.ink, 0.25), 1.0)


def _range(pose: Float, place: Float) -> float:
    return math.hypot(place[0] - pose[0], place[1] - pose[1])


def _silhouette_of_disc(pose: Float, mount: float, centre: Float, radius: float, height: float) -> Float:
    """(T, 2) image of an upright cylinder: its near rim on the floor, and of its top the rim that looks higher."""
    distance = _range(pose, centre)
    toward = math.atan2(pose[1] - centre[1], pose[0] - centre[0])
    if distance <= radius or -math.cos(toward - pose[2]) * distance < radius + _NEAREST:
        return np.zeros((0, 2))
    half = math.acos(radius / distance)
    turn = toward + half * _ARC
    top = turn[::-1] if height > mount else toward + half + (2.0 * math.pi - 2.0 * half) * 0.5 * (1.0 + _ARC)
    around = np.concatenate([turn, top])
    rim = np.empty((len(around), 3))
    rim[:, 0], rim[:, 1] = centre[0] + radius * np.cos(around), centre[1] + radius * np.sin(around)
    rim[: len(turn), 2], rim[len(turn) :, 2] = 0.0, height
    return project(pose, mount, rim)[:, :2]


def _silhouette_of_box(pose: Float, mount: float, box: Float) -> Float:
    """(T, 2) image of an upright box."""
    ground = np.concatenate([geometry.box_corners(box), np.zeros((4, 1))], axis=1)
    seen = project(pose, mount, np.concatenate([ground, ground + np.array([0.0, 0.0, box[6]])]))
    return _hull(seen[:, :2]) if (seen[:, 2] > _NEAREST).all() else np.zeros((0, 2))


def _hull(corners: Float) -> Float:
    """Convex hull of (T, 2) corners (A. M. Andrew's monotone chain, Inf. Proc. Lett. 9(5), 1979)."""
    ordered = sorted(map(tuple, corners.tolist()))
    chains = []
    for run in (ordered, ordered[::-1]):
        chain: list[tuple[float, ...]] = []
        for point in run:
            while len(chain) > 1 and (
                (chain[-1][0] - chain[-2][0]) * (point[1] - chain[-2][1])
                <= (chain[-1][1] - chain[-2][1]) * (point[0] - chain[-2][0])
            ):
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return np.array(chains)


def _draw_true(
    canvas: Canvas, frame: ImageFrame, scene: Scene, robot: int, place: int, theme: Theme, ui: float
) -> None:
    """Draw a true point: solid; pale where it is inside the image but hidden."""
    at = project(scene.poses[robot], scene.cameras[robot].mount, scene.points[place][None])[0]
    if at[2] < _NEAREST:
        return
    red, green, blue = scene.colours[place].tolist()
    colour = (red, green, blue)
    centre = frame.pixel(scene.true_image[robot, place])
    if not scene.in_view[robot, place]:
        canvas.disc(centre, 4.5 * ui, mix(colour, theme.floor, 0.7))
        return
    canvas.disc(centre, 5.5 * ui, mix(colour, theme.ink, 0.45))
    canvas.disc(centre, 4.5 * ui, colour)


def _draw_measured(canvas: Canvas, frame: ImageFrame, image: Float, theme: Theme, ui: float) -> None:
    """Draw a measured point: a cross; a bearing without a height: an upright line."""
    width = max(1.0, 1.25 * ui)
    if np.isnan(image[1]):
        x = frame.pixel(np.array([image[0], 0.0]))[0]
        canvas.line((x, frame.box[1]), (x, frame.box[1] + frame.box[3]), theme.ink, width)
        return
    x, y = frame.pixel(image.astype(float))
    arm = 7.0 * ui
    for colour, wider in ((theme.floor, 1.0), (theme.ink, 0.0)):
        canvas.line((x - arm, y), (x + arm, y), colour, width + wider)
        canvas.line((x, y - arm), (x, y + arm), colour, width + wider)


def _write_number(
    canvas: Canvas, frame: ImageFrame, image: Float, number: int, shade: Colour, ui: float, letters: float
) -> None:
    """Write the number of a measured point beside its cross, inside the image."""
    left, top, width, height = frame.box
    x, y = frame.pixel(np.nan_to_num(image.astype(float)))
    side = 1.0 if x < left + 0.85 * width else -1.0
    y = min(max(y - 9.0 * ui, top + 0.6 * letters), top + height - 0.6 * letters)
    canvas.text(str(number), (x + 9.0 * ui * side, y), 0.9 * letters, shade, anchor=(0.5 - 0.5 * side, 0.5))


def _draw_predicted(canvas: Canvas, frame: ImageFrame, scene: Scene, robot: int, theme: Theme, ui: float) -> None:
    """Draw where the estimates expect the points: hollow rings, with their 2 sigma regions where these are larger."""
    assert scene.estimate is not None
    colour, radius = theme.robot(robot), 9.0 * ui
    for place in np.flatnonzero(scene.estimate.known[robot]).tolist():
        point, covariance = scene.estimate.points[robot, place], scene.estimate.points_covariance[robot, place]
        if abs(math.remainder(point[0], 2.0 * math.pi)) > 1.5:
            continue
        centre = frame.pixel(geometry.polar_image(point[:1], point[1:2])[0])
        canvas.ring(centre, radius, colour, max(1.25, 1.75 * ui))
        region = geometry.ellipse(point[:2], covariance[:2, :2])
        shape = frame.pixels(geometry.polar_image(np.clip(region[:, 0], -1.5, 1.5), region[:, 1]))
        if np.abs(shape - np.array(centre)).max() > radius:
            canvas.region(shape, colour, 34, mix(colour, theme.floor, 0.35), max(0.75, 1.0 * ui))
