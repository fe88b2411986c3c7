"""The picture of an environment: readings at the left, the world from above, the camera images at the right."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from relloc_env.rendering import geometry
from relloc_env.rendering.camera_view import draw_camera, image_frame
from relloc_env.rendering.canvas import Box, Canvas
from relloc_env.rendering.scene import CameraGeometry, Reading, Scene, robot_colour, robot_name
from relloc_env.rendering.theme import THEMES, mix
from relloc_env.rendering.world_view import MapFrame, draw_ground, draw_world

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pygame import Surface

SMALLEST = (320, 180)
"""[px] least width and height of a picture."""
_COLUMN = 9.0
"""Least width of a column of readings, in letters."""


@dataclass(frozen=True)
class Layout:
    """Where the parts are [px], how large markers are (`ui` = 1 at 960 x 540), and letters [px]."""

    ui: float
    letters: float
    rail: Box
    world: Box
    images: tuple[Box, ...]


def layout(size: tuple[int, int], cameras: "Sequence[CameraGeometry]") -> Layout:
    """Share a picture out: letters and markers not too small, the map as large as the camera images leave it.

    Readings are at the left; those of a robot alone are below its camera's image.
    """
    width, height = size
    unit = min(width / 960.0, height / 540.0)
    letters = max(9.0, 11.5 * unit)
    pad, caption = max(6.0, 12.0 * unit), 1.7 * letters
    tall = height - 2.0 * pad
    alone = len(cameras) == 1
    rail = 0.0 if alone else max(8.6 * letters, 118.0 * unit)
    free = width - rail - (3.0 if alone else 4.0) * pad
    columns = 1 if len(cameras) <= 3 else 2
    rows = math.ceil(len(cameras) / columns)
    aspect = max(camera.width / camera.height for camera in cameras)
    highest = (tall - (rows - 1) * pad - (12.0 * letters if alone else 0.0)) / rows - caption
    column = max(min(highest * aspect, max(free - tall, 0.36 * free) / columns), 0.3 * free / columns)
    right = columns * column + (columns - 1) * pad
    world = (pad if alone else rail + 2.0 * pad, pad, free - right, tall)
    images = []
    for robot, camera in enumerate(cameras):
        fit = min(column, column / aspect * camera.width / camera.height)
        left = width - pad - right + robot % columns * (column + pad)
        top = pad + caption + robot // columns * (column / aspect + caption + pad)
        images.append((left, top, fit, fit * camera.height / camera.width))
    below = images[0][1] + images[0][3] + 1.5 * pad
    readings = (images[0][0], below, column, height - pad - below) if alone else (pad, pad, rail, tall)
    return Layout(max(unit, 0.7), letters, readings, world, tuple(images))


def _height(reading: Reading) -> float:
    """Height of a reading, in letters."""
    return 3.4 if reading.gauge is None else 3.1


def _along(value: float, low: float, high: float) -> float:
    """Where a value lies on a logarithmic strip from a tenth of the band's low end to a hundredfold of its high end."""
    first, last = 0.1 * low, 100.0 * high
    return min(max(math.log(max(value, first) / first) / math.log(last / first), 0.01), 0.99)


