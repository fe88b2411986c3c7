"""What an environment is put together of: robots, cameras, obstacles, shield, starts, first guesses, network, gains."""

import math
import numbers
from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import field_validator, model_validator

from relloc_env.config.base import Colour, Model
from relloc_env.config.imaging import ImageConfig
from relloc_env.quantities import (
    Angle,
    AngleError,
    AngleSd,
    Chance,
    Coordinate,
    Distance,
    Duration,
    FocalLength,
    Gain,
    HalfTurn,
    Height,
    Length,
    LengthSd,
    Mass,
    MotionSd,
    PixelCoordinate,
    PixelDistance,
    Pixels,
    Rate,
    Speed,
    YawRate,
)
from relloc_env.quoting import quote


class RobotConfig(Model):
    """A disc robot with differential drive."""

    radius: Length = 0.18
    """[m]"""
    height: Length = 0.4
    """[m] of the body: what hides points from the other camera."""
    mass: Mass = 5.0
    """[kg]"""
    max_speed: Speed = 0.3
    """[m/s] forward, and backward where `reverse`."""
    max_yaw_rate: YawRate = 0.8
    """[rad/s]"""
    reverse: bool = True
    lag: tuple[Duration, Duration] = (0.0, 0.0)
    """[s] time constants of the first-order response in speed and yaw rate; 0 follows at once."""
    actuator_noise: MotionSd = (0.0, 0.0)
    """[m/s, rad/s] standard deviation of what the wheels add to the command in each sample."""
    odometry_noise: MotionSd = (0.01, 0.01)
    """[m/s, rad/s] standard deviation of the measured speed and yaw rate in each sample."""


CAMERAS: dict[str, dict[str, Any]] = {
    "pi": {"width": 640, "height": 480, "field_of_view": 62.2, "pixel_noise": 1.6},
    "kinect": {"width": 640, "height": 480, "field_of_view": 57.0, "pixel_noise": 1.0, "near": 0.4, "far": 8.0},
    "unlimited": {"width": 640, "height": 480, "field_of_view": 90.0, "pixel_noise": 0.0, "limited": False},
}
"""Presets: a Pi camera (TurtleBot 3), a Kinect-class camera (TurtleBot 2), one that sees all points ahead of it."""
KINDS = ("analytic", "image")
"""How a camera measures: points projected and noise added, or pictures taken and targets found in them."""
VIEWS = (0.1, 178.0)
"""[deg] narrowest and widest field of view."""
OUTERMOST = 100.0
"""[-] normalised image coordinate that borders of an image may have: 89.4 degrees off the axis."""
GREY: Colour = (150, 146, 140)
"""Of obstacles in pictures."""


