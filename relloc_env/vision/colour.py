"""Coloured spheres found by hue, each to a fraction of a pixel, with the place where its centre is projected."""

import colorsys
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.config.imaging import SATURATION
from relloc_env.extras import extra
from relloc_env.samples import Bool, Float
from relloc_env.vision.lens import picture_rays, to_pixels
from relloc_env.vision.outline import agreement, area_of, from_ellipse, from_rim, moments, refined
from relloc_env.vision.protocol import Detections, Detector, Picture, View

with extra("vision"):
    import cv2


BRIGHTNESS, OF_LIGHT = 30, 0.3
"""Least greatest channel (of 255) of a target's pixels, or as much of that of the picture's median if it is less."""
DARK, NIGHT = 45, 12
"""Greatest channel of the picture's median below which colours are told from neighbouring pixels together, since noise
has colours; and below which nothing is."""
HUE = 10.0
"""Greatest difference of hue (of 256) from a target's colour; less where colours are closer than twice that."""
LEAST_AREA = 12
"""[px] of a target in the picture."""
MARGIN = 5
"""[px] around what was found that tell the background."""
REACH, FALL = 9, 1.0
"""[px] edge of the square in which the grey around a pixel is looked for, and standard deviation of the weights there:
the nearest count most."""
LEAST_ROUND = 0.8
"""Share of the edge that must be on the outline of a sphere that shows whole."""
BLURRED, SMEARED = 1.4, 1.0
"""An edge so many times as wide as a sharp one is blurred by motion; then the second moments may differ by so much from
those of a sphere's image."""
LEAST_RIM, LEAST_PART = 0.5, 0.35
"""Shares of the edge that must be the sphere's outline, and of the sphere's image that must show."""

UNSURE = 0.1
"""[px] A centre whose standard deviation is greater, by the scatter of the edge about the outline, is not known."""


class Blob(NamedTuple):
    """A patch of one colour."""

    box: tuple[int, int, int, int]
    """[px] column, row, width, height."""
    mask: NDArray[np.uint8]
    """(height, width) 1 inside."""
    colour: int


def open_detector(view: View) -> Detector:
    """The detector of this module."""
    return ColourDetector(view)


class ColourDetector:
    """Finds coloured spheres: pixels by hue and saturation, patches of them, and the centre of each by moments.

    Each pixel at the rim counts by the share that the sphere covers. Where the edge is not the outline of a sphere, a
    part is hidden, or out of the picture: the outline is fitted to what shows of it. Or else it is something else.

    Args:
        view: what it looks through, and for; targets of one colour cannot be told apart in one picture.
    """

    def __init__(self, view: View) -> None:
        self._view = view
        painted = [view.marker.colour_of(m) for m in range(view.targets)]
        self._colours = list(dict.fromkeys(painted))
        self._fits: Bool = np.array([[one == other for other in painted] for one in self._colours])
        self._class_of = _classes([_hue(colour) for colour in self._colours])
        self._rays = picture_rays(view.width, view.height, view.intrinsics, view.lens)
        across, down = np.gradient(self._rays, axis=1), np.gradient(self._rays, axis=0)
        self._areas: Float = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])

    def detect(self, picture: Picture) -> Detections:
        """Find targets in a picture, uint8 (H, W, 3) RGB."""
        found: list[tuple[Float, float, int]] = []
        white = np.median(picture[4::8, 4::8].reshape(-1, 3), axis=0)
        for blob in self._blobs(picture, white):
            sight = self._measure(picture, blob, dark=white.max() < DARK)
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

    def _blobs(self, picture: Picture, white: Float) -> list[Blob]:
        """Patches of the targets' colours."""
        light = float(white.max())
        if light < NIGHT:
            return []
        balanced = _balanced(picture, white)
        if light < DARK:
            balanced = np.asarray(cv2.blur(balanced, (3, 3)), np.uint8)
        hsv = cv2.cvtColor(balanced, cv2.COLOR_RGB2HSV_FULL)
        vivid = cv2.inRange(hsv, (0, SATURATION, min(BRIGHTNESS, OF_LIGHT * light)), (255, 255, 255))
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

    def _measure(self, picture: Picture, blob: Blob, *, dark: bool) -> tuple[Float, float] | None:
        """Where the centre of the sphere behind a patch is projected [-] (2,), and its size [px]; None for none."""
        x, y, w, h = blob.box
        width, height = self._view.width, self._view.height
        left, top = max(x - MARGIN, 0), max(y - MARGIN, 0)
        right, bottom = min(x + w + MARGIN, width), min(y + h + MARGIN, height)
        inside = np.zeros((bottom - top, right - left), np.uint8)
        inside[y - top : y - top + h, x - left : x - left + w] = blob.mask
        part = np.s_[top:bottom, left:right]
        cover, rays = _cover(picture[part].astype(np.float32), inside), self._rays[part]
        weight = cover * self._areas[part]
        area = float(weight.sum())
        rim = (cover > 0.1) & (cover < 0.9)
        if dark:  # noise makes pixels within look half covered
            rim &= cv2.erode(inside, _SQUARE) == 0
        edge = (rays[rim], cover[rim] - 0.5, 1.0 / float(self._view.intrinsics[0]))
        size = float(cover.sum())
        if x > 0 and y > 0 and x + w < width and y + h < height:
            centre = np.tensordot(weight, rays, 2) / area
            p, q = from_ellipse(centre, area)
            on = agreement(*edge, p, q)
            if on > LEAST_ROUND:
                fit = refined(*edge, p, q)
                if fit is not None and fit.sd < UNSURE:
                    return fit.p, on * size
            d = rays - centre
            spread, expected = np.einsum("ij,ijk,ijl->kl", weight, d, d) / area, moments(p, q)
            soft = rim.sum() / math.sqrt(4.0 * math.pi * size)
            if not dark and soft > BLURRED and np.linalg.norm(spread - expected) < SMEARED * np.linalg.norm(expected):
                return p, on * size
        return _part(edge, area, size)


