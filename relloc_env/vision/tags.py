"""AprilTags (family 36h11), drawn for targets and found by OpenCV."""

import numpy as np
from numpy.typing import NDArray

from relloc_env.extras import extra
from relloc_env.samples import Float
from relloc_env.vision.lens import to_pixels
from relloc_env.vision.protocol import Detections, Detector, Picture, View

with extra("vision"):
    import cv2


_CELLS = 8
"""Cells along the edge of a tag, without the white border."""


def _family() -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def tag_cells(count: int) -> NDArray[np.float32]:
    """(count, 10, 10) cells of the first tags with a white border, from 0 for black to 1 for white."""
    family = _family()
    tags = [cv2.aruco.generateImageMarker(family, m, _CELLS) for m in range(count)]
    return np.pad(np.array(tags, np.float32) / 255.0, ((0, 0), (1, 1), (1, 1)), constant_values=1.0)


def open_detector(view: View) -> Detector:
    """The detector of this module."""
    return TagDetector(view)


class TagDetector:
    """Finds tags by OpenCV; the id says which target it is. A tag's centre is where its diagonals cross.

    Args:
        view: what it looks through, and for.
    """

    def __init__(self, view: View) -> None:
        options = cv2.aruco.DetectorParameters()
        options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        options.minMarkerPerimeterRate = 0.02
        self._detector = cv2.aruco.ArucoDetector(_family(), options)
        self._view = view

    def detect(self, picture: Picture) -> Detections:
        """Find tags in a picture, uint8 (H, W, 3) RGB."""
        corners, ids, _ = self._detector.detectMarkers(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
        numbers = [] if ids is None else [int(m) for m in ids.ravel()]
        found = [(m, c) for m, c in zip(numbers, corners, strict=True) if m < self._view.targets]
        shapes = [np.asarray(c, np.float64).reshape(4, 2) + 0.5 for _, c in found]  # a pixel's centre is at 0.5 here
        fits = np.zeros((len(found), self._view.targets), np.bool_)
        for d, (m, _) in enumerate(found):
            fits[d, m] = True
        # Lines are straight in the ideal camera's image, not behind a lens that distorts.
        rays = np.array([_crossing(self._view.rays(shape)) for shape in shapes]).reshape(-1, 2)
        pixels = to_pixels(rays, self._view.intrinsics, self._view.lens)
        return Detections(pixels, fits, np.array([cv2.contourArea(shape.astype(np.float32)) for shape in shapes]))


def _crossing(corners: Float) -> Float:
    """Where the diagonals of a quadrilateral (4, 2) cross."""
    a, b = corners[2] - corners[0], corners[3] - corners[1]
    side = corners[1] - corners[0]
    t = (side[0] * b[1] - side[1] * b[0]) / (a[0] * b[1] - a[1] * b[0])
    crossing: Float = corners[0] + t * a
    return crossing
