"""Quantities of configurations, with the limits within which everything that is computed from them stays finite.

The limits are wide: no robot is meant to be near them. A value beyond is a slip of the unit or of the exponent.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema


@dataclass(frozen=True)
class Limits:
    """Least and greatest value of a number, in a type: `Annotated[float, Limits(0.0, 1.0, "m")]`."""

    ge: float
    le: float
    unit: str = ""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def _check(self, value: Any) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError("must be a finite number")
        if self.ge > 0.0 >= value:
            raise ValueError("must be greater than 0")
        if self.ge == 0.0 > value:
            raise ValueError("must be greater than or equal to 0")
        if not self.ge <= value <= self.le:
            raise ValueError(f"must be from {self.ge:.12g} to {self.le:.12g} {self.unit}".rstrip())
        return value


Length = Annotated[float, Limits(1e-3, 1e5, "m")]
"""Of what has a size."""
Distance = Annotated[float, Limits(0.0, 1e5, "m")]
Coordinate = Annotated[float, Limits(-1e8, 1e8, "m")]
"""In the world; coordinates of maps (UTM) have their place in it."""
Height = Annotated[float, Limits(-1e5, 1e5, "m")]
"""Of a point above the floor or a camera."""
LengthSd = Annotated[float, Limits(1e-6, 1e6, "m")]
"""Standard deviation of what is not exact."""
InverseLength = Annotated[float, Limits(1e-6, 1e3, "1/m")]
Angle = Annotated[float, Limits(-1e3, 1e3, "rad")]
HalfTurn = Annotated[float, Limits(0.0, 180.0, "degrees")]
AngleError = Annotated[float, Limits(0.0, 1e4, "degrees")]
AngleSd = Annotated[float, Limits(1e-4, 1e4, "degrees")]
Pose = tuple[Coordinate, Coordinate, Angle]
Point = tuple[Coordinate, Coordinate, Height]

Rate = Annotated[float, Limits(0.01, 1e4, "Hz")]
Duration = Annotated[float, Limits(0.0, 1e6, "s")]
Period = Annotated[float, Limits(1e-6, 1e6, "s")]

Speed = Annotated[float, Limits(1e-6, 1e3, "m/s")]
YawRate = Annotated[float, Limits(1e-6, 100.0, "rad/s")]
SpeedSd = Annotated[float, Limits(0.0, 100.0, "m/s")]
YawRateSd = Annotated[float, Limits(0.0, 100.0, "rad/s")]
MotionSd = tuple[SpeedSd, YawRateSd]
"""Of speed and yaw rate."""
Mass = Annotated[float, Limits(1e-3, 1e6, "kg")]

Pixels = Annotated[int, Field(gt=0, le=8192)]
"""A side of a picture."""
PixelDistance = Annotated[float, Limits(0.0, 1e3, "px")]
PixelSd = Annotated[float, Limits(1e-6, 1e3, "px")]
PixelCoordinate = Annotated[float, Limits(-1e5, 1e5, "px")]
FocalLength = Annotated[float, Limits(1e-3, 1e7, "px")]
ImageNoise = Annotated[float, Limits(0.0, 10.0)]
"""Of normalised image coordinates."""
ImageSd = Annotated[float, Limits(1e-6, 10.0)]
"""The same, where there must be some."""
Light = Annotated[float, Limits(1e-3, 1e3)]
"""Times the light of a well-lit picture."""
LevelNoise = Annotated[float, Limits(0.0, 255.0)]
LensCoefficient = Annotated[float, Limits(-100.0, 100.0)]

Chance = Annotated[float, Field(ge=0.0, le=1.0)]
Gain = Annotated[float, Limits(1e-6, 1e6)]
Scale = Annotated[float, Limits(0.0, 10.0)]
"""Standard deviation of a factor near 1."""
Small = Annotated[float, Limits(1e-12, 1e3)]
"""Below which something ends."""
Weight = Annotated[float, Limits(-1e9, 1e9)]
Count = Annotated[int, Field(ge=1, le=10**9)]
"""Of actions, samples and what is repeated."""