def _part(edge: tuple[Float, Float, float], area: float, size: float) -> tuple[Float, float] | None:
    """The same of a sphere of which a part is hidden, or out of the picture: by its outline alone."""
    fit = from_rim(*edge)
    if fit is None:
        return None
    share = float(fit.on.mean())
    if share < LEAST_RIM or fit.sd > UNSURE or not LEAST_PART < area / area_of(fit.p, fit.q) < 1.1:
        return None
    return fit.p, share * size


def _balanced(picture: Picture, white: Float) -> Picture:
    """The picture as if the light were white, which is what most of the world looks like."""
    gains = white.max() / np.maximum(white, 1.0)
    if gains.max() < 1.08:
        return picture
    levels = np.minimum(np.arange(256)[:, None] * gains, 255.0)
    return np.asarray(cv2.LUT(picture, levels.astype(np.uint8)[None]), np.uint8)


def _cover(colours: NDArray[np.float32], inside: NDArray[np.uint8]) -> Float:
    """Share of each pixel that the sphere covers, from its colours (h, w, 3).

    A pixel is a mixture of the sphere's colour, however bright, and of the grey around. What it has at right angles to
    the former is the share of the grey in it; how bright that grey is, the nearest pixels outside say.
    """
    near = cv2.dilate(inside, _SQUARE, iterations=2)
    within = cv2.erode(inside, _SQUARE)  # without the rim, if there is more than that
    paint = colours[(within if within.any() else inside).astype(np.bool_)].sum(axis=0)
    paint /= math.sqrt(paint @ paint)
    grey = colours @ (np.ones(3, np.float32) - paint.sum() * paint)
    outside = (1 - cv2.dilate(inside, _SQUARE)).astype(np.float32)
    count = cv2.GaussianBlur(outside, (REACH, REACH), FALL)
    around = cv2.GaussianBlur(grey * outside, (REACH, REACH), FALL) / np.maximum(count, 1e-6)
    known = count > 1e-3
    around = np.where(known, around, around[known].mean() if known.any() else grey.max())
    return np.where(near > 0, np.clip(1.0 - grey / np.maximum(around, 1e-6), 0.0, 1.0), 0.0).astype(np.float64)


_SQUARE = np.ones((3, 3), np.uint8)


def _hue(colour: tuple[int, int, int]) -> float:
    """Hue of 256."""
    return 256.0 * colorsys.rgb_to_hsv(*(level / 255.0 for level in colour))[0]


def _classes(hues: list[float]) -> NDArray[np.uint8]:
    """(256,) which colour each hue is, counted from 1; 0 for none."""
    away = np.abs((np.arange(256)[:, None] - np.array(hues) + 128.0) % 256.0 - 128.0)
    nearest = np.argmin(away, axis=1)
    return np.where(away.min(axis=1) <= HUE, nearest + 1, 0).astype(np.uint8)
