"""A surface to draw on in fractions of a pixel: drawn at twice its size, made smooth by scaling down, then lettered."""

import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from relloc_env.extras import extra
from relloc_env.rendering.theme import Colour
from relloc_env.samples import Float

if TYPE_CHECKING:
    from pygame import Surface
    from pygame.font import Font

_FINE = 2
_MASKS = (0xFF, 0xFF00, 0xFF0000, 0)
_MASKS_ALPHA = (0xFF, 0xFF00, 0xFF0000, 0xFF000000)
_LETTERINGS_KEPT = 512
_AWAY = 20000.0
"""[px] beyond any picture, and still small enough for the drawing library's integers."""
_SMALL = 60000.0
"""Area below which a translucent shape is quicker drawn pixel by pixel than through a second surface."""

Made = TypeVar("Made")
Box = tuple[float, float, float, float]
"""[px] left, top, width, height."""


def font_file(name: str) -> str | None:
    """Path of a DejaVu font as matplotlib ships it (found, not imported), or None: pygame's own font then."""
    found = importlib.util.find_spec("matplotlib")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf" / f"{name}.ttf"
    return str(path) if path.is_file() else None


class Canvas:
    """Draws into memory; touches no display.

    Args:
        size: [px] width and height of the finished picture.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        with extra("render"):
            import pygame
            import pygame.gfxdraw

        self._pygame, self._gfxdraw = pygame, pygame.gfxdraw
        pygame.font.init()
        self.size = size
        self._fine = pygame.Surface((size[0] * _FINE, size[1] * _FINE), 0, 32, _MASKS)
        self._scratch = pygame.Surface(self._fine.get_size(), pygame.SRCALPHA, 32, _MASKS_ALPHA)
        self.surface = pygame.Surface(size, 0, 32, _MASKS)
        self._clip = (0.0, 0.0, float(size[0]), float(size[1]))
        self._queue: list[tuple[Surface, tuple[int, int], Box]] = []
        self._letterings: dict[tuple[str, float, Colour, bool], Surface] = {}
        self._widths: dict[tuple[str, int, bool], int] = {}
        self._fonts: dict[tuple[int, bool], Font] = {}
        self._clock = pygame.time.Clock()

    def wait(self, rate: float) -> None:
        """Wait until the next picture is due [1/s]."""
        self._clock.tick(rate)

    def fill(self, colour: Colour) -> None:
        """Start a picture: one colour everywhere."""
        self._fine.fill(colour)
        self._queue.clear()

    def snapshot(self) -> "Surface":
        """Return a copy of what is drawn so far, without letters, for `restore`."""
        return self._fine.copy()

    def restore(self, drawn: "Surface") -> None:
        """Start a picture from a `snapshot`."""
        self._fine.blit(drawn, (0, 0))
        self._queue.clear()

    @contextmanager
    def inside(self, box: Box) -> Iterator[None]:
        """Keep what is drawn meanwhile inside a box."""
        before = self._clip
        self._clip = box
        left, top, width, height = (round(v * _FINE) for v in box)
        self._fine.set_clip((left, top, width, height))
        try:
            yield
        finally:
            self._clip = before
            left, top, width, height = (round(v * _FINE) for v in before)
            self._fine.set_clip((left, top, width, height))

    def rectangle(self, box: Box, colour: Colour, width: float = 0.0) -> None:
        """Fill a box, or draw its frame inside it."""
        left, top, right, bottom = (round(v * _FINE) for v in (box[0], box[1], box[0] + box[2], box[1] + box[3]))
        thick = max(1, round(width * _FINE)) if width else 0
        self._pygame.draw.rect(self._fine, colour, (left, top, right - left, bottom - top), thick)

    def picture(self, box: Box, pixels: NDArray[np.uint8]) -> None:
        """Fill a box with a picture (height, width, 3), stretched."""
        left, top, right, bottom = (round(v * _FINE) for v in (box[0], box[1], box[0] + box[2], box[1] + box[3]))
        taken = self._pygame.image.frombuffer(pixels.tobytes(), pixels.shape[1::-1], "RGB")
        self._fine.blit(self._pygame.transform.smoothscale(taken, (right - left, bottom - top)), (left, top))

    def polygon(self, corners: Float, colour: Colour) -> None:
        """Fill a polygon of (T, 2) corners."""
        shape = self._fit(corners)
        if len(shape) > 2:
            self._pygame.draw.polygon(self._fine, colour, shape.tolist())

    def region(
        self, corners: Float, colour: Colour, alpha: int, edge: Colour | None = None, width: float = 1.0
    ) -> None:
        """Fill a polygon of (T, 2) corners with a translucent colour (alpha of 255), and draw its edge."""
        shape = self._fit(corners)
        if len(shape) < 3:
            return
        x, y = shape[:, 0], shape[:, 1]
        twice = float(x[1:] @ y[:-1] - y[1:] @ x[:-1] + x[0] * y[-1] - y[0] * x[-1])
        if abs(twice) < 2.0 * _SMALL:
            self._gfxdraw.filled_polygon(self._fine, np.rint(shape).astype(int).tolist(), (*colour, alpha))
        else:
            low = np.floor(shape.min(axis=0)).astype(int)
            size = np.ceil(shape.max(axis=0)).astype(int) - low + 1
            area = (0, 0, min(int(size[0]), self._scratch.get_width()), min(int(size[1]), self._scratch.get_height()))
            self._scratch.fill((*colour, 0), area)
            self._pygame.draw.polygon(self._scratch, (*colour, alpha), (shape - low).tolist())
            self._fine.blit(self._scratch, low.tolist(), area)
        if edge is not None:
            self._pygame.draw.lines(self._fine, edge, True, shape.tolist(), max(1, round(width * _FINE)))

    def outline(self, corners: Float, colour: Colour, width: float) -> None:
        """Draw the closed line through (T, 2) corners."""
        shape = self._fit(corners)
        if len(shape) > 1:
            self._pygame.draw.lines(self._fine, colour, True, shape.tolist(), max(1, round(width * _FINE)))

    def path(self, points: Float, colour: Colour, width: float) -> None:
        """Draw the open line through (T, 2) points."""
        if len(points) > 1:
            near = np.clip(points * _FINE, -_AWAY, _AWAY)
            self._pygame.draw.lines(self._fine, colour, False, near.tolist(), max(1, round(width * _FINE)))

    def line(self, start: Sequence[float], end: Sequence[float], colour: Colour, width: float) -> None:
        """Draw a straight line."""
        one, two = (start[0] * _FINE, start[1] * _FINE), (end[0] * _FINE, end[1] * _FINE)
        if self._near(start, _AWAY) and self._near(end, _AWAY):
            self._pygame.draw.line(self._fine, colour, one, two, max(1, round(width * _FINE)))

    def hairlines(self, start: Float, end: Float, colour: Colour) -> None:
        """Draw many thin lines from (T, 2) to (T, 2) points."""
        one, two = np.clip(start * _FINE, -_AWAY, _AWAY).tolist(), np.clip(end * _FINE, -_AWAY, _AWAY).tolist()
        for begin, finish in zip(one, two, strict=True):
            self._pygame.draw.line(self._fine, colour, begin, finish)

    def disc(self, centre: Sequence[float], radius: float, colour: Colour) -> None:
        """Fill a disc."""
        if self._near(centre, radius):
            place = (round(centre[0] * _FINE), round(centre[1] * _FINE))
            self._pygame.draw.aacircle(self._fine, colour, place, max(1, round(radius * _FINE)))

    def ring(self, centre: Sequence[float], radius: float, colour: Colour, width: float) -> None:
        """Draw a circle whose line lies inside `radius`."""
        if self._near(centre, radius):
            place = (round(centre[0] * _FINE), round(centre[1] * _FINE))
            thick = max(1, round(width * _FINE))
            self._pygame.draw.aacircle(self._fine, colour, place, max(1, round(radius * _FINE)), thick)

    def text(
        self,
        words: str,
        place: Sequence[float],
        size: float,
        colour: Colour,
        *,
        anchor: tuple[float, float] = (0.0, 0.0),
        bold: bool = False,
    ) -> None:
        """Write words, above everything drawn; `anchor` is the point of the text's box (0 to 1) put at `place`."""
        if not (self._near(place, 0.0) and words):
            return
        lettering = self._lettering(words, size, colour, bold)
        left = round(place[0] - anchor[0] * lettering.get_width())
        top = round(place[1] - anchor[1] * lettering.get_height())
        self._queue.append((lettering, (left, top), self._clip))

    def cover(self, box: Box) -> None:
        """Drop the words written so far that start inside a box."""
        left, top, right, bottom = box[0], box[1], box[0] + box[2], box[1] + box[3]
        self._queue = [line for line in self._queue if not (left <= line[1][0] < right and top <= line[1][1] < bottom)]

    def width_of(self, words: str, size: float, *, bold: bool = False) -> int:
        """Width [px] of words."""
        key = (words, round(size), bold)
        if key not in self._widths:
            if len(self._widths) >= _LETTERINGS_KEPT:
                self._widths.clear()
            self._widths[key] = self._with_font(size, bold, lambda font: font.size(words)[0])
        return self._widths[key]

    def fitting(self, words: str, size: float, width: float, *, bold: bool = False) -> float:
        """Return the greatest letter size, at most `size` and at least 8 px, at which words fit into a width [px]."""
        while size > 8.0 and self.width_of(words, size, bold=bold) > width:
            size -= 1.0
        return size

    def finish(self) -> NDArray[np.uint8]:
        """Return the picture, (height, width, 3) red, green, blue; `surface` holds it as well."""
        self._pygame.transform.smoothscale(self._fine, self.size, self.surface)
        for lettering, place, box in self._queue:
            left, top, right, bottom = (round(v) for v in (box[0], box[1], box[0] + box[2], box[1] + box[3]))
            self.surface.set_clip((left, top, right - left, bottom - top))
            self.surface.blit(lettering, place)
        self.surface.set_clip(None)
        width, height = self.size
        pixels = np.frombuffer(self.surface.get_view("0"), np.uint8).reshape(height, width, 4)  # type: ignore[call-overload]
        picture = np.empty((height, width, 3), np.uint8)
        for channel in range(3):
            picture[:, :, channel] = pixels[:, :, channel]
        return picture

    def _with_font(self, size: float, bold: bool, use: "Callable[[Font], Made]") -> "Made":
        """Use a font. Where somebody stopped pygame's fonts since, they are started and opened anew."""
        try:
            return use(self._font(size, bold))
        except self._pygame.error:
            self._fonts.clear()
            self._pygame.font.init()
            return use(self._font(size, bold))

    def _font(self, size: float, bold: bool) -> "Font":
        key = (round(size), bold)
        if key not in self._fonts:
            path = font_file("DejaVuSans-Bold" if bold else "DejaVuSans")
            self._fonts[key] = self._pygame.font.Font(path, key[0] if path else round(1.15 * key[0]))
        return self._fonts[key]

    def _lettering(self, words: str, size: float, colour: Colour, bold: bool) -> "Surface":
        key = (words, size, colour, bold)
        if key not in self._letterings:
            if len(self._letterings) >= _LETTERINGS_KEPT:
                self._letterings.clear()
            self._letterings[key] = self._with_font(size, bold, lambda font: font.render(words, True, colour))
        return self._letterings[key]

    def _near(self, place: Sequence[float], reach: float) -> bool:
        left, top, width, height = self._clip
        return bool(
            left - reach <= place[0] <= left + width + reach and top - reach <= place[1] <= top + height + reach
        )

    def _fit(self, corners: Float) -> Float:
        """Corners in fine pixels, cut to just outside the clip box where they leave it."""
        left, top, width, height = self._clip
        low = np.array([left - 8.0, top - 8.0])
        high = np.array([left + width + 8.0, top + height + 8.0])
        if (corners < low).any() or (corners > high).any():
            corners = cut(corners, low, high)
        return corners * _FINE


def cut(corners: Float, low: Float, high: Float) -> Float:
    """Return the part of a polygon inside an upright box (Sutherland and Hodgman, Comm. ACM 17(1), 1974)."""
    for axis in (0, 1):
        for bound, sign in ((low[axis], 1.0), (high[axis], -1.0)):
            depth = sign * (corners[:, axis] - bound)
            inside = depth >= 0.0
            if inside.all():
                continue
            before = np.arange(-1, len(corners) - 1)
            crossing = inside != inside[before]
            both = np.zeros((len(corners), 2, 2))
            share = depth[before][crossing] / (depth[before] - depth)[crossing]
            start = corners[before][crossing]
            both[crossing, 0] = start + share[:, None] * (corners[crossing] - start)
            both[:, 1] = corners
            corners = both[np.stack([crossing, inside], axis=1)]
    return corners
