"""What all figures look like: colours of the robots and points as everywhere else, letters that a phone can show."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from relloc_env.files import whole
from relloc_env.rendering import robot_colour, target_colours
from relloc_env.samples import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Colour = tuple[float, float, float]
INK, MUTED, GRID = "#202428", "#70757a", "#e4e6e5"
WIDTH = 6.4
"""[inch] of every figure: a column of text."""
_STYLE: Any = {
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.grid": True,
    "grid.color": GRID,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "svg.hashsalt": "relloc_env",  # the same file each time
}


def _share(colour: tuple[int, int, int]) -> Colour:
    red, green, blue = (part / 255.0 for part in colour)
    return red, green, blue


ROBOT = tuple(_share(robot_colour(r)) for r in range(2))
POINT = tuple(_share(tuple(row)) for row in target_colours(4).tolist())


@contextmanager
def page(path: Path, height: float) -> Iterator[Figure]:
    """A figure of the usual width and this height [inch], which is written in the end."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        yield figure
        with whole(path) as partial:
            figure.savefig(partial, metadata={"Date": None})


def robot(axes: "Axes", pose: Sequence[float] | Float, index: int = 0, *, size: float = 0.22) -> None:
    """A robot from above: a disc with a nose."""
    (x, y, heading), colour = pose, ROBOT[index]
    nose = np.array([x + 1.7 * size * np.cos(heading), y + 1.7 * size * np.sin(heading)])
    axes.plot([x, nose[0]], [y, nose[1]], color=colour, lw=2.5, zorder=4, solid_capstyle="round")
    axes.add_patch(Ellipse((x, y), 2 * size, 2 * size, color=colour, lw=0, zorder=5))


def uncertainty(axes: "Axes", place: Float, covariance: Float, colour: Colour, **options: Any) -> None:
    """The 2 sigma ellipse of a position."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    width, height = 4.0 * np.sqrt(values[::-1])
    axes.add_patch(
        Ellipse((place[0], place[1]), width, height, angle=angle, fill=False, edgecolor=colour, zorder=3, **options)
    )


def plan(axes: "Axes") -> None:
    """Axes that are a map: equal scales, no numbers."""
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    for side in axes.spines.values():
        side.set_visible(False)
