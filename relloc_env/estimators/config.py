"""Options of the built-in estimators: frozen, validated where they are built, plain data and back without loss."""

import difflib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    field_serializer,
    field_validator,
    model_validator,
)

from relloc_env.places import place_of
from relloc_env.quantities import (
    Chance,
    Count,
    Duration,
    Height,
    ImageNoise,
    ImageSd,
    InverseLength,
    Length,
    LengthSd,
    Limits,
    MotionSd,
    Period,
    Scale,
    Small,
    SpeedSd,
)
from relloc_env.quantities import Gain as OneGain
from relloc_env.quoting import quote

LEAST_IMAGE_NOISE = 1e-4
"""[-] a camera without noise is taken to have this much: covariances stay regular."""

Gain = OneGain | Annotated[tuple[OneGain, ...], Field(min_length=1)]
"""One value for all robots, or one per robot."""


def suggest(word: str, known: list[str]) -> str:
    """Return what to add to an error about an unknown `word`: the nearest known one, if any, and the list."""
    near = difflib.get_close_matches(word, known, n=1)
    guess = f" Did you mean {quote(near[0])}?" if near else ""
    return f"{guess} Known: {', '.join(sorted(known))}."


class EstimatorOptions(BaseModel):
    """Base of all estimator configurations: frozen, finite, and strict about names."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _know_the_names(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    raise ValueError(f"Unknown option {quote(key)}.{suggest(str(key), list(cls.model_fields))}")
        return data


class CascadeConfig(EstimatorOptions):
    """The paper's estimator: a depth observer per point, then a filter for the pose of each ordered pair."""

    kind: Literal["cascade"] = "cascade"

    h: Gain = 2.5
    """[1/s] gain H of the image innovation; not used with `damping="critical"`."""
    alpha_lambda: Gain = 120.0
    """[1/m²] product alpha Lambda of the depth innovation."""
    damping: Literal["fixed", "critical"] = "fixed"
    """`critical`: H = 2 sqrt(alpha Lambda) sigma from the current excitation sigma, not below `h_floor`."""
    h_floor: OneGain = 1.0
    """[1/s] least H with `damping="critical"`."""
    z_min: Length = 0.1
    """[m] least depth."""
    z_max: Length = 100.0
    """[m] greatest depth."""

    pose_model: Literal["position", "velocity", "printed"] = "position"
    """Observation model of the pose filter (docs/equations.md, section 4)."""
    measurement: Literal["fixed", "depth"] = "fixed"
    """Covariance of a point in the pose update: fixed, or from the depth observers of both robots."""
    measurement_sd: LengthSd = 0.05
    """[m; m/s] standard deviation with `measurement="fixed"`, and the floor with `"depth"`."""
    process: Literal["fixed", "odometry"] = "fixed"
    """Process noise of the pose: fixed per sample, or from the odometry noise of both robots."""
    process_sd: LengthSd = 1e-3
    """[m, m, rad] standard deviation of the pose's process noise per sample with `process="fixed"`."""
    use_unseen: bool = False
    """Whether remembered points (known, but not seen at that sample) take part in the pose update."""

    image_noise: ImageNoise = 0.003
    """[-] standard deviation of normalised image coordinates."""
    odometry_noise: MotionSd = (0.01, 0.01)
    """[m/s, rad/s] standard deviation of the odometry of one sample: forward speed, yaw rate."""
    unheard_sd: MotionSd = (0.1, 0.2)
    """[m/s, rad/s] how far the other robot's velocity may be from the last one heard while no message comes."""
    max_gap: Period = 0.3
    """[s] longest gap between two sights of a point that the depth observer bridges as one interval."""

    @model_validator(mode="after")
    def _depths_are_a_range(self) -> "CascadeConfig":
        if self.z_min >= self.z_max:
            raise ValueError(f"Argument `z_max` must be above `z_min` = {self.z_min}, but is {self.z_max}.")
        return self


