"""The world from above: floor, views, trails, robots, targets, and what the robots believe."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relloc_env.rendering import geometry
from relloc_env.rendering.canvas import Box, Canvas
from relloc_env.rendering.scene import Scene, robot_name
from relloc_env.rendering.theme import Colour, Theme, mix
from relloc_env.samples import Float, ordered_pairs

_TRAIL_CORNERS = 400
_TRAIL_SHADES = 5
_NOSE = 1.6
_RIM = np.linspace(math.acos(1.0 / _NOSE), 2.0 * np.pi - math.acos(1.0 / _NOSE), 40)
_ROBOT = np.concatenate([[[_NOSE, 0.0]], np.stack([np.cos(_RIM), np.sin(_RIM)], axis=1)])
"""Outline of a robot of radius 1 that looks along x."""


@dataclass(frozen=True)
class MapFrame:
    """Where the world is on the picture: whole scene in a box, y upwards, one scale.

    Args:
        box: [px] where to draw.
        bounds: [m] x_min, x_max, y_min, y_max that must be visible.
    """

    box: Box
    bounds: tuple[float, float, float, float]

    @cached_property
    def scale(self) -> float:
        """Pixels per metre."""
        x_min, x_max, y_min, y_max = self.bounds
        return min(self.box[2] / (x_max - x_min), self.box[3] / (y_max - y_min))

    @cached_property
    def reach(self) -> float:
        """A length [m] from any visible place to beyond the edge of the map."""
        return math.hypot(self.box[2], self.box[3]) / self.scale

    @cached_property
    def _origin(self) -> Float:
        """Pixels of the world's origin."""
        x_min, x_max, y_min, y_max = self.bounds
        left, top, width, height = self.box
        middle = np.array([x_min + x_max, -y_min - y_max])
        return np.array([left + 0.5 * width, top + 0.5 * height]) - 0.5 * self.scale * middle

    def pixels(self, places: Float) -> Float:
        """Return (T, 2) [px] of (T, 2) [m] places."""
        placed: Float = self._origin + places * np.array([self.scale, -self.scale])
        return placed

    def pixel(self, place: Float) -> tuple[float, float]:
        """Return x, y [px] of one place."""
        x, y = self.pixels(place[None, :2])[0].tolist()
        return x, y


def draw_ground(canvas: Canvas, frame: MapFrame, scene: Scene, theme: Theme, ui: float) -> None:
    """Draw what does not move: floor, grid, walls, obstacles, scale bar without its letters."""
    with canvas.inside(frame.box):
        canvas.rectangle(frame.box, theme.outside if scene.arena is not None else theme.floor)
        if scene.arena is not None:
            x_min, x_max, y_min, y_max = scene.arena
            left, top = frame.pixel(np.array([x_min, y_max]))
            right, bottom = frame.pixel(np.array([x_max, y_min]))
            canvas.rectangle((left, top, right - left, bottom - top), theme.floor)
        _draw_grid(canvas, frame, scene, theme)
        if scene.arena is not None:
            wall = max(1.5, 2.0 * ui)
            canvas.rectangle(
                (left - wall, top - wall, right - left + 2 * wall, bottom - top + 2 * wall), theme.edge, wall
            )
        for obstacle in scene.obstacles if scene.obstacles is not None else ():
            if obstacle[0] == 0:
                centre, radius = frame.pixel(obstacle[1:3]), obstacle[3] * frame.scale
                canvas.disc(centre, radius, theme.obstacle)
                canvas.ring(centre, radius, theme.obstacle_edge, 1.5)
            else:
                corners = frame.pixels(geometry.box_corners(obstacle))
                canvas.polygon(corners, theme.obstacle)
                canvas.outline(corners, theme.obstacle_edge, 1.5)
        start, end, y, _ = scale_bar(frame, ui)
        canvas.line((start, y), (end, y), theme.ink, max(1.5, 2.0 * ui))
        for x in (start, end):
            canvas.line((x, y - 3.0 * ui), (x, y + 3.0 * ui), theme.ink, max(1.5, 2.0 * ui))
    canvas.rectangle(frame.box, theme.edge if scene.arena is None else theme.outside, 1.0)


def scale_bar(frame: MapFrame, ui: float) -> tuple[float, float, float, str]:
    """Left end, right end, height [px] and words of the scale bar: the length nearest to a sixth of the map."""
    wanted = frame.box[2] / frame.scale / 6.0
    length = min((0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100), key=lambda metres: abs(math.log(metres / wanted)))
    start = frame.box[0] + 20.0 * ui
    return start, start + length * frame.scale, frame.box[1] + frame.box[3] - 20.0 * ui, f"{length:g} m"


