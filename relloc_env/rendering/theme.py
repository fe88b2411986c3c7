"""The visual language: what each thing looks like. Colours of targets are in `scene`.

A colour is a robot's or a target's and nothing else's, red apart: it warns. What is true is solid, what a robot
believes is hollow and of its colour, with a region of 2 sigma; what it measures is a cross.
"""

from dataclasses import dataclass
from functools import lru_cache

from relloc_env.rendering.scene import ROBOT_COLOURS

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Theme:
    """Colours of everything that is not a target."""

    robots: tuple[Colour, ...]
    """Robots, their trails, their cameras' frames and all that they believe; they repeat."""
    on_robot: Colour
    """Letters on a robot."""
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
    """Contact, and numbers above their band."""

    def robot(self, robot: int) -> Colour:
        """Colour of a robot."""
        return self.robots[robot % len(self.robots)]


LIGHT = Theme(
    robots=ROBOT_COLOURS,
    on_robot=(255, 255, 255),
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
    robots=((86, 180, 233), (230, 159, 0), (226, 160, 198), (170, 170, 170)),
    on_robot=(16, 18, 20),
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