class CameraConfig(Model):
    """A pinhole camera, looking along the robot's heading. Give `focal_length` or `field_of_view`, not both."""

    preset: Literal["pi", "kinect", "unlimited"] | None = None
    kind: Literal["analytic", "image"] = "analytic"
    """points are projected and noise added, or pictures are taken and the targets found in them (extra `vision`)."""
    width: Pixels = 640
    """[px]"""
    height: Pixels = 480
    """[px]"""
    focal_length: FocalLength
    """[px]"""
    principal_point: tuple[PixelCoordinate, PixelCoordinate]
    """[px] column and row where the optical axis meets the image; the middle by default."""
    mount_height: Length = 0.3
    """[m] of the camera above the floor."""
    pixel_noise: PixelDistance = 1.6
    """[px] standard deviation of each coordinate of a detection; of an analytic camera, as is the next."""
    quantisation: PixelDistance = 0.0
    """[px] step to which detections are rounded; 0 for none."""
    frame_rate: Rate | None = None
    """[Hz] of the camera, at most the sample rate; None for one frame in each sample."""
    near: Distance = 0.1
    """[m] least depth at which a point is detected."""
    far: Length | None = None
    """[m] greatest depth; None for no limit."""
    miss_probability: Chance = 0.0
    """chance that a point in view is not detected in a frame; of an analytic camera."""
    limited: bool = True
    """whether the image has borders; without, every point ahead of the camera is in view."""
    image: ImageConfig = ImageConfig()
    """how pictures come about, for `kind="image"` and for the observation `image`."""

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any) -> Any:
        """Fill in the preset, the focal length from the field of view, and the principal point."""
        if isinstance(data, str):
            if data not in CAMERAS and data not in KINDS:
                raise ValueError(
                    f"must be a preset ({', '.join(CAMERAS)}) or a kind ({', '.join(KINDS)}), but is {quote(data)}"
                )
            data = {"kind": data} if data in KINDS else {"preset": data}
        if not isinstance(data, Mapping):
            return data
        data = dict(data)
        preset = data.get("preset")
        base = dict(CAMERAS.get(preset, CAMERAS["pi"]) if isinstance(preset, str) else CAMERAS["pi"])
        if "focal_length" in data:
            base.pop("field_of_view", None)
        data = base | data
        width, height = (_side(data, name) for name in ("width", "height"))
        if "field_of_view" in data:
            angle = data.pop("field_of_view")
            if "focal_length" in data:
                raise ValueError("must have `focal_length` or `field_of_view`, not both")
            if not isinstance(angle, int | float) or not 0.0 < angle < 180.0:
                raise ValueError(f"must have a `field_of_view` between 0 and 180 degrees, but it is {quote(angle)}")
            if not VIEWS[0] <= angle <= VIEWS[1]:
                raise ValueError(
                    f"must have a `field_of_view` from {VIEWS[0]:g} to {VIEWS[1]:g} degrees, but it is {angle!r}"
                )
            data["focal_length"] = 0.5 * width / math.tan(0.5 * math.radians(angle))
        data.setdefault("principal_point", (0.5 * width, 0.5 * height))
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.far is not None and self.far <= self.near:
            raise ValueError(f"must have `far` greater than `near` ({self.near}), but it is {self.far}")
        x, y = self.principal_point
        border = max(x, self.width - x, y, self.height - y) / self.focal_length
        if self.limited and border > OUTERMOST:
            raise ValueError(
                f"must have a `width` and `height` that leave the borders of the image within {OUTERMOST:g} times the "
                f"`focal_length` of the `principal_point`, but one is {border:.3g} times as far"
            )
        if self.kind == "image" and not self.limited:
            raise ValueError("must have `limited` true with `kind` image: a picture has borders")
        return self

    @property
    def image_noise(self) -> float:
        """[-] standard deviation of a normalised image coordinate: pixel noise and rounding, or the detector's."""
        if self.kind == "image":
            return self.image.detection_noise / self.focal_length
        return math.hypot(self.pixel_noise, self.quantisation / math.sqrt(12.0)) / self.focal_length

    @property
    def half_view(self) -> float:
        """[rad] half the horizontal field of view."""
        return math.atan(0.5 * self.width / self.focal_length)


def _side(data: Mapping[str, Any], name: str) -> float:
    """Width or height of an image, before it is checked."""
    side = data.get(name, CAMERAS["pi"][name])
    if isinstance(side, numbers.Real):
        return min(float(min(side, 10**9)), 1e9)  # type: ignore[arg-type]
    raise ValueError(f"must have an integer as `{name}`, but it is {quote(side)}")


class DiscConfig(Model):
    """A round obstacle."""

    shape: Literal["disc"] = "disc"
    position: tuple[Coordinate, Coordinate]
    """[m] of its centre in the world."""
    radius: Length
    """[m]"""
    height: Length = 2.0
    """[m]"""
    colour: Colour = GREY
    """in pictures."""


class BoxConfig(Model):
    """A rectangular obstacle."""

    shape: Literal["box"] = "box"
    position: tuple[Coordinate, Coordinate]
    """[m] of its centre in the world."""
    size: tuple[Length, Length]
    """[m] full length along its own x and y."""
    angle: Angle = 0.0
    """[rad] of its x axis, counter-clockwise from the world's."""
    height: Length = 2.0
    """[m]"""
    colour: Colour = GREY
    """in pictures."""