class MapAlignmentConfig(EstimatorOptions):
    """A joint map per robot, and the pose anew from the two maps at each alignment (docs/equations.md, section 7)."""

    kind: Literal["map-alignment"] = "map-alignment"

    image_noise: ImageSd = 0.003
    """[-] standard deviation of normalised image coordinates (of tan bearing, where only that is measured)."""
    odometry_noise: MotionSd = (0.01, 0.01)
    """[m/s, rad/s] standard deviation of the odometry of one sample: forward speed, yaw rate."""
    lateral_noise: SpeedSd = 0.0
    """[m/s] the same for the lateral speed; 0 where the robot cannot move sideways."""
    noise_period: Period | None = None
    """[s] length of the sample that the odometry noise is for: a sample of length dt has `noise_period`/dt of its
    variance (1.0: the noise is given in m/√s and rad/√s). None: any sample has it, whatever its length."""
    rest_share: Chance = 1.0
    """[-] share of the odometry noise that is left in samples whose measured velocity is exactly zero: below 1 where
    commands are measured, since a robot that is told to stand stands."""
    scale_sd: tuple[Scale, Scale] = (0.0, 0.0)
    """[-] standard deviation of the scales of speed and yaw rate, estimated per robot; 0: exact."""
    turn_loss_sd: Scale = 0.0
    """[m/rad] standard deviation of the forward speed lost per yaw rate in turns, estimated per robot; 0: none."""
    camera_yaw_sd: Scale = 0.0
    """[rad] standard deviation of the camera's yaw in the body, estimated per robot; 0: straight ahead."""
    camera_delay_sd: Duration = 0.0
    """[s] standard deviation of the delay of images behind the odometry, estimated per robot; 0: none."""

    inverse_range_prior: tuple[InverseLength, InverseLength] | None = None
    """[1/m] mean and standard deviation of a point's inverse range at first sight, in place of the depth prior."""
    gate_probability: Annotated[float, Limits(1e-9, 0.499)] = 0.001
    """[-] part of good measurements that the gate against outliers refuses."""
    most_rejections: Count = 5
    """Refusals in a row after which a point's bearing starts anew."""
    forget_after: Period | None = None
    """[s] unseen for longer, a point leaves the map. None: never."""

    camera_heights: tuple[Height, ...] | None = None
    """[m] of the cameras, one per robot. None: all equal."""
    height_sd: Scale = 0.0
    """[m] standard deviation of the difference of two camera heights, estimated with the pose; 0: exact."""
    align_every: Count | Literal["update"] = 1
    """[samples] between two alignments; `update`: one at the last sample of each update (of each action;
    of each sample where messages may be late or lost)."""
    challenger_every: Count = 3
    """[alignments] between two challengers of the global search once the heading is known; one each before. Alignments
    that are ten samples apart or more have six challengers each."""
    grid_period: Period | None = 0.5
    """[s] while the heading is uncertain, the pose comes from a grid of headings, renewed this often. None: never."""
    mirror: bool = True
    """Whether a direction that is aligned from the same two maps as the other takes the inverse of its pose where the
    heading is well known, priors exchanged, and its optimum as the challenger before."""
    unheard_sd: MotionSd = (0.1, 0.2)
    """[m/s, rad/s] how far the other robot's velocity may be from the last one heard while no message comes."""
    iterations: Annotated[int, Field(ge=1, le=1000)] = 30
    """Greatest number of Levenberg-Marquardt steps of an alignment."""
    tolerance: Small = 1e-3
    """[-] an alignment ends where the next step promises to lower its cost C by less."""


class InverseDepthConfig(EstimatorOptions):
    """A Kalman filter of each point on its own, then a filter for the pose of each ordered pair: a simple baseline."""

    kind: Literal["inverse-depth"] = "inverse-depth"

    image_noise: ImageNoise = 0.003
    """[-] standard deviation of normalised image coordinates."""
    odometry_noise: MotionSd = (0.01, 0.01)
    """[m/s, rad/s] standard deviation of the odometry of one sample: forward speed, yaw rate."""
    measurement_sd: LengthSd = 0.05
    """[m] standard deviation of a point in the pose update beside what the filters of both robots claim."""
    use_unseen: bool = False
    """Whether remembered points (known, but not seen at that sample) take part in the pose update."""
    unheard_sd: MotionSd = (0.1, 0.2)
    """[m/s, rad/s] how far the other robot's velocity may be from the last one heard while no message comes."""


