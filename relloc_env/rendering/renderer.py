"""The picture of an environment: the world from above, the cameras' images, and numbers over time."""

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from relloc_env.rendering import geometry
from relloc_env.rendering.camera_view import draw_camera, image_frame
from relloc_env.rendering.canvas import Canvas
from relloc_env.rendering.layout import Layout, layout
from relloc_env.rendering.scene import Scene, robot_name
from relloc_env.rendering.strip_view import band_colour, bound_colour, draw_clock, draw_frame, draw_strip
from relloc_env.rendering.theme import THEMES, mix
from relloc_env.rendering.window import NoDisplayError, Window
from relloc_env.rendering.world_view import MapFrame, draw_ground, draw_world

if TYPE_CHECKING:
    from pygame import Surface

SMALLEST = (320, 180)
"""[px] least width and height of a picture."""


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
        self.lost = False
        """Whether it was closed by somebody else in this process, who stopped pygame."""
        self._theme = THEMES[theme]
        self._canvas: Canvas | None = None
        self._ground: tuple[bytes, Surface] | None = None
        self._window: Window | None = None

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
            self._window.close()
            self._window = None

    def _paint(self, scene: Scene) -> NDArray[np.uint8]:
        if self._canvas is None:
            self._canvas = Canvas(self.size)
        canvas, theme = self._canvas, self._theme
        parts = layout(self.size, scene.cameras, len(scene.strips))
        ui, letters = parts.ui, parts.letters
        frame = MapFrame(parts.world, geometry.bounds(scene))
        obstacles = b"" if scene.obstacles is None else scene.obstacles.tobytes()
        axes = [(strip.span, strip.band) for strip in scene.strips]
        key = repr((parts, frame, scene.arena, axes)).encode() + obstacles
        if self._ground is None or self._ground[0] != key:
            canvas.fill(theme.page)
            draw_ground(canvas, frame, scene, theme, ui)
            for box, strip in zip(parts.strips, scene.strips, strict=True):
                draw_frame(canvas, box, strip, theme, letters)
            self._ground = (key, canvas.snapshot())
        canvas.restore(self._ground[1])
        draw_world(canvas, frame, scene, theme, ui, letters)
        for robot, box in enumerate(parts.images):
            self._caption(canvas, parts, scene, robot)
            draw_camera(canvas, image_frame(box, scene, robot), scene, robot, theme, ui, letters)
        for box, strip in zip(parts.strips, scene.strips, strict=True):
            draw_strip(canvas, box, strip, scene, theme, ui, letters)
        if parts.strips:
            draw_clock(canvas, parts.strips[-1], scene, theme, letters)
        self._header(canvas, parts, scene)
        self._notes(canvas, parts, scene)
        return canvas.finish()

    def _caption(self, canvas: Canvas, parts: Layout, scene: Scene, robot: int) -> None:
        """Write a camera's robot at the left, and what holds the robot, or how much it sees, at the right."""
        theme, letters = self._theme, parts.letters
        left, top, width, _ = parts.images[robot]
        colour = mix(theme.robot(robot), theme.ink, 0.15)
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

    def _header(self, canvas: Canvas, parts: Layout, scene: Scene) -> None:
        """Write the time and the title, and what the marks mean where there is room."""
        theme, letters = self._theme, parts.letters
        left, top, width, _ = parts.header
        y, end = top + 0.8 * letters, left + width
        time = f"{scene.time:.1f} s"
        canvas.text(time, (left, y), 1.6 * letters, theme.ink, anchor=(0.0, 0.5), bold=True)
        left += canvas.width_of("000.0 s", 1.6 * letters, bold=True) + letters
        if scene.title:
            size = canvas.fitting(scene.title, 1.15 * letters, end - left, bold=True)
            canvas.text(scene.title, (left, y), size, theme.ink, anchor=(0.0, 0.5), bold=True)
            left += canvas.width_of(scene.title, size, bold=True) + letters
        self._legend(canvas, parts, scene, (left, end, y))

    def _legend(self, canvas: Canvas, parts: Layout, scene: Scene, place: tuple[float, float, float]) -> None:
        """Say what the marks mean, from the right as far as there is room. `place`: left and right end, middle."""
        theme, ui, letters = self._theme, parts.ui, 0.95 * parts.letters
        left, right, y = place
        marks = ["true", "estimate, 2σ", "measured"]
        marks += ["bound"] if any(strip.bound is not None for strip in scene.strips) else []
        marks += ["95 % if honest"] if any(strip.band is not None for strip in scene.strips) else []
        sign, gap = 15.0 * ui, 0.9 * letters
        while marks and sum(canvas.width_of(words, letters) + sign + gap for words in marks) - gap > right - left:
            marks.pop()
        x = right
        for words in reversed(marks):
            x -= canvas.width_of(words, letters)
            canvas.text(words, (x, y), letters, theme.muted, anchor=(0.0, 0.5))
            at, arm = x - 0.5 * sign - 1.0, 5.5 * ui
            if words == "true":
                canvas.disc((at, y), 4.5 * ui, theme.muted)
            elif words.startswith("estimate"):
                canvas.ring((at, y), 5.5 * ui, theme.muted, max(1.25, 1.75 * ui))
            elif words == "measured":
                canvas.line((at - arm, y), (at + arm, y), theme.muted, max(1.0, 1.25 * ui))
                canvas.line((at, y - arm), (at, y + arm), theme.muted, max(1.0, 1.25 * ui))
            elif words == "bound":
                canvas.line((at - arm, y), (at + arm, y), bound_colour(theme), max(1.0, 1.25 * ui))
            else:
                canvas.rectangle((at - arm, y - 0.4 * letters, 2.0 * arm, 0.8 * letters), band_colour(theme))
            x -= sign + gap

    def _notes(self, canvas: Canvas, parts: Layout, scene: Scene) -> None:
        """Write the notes in a panel at the upper left of the map."""
        if not scene.notes:
            return
        theme, letters = self._theme, parts.letters
        left, top, width, height = parts.world
        lines = scene.notes[: max(1, int(height / (1.5 * letters)) - 1)]
        keys = max(canvas.width_of(key, letters, bold=True) for key, _ in lines) + letters
        wide = min(keys + max(canvas.width_of(words, letters) for _, words in lines) + letters, width)
        box = (left, top, wide, (1.5 * len(lines) + 0.5) * letters)
        canvas.rectangle(box, theme.page)
        canvas.rectangle(box, theme.grid, 1.0)
        canvas.cover(box)
        with canvas.inside(box):
            for k, (key, words) in enumerate(lines):
                y = top + (1.5 * k + 1.0) * letters
                canvas.text(key, (left + 0.5 * letters, y), letters, theme.ink, anchor=(0.0, 0.5), bold=True)
                canvas.text(words, (left + 0.5 * letters + keys, y), letters, theme.muted, anchor=(0.0, 0.5))

    def _show(self, scene: Scene) -> None:
        if self._window is None:
            try:
                self._window = Window(self.size)
            except NoDisplayError as error:
                raise NoDisplayError(f"Mode 'human' needs a display to open a window on: {error}") from error
        self._paint(scene)
        assert self._canvas is not None
        self._window.show(self._canvas.surface)
        self.closed, self.lost = self._window.closed, self._window.lost
        if self.fps > 0.0 and not self.closed:
            self._canvas.wait(self.fps)
