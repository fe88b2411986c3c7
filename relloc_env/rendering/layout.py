"""Where the parts of a picture are: the map, the cameras' images, the strips of numbers over time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from relloc_env.rendering.canvas import Box
from relloc_env.rendering.scene import CameraGeometry

_WIDE = 1.3
"""Least width over height at which strips are below the images; else they are below the map."""


@dataclass(frozen=True)
class Layout:
    """Where the parts are [px], how large markers are (`ui` = 1 at 960 x 540), and letters [px]."""

    ui: float
    letters: float
    header: Box
    world: Box
    images: tuple[Box, ...]
    strips: tuple[Box, ...]


def layout(size: tuple[int, int], cameras: Sequence[CameraGeometry], strips: int) -> Layout:
    """Share a picture out: letters and markers not too small, the map as large as the rest leaves it.

    Wide pictures have the map at the left, and at the right the cameras' images above the strips. In others the strips
    are at the foot, two in a row.
    """
    width, height = size
    unit = min(width / 960.0, height / 540.0) if width >= _WIDE * height else min(width, height) / 640.0
    letters = max(9.0, 11.5 * unit)
    pad, head = max(6.0, 12.0 * unit), 2.3 * letters
    if width >= _WIDE * height:
        tall = height - 2.0 * pad
        side = min(tall, 0.58 * (width - 3.0 * pad))
        world = (pad, pad, side, tall)
        left, right = side + 2.0 * pad, width - pad
        header = (left, pad, right - left, head)
        top = pad + head
        area = (left, top, right - left, height - pad - top)
        images, bottom = _images(area, cameras, letters, pad, 0.5 if strips else 1.0, _rows(len(cameras), 2))
        boxes = _strips((left, bottom, right - left, height - pad - bottom), strips, 1, pad)
    else:
        rows = math.ceil(strips / 2)
        foot = max(0.16 * height, 5.5 * letters) * rows
        header = (pad, pad, width - 2.0 * pad, head)
        top = pad + head
        tall = height - top - pad - (foot + pad if rows else 0.0)
        side = min(tall, 0.64 * (width - 3.0 * pad))
        world = (pad, top, side, tall)
        left = side + 2.0 * pad
        images, _ = _images((left, top, width - pad - left, tall), cameras, letters, pad, 1.0, _rows(len(cameras), 1))
        boxes = _strips((pad, height - pad - foot, width - 2.0 * pad, foot), strips, 2, pad)
    return Layout(max(unit, 0.7), letters, header, world, images, boxes)


def _rows(count: int, columns: int) -> int:
    """Rows of images: one column, or `columns`, as long as they are three or less in a row."""
    return math.ceil(count / columns) if columns > 1 or count <= 3 else math.ceil(count / 2)


def _images(
    area: Box, cameras: Sequence[CameraGeometry], letters: float, pad: float, share: float, rows: int
) -> tuple[tuple[Box, ...], float]:
    """Boxes of the images, each below its caption, in at most `share` of an area; and where they end."""
    left, top, width, height = area
    columns, caption = math.ceil(len(cameras) / rows), 1.7 * letters
    aspect = max(camera.width / camera.height for camera in cameras)
    highest = (share * height - (rows - 1) * pad) / rows - caption
    wide = min((width - (columns - 1) * pad) / columns, highest * aspect)
    tall = wide / aspect
    boxes = []
    for robot, camera in enumerate(cameras):
        fit = min(wide, tall * camera.width / camera.height)
        x, y = left + robot % columns * (wide + pad), top + caption + robot // columns * (tall + caption + pad)
        boxes.append((x, y, fit, fit * camera.height / camera.width))
    return tuple(boxes), top + rows * (tall + caption) + rows * pad


def _strips(area: Box, count: int, columns: int, pad: float) -> tuple[Box, ...]:
    """Boxes of strips, row by row; the last one of an odd number is as wide as the area."""
    left, top, width, height = area
    rows = math.ceil(count / columns)
    boxes = []
    for k in range(count):
        row, column = divmod(k, columns)
        share = columns if k < count - 1 or count % columns == 0 else 1
        wide, tall = (width - (share - 1) * pad) / share, (height - (rows - 1) * 0.5 * pad) / rows
        boxes.append((left + column * (wide + pad), top + row * (tall + 0.5 * pad), wide, tall))
    return tuple(boxes)
