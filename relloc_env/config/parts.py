"""What an environment is put together of: robots, cameras, obstacles, shield, starts, first guesses, network, gains."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from relloc_env.config.base import Bounds, Colour, Finite, Model, NonNegative, Pair, Positive, Range
from relloc_env.config.imaging import ImageConfig
from relloc_env.quoting import quote


class RobotConfig(Model):
    """A disc robot with differential drive."""

    radius: Positive = 0.18
    """[m]"""
    height: Positive = 0.4
    """[m] of the body: what hides points from the other camera."""
    mass: Positive = 5.0
    """[kg]"""
    max_speed: Positive = 0.3
    """[m/s] forward, and backward where `reverse`."""
    max_yaw_rate: Positive = 0.8
    """[rad/s]"""
    reverse: bool = True
    lag: Pair = (0.0, 0.0)
    """[s] time constants of the first-order response in speed and yaw rate; 0 follows at once."""
    actuator_noise: Pair = (0.0, 0.0)
    """[m/s, rad/s] standard deviation of what the wheels add to the command in each sample."""
    odometry_noise: Pair = (0.01, 0.01)
    """[m/s, rad/s] standard deviation of the measured speed and yaw rate in each sample."""


CAMERAS: dict[str, dict[str, Any]] = {
    "pi": {"width": 640, "height": 480, "field_of_view": 62.2, "pixel_noise": 1.6},
    "kinect": {"width": 640, "height": 480, "field_of_view": 57.0, "pixel_noise": 1.0, "near": 0.4, "far": 8.0},
    "unlimited": {"width": 640, "height": 480, "field_of_view": 90.0, "pixel_noise": 0.0, "limited": False},
}
"""Presets: a Pi camera (TurtleBot 3), a Kinect-class camera (TurtleBot 2), one that sees all points ahead of it."""
KINDS = ("analytic", "image")
"""How a camera measures: points projected and noise added, or pictures taken and targets found in them."""
GREY: Colour = (150, 146, 140)
"""Of obstacles in pictures."""


class CameraConfig(Model):
    """A pinhole camera, looking along the robot's heading. Give `focal_length` or `field_of_view`, not both."""

    preset: Literal["pi", "kinect", "unlimited"] | None = None
    kind: Literal["analytic", "image"] = "analytic"
    """points are projected and noise added, or pictures are taken and the targets found in them (extra `vision`)."""
    width: Annotated[int, Field(gt=0)] = 640
    """[px]"""
    height: Annotated[int, Field(gt=0)] = 480
    """[px]"""
    focal_length: Positive
    """[px]"""
    principal_point: tuple[Finite, Finite]
    """[px] column and row where the optical axis meets the image; the middle by default."""
    mount_height: Positive = 0.3
    """[m] of the camera above the floor."""
    pixel_noise: NonNegative = 1.6
    """[px] standard deviation of each coordinate of a detection; of an analytic camera, as is the next."""
    quantisation: NonNegative = 0.0
    """[px] step to which detections are rounded; 0 for none."""
    frame_rate: Positive | None = None
    """[Hz] of the camera, at most the sample rate; None for one frame in each sample."""
    near: NonNegative = 0.1
    """[m] least depth at which a point is detected."""
    far: Positive | None = None
    """[m] greatest depth; None for no limit."""
    miss_probability: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
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
        width, height = data.get("width", 640), data.get("height", 480)
        if "field_of_view" in data:
            angle = data.pop("field_of_view")
            if "focal_length" in data:
                raise ValueError("must have `focal_length` or `field_of_view`, not both")
            if not isinstance(angle, int | float) or not 0.0 < angle < 180.0:
                raise ValueError(f"must have a `field_of_view` between 0 and 180 degrees, but it is {quote(angle)}")
            if isinstance(width, int | float):
                data["focal_length"] = 0.5 * width / math.tan(0.5 * math.radians(angle))
        if isinstance(width, int | float) and isinstance(height, int | float):
            data.setdefault("principal_point", (0.5 * width, 0.5 * height))
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.far is not None and self.far <= self.near:
            raise ValueError(f"must have `far` greater than `near` ({self.near}), but it is {self.far}")
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


class DiscConfig(Model):
    """A round obstacle."""

    shape: Literal["disc"] = "disc"
    position: tuple[Finite, Finite]
    """[m] of its centre in the world."""
    radius: Positive
    """[m]"""
    height: Positive = 2.0
    """[m]"""
    colour: Colour = GREY
    """in pictures."""


class BoxConfig(Model):
    """A rectangular obstacle."""

    shape: Literal["box"] = "box"
    position: tuple[Finite, Finite]
    """[m] of its centre in the world."""
    size: tuple[Positive, Positive]
    """[m] full length along its own x and y."""
    angle: Finite = 0.0
    """[rad] of its x axis, counter-clockwise from the world's."""
    height: Positive = 2.0
    """[m]"""
    colour: Colour = GREY
    """in pictures."""


class ShieldConfig(Model):
    """Speed is set to zero for a sample that would bring a robot closer than this. Not a contact."""

    target: NonNegative = 0.5
    """[m] between camera and target, in the plane."""
    robot: NonNegative = 0.6
    """[m] between the robots' centres."""
    wall: NonNegative = 0.3
    """[m] between a robot's centre and a wall or an obstacle."""


class StartConfig(Model):
    """Distribution of starts; what `poses` or `points` fix is not drawn."""

    target_distance: Pair = (2.0, 7.0)
    """[m] least and greatest distance of each robot to each target, in the plane."""
    target_separation: Pair = (0.8, 4.0)
    """[m] least and greatest distance between targets, in the plane."""
    target_height: Range = (-0.3, 0.8)
    """[m] of targets above the camera."""
    heading_error: Annotated[float, Field(ge=0.0, le=180.0)] = 8.0
    """[deg] greatest angle between heading and direction to the targets' centroid."""
    robot_distance: NonNegative = 1.0
    """[m] least distance between the robots."""
    margin: NonNegative = 0.5
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
    depth: NonNegative = 1.0
    """[m] error of each robot's guess of a target's depth."""
    position: NonNegative = 1.5
    """[m] error of each coordinate of the other robot's position."""
    heading: NonNegative = 60.0
    """[deg] error of the other robot's heading."""
    depth_sd: Positive = 1.0
    """[m] standard deviation the estimators and the bound give to the depth guess."""
    position_sd: Positive = 1.5
    """[m] the same for the position."""
    heading_sd: Positive = 60.0
    """[deg] the same for the heading."""


class NetworkConfig(Model):
    """How a robot's message reaches the other; perfect by default."""

    latency: NonNegative = 0.0
    """[s]"""
    jitter: NonNegative = 0.0
    """[s] added to the latency, uniform from 0 to this."""
    loss: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """chance that a message is lost."""
    rate: Positive | None = None
    """[Hz] greatest rate of messages; None for one in each sample."""

    @property
    def perfect(self) -> bool:
        """Whether every message arrives at once."""
        return self.latency == 0.0 and self.jitter == 0.0 and self.loss == 0.0 and self.rate is None


class GainsConfig(Model):
    """Bounds of the depth observers' gains that actions set with `action="motion+gains"`, on a log scale.

    The middle of the default bounds is what the paper uses.
    """

    h: Bounds = (0.25, 25.0)
    """[1/s] least and greatest gain H of the image innovation."""
    alpha_lambda: Bounds = (12.0, 1200.0)
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
