"""One instant of one environment, as the pictures show it: plain arrays, no drawing library.

R robots, M points, O obstacles, P ordered pairs of robots (`relloc_env.samples.ordered_pairs`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.samples import Bool, Estimate, Float, ordered_pairs

if TYPE_CHECKING:
    from relloc_env.config import CameraConfig

Colours = NDArray[np.uint8]

ROBOT_COLOURS = ((0, 114, 178), (213, 94, 0), (204, 121, 167), (110, 110, 110))
"""Blue, vermilion, purple, grey: after M. Okabe and K. Ito, told apart with any colour vision. On light ground."""
TARGET_COLOURS = (
    (0, 158, 115),
    (136, 34, 85),
    (221, 204, 119),
    (51, 34, 136),
    (100, 220, 220),
    (120, 70, 20),
    (204, 102, 119),
    (150, 150, 150),
)
"""Green, wine, sand, indigo, cyan, brown, rose, grey: the first six are told apart with any colour vision."""


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

    @classmethod
    def of(cls, camera: "CameraConfig") -> "CameraGeometry":
        """Geometry of a configured camera."""
        return cls(
            width=camera.width,
            height=camera.height,
            focal=camera.focal_length,
            c_x=camera.principal_point[0],
            c_y=camera.principal_point[1],
            near=camera.near,
            far=math.inf if camera.far is None else camera.far,
            limited=camera.limited,
            mount=camera.mount_height,
        )


class Strip(NamedTuple):
    """A number over time, of each robot, on a logarithmic axis."""

    label: str
    """What it is, with its unit, in a few words."""
    time: Float
    """[s] (T,) increasing."""
    lines: Float
    """(R, T) the number of each robot; NaN where there is none."""
    values: Sequence[str]
    """(R,) the newest number of each robot, as text."""
    span: tuple[float, float]
    """Ends of the axis, positive; what is beyond lies on the edge."""
    band: tuple[float, float] | None = None
    """Where 95 % of the numbers lie when all is right; a value above it is marked. None for no band."""
    bound: Float | None = None
    """(T,) what no estimator can beat; None for none."""


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
    pictures: Sequence[Colours | None] = ()
    """(R,) of uint8 (H, W, 3) what the cameras took, in the proportions of their images; None, or empty: a sketch."""
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
    strips: Sequence[Strip] = ()
    """Numbers over time beside the map, most important first."""
    horizon: float = 30.0
    """[s] length of the time axis of the strips; in longer episodes it moves along."""
    title: str = ""
    """Name of the motion, policy or episode; may be empty."""
    notes: Sequence[tuple[str, str]] = ()
    """Keys and what they do, or names and values, in a panel on the map; may be empty."""

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
        for j, strip in enumerate(self.strips):
            shapes[f"strips[{j}].lines"] = (strip.lines, (robots, len(strip.time)))
            if strip.bound is not None:
                shapes[f"strips[{j}].bound"] = (strip.bound, (len(strip.time),))
        for name, (array, shape) in shapes.items():
            if np.shape(array) != shape:
                raise ValueError(f"Argument `{name}` must have shape {shape}, but has {np.shape(array)}.")
        if len(self.cameras) != robots:
            raise ValueError(
                f"Argument `cameras` must have one entry for each of {robots} robots, but has {len(self.cameras)}."
            )
        for name, entries in (("trails", self.trails), ("pictures", self.pictures)):
            if len(entries) not in (0, robots):
                raise ValueError(
                    f"Argument `{name}` must be empty or have one entry for each of {robots} robots, but has "
                    f"{len(entries)}."
                )
