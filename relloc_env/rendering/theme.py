"""The visual language: what each thing looks like. Colours of robots and targets are in `scene`."""

from dataclasses import dataclass
from functools import lru_cache

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Theme:
    """Colours of everything that is neither a robot nor a target."""

    page: Colour
    """Behind everything."""
    outside: Colour
    """Map outside the walls; the sky of a camera image."""
    floor: Colour
    """Map inside the walls; the floor of a camera image."""
    grid: Colour
    """Lines every metre."""
    edge: Colour
    """Frames and walls."""
    obstacle: Colour
    obstacle_edge: Colour
    ink: Colour
    """Numbers and measured points."""
    muted: Colour
    """Labels."""
    alarm: Colour
    """Contact."""


LIGHT = Theme(
    page=(250, 250, 248),
    outside=(233, 234, 232),
    floor=(255, 255, 255),
    grid=(236, 237, 236),
    edge=(120, 124, 128),
    obstacle=(203, 206, 208),
    obstacle_edge=(160, 164, 168),
    ink=(32, 36, 40),
    muted=(112, 117, 122),
    alarm=(204, 30, 30),
)
DARK = Theme(
    page=(22, 25, 29),
    outside=(28, 32, 37),
    floor=(36, 41, 47),
    grid=(48, 54, 61),
    edge=(120, 128, 136),
    obstacle=(74, 82, 91),
    obstacle_edge=(104, 113, 122),
    ink=(236, 238, 240),
    muted=(152, 160, 168),
    alarm=(255, 92, 80),
)
THEMES = {"light": LIGHT, "dark": DARK}


@lru_cache(maxsize=1024)
def mix(a: Colour, b: Colour, share: float) -> Colour:
    """Colour between `a` (share 0) and `b` (share 1)."""
    red, green, blue = (round(x + (y - x) * share) for x, y in zip(a, b, strict=True))
    return red, green, blue
