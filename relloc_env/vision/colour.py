"""Coloured spheres found by hue, each to a fraction of a pixel, with the place where its centre is projected."""

import colorsys
import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from relloc_env.samples import Bool, Float
from relloc_env.vision.lens import to_pixels
from relloc_env.vision.outline import from_ellipse, moments
from relloc_env.vision.protocol import Detections, Picture, View

SATURATION = 96
"""Least saturation (of 255) of a target's pixels; the world around is greyer."""
BRIGHTNESS = 30
"""Least greatest channel (of 255) of a target's pixels."""
HUE = 10.0
"""Greatest difference of hue (of 256) from a target's colour; less where colours are closer than twice that."""
LEAST_AREA = 12
"""[px] of a target in the picture."""
MARGIN = 3
"""[px] around what was found that tell the background."""
SHAPE = 0.15
"""Greatest relative difference of the second moments from those of a sphere's image."""


class Blob(NamedTuple):
    """A patch of one colour."""

    box: tuple[int, int, int, int]
    """[px] column, row, width, height."""
    mask: NDArray[np.uint8]
    """(height, width) 1 inside."""
    colour: int


class ColourDetector:
    """Finds coloured spheres: pixels by hue and saturation, patches of them, and the centre of each by moments.

    Each pixel at the rim counts by the share that the sphere covers. A patch whose second moments are not those of a
    sphere's image is something else, or partly hidden.

    Args:
        view: what it looks through, and for; targets of one colour cannot be told apart in one picture.
    """

    def __init__(self, view: View) -> None:
        self._view = view
        painted = [view.marker.colour_of(m) for m in range(view.targets)]
        self._colours = list(dict.fromkeys(painted))
        self._fits: Bool = np.array([[one == other for other in painted] for one in self._colours])
        self._class_of = _classes([_hue(colour) for colour in self._colours])
        rows, columns = np.mgrid[: view.height, : view.width] + 0.5
        self._rays = view.rays(np.stack([columns, rows], axis=-1))
        across, down = np.gradient(self._rays, axis=1), np.gradient(self._rays, axis=0)
        self._areas: Float = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])

    def detect(self, picture: Picture) -> Detections:
        """Find targets in a picture, uint8 (H, W, 3) RGB."""
        found: list[tuple[Float, float, int]] = []
        for blob in self._blobs(picture):
            sight = self._measure(picture, blob)
            if sight is not None:
                found.append((*sight, blob.colour))
        if not found:
            return Detections(np.zeros((0, 2)), np.zeros((0, self._view.targets), np.bool_), np.zeros(0))
        places = np.array([p for p, _, _ in found])
        return Detections(
            to_pixels(places, self._view.intrinsics, self._view.lens),
            self._fits[[colour for *_, colour in found]],
            np.array([score for _, score, _ in found]),
        )

    def _blobs(self, picture: Picture) -> list[Blob]:
        """Patches of the targets' colours."""
        hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV_FULL)
        vivid = cv2.inRange(hsv, (0, SATURATION, BRIGHTNESS), (255, 255, 255))
        left, top, width, height = cv2.boundingRect(vivid)
        if width == 0:
            return []
        part = np.s_[top : top + height, left : left + width]
        classes = cv2.bitwise_and(cv2.LUT(hsv[part][..., 0], self._class_of), vivid[part])
        blobs = []
        for colour in range(len(self._colours)):
            mask = np.equal(classes, colour + 1).view(np.uint8)
            count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
            for label in range(1, count):
                x, y, w, h, area = stats[label].tolist()
                if area >= LEAST_AREA:
                    inside = np.equal(labels[y : y + h, x : x + w], label).view(np.uint8)
                    blobs.append(Blob((left + x, top + y, w, h), inside, colour))
        return blobs

    def _measure(self, picture: Picture, blob: Blob) -> tuple[Float, float] | None:
        """Where the centre of the sphere behind a patch is projected [-] (2,), and its size [px]; None if it is none."""
        x, y, w, h = blob.box
        if x == 0 or y == 0 or x + w == self._view.width or y + h == self._view.height:
            return None
        left, top = max(x - MARGIN, 0), max(y - MARGIN, 0)
        right, bottom = min(x + w + MARGIN, self._view.width), min(y + h + MARGIN, self._view.height)
        inside = np.zeros((bottom - top, right - left), np.uint8)
        inside[y - top : y - top + h, x - left : x - left + w] = blob.mask
        part = np.s_[top:bottom, left:right]
        weight = _cover(picture[part].astype(np.float64), inside) * self._areas[part]
        area = float(weight.sum())
        rays = self._rays[part]
        centre = np.tensordot(weight, rays, 2) / area
        p, q = from_ellipse(centre, area)
        expected = moments(p, q)
        d = rays - centre
        spread = np.einsum("ij,ijk,ijl->kl", weight, d, d) / area
        # a pixel is a square of its own: its moments are in those of the picture
        if np.linalg.norm(spread - expected) > SHAPE * np.linalg.norm(expected):
            return None
        return p, area


def _cover(colours: Float, inside: NDArray[np.uint8]) -> Float:
    """Share of each pixel that the sphere covers, from its colours (h, w, 3).

    A pixel is a mixture of the sphere's colour, however bright, and of the grey around. What it has at right angles to
    the former is the share of the grey in it.
    """
    near = cv2.dilate(inside, _SQUARE, iterations=2).astype(np.bool_)
    paint = colours[inside.astype(np.bool_)].sum(axis=0)
    paint /= math.sqrt(paint @ paint)
    across = np.ones(3) - paint.sum() * paint
    grey = colours @ across
    around = float(np.median(grey[~near])) if not near.all() else float(grey.max())
    return np.where(near, np.clip(1.0 - grey / max(around, 1e-6), 0.0, 1.0), 0.0)


_SQUARE = np.ones((3, 3), np.uint8)


def _hue(colour: tuple[int, int, int]) -> float:
    """Hue of 256."""
    return 256.0 * colorsys.rgb_to_hsv(*(level / 255.0 for level in colour))[0]


def _classes(hues: list[float]) -> NDArray[np.uint8]:
    """(256,) which colour each hue is, counted from 1; 0 for none."""
    away = np.abs((np.arange(256)[:, None] - np.array(hues) + 128.0) % 256.0 - 128.0)
    nearest = np.argmin(away, axis=1)
    return np.where(away.min(axis=1) <= HUE, nearest + 1, 0).astype(np.uint8)
