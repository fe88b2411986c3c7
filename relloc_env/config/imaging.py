"""How cameras take pictures, what targets look like in them, and who finds them there."""

import colorsys
from collections.abc import Callable
from typing import Any, Literal

from pydantic import field_serializer, field_validator

from relloc_env.config.base import Colour, Model
from relloc_env.places import place_of
from relloc_env.quantities import Duration, Length, LensCoefficient, LevelNoise, Light, PixelSd
from relloc_env.quoting import quote

PALETTE: tuple[Colour, ...] = (
    (214, 40, 40), (30, 90, 214), (40, 170, 60), (232, 190, 20), (190, 40, 190), (20, 180, 190), (236, 120, 20),
    (110, 60, 210),
)  # fmt: skip
"""Colours of up to eight targets in pictures, far apart in hue."""
MOST_HUES = 24
"""Even hues that the colour detector still tells apart; with more targets they repeat."""
SATURATION = 96
"""Least saturation (of 255) of what the colour detector takes for a target's pixels; the world around is greyer."""
LEAST_SATURATION, LEAST_LEVEL = 102, 40
"""Least saturation and greatest channel (of 255) of a target's colour, which light and noise make greyer."""

DETECTORS = {"colour": "sphere", "apriltag": "tag"}
"""Those of this package, and the kind of marker that each finds."""


class MarkerConfig(Model):
    """What a target looks like in pictures."""

    kind: Literal["sphere", "tag"] = "sphere"
    """a coloured sphere, or an upright AprilTag (family 36h11, id of the target's number) that faces the camera."""
    radius: Length = 0.1
    """[m] of the sphere."""
    size: Length = 0.4
    """[m] edge of the tag, without its white border."""
    colours: tuple[Colour, ...] | None = None
    """of the spheres, in turn; None: eight hues, or for more targets as many even hues, up to 24."""

    @field_validator("colours")
    @classmethod
    def _coloured(cls, value: tuple[Colour, ...] | None) -> tuple[Colour, ...] | None:
        if value is not None and not value:
            raise ValueError("must have at least one colour, but has none")
        return value

    def colour_of(self, target: int) -> Colour:
        """Colour of a target."""
        colours = self.colours or PALETTE
        return colours[target % len(colours)]

    def for_targets(self, count: int) -> "MarkerConfig":
        """The same with the colours of so many targets, where none are stated."""
        if self.colours is not None or count <= len(PALETTE):
            return self
        return self.model_copy(update={"colours": _even_hues(min(count, MOST_HUES))})


class ImageConfig(Model):
    """How a camera's pictures come about, and who finds the targets in them."""

    exposure: Light = 1.0
    """brightness of the picture; 1 is well lit."""
    white_balance: tuple[Light, Light, Light] = (1.0, 1.0, 1.0)
    """gain of red, green and blue: the colour of the light."""
    noise: LevelNoise = 2.0
    """[levels of 255] standard deviation of each channel of a pixel."""
    shutter: Duration = 0.0
    """[s] time for which the shutter is open, around the time of the sample; motion blurs the picture meanwhile."""
    distortion: tuple[LensCoefficient, LensCoefficient, LensCoefficient, LensCoefficient, LensCoefficient] = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    """k1, k2, p1, p2, k3 of the lens, as OpenCV has them; robots know them."""
    detection_noise: PixelSd = 0.02
    """[px] standard deviation of each coordinate of a detection, as estimators are told. The default is more than the
    colour detector has in plain pictures (docs/vision.md), and less than it has with blur, glare or tags."""
    detector: str | Callable[..., Any] | None = None
    """who finds targets: `colour`, `apriltag`, or a factory of the user's own (`relloc_env.vision.protocol`) or its
    place, `module:Name` or `path/to/file.py:Name`. None: `colour` for spheres, `apriltag` for tags."""

    @field_validator("distortion", mode="before")
    @classmethod
    def _five(cls, value: Any) -> Any:
        if isinstance(value, list | tuple) and len(value) != 5:
            raise ValueError(f"must be five numbers k1, k2, p1, p2, k3, but is {quote(value)}")
        return value

    @field_validator("detector", mode="before")
    @classmethod
    def _known(cls, value: Any) -> Any:
        known = value in DETECTORS or ":" in value if isinstance(value, str) else value is None or callable(value)
        if not known:
            raise ValueError(f"must be one of {', '.join(DETECTORS)}, a factory or its place, but is {quote(value)}")
        return value

    @field_serializer("detector", when_used="json")
    def _as_place(self, value: Any) -> str | None:
        if value is None or isinstance(value, str):
            return value
        place = place_of(value)
        if place is None:
            raise ValueError(
                "Argument `camera.image.detector` must be a class or function that its module has by name, or "
                f"'path/to/file.py:Name', to be written down as plain data, but is {quote(value)}"
            )
        return place


def _even_hues(count: int) -> tuple[Colour, ...]:
    """So many colours, as far apart in hue as can be."""
    found = (colorsys.hsv_to_rgb(i / count, 0.82, 0.88) for i in range(count))
    return tuple((round(255.0 * red), round(255.0 * green), round(255.0 * blue)) for red, green, blue in found)
