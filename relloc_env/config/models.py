"""The configurations themselves: frozen, checked where they are built, plain data and back without loss."""

import difflib
import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, BeforeValidator, Field, field_validator, model_validator

from relloc_env.config.base import Bounds, Colour, Finite, Model, NonNegative, Pair, Positive, Range, Vector3
from relloc_env.config.imaging import ImageConfig, MarkerConfig
from relloc_env.estimators.config import CascadeConfig, EstimatorConfig
from relloc_env.estimators.registry import resolve


class ConfigError(ValueError):
    """A configuration that cannot be: the message names the option, what it must be, and what it was."""


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
                raise ValueError(f"must have a `field_of_view` between 0 and 180 degrees, but it is {angle!r}")
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


REWARD_TERMS = (
    "excitation",
    "information_depth",
    "information_pose",
    "depth_error",
    "pose_error",
    "visibility",
    "collision",
    "blocked",
    "effort",
    "change",
    "depth_error_decrease",
    "pose_error_decrease",
)
"""Names of the reward's terms; `relloc_env.rewards` says what each is."""


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


def _named_estimator(value: Any) -> Any:
    """A name stands for its preset configuration, a factory or its place for an estimator of the user's own."""
    return resolve(value) if isinstance(value, str) or callable(value) else value


def _sequence(value: Any) -> Any:
    """One robot or camera stands for a sequence of one."""
    return (value,) if isinstance(value, str | Mapping | BaseModel) else value