class ShieldConfig(Model):
    """Speed is set to zero for a sample that would bring a robot closer than this. Not a contact."""

    target: Distance = 0.5
    """[m] between camera and target, in the plane."""
    robot: Distance = 0.6
    """[m] between the robots' centres."""
    wall: Distance = 0.3
    """[m] between a robot's centre and a wall or an obstacle."""


class StartConfig(Model):
    """Distribution of starts; what `poses` or `points` fix is not drawn."""

    target_distance: tuple[Distance, Distance] = (2.0, 7.0)
    """[m] least and greatest distance of each robot to each target, in the plane."""
    target_separation: tuple[Distance, Distance] = (0.8, 4.0)
    """[m] least and greatest distance between targets, in the plane."""
    target_height: tuple[Height, Height] = (-0.3, 0.8)
    """[m] of targets above the camera."""
    heading_error: HalfTurn = 8.0
    """[deg] greatest angle between heading and direction to the targets' centroid."""
    robot_distance: Distance = 1.0
    """[m] least distance between the robots."""
    margin: Distance = 0.5
    """[m] least distance of everything to the walls."""
    in_view: bool = True
    """whether every robot sees every target at the start."""

    @field_validator("target_distance", "target_separation", "target_height")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("must be a pair (least, greatest)")
        return value


class GuessConfig(Model):
    """What the robots are told at the start: the truth with errors of this size."""

    kind: Literal["fixed", "positive", "gaussian"] = "fixed"
    """errors of fixed size and random sign, of fixed size and positive, or Gaussian."""
    depth: Distance = 1.0
    """[m] error of each robot's guess of a target's depth."""
    position: Distance = 1.5
    """[m] error of each coordinate of the other robot's position."""
    heading: AngleError = 60.0
    """[deg] error of the other robot's heading."""
    depth_sd: LengthSd = 1.0
    """[m] standard deviation the estimators and the bound give to the depth guess."""
    position_sd: LengthSd = 1.5
    """[m] the same for the position."""
    heading_sd: AngleSd = 60.0
    """[deg] the same for the heading."""


class NetworkConfig(Model):
    """How a robot's message reaches the other; perfect by default."""

    latency: Duration = 0.0
    """[s]"""
    jitter: Duration = 0.0
    """[s] added to the latency, uniform from 0 to this."""
    loss: Chance = 0.0
    """chance that a message is lost."""
    rate: Rate | None = None
    """[Hz] greatest rate of messages; None for one in each sample."""

    @property
    def perfect(self) -> bool:
        """Whether every message arrives at once."""
        return self.latency == 0.0 and self.jitter == 0.0 and self.loss == 0.0 and self.rate is None


class GainsConfig(Model):
    """Bounds of the depth observers' gains that actions set with `action="motion+gains"`, on a log scale.

    The middle of the default bounds is what the paper uses.
    """

    h: tuple[Gain, Gain] = (0.25, 25.0)
    """[1/s] least and greatest gain H of the image innovation."""
    alpha_lambda: tuple[Gain, Gain] = (12.0, 1200.0)
    """[1/m²] least and greatest product alpha Lambda of the depth innovation."""

    @field_validator("h", "alpha_lambda")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            raise ValueError("must be a pair (least, greatest)")
        return value


def clearance(obstacle: DiscConfig | BoxConfig, x: float, y: float) -> float:
    """Distance [m] of a point to an obstacle; 0 inside it."""
    d_x, d_y = x - obstacle.position[0], y - obstacle.position[1]
    if isinstance(obstacle, DiscConfig):
        return max(0.0, math.hypot(d_x, d_y) - obstacle.radius)
    cos, sin = math.cos(obstacle.angle), math.sin(obstacle.angle)
    a, b = abs(cos * d_x + sin * d_y) - 0.5 * obstacle.size[0], abs(cos * d_y - sin * d_x) - 0.5 * obstacle.size[1]
    return math.hypot(max(a, 0.0), max(b, 0.0))