def draw_world(canvas: Canvas, frame: MapFrame, scene: Scene, theme: Theme, ui: float, letters: float) -> None:
    """Draw what moves, above the ground: regions first, then the truth, then the estimates."""
    with canvas.inside(frame.box):
        for robot in range(len(scene.poses)):
            if scene.cameras[robot].limited:
                _draw_view(canvas, frame, scene, robot, theme, ui)
        for robot, trail in enumerate(scene.trails):
            _draw_trail(canvas, frame, trail, theme.robot(robot), theme.floor, ui)
        if scene.estimate is not None:
            _draw_regions(canvas, frame, scene, theme, ui)
        for place, colour in zip(scene.points, scene.colours.tolist(), strict=True):
            _draw_target(canvas, frame.pixel(place), (colour[0], colour[1], colour[2]), theme, ui)
        for robot in range(len(scene.poses)):
            _draw_robot(canvas, frame, scene, robot, theme, ui)
        if scene.estimate is not None:
            _draw_believed(canvas, frame, scene, theme, ui)
        for number, place in enumerate(scene.points, 1):
            x, y = frame.pixel(place)
            canvas.text(str(number), (x + 9.0 * ui, y - 9.0 * ui), 0.9 * letters, theme.muted, anchor=(0.0, 0.5))
        start, _, y, words = scale_bar(frame, ui)
        canvas.text(words, (start, y - 4.0 * ui), letters, theme.ink, anchor=(0.0, 1.0))


def _draw_grid(canvas: Canvas, frame: MapFrame, scene: Scene, theme: Theme) -> None:
    reach = frame.reach
    x_min, x_max, y_min, y_max = scene.arena or (-math.inf, math.inf, -math.inf, math.inf)
    centre_x, centre_y = 0.5 * (frame.bounds[0] + frame.bounds[1]), 0.5 * (frame.bounds[2] + frame.bounds[3])
    x_min, x_max = max(x_min, centre_x - reach), min(x_max, centre_x + reach)
    y_min, y_max = max(y_min, centre_y - reach), min(y_max, centre_y + reach)
    step = next((metres for metres in (1, 5, 10, 50) if metres * frame.scale >= 10.0), 100)
    for k in range(math.ceil(x_min / step), math.floor(x_max / step) + 1):
        ends = frame.pixels(np.array([[k * step, y_min], [k * step, y_max]])).tolist()
        canvas.line(ends[0], ends[1], theme.grid, 1.0)
    for k in range(math.ceil(y_min / step), math.floor(y_max / step) + 1):
        ends = frame.pixels(np.array([[x_min, k * step], [x_max, k * step]])).tolist()
        canvas.line(ends[0], ends[1], theme.grid, 1.0)


def _draw_view(canvas: Canvas, frame: MapFrame, scene: Scene, robot: int, theme: Theme, ui: float) -> None:
    shape = frame.pixels(geometry.view(scene, robot, frame.reach))
    canvas.region(shape, theme.robot(robot), 16, mix(theme.robot(robot), theme.floor, 0.7), max(0.5, 0.5 * ui))


def _draw_trail(canvas: Canvas, frame: MapFrame, trail: Float, colour: Colour, floor: Colour, ui: float) -> None:
    """Older parts are paler. Long trails are thinned at places that do not change as they grow."""
    if len(trail) < 2:
        return
    stride = 1
    while len(trail) / stride > _TRAIL_CORNERS:
        stride *= 2
    line = frame.pixels(np.concatenate([trail[::stride, :2], trail[-1:, :2]]))
    cuts = np.linspace(0, len(line) - 1, _TRAIL_SHADES + 1).astype(int)
    for shade in range(_TRAIL_SHADES):
        part = line[cuts[shade] : cuts[shade + 1] + 1]
        canvas.path(part, mix(floor, colour, 0.25 + 0.4 * (shade + 1) / _TRAIL_SHADES), max(1.0, 1.5 * ui))


def _draw_target(canvas: Canvas, place: tuple[float, float], colour: Colour, theme: Theme, ui: float) -> None:
    canvas.disc(place, 6.5 * ui, theme.floor)
    canvas.disc(place, 5.5 * ui, mix(colour, theme.ink, 0.45))
    canvas.disc(place, 4.5 * ui, colour)


def _outline_of_robot(centre: tuple[float, float], heading: float, radius: float) -> Float:
    """(T, 2) [px] corners of a disc with a nose that points along the heading."""
    cos, sin = math.cos(heading), math.sin(heading)
    corners: Float = np.array(centre) + _ROBOT @ np.array([[radius * cos, -radius * sin], [radius * sin, radius * cos]])
    return corners