class EnvConfig(Model):
    """One environment. A single entry in `robot` or `camera` holds for all robots."""

    RATE: ClassVar[float] = 20.0

    robots: Annotated[int, Field(ge=1, le=2)] = 2
    """number of robots."""
    targets: Annotated[int, Field(ge=1, le=32)] = 2
    """number of points the robots watch."""
    robot: Annotated[tuple[RobotConfig, ...], BeforeValidator(_sequence)] = (RobotConfig(),)
    """one for all, or one per robot."""
    camera: Annotated[tuple[CameraConfig, ...], BeforeValidator(_sequence)] = (CameraConfig.model_validate("pi"),)
    """one for all, or one per robot; the name of a preset stands for it."""
    network: NetworkConfig = NetworkConfig()
    arena: tuple[Positive, Positive] | None = (10.0, 10.0)
    """[m] size of the walled floor, centred at the origin; None for an open one."""
    obstacles: tuple[Annotated[DiscConfig | BoxConfig, Field(discriminator="shape")], ...] = ()
    shield: ShieldConfig | None = ShieldConfig()
    marker: MarkerConfig = MarkerConfig()
    """what targets look like in pictures."""
    poses: tuple[Vector3, ...] | None = None
    """[m, m, rad] fixed start of each robot in the world; None to draw them."""
    points: tuple[Vector3, ...] | None = None
    """[m] fixed targets in the world, z above the floor; None to draw them."""
    start: StartConfig = StartConfig()
    guess: GuessConfig = GuessConfig()
    sample_rate: Positive = RATE
    """[Hz] of the estimators."""
    samples_per_action: Annotated[int, Field(ge=1, le=1000)] = 5
    action: Literal["motion", "motion+gains"] = "motion"
    """what an action sets: speed and yaw rate, or also the gains of the robot's depth observers (estimators of the
    kind `cascade`)."""
    gains: GainsConfig = GainsConfig()
    max_cycles: Annotated[int, Field(ge=1)] = 120
    """actions until the episode is truncated."""
    terminate_on_collision: bool = False
    terminate_on_success: bool = False
    """whether the episode ends once the bound is at `success`."""
    success: tuple[Positive, Positive] = (0.05, 1.5)
    """[m, deg] standard deviation of depth or position, and of the heading, that count as success."""
    estimator: Annotated[EstimatorConfig | None, BeforeValidator(_named_estimator)] = "map-alignment"  # type: ignore[assignment]
    """name or configuration of the estimator, or the user's own (`relloc_env.estimators.OwnConfig`); None for the bare
    environment."""
    reward: dict[str, Finite] | None = None
    """weight of each term; None for the default: information gained, less 0.02 for blocked samples."""
    reward_start: NonNegative = 0.0
    """[s] from which information gained counts in the reward: actions that begin before it gain none."""
    bound: bool | None = None
    """whether the information bound is computed (`information` and `bound_sd` in `info`, the terms `information_*`).
    None: where the reward or `terminate_on_success` needs it."""
    observation: Literal["flat", "dict", "image"] = "flat"
    """numbers in one vector, the same by name, or the picture of each robot's camera."""
    image_size: tuple[Annotated[int, Field(ge=8, le=4096)], Annotated[int, Field(ge=8, le=4096)]] = (84, 84)
    """[px] width and height of the picture of the observation `image`, which shows the camera's whole view."""

    @model_validator(mode="before")
    @classmethod
    def _counts(cls, data: Any) -> Any:
        """Fixed points set their number."""
        points = data.get("points") if isinstance(data, Mapping) else None
        if isinstance(points, list | tuple):
            if not points:
                raise ValueError("must have at least one point in `points`, but has none")
            data = {"targets": len(points), **data}
        return data

    @field_validator("reward")
    @classmethod
    def _terms(cls, value: dict[str, float] | None) -> dict[str, float] | None:
        for name in value or ():
            if name not in REWARD_TERMS:
                raise ValueError(f"must have terms among {', '.join(REWARD_TERMS)}, but has `{name}`{hint(name)}")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, value, count in (
            ("robot", self.robot, self.robots),
            ("camera", self.camera, self.robots),
        ):
            if len(value) not in (1, count):
                raise ValueError(f"must have 1 or {count} entries in `{name}`, but has {len(value)}")
        if self.poses is not None and len(self.poses) != self.robots:
            raise ValueError(f"must have {self.robots} entries in `poses`, but has {len(self.poses)}")
        if self.points is not None and len(self.points) != self.targets:
            raise ValueError(f"must have {self.targets} entries in `points`, but has {len(self.points)}")
        if self.action == "motion+gains" and not isinstance(self.estimator, CascadeConfig):
            kind = self.estimator and self.estimator.kind
            raise ValueError(
                'must have an `estimator` with gains (`cascade`, `cascade-critical`) for `action` "motion+gains", '
                f"but has {kind!r}"
            )
        if self.message_window > 64:
            raise ValueError(
                f"must have latency and jitter of less than 64 samples, but they are {self.message_window}"
            )
        for camera in self.camera:
            if camera.frame_rate is not None and camera.frame_rate > self.sample_rate:
                raise ValueError(
                    f"must have `frame_rate` at most the sample rate {self.sample_rate}, but it is {camera.frame_rate}"
                )
        if self.arena is not None and 2.0 * self.start.margin >= min(self.arena):
            raise ValueError(
                f"must have `start.margin` below half the arena {self.arena}, but it is {self.start.margin}"
            )
        if self.bound is False and self._needs_bound:
            raise ValueError("must not have `bound` false where the reward or `terminate_on_success` needs it")
        if self.poses is not None:
            self.check_poses(self.poses)
        return self

    def check_poses(self, poses: tuple[tuple[float, float, float], ...]) -> None:
        """Raise ValueError where a robot at one of `poses` would stand in a wall, an obstacle, or another robot."""
        for r, (x, y, _) in enumerate(poses):
            radius = self.robot_of(r).radius
            if self.arena is not None and (
                abs(x) + radius > 0.5 * self.arena[0] or abs(y) + radius > 0.5 * self.arena[1]
            ):
                raise ValueError(f"must have robots within the walls, but robot {r} at ({x}, {y}) is not")
            for obstacle in self.obstacles:
                if _clearance(obstacle, x, y) < radius:
                    raise ValueError(f"must have robots clear of obstacles, but robot {r} at ({x}, {y}) is not")
            for other in range(r):
                distance = math.hypot(x - poses[other][0], y - poses[other][1])
                if distance < radius + self.robot_of(other).radius:
                    raise ValueError(f"must have robots apart, but robots {other} and {r} are {distance:.3g} m apart")

    def robot_of(self, index: int) -> RobotConfig:
        """Configuration of one robot."""
        return self.robot[index % len(self.robot)]

    def camera_of(self, index: int) -> CameraConfig:
        """Configuration of one robot's camera."""
        return self.camera[index % len(self.camera)]

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Gains of each point's observer that an action sets; critically damped, H follows from alpha Lambda."""
        if self.action == "motion" or not isinstance(self.estimator, CascadeConfig):
            return ()
        return ("alpha_lambda",) if self.estimator.damping == "critical" else ("h", "alpha_lambda")

    @property
    def action_size(self) -> int:
        """Count of the numbers in one robot's action: speed, yaw rate, then the gains of each point's observer."""
        return 2 + self.targets * len(self.gain_names)

    @property
    def sample_period(self) -> float:
        """Time between two samples [s]."""
        return 1.0 / self.sample_rate

    @property
    def message_window(self) -> int:
        """Samples after which a message has arrived or never will."""
        delay = (self.network.latency + self.network.jitter) * self.sample_rate
        return math.ceil(delay - 1e-9) + 1

    @property
    def reward_weights(self) -> dict[str, float]:
        """Weight of each term of the reward."""
        if self.reward is not None:
            return dict(self.reward)
        return {"information_depth" if self.robots == 1 else "information_pose": 3.0, "blocked": -0.02}

    @property
    def tracks_bound(self) -> bool:
        """Whether the information bound is computed."""
        if self.bound is not None:
            return self.bound
        return self._needs_bound

    @property
    def _needs_bound(self) -> bool:
        """Whether the reward or an end needs the information bound."""
        rewarded = any(self.reward_weights.get(name) for name in ("information_depth", "information_pose"))
        return rewarded or self.terminate_on_success

    def to_dict(self) -> dict[str, Any]:
        """Plain data from which `load_config` makes the same configuration.

        What the estimator does not state (it takes the noise of the sensors then) stays unstated.
        """
        data = self.model_dump(mode="json")
        if self.estimator is not None:
            stated = self.estimator.model_dump(mode="json", exclude_unset=True)
            data["estimator"] = {"kind": self.estimator.kind, **stated}
        return data


def _clearance(obstacle: DiscConfig | BoxConfig, x: float, y: float) -> float:
    """Distance [m] of a point to an obstacle; 0 inside it."""
    d_x, d_y = x - obstacle.position[0], y - obstacle.position[1]
    if isinstance(obstacle, DiscConfig):
        return max(0.0, math.hypot(d_x, d_y) - obstacle.radius)
    cos, sin = math.cos(obstacle.angle), math.sin(obstacle.angle)
    a, b = abs(cos * d_x + sin * d_y) - 0.5 * obstacle.size[0], abs(cos * d_y - sin * d_x) - 0.5 * obstacle.size[1]
    return math.hypot(max(a, 0.0), max(b, 0.0))


def hint(name: str, known: tuple[str, ...] = REWARD_TERMS) -> str:
    """Return a suggestion for a misspelt name, or nothing."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean `{close[0]}`?" if close else ""
