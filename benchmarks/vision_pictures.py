"""The pictures of docs/vision.md: what cameras take, with what is found in it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import load_config
from relloc_env.extras import extra
from relloc_env.folders import open_folder
from relloc_env.vision import make_detector
from relloc_env.vision.sensor import Sensor

with extra("vision"):
    import cv2


POSES = np.array([[-2.4, -0.3, 0.12], [0.2, 0.75, 2.6]])
POINTS = np.array([[2.2, 1.35, 0.75], [3.0, -0.1, 0.55], [1.2, -1.1, 0.28], [-1.25, 0.62, 0.42]])
"""Of the last, a part is out of the picture."""
OBSTACLES = (
    {"shape": "disc", "position": (0.4, -0.75), "radius": 0.06, "height": 1.0},
    {"shape": "box", "position": (1.6, 2.2), "size": (1.2, 0.4), "angle": 0.5, "height": 0.9},
)
HARD: tuple[tuple[str, Mapping[str, Any]], ...] = (
    ("a third of the light", {"exposure": 0.33}),
    ("warm light, noise of 10 levels", {"white_balance": (1.15, 1.0, 0.75), "noise": 10.0}),
    ("open for 40 ms, turning at 0.8 rad/s", {"shutter": 0.04}),
    ("a lens that distorts", {"distortion": (-0.35, 0.1, 0.0, 0.0, 0.0)}),
)
SCENE: Mapping[str, Any] = {"targets": 4, "obstacles": OBSTACLES}


def draw(out: Path) -> list[Path]:
    """Write `vision_found.png`, `vision_hard.png` and `vision_tags.png` into a folder."""
    out = open_folder(out)
    tags = {"detector": "apriltag"}
    pictures = {
        "vision_found.png": _take({}),
        "vision_hard.png": np.vstack(
            [np.hstack([_small(_take(image), words) for words, image in HARD[k : k + 2]]) for k in (0, 2)]
        ),
        "vision_tags.png": _take(tags, marker={"kind": "tag"}),
    }
    for name, picture in pictures.items():
        cv2.imwrite(str(out / name), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return [out / name for name in pictures]


def _take(image: Mapping[str, Any], **options: Any) -> NDArray[np.uint8]:
    """One picture, with a cross where the detector finds a target."""
    config = load_config(None, camera={"kind": "image", "image": image}, **SCENE, **options)
    sensor = Sensor(config, 0)
    picture = np.zeros((sensor.view.height, sensor.view.width, 3), np.uint8)
    motion = np.array([[[0.0, 0.0, 0.8], [0.0, 0.0, 0.0]]])
    sensor.take(picture[None], POSES[None], motion, POINTS[None], np.zeros(1, np.uint64))
    for x, y in make_detector(config, 0).detect(picture).pixels - 0.5:
        centre = (round(16 * x), round(16 * y))
        for a, b in ((144, 0), (0, 144)):  # sixteenths of a pixel
            ends = (centre[0] - a, centre[1] - b), (centre[0] + a, centre[1] + b)
            for colour, width in (((255, 255, 255), 3), ((0, 0, 0), 1)):
                cv2.line(picture, *ends, colour, width, cv2.LINE_AA, 4)
    return picture


def _small(picture: NDArray[np.uint8], words: str) -> NDArray[np.uint8]:
    """The picture smaller, with words on it."""
    small = cv2.resize(picture, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    cv2.rectangle(small, (0, 0), (300, 30), (255, 255, 255), cv2.FILLED)
    cv2.putText(small, words, (10, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1, cv2.LINE_AA)
    return np.asarray(small, np.uint8)
