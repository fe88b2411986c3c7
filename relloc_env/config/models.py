"""The configuration of an environment: frozen, checked where it is built, plain data and back without loss."""

import difflib
import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, BeforeValidator, Field, field_validator, model_validator
from pydantic_core import PydanticSerializationError

from relloc_env.config.base import Model
from relloc_env.config.imaging import DETECTORS, LEAST_LEVEL, LEAST_SATURATION, MarkerConfig
from relloc_env.config.parts import (
    BoxConfig,
    CameraConfig,
    DiscConfig,
    GainsConfig,
    GuessConfig,
    NetworkConfig,
    RobotConfig,
    ShieldConfig,
    StartConfig,
    clearance,
)
from relloc_env.estimators.config import CascadeConfig, EstimatorConfig
from relloc_env.estimators.registry import resolve
from relloc_env.quantities import AngleSd, Count, Duration, Length, LengthSd, Point, Pose, Rate, Weight
from relloc_env.quoting import quote


class ConfigError(ValueError):
    """A configuration that cannot be: the message names the option, what it must be, and what it was."""


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


FASTEST = 1000.0
"""[-] longest way of a robot in a sample, in radii: contacts are solved in steps of a quarter of the radius."""


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
    """how late messages between robots are, and how many are lost."""
    arena: tuple[Length, Length] | None = (10.0, 10.0)
    """[m] size of the walled floor, centred at the origin; None for an open one."""
    obstacles: tuple[Annotated[DiscConfig | BoxConfig, Field(discriminator="shape")], ...] = ()
    """discs and boxes that stop robots and hide targets."""
    shield: ShieldConfig | None = ShieldConfig()
    """what stops robots before they touch anything; None: nothing does."""
    marker: MarkerConfig = MarkerConfig()
    """what targets look like in pictures."""
    poses: tuple[Pose, ...] | None = None
    """[m, m, rad] fixed start of each robot in the world; None to draw them."""
    points: tuple[Point, ...] | None = None
    """[m] fixed targets in the world, z above the floor; None to draw them."""
    start: StartConfig = StartConfig()
    """where robots and targets are drawn."""
    guess: GuessConfig = GuessConfig()
    """how far off the first guesses of depths and pose are that the robots are told."""
    sample_rate: Rate = RATE
    """[Hz] of the estimators."""
    samples_per_action: Annotated[int, Field(ge=1, le=1000)] = 5
    action: Literal["motion", "motion+gains"] = "motion"
    """what an action sets: speed and yaw rate, or also the gains of the robot's depth observers (estimators of the
    kind `cascade`)."""
    gains: GainsConfig = GainsConfig()
    """ranges of the gains that an action sets."""
    max_cycles: Count = 120
    """actions until the episode is truncated."""
    terminate_on_collision: bool = False
    """whether the episode ends once a robot touches anything."""
    terminate_on_success: bool = False
    """whether the episode ends once the bound is at `success`."""
    success: tuple[LengthSd, AngleSd] = (0.05, 1.5)
    """[m, deg] standard deviation of depth or position, and of the heading, that count as success."""
    estimator: Annotated[EstimatorConfig | None, BeforeValidator(_named_estimator)] = "map-alignment"  # type: ignore[assignment]
    """name or configuration of the estimator, or the user's own (`relloc_env.estimators.OwnConfig`); None for the bare
    environment."""
    reward: dict[str, Weight] | None = None
    """weight of each term; None for the default: information gained, less 0.02 for blocked samples."""
    reward_start: Duration = 0.0
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
                f"but has {quote(kind)}"
            )
        for name in ("h", "alpha_lambda", "camera_heights"):
            each = getattr(self.estimator, name, None)
            if isinstance(each, tuple) and len(each) != self.robots:
                raise ValueError(f"must have {self.robots} entries in `estimator.{name}`, but has {len(each)}")
        if self.message_window > 64:
            raise ValueError(
                f"must have latency and jitter of less than 64 samples, but they are {self.message_window}"
            )
        for camera in self.camera:
            if camera.frame_rate is not None and camera.frame_rate > self.sample_rate:
                raise ValueError(
                    f"must have `frame_rate` at most the sample rate {self.sample_rate}, but it is {camera.frame_rate}"
                )
        for robot in self.robot:
            if robot.max_speed * self.sample_period > FASTEST * robot.radius:
                raise ValueError(
                    f"must have robots that move at most {FASTEST:g} times their radius in a sample, but with "
                    f"`robot.max_speed` {robot.max_speed}, `robot.radius` {robot.radius} and `sample_rate` "
                    f"{self.sample_rate} they move more"
                )
        self._check_detectors()
        if self.arena is not None and 2.0 * self.start.margin >= min(self.arena):
            raise ValueError(
                f"must have `start.margin` below half the arena {self.arena}, but it is {self.start.margin}"
            )
        if self.bound is False and self._needs_bound:
            raise ValueError("must not have `bound` false where the reward or `terminate_on_success` needs it")
        if self.poses is not None:
            self.check_poses(self.poses)
        return self

    def _check_detectors(self) -> None:
        """Raise ValueError where a detector of this package cannot find the targets."""
        kind, shown = self.marker.kind, self.look
        for r in {r % len(self.camera) for r in range(self.robots) if self.camera_of(r).kind == "image"}:
            detector = self.detector_of(r)
            if not isinstance(detector, str) or detector not in DETECTORS:
                continue
            if DETECTORS[detector] != kind:
                fits = next(name for name, found in DETECTORS.items() if found == kind)
                raise ValueError(
                    f"must have a `camera.image.detector` that finds the `marker.kind` {kind!r}, such as {fits!r}, but "
                    f"it is {quote(detector)}"
                )
            for m in range(self.targets if kind == "sphere" else 0):
                colour = shown.colour_of(m)
                high = max(colour)
                if high < LEAST_LEVEL or 255.0 * (high - min(colour)) < LEAST_SATURATION * high:
                    raise ValueError(
                        "must have `marker.colours` that the detector `colour` tells from grey: with a greatest "
                        f"channel of {LEAST_LEVEL} or more, the least at most "
                        f"{1.0 - LEAST_SATURATION / 255.0:.0%} of it; but one is {colour}"
                    )

    def check_poses(self, poses: tuple[tuple[float, float, float], ...]) -> None:
        """Raise ValueError where a robot at one of `poses` would stand in a wall, an obstacle, or another robot."""
        for r, (x, y, _) in enumerate(poses):
            radius = self.robot_of(r).radius
            if self.arena is not None and (
                abs(x) + radius > 0.5 * self.arena[0] or abs(y) + radius > 0.5 * self.arena[1]
            ):
                raise ValueError(f"must have robots within the walls, but robot {r} at ({x}, {y}) is not")
            for obstacle in self.obstacles:
                if clearance(obstacle, x, y) < radius:
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

    def detector_of(self, index: int) -> str | Callable[..., Any]:
        """Who finds targets in the pictures of one robot: what is stated, or the one that finds the marker."""
        stated = self.camera_of(index).image.detector
        return next(name for name, kind in DETECTORS.items() if kind == self.marker.kind) if stated is None else stated

    @property
    def look(self) -> MarkerConfig:
        """What targets look like, with a colour for each."""
        return self.marker.for_targets(self.targets)

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

        Raises:
            ConfigError: a detector or an estimator of the user's own that has no place.
        """
        try:
            data = self.model_dump(mode="json")
            if self.estimator is not None:
                stated = self.estimator.model_dump(mode="json", exclude_unset=True)
                data["estimator"] = {"kind": self.estimator.kind, **stated}
        except PydanticSerializationError as error:
            raise ConfigError(str(error).partition("ValueError: ")[2] or str(error)) from None
        return data


def hint(name: str, known: tuple[str, ...] = REWARD_TERMS) -> str:
    """Return a suggestion for a misspelt name, or nothing."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean `{close[0]}`?" if close else ""
