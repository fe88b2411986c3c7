"""One instant of one environment, as the pictures show it: plain arrays, no drawing library.

R robots, M points, O obstacles, P ordered pairs of robots (`relloc_env.samples.ordered_pairs`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.samples import Bool, Estimate, Float, ordered_pairs

Colours = NDArray[np.uint8]

ROBOT_COLOURS = ((0, 119, 187), (238, 119, 51), (0, 153, 136), (204, 51, 17))
"""Blue, orange, teal, red: the `vibrant` scheme of P. Tol, told apart with any colour vision."""
TARGET_COLOURS = (
    (17, 119, 51),
    (170, 68, 153),
    (221, 204, 85),
    (51, 34, 136),
    (136, 204, 238),
    (136, 34, 85),
    (153, 153, 51),
    (204, 102, 119),
)
"""Green, purple, yellow, indigo, cyan, wine, olive, rose: the `muted` scheme of P. Tol."""


def robot_colour(robot: int) -> tuple[int, int, int]:
    """Colour of a robot, of its trail, its camera's frame and everything that it believes."""
    return ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]


def robot_name(robot: int) -> str:
    """Name of a robot in a picture: A, B, ..."""
    return chr(ord("A") + robot)


def target_colours(points: int) -> Colours:
    """(M, 3) colours of targets that have none of their own; they repeat after eight."""
    return np.array([TARGET_COLOURS[j % len(TARGET_COLOURS)] for j in range(points)], np.uint8).reshape(-1, 3)


class CameraGeometry(NamedTuple):
    """What a robot's camera can see. It looks along the heading, level, from the robot's origin."""

    width: int = 640
    """[px] of the image."""
    height: int = 480
    """[px] of the image."""
    focal: float = 525.0
    """[px] focal length."""
    c_x: float = 320.0
    """[px] column of the optical axis, from the left."""
    c_y: float = 240.0
    """[px] row of the optical axis, from the top."""
    near: float = 0.0
    """[m] least depth."""
    far: float = float("inf")
    """[m] greatest depth."""
    limited: bool = True
    """Whether the image ends the view. If not, its frame only sets what the picture shows."""
    mount: float = 0.3
    """[m] height of the optical axis above the floor."""


class Reading(NamedTuple):
    """A number worth showing."""

    label: str
    """What it is, in a word or two."""
    value: str
    """The number with its unit, as text."""
    robot: int = -1
    """Robot whose colour marks it; -1 for none."""
    gauge: tuple[float, float, float] | None = None
    """The number and the positive ends of the band in which it should be, for a strip below; None for no strip."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """One instant of one environment: the truth, what the robots measure, what they believe."""

    time: float
    """[s] since the start of the episode."""
    poses: Float
    """[m, m, rad] (R, 3) true poses, world."""
    points: Float
    """[m] (M, 3) true points, world; z above the floor."""
    colours: Colours
    """(M, 3) red, green, blue of each point."""
    cameras: Sequence[CameraGeometry]
    """(R,) cameras."""
    true_image: Float
    """[-] (R, M, 2) noise-free normalised image coordinates; read only where the point is in front of the camera."""
    in_view: Bool
    """(R, M) whether the point is inside the view and not hidden."""
    image: Float
    """[-] (R, M, 2) measured normalised image coordinates; NaN as the second is a bearing without a height."""
    seen: Bool
    """(R, M) whether the camera measured the point."""
    robot_radius: float
    """[m] of every robot."""
    robot_height: float = 0.4
    """[m] of every robot, as the other one's camera sees it."""
    arena: tuple[float, float, float, float] | None = None
    """[m] (x_min, x_max, y_min, y_max) walls; None is an open floor, of which the picture shows what is in use."""
    obstacles: Float | None = None
    """(O, 7) kind (0 disc, 1 box), x, y, radius or half length, half width [m], angle [rad], height [m]."""
    trails: Sequence[Float] = ()
    """(R,) of (T, 2) [m] places where each robot was, oldest first, world; may be empty."""
    estimate: Estimate | None = None
    """What the estimators believe, without the leading axis of environments; None shows none."""
    contact: Bool | None = None
    """(R,) whether a robot touches something."""
    blocked: Bool | None = None
    """(R,) whether a shield held a robot back."""
    readings: Sequence[Reading] = ()
    """Key numbers beside the picture, most important first."""
    title: str = ""
    """Name of the motion, policy or episode; may be empty."""

    def __post_init__(self) -> None:
        robots, points = len(self.poses), len(self.points)
        pairs = len(ordered_pairs(robots))
        shapes: dict[str, tuple[NDArray[Any], tuple[int, ...]]] = {
            "poses": (self.poses, (robots, 3)),
            "points": (self.points, (points, 3)),
            "colours": (self.colours, (points, 3)),
            "true_image": (self.true_image, (robots, points, 2)),
            "in_view": (self.in_view, (robots, points)),
            "image": (self.image, (robots, points, 2)),
            "seen": (self.seen, (robots, points)),
        }
        if self.estimate is not None:
            believed = self.estimate
            shapes |= {
                "estimate.points": (believed.points, (robots, points, 3)),
                "estimate.points_covariance": (believed.points_covariance, (robots, points, 3, 3)),
                "estimate.known": (believed.known, (robots, points)),
                "estimate.pose": (believed.pose, (pairs, 3)),
                "estimate.pose_covariance": (believed.pose_covariance, (pairs, 3, 3)),
            }
        for name, flag in (("contact", self.contact), ("blocked", self.blocked)):
            if flag is not None:
                shapes[name] = (flag, (robots,))
        if self.obstacles is not None:
            shapes["obstacles"] = (self.obstacles, (len(self.obstacles), 7))
        for name, (array, shape) in shapes.items():
            if np.shape(array) != shape:
                raise ValueError(f"Argument `{name}` must have shape {shape}, but has {np.shape(array)}.")
        if len(self.cameras) != robots:
            raise ValueError(
                f"Argument `cameras` must have one entry for each of {robots} robots, but has {len(self.cameras)}."
            )
        if self.trails and len(self.trails) != robots:
            raise ValueError(
                f"Argument `trails` must be empty or have one entry for each of {robots} robots, but has "
                f"{len(self.trails)}."
            )