class Renderer:
    """Draws scenes, in memory or in a window.

    Args:
        size: [px] width and height of the picture.
        mode: `rgb_array` touches no display; `human` opens a window at the first scene.
        fps: [1/s] greatest rate of pictures in a window; 0 for no limit.
        theme: `light` or `dark`.
    """

    def __init__(
        self,
        size: tuple[int, int] = (960, 540),
        mode: Literal["rgb_array", "human"] = "rgb_array",
        fps: float = 20.0,
        theme: Literal["light", "dark"] = "light",
    ) -> None:
        if size[0] < SMALLEST[0] or size[1] < SMALLEST[1]:
            raise ValueError(f"Argument `size` must be at least {SMALLEST}, but is {size}.")
        if mode not in {"rgb_array", "human"}:
            raise ValueError(f"Argument `mode` must be 'rgb_array' or 'human', but is {mode!r}.")
        if theme not in THEMES:
            raise ValueError(f"Argument `theme` must be one of {sorted(THEMES)}, but is {theme!r}.")
        self.size = size
        self.mode = mode
        self.fps = fps
        self.closed = False
        """Whether the window was closed, by its user or by `close`; scenes drawn after that are not shown."""
        self._theme = THEMES[theme]
        self._band = mix(self._theme.page, self._theme.muted, 0.35)
        self._canvas: Canvas | None = None
        self._ground: tuple[bytes, Surface] | None = None
        self._window: Surface | None = None

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Draw a scene: return it as (height, width, 3) uint8, or show it (`human`) and return None."""
        if self.mode == "human":
            if not self.closed:
                self._show(scene)
            return None
        return self._paint(scene)

    def close(self) -> None:
        """Close the window, if there is one; may be called twice."""
        self.closed = True
        if self._window is not None:
            import pygame

            self._window = None
            pygame.display.quit()

    def _paint(self, scene: Scene) -> NDArray[np.uint8]:
        if self._canvas is None:
            self._canvas = Canvas(self.size)
        canvas, theme = self._canvas, self._theme
        parts = layout(self.size, scene.cameras)
        frame = MapFrame(parts.world, geometry.bounds(scene))
        obstacles = b"" if scene.obstacles is None else scene.obstacles.tobytes()
        key = repr((parts, frame, scene.arena)).encode() + obstacles
        if self._ground is None or self._ground[0] != key:
            canvas.fill(theme.page)
            draw_ground(canvas, frame, scene, theme, parts.ui)
            self._ground = (key, canvas.snapshot())
        canvas.restore(self._ground[1])
        draw_world(canvas, frame, scene, theme, parts.ui, parts.letters)
        for robot, box in enumerate(parts.images):
            self._caption(canvas, parts, scene, robot)
            draw_camera(canvas, image_frame(box, scene, robot), scene, robot, theme, parts.ui)
        self._rail(canvas, parts, scene)
        return canvas.finish()

    def _caption(self, canvas: Canvas, parts: Layout, scene: Scene, robot: int) -> None:
        """Write a camera's robot at the left, and what holds the robot, or how much it sees, at the right."""
        theme, letters = self._theme, parts.letters
        left, top, width, _ = parts.images[robot]
        colour = mix(robot_colour(robot), theme.ink, 0.15)
        y = top - 0.85 * letters
        name = f"camera {robot_name(robot)}"
        canvas.text(name, (left, y), letters, colour, anchor=(0.0, 0.5), bold=True)
        words, shade = f"sees {int(scene.seen[robot].sum())} of {len(scene.points)}", theme.muted
        if scene.blocked is not None and scene.blocked[robot]:
            words, shade = "blocked", theme.ink
        if scene.contact is not None and scene.contact[robot]:
            words, shade = "contact", theme.alarm
        if canvas.width_of(name, letters, bold=True) + canvas.width_of(words, letters) + letters < width:
            canvas.text(words, (left + width, y), letters, shade, anchor=(1.0, 0.5))

    def _rail(self, canvas: Canvas, parts: Layout, scene: Scene) -> None:
        """Write title, time and readings, and what the marks mean where there is room."""
        theme, letters = self._theme, parts.letters
        left, top, width, height = parts.rail
        bottom, y = top + height, top
        with canvas.inside(parts.rail):
            if scene.title:
                canvas.text(scene.title, (left, y), canvas.fitting(scene.title, letters, width), theme.muted)
                y += 1.4 * letters
            canvas.text(f"{scene.time:.1f} s", (left, y), 2.0 * letters, theme.ink, bold=True)
            y += 3.2 * letters
            if width > 26.0 * letters:
                self._legend(canvas, parts, scene, left + width - 10.0 * letters)
                width -= 11.0 * letters
            elif y + (sum(map(_height, scene.readings)) + 6.6) * letters < bottom:
                self._legend(canvas, parts, scene, left)
            if width > 2.0 * _COLUMN * letters:
                width = 0.5 * width - 0.5 * letters
            start, end = y, left + parts.rail[2] - 0.9 * width
            for reading in scene.readings:
                if y + (_height(reading) - 0.8) * letters > bottom:
                    left, y = left + width + letters, start
                if left > end:
                    break
                self._reading(canvas, reading, (left, y, width, letters))
                y += _height(reading) * letters

    def _reading(self, canvas: Canvas, reading: Reading, place: tuple[float, float, float, float]) -> None:
        """Write a number below its label; one with a band beside it, above the strip. `place`: x, y, width, letters."""
        theme, (left, y, width, letters) = self._theme, place
        indent = 0.0
        if reading.robot >= 0:
            indent = 0.9 * letters
            canvas.disc((left + 0.35 * letters, y + 0.65 * letters), 0.35 * letters, robot_colour(reading.robot))
        if reading.gauge is None:
            size = canvas.fitting(reading.label, letters, width - indent)
            canvas.text(reading.label, (left + indent, y), size, theme.muted)
            size = canvas.fitting(reading.value, 1.25 * letters, width, bold=True)
            canvas.text(reading.value, (left, y + 1.25 * letters), size, theme.ink, bold=True)
            return
        number, low, high = reading.gauge
        shade = theme.alarm if number > high else theme.ink
        room = width - indent - canvas.width_of(reading.value, letters, bold=True) - 0.4 * letters
        size = canvas.fitting(reading.label, letters, room)
        canvas.text(reading.label, (left + indent, y), size, theme.muted)
        canvas.text(reading.value, (left + width, y), letters, shade, anchor=(1.0, 0.0), bold=True)
        if math.isnan(number):
            return
        line, tall = y + 1.75 * letters, 0.5 * letters
        ends = [left + width * _along(value, low, high) for value in (low, high)]
        canvas.rectangle((ends[0], line - 0.5 * tall, ends[1] - ends[0], tall), self._band)
        canvas.line((left, line), (left + width, line), mix(theme.page, theme.edge, 0.6), 1.0)
        x, mark = left + width * _along(number, low, high), max(2.0, 0.2 * letters)
        canvas.rectangle((x - 0.5 * mark, line - 0.6 * letters, mark, 1.2 * letters), shade)

    def _legend(self, canvas: Canvas, parts: Layout, scene: Scene, left: float) -> None:
        """Say what the marks mean, at the foot of the readings."""
        theme, ui, letters = self._theme, parts.ui, parts.letters
        rows = ["true", "estimate, 2σ", "measured"]
        if any(reading.gauge is not None for reading in scene.readings):
            rows.append("95 % when right")
        top = parts.rail[1] + parts.rail[3] - 1.6 * len(rows) * letters
        centres = [(left + 7.0 * ui, top + (1.6 * row + 0.8) * letters) for row in range(len(rows))]
        canvas.disc(centres[0], 5.0 * ui, theme.muted)
        canvas.ring(centres[1], 6.5 * ui, theme.muted, max(1.25, 1.75 * ui))
        x, y = centres[2]
        canvas.line((x - 6.0 * ui, y), (x + 6.0 * ui, y), theme.muted, max(1.0, 1.25 * ui))
        canvas.line((x, y - 6.0 * ui), (x, y + 6.0 * ui), theme.muted, max(1.0, 1.25 * ui))
        for x, y in centres[3:]:
            wide, tall = 12.0 * ui, 0.5 * letters
            canvas.rectangle((x - 0.5 * wide, y - 0.5 * tall, wide, tall), self._band)
        for words, (x, y) in zip(rows, centres, strict=True):
            canvas.text(words, (x + 11.0 * ui, y), letters, theme.muted, anchor=(0.0, 0.5))

    def _show(self, scene: Scene) -> None:
        import pygame

        if self._window is None:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode(self.size)
            except pygame.error as error:
                raise RuntimeError(f"Mode 'human' needs a display to open a window on: {error}.") from error
            pygame.display.set_caption("relloc_env")
            self._clock = pygame.time.Clock()
        for event in pygame.event.get():
            if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
                self.close()
                return
        self._paint(scene)
        assert self._canvas is not None
        self._window.blit(self._canvas.surface, (0, 0))
        pygame.display.flip()
        if self.fps > 0.0:
            self._clock.tick(self.fps)
