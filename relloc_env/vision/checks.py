"""Detectors of the user's own: a look at what they find before anything is made of it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.vision.protocol import Detections, Detector, Picture, View


def find(detector: Detector, picture: Picture, view: View) -> Detections:
    """Return what a detector finds in a picture, as arrays of the right form.

    Raises:
        RuntimeError: the detector raised.
        TypeError: something else than `Detections`.
        ValueError: arrays of another shape or type, numbers that are not finite, or pixels farther out of the picture
            than it is wide or high.
    """
    name = type(detector).__name__
    try:
        found: Any = detector.detect(picture)
    except Exception as error:
        raise RuntimeError(
            f"Detector `{name}` must find targets in any picture, but raised {type(error).__name__}: {error}"
        ) from error
    if not isinstance(found, Detections):
        raise TypeError(
            f"Detector `{name}` must return `relloc_env.vision.Detections`, but returned {type(found).__name__}"
        )
    pixels = _array(name, "pixels", found.pixels, "iuf", (None, 2))
    fits = _array(name, "fits", found.fits, "b", (len(pixels), view.targets))
    score = _array(name, "score", found.score, "iuf", (len(pixels),))
    size = np.array([view.width, view.height])
    out = (pixels < -size) | (pixels > 2 * size)
    if out.any():
        raise ValueError(
            f"Detector `{name}` must find `pixels` in the picture of {view.width} × {view.height} or at most its size "
            f"out of it, but found {pixels[out.any(axis=1)][0].tolist()}"
        )
    return Detections(pixels, fits, score)


def _array(name: str, what: str, given: Any, kinds: str, shape: tuple[int | None, ...]) -> NDArray[Any]:
    """One part, if it is what it should be; None in a shape is any length."""
    try:
        array = np.asarray(given)
    except ValueError:  # ragged lists
        array = np.array(None)
    fitting = len(array.shape) == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fitting or array.dtype.kind not in kinds:
        words = "(" + ", ".join("D" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
        kind = "booleans" if kinds == "b" else "numbers"
        has = f"{array.dtype} of shape {array.shape}" if array.dtype.kind != "O" else repr(given)
        raise ValueError(f"Detector `{name}` must find `{what}` as {kind} of shape {words}, but found {has}")
    if kinds == "b":
        return array
    if not np.isfinite(array).all():
        raise ValueError(f"Detector `{name}` must find finite `{what}`, but found {array.tolist()}")
    return array.astype(np.float64)
