"""What a detector is: it is told once what it looks through and for, then finds targets in one picture at a time.

A detector remembers nothing; `relloc_env.vision.tracking` follows what it finds from picture to picture.
"""

import importlib
from collections.abc import Callable
from typing import NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig, MarkerConfig
from relloc_env.places import load
from relloc_env.samples import Bool, Float
from relloc_env.vision.lens import from_pixels

Picture = NDArray[np.uint8]
BUILT_IN = {"colour": "colour", "apriltag": "tags"}
"""Where the detectors of this package are."""


class View(NamedTuple):
    """What a robot knows of its camera and of the targets."""

    width: int
    """[px]"""
    height: int
    """[px]"""
    intrinsics: Float
    """[px] (4,) f_x, f_y, c_x, c_y. The corner of the picture is (0, 0), the centre of its first pixel (0.5, 0.5)."""
    lens: Float
    """(5,) k1, k2, p1, p2, k3, as OpenCV has them."""
    marker: MarkerConfig
    """What targets look like."""
    targets: int
    """How many there are."""

    def rays(self, pixels: Float) -> Float:
        """Return the normalised image coordinates (..., 2) of the ideal camera at pixels (..., 2).

        Outside the picture a strong lens may show nothing there: they are NaN.
        """
        return from_pixels(pixels, self.intrinsics, self.lens)


class Detections(NamedTuple):
    """What was found in one picture: D things that may be targets."""

    pixels: Float
    """[px] (D, 2) column and row where the centre of each is projected, from the picture's upper left corner."""
    fits: Bool
    """(D, M) whether it may be target m, as far as a single picture tells."""
    score: Float
    """(D,) which to prefer where several fit: the greater."""


class Detector(Protocol):
    """Finds targets in pictures."""

    def detect(self, picture: Picture) -> Detections:
        """Find targets in a picture, uint8 (H, W, 3) RGB."""


def view_of(config: EnvConfig, robot: int, size: tuple[int, int] | None = None) -> View:
    """What a robot knows of its camera; a picture of another size [px] (width, height) shows the same view."""
    camera = config.camera_of(robot)
    width, height = size or (camera.width, camera.height)
    x, y = width / camera.width, height / camera.height
    focal, (c_x, c_y) = camera.focal_length, camera.principal_point
    intrinsics = np.array([x * focal, y * focal, x * c_x, y * c_y])
    return View(width, height, intrinsics, np.array(camera.image.distortion), config.look, config.targets)


def make_detector(config: EnvConfig, robot: int) -> Detector:
    """Build the detector that a robot's camera is configured with.

    Raises:
        MissingExtraError: OpenCV is missing for one of the built-in ones.
        ValueError, TypeError: a name that leads nowhere, or to what makes no detector.
    """
    view, given = view_of(config, robot), config.detector_of(robot)
    if given in BUILT_IN:
        module = importlib.import_module(f"relloc_env.vision.{BUILT_IN[str(given)]}")
        built: Detector = module.open_detector(view)
        return built
    factory = load(given, "detector") if isinstance(given, str) else given
    made = cast("Callable[[View], Detector]", factory)(view)
    if not callable(getattr(made, "detect", None)):
        raise TypeError(f"Argument `detector` must make something with `detect`, but it makes {type(made).__name__}")
    return made
