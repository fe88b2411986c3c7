"""What all configurations are built of."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Pair = tuple[NonNegative, NonNegative]
Range = tuple[Finite, Finite]
Bounds = tuple[Positive, Positive]
Vector3 = tuple[Finite, Finite, Finite]
Level = Annotated[int, Field(ge=0, le=255)]
Colour = tuple[Level, Level, Level]
"""Red, green, blue."""


class Model(BaseModel):
    """Base of all configurations: frozen and strict about names."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)