class OwnConfig(EstimatorOptions):
    """An estimator of the user's own, built by a class or function of theirs."""

    kind: Literal["own"] = "own"

    factory: Any
    """Called as `factory(num_envs, robots, points, message_window=...)`; returns an `Estimator`. Or where it is:
    `module:Name`, or `path/to/file.py:Name`; as plain data it is always that."""

    @field_validator("factory")
    @classmethod
    def _leads_somewhere(cls, value: Any) -> Any:
        if callable(value):
            return value
        place, _, name = value.rpartition(":") if isinstance(value, str) else ("", "", "")
        if not (place and name):
            raise ValueError(
                "Argument `estimator.factory` must be a class, a function, 'module:Name' or 'path/to/file.py:Name', "
                f"but is {quote(value)}"
            )
        return value

    @field_serializer("factory", when_used="json")
    def _as_path(self, value: Any) -> str:
        if isinstance(value, str):
            return value
        if not self.has_place:
            raise ValueError(
                "Argument `estimator.factory` must be a class or function that its module has by name, or "
                f"'path/to/file.py:Name', to be written down as plain data, but is {quote(value)}"
            )
        return f"{value.__module__}:{value.__qualname__}"

    @property
    def has_place(self) -> bool:
        """Whether the factory is found again by its name: a lambda, a partial or a function inside another is not."""
        return isinstance(self.factory, str) or place_of(self.factory) is not None

    @property
    def name(self) -> str:
        """What to call the estimator in results: the factory's name."""
        return self.factory.rpartition(":")[2] if isinstance(self.factory, str) else _name(self.factory)


def _name(factory: Any) -> str:
    """Name of a class or function, behind a partial too; of anything else that can be called, that of its class."""
    factory = getattr(factory, "func", factory)
    return str(getattr(factory, "__qualname__", type(factory).__qualname__))


BuiltIn = CascadeConfig | InverseDepthConfig | MapAlignmentConfig
"""Configuration of any built-in estimator."""

AnyConfig = BuiltIn | OwnConfig
"""Configuration of any estimator."""

EstimatorConfig = Annotated[AnyConfig, Field(discriminator="kind")]
"""The same in a configuration file, told apart by `kind`."""

PRESETS: Mapping[str, BuiltIn] = MappingProxyType(
    {
        "cascade": CascadeConfig(),
        "cascade-critical": CascadeConfig(damping="critical", measurement="depth", process="odometry"),
        "inverse-depth": InverseDepthConfig(),
        "map-alignment": MapAlignmentConfig(align_every="update"),
        "map-alignment-mocap": MapAlignmentConfig(
            image_noise=0.02,
            odometry_noise=(0.005, 0.005),
            lateral_noise=0.005,
            noise_period=1.0,
            camera_delay_sd=0.1,
            inverse_range_prior=(0.35, 0.3),
            forget_after=300.0,
            grid_period=None,
        ),
        "map-alignment-commands": MapAlignmentConfig(
            image_noise=0.02,
            odometry_noise=(0.03, 0.07),
            lateral_noise=0.01,
            noise_period=1.0,
            rest_share=0.1,
            scale_sd=(0.1, 0.1),
            turn_loss_sd=0.1,
            camera_delay_sd=0.1,
            inverse_range_prior=(0.3, 0.2),
            forget_after=300.0,
            grid_period=None,
        ),
    }
)
"""The registry of names. Those that end in `mocap` and `commands` are for logs of real robots, by where their
velocities come from; they suit cameras that give bearings alone."""

_ADAPTER: TypeAdapter[AnyConfig] = TypeAdapter(EstimatorConfig)


def from_mapping(data: Mapping[str, Any]) -> AnyConfig:
    """Return the configuration that `data` (plain data with a `kind`) describes."""
    kinds: list[str] = sorted({"own"} | {preset.kind for preset in PRESETS.values()})
    if data.get("kind") not in kinds:
        given = data.get("kind", "missing")
        raise ValueError(
            f"Argument `kind` must be the kind of an estimator, but is {quote(given)}.{suggest(str(given), kinds)}"
        )
    return _ADAPTER.validate_python(dict(data))