def _size_of_robot(frame: MapFrame, scene: Scene, ui: float) -> float:
    return max(scene.robot_radius * frame.scale, 7.0 * ui, 6.5)


def _draw_robot(canvas: Canvas, frame: MapFrame, scene: Scene, robot: int, theme: Theme, ui: float) -> None:
    pose, colour = scene.poses[robot], theme.robot(robot)
    centre, radius = frame.pixel(pose), _size_of_robot(frame, scene, ui)
    if scene.contact is not None and scene.contact[robot]:
        canvas.ring(centre, radius + 7.0 * ui, theme.alarm, 2.5 * ui)
    if scene.blocked is not None and scene.blocked[robot]:
        ahead = np.array([math.cos(pose[2]), -math.sin(pose[2])])
        middle = np.array(centre) + (_NOSE * radius + 5.0 * ui) * ahead
        across = radius * np.array([-ahead[1], ahead[0]])
        canvas.line((middle - across).tolist(), (middle + across).tolist(), theme.ink, 3.0 * ui)
    canvas.polygon(_outline_of_robot(centre, pose[2], radius + 1.5 * ui), theme.floor)
    canvas.polygon(_outline_of_robot(centre, pose[2], radius), colour)
    if radius >= 6.5:
        canvas.text(robot_name(robot), centre, max(1.2 * radius, 8.0), theme.on_robot, anchor=(0.5, 0.5), bold=True)


def _draw_regions(canvas: Canvas, frame: MapFrame, scene: Scene, theme: Theme, ui: float) -> None:
    """Draw the 2 sigma regions of points and of the other robot, and the wedge of its heading."""
    assert scene.estimate is not None
    believed, line = scene.estimate, max(0.75, 1.0 * ui)
    for robot, pose in enumerate(scene.poses):
        colour = theme.robot(robot)
        for point in np.flatnonzero(believed.known[robot]):
            region = geometry.polar_region(
                believed.points[robot, point], believed.points_covariance[robot, point], 2.0 * frame.reach
            )
            shape = frame.pixels(geometry.to_world(pose, region))
            canvas.region(shape, colour, 34, mix(colour, theme.floor, 0.35), line)
    for pair, (robot, _) in enumerate(ordered_pairs(len(scene.poses))):
        pose, colour = scene.poses[robot], theme.robot(int(robot))
        mean, covariance = believed.pose[pair], believed.pose_covariance[pair]
        shape = frame.pixels(geometry.to_world(pose, geometry.ellipse(mean[:2], covariance[:2, :2])))
        canvas.region(shape, colour, 34, mix(colour, theme.floor, 0.35), line)
        spread = min(geometry.SIGMAS * math.sqrt(max(float(np.nan_to_num(covariance[2, 2])), 0.0)), math.pi)
        centre = frame.pixel(geometry.to_world(pose, mean[None, :2])[0])
        turn = -(pose[2] + mean[2] + np.linspace(-spread, spread, 32))
        arc = np.array(centre) + 2.8 * _size_of_robot(frame, scene, ui) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        canvas.region(np.concatenate([np.array(centre)[None], arc]), colour, 70)


def _draw_believed(canvas: Canvas, frame: MapFrame, scene: Scene, theme: Theme, ui: float) -> None:
    """Draw hollow rings for estimated points, with a dot of the target's colour, and the other robot's outline."""
    assert scene.estimate is not None
    believed, width = scene.estimate, max(1.25, 1.75 * ui)
    for robot, pose in enumerate(scene.poses):
        for point in np.flatnonzero(believed.known[robot]):
            place = geometry.polar_place(believed.points[robot, point])
            centre = frame.pixel(geometry.to_world(pose, place[None])[0])
            canvas.ring(centre, 7.5 * ui, theme.robot(robot), width)
            red, green, blue = scene.colours[point].tolist()
            canvas.disc(centre, 3.0 * ui, (red, green, blue))
    for pair, (robot, other) in enumerate(ordered_pairs(len(scene.poses))):
        pose, mean, colour = scene.poses[robot], believed.pose[pair], theme.robot(int(robot))
        centre, radius = frame.pixel(geometry.to_world(pose, mean[None, :2])[0]), _size_of_robot(frame, scene, ui)
        canvas.outline(_outline_of_robot(centre, pose[2] + mean[2], radius), colour, width)
        if radius >= 6.5 and math.dist(centre, frame.pixel(scene.poses[other])) > 1.5 * radius:
            letters, shade = max(1.1 * radius, 8.0), mix(colour, theme.ink, 0.2)
            canvas.text(robot_name(int(other)), centre, letters, shade, anchor=(0.5, 0.5))
