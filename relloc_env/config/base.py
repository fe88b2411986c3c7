"""What all configurations are built of."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Level = Annotated[int, Field(ge=0, le=255)]
Colour = tuple[Level, Level, Level]
"""Red, green, blue."""


class Model(BaseModel):
    """Base of all configurations: frozen and strict about names."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)
