"""Detectors of the user's own that find what cannot be, or fail: the error names them."""

from typing import Any

import numpy as np
import pytest

from relloc_env.envs.centralised import RellocEnv
from relloc_env.vision import Detections, View

SMALL = {"kind": "image", "width": 64, "height": 48, "field_of_view": 62.2}


def environment(result: Any, **image: Any) -> RellocEnv:
    """One whose detector finds `result`, or what that makes of the view."""

    class Odd:
        def __init__(self, view: View) -> None:
            self.view = view

        def detect(self, picture: Any) -> Any:
            return result(self.view) if callable(result) else result

    return RellocEnv(camera={**SMALL, "image": {"detector": Odd, **image}}, targets=2, estimator=None)


ONE, FITS, SCORE = np.array([[20.0, 10.0]]), np.array([[True, False]]), np.ones(1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", [0, 1])
def test_pixels_that_are_not_finite_do_not_enter(bad, column) -> None:
    pixels = ONE.copy()
    pixels[0, column] = bad
    with pytest.raises(ValueError, match="Detector `Odd` must find finite `pixels`, but found"):
        environment(Detections(pixels, FITS, SCORE)).reset(seed=1)
    with pytest.raises(ValueError, match="Detector `Odd` must find finite `score`, but found"):
        environment(Detections(ONE, FITS, np.array([bad]))).reset(seed=1)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (None, "return `relloc_env.vision.Detections`, but returned NoneType"),
        ((ONE, FITS, SCORE), "return `relloc_env.vision.Detections`, but returned tuple"),
        (Detections(ONE[0], FITS, SCORE), r"`pixels` as numbers of shape \(D, 2\), but found float64 of shape \(2,\)"),
        (Detections(np.zeros(0), FITS[:0], SCORE[:0]), r"`pixels` as numbers of shape \(D, 2\), .* shape \(0,\)"),
        (Detections(np.array([[1.0, 2.0, 3.0]]), FITS, SCORE), r"`pixels` .* shape \(1, 3\)"),
        (Detections(ONE.astype(str), FITS, SCORE), "`pixels` as numbers"),
        (Detections(None, FITS, SCORE), "`pixels` as numbers .* but found None"),  # type: ignore[arg-type]
        (Detections([[1.0], [2.0, 3.0]], FITS, SCORE), "`pixels` as numbers"),  # type: ignore[arg-type]
        (Detections(ONE, FITS[:, :1], SCORE), r"`fits` as booleans of shape \(1, 2\), but found .* \(1, 1\)"),
        (Detections(ONE, FITS[0], SCORE), r"`fits` as booleans of shape \(1, 2\), but found bool of shape \(2,\)"),
        (Detections(ONE, FITS.astype(float), SCORE), "`fits` as booleans .* but found float64"),
        (Detections(ONE, FITS, SCORE[:0]), r"`score` as numbers of shape \(1,\), but found float64 of shape \(0,\)"),
        (Detections(ONE, FITS, np.ones((1, 1))), r"`score` as numbers of shape \(1,\)"),
    ],
)  # fmt: skip
def test_what_is_no_detections_is_named(found, message) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^Detector `Odd` must .*{message}"):
        environment(found).reset(seed=1)


def test_lists_and_whole_numbers_are_taken() -> None:
    env = environment(Detections([[20, 10]], [[True, False]], [1]))  # type: ignore[arg-type]
    env.reset(seed=1)
    samples = env.core.simulation.first
    focal = env.config.camera_of(0).focal_length
    assert samples.seen[0, 0].tolist() == [[True, False]] * 2
    assert np.allclose(samples.image[0, 0, :, 0], [(20 - 32) / focal, (10 - 24) / focal])


@pytest.mark.parametrize(
    ("place", "allowed"),
    [((-64, 96), True), ((128, -48), True), ((-65, 0), False), ((129, 0), False), ((0, -49), False), ((0, 97), False)],
)
def test_a_centre_may_be_as_far_out_as_the_picture_is_large(place, allowed) -> None:
    env = environment(Detections(np.array([place], float), FITS, SCORE))
    if allowed:
        env.reset(seed=1)
        assert env.core.simulation.first.seen[0, 0, 0].tolist() == [True, False]
    else:
        with pytest.raises(ValueError, match="Detector `Odd` must find `pixels` in the picture of 64 × 48 or at most"):
            env.reset(seed=1)


def test_where_the_lens_shows_nothing_nothing_is_seen() -> None:
    """k1 = -0.2 shows nothing farther than 0.86 from the middle; the corner is at 0.75, and the second pixel at 1.2."""
    env = environment(Detections(np.array([[20.0, 10.0], [96.0, 24.0]]), np.eye(2, dtype=bool), np.ones(2)),
                      distortion=(-0.2, 0.0, 0.0, 0.0, 0.0))  # fmt: skip
    env.reset(seed=1)
    samples = env.core.simulation.first
    assert samples.seen[0, 0].tolist() == [[True, False]] * 2
    assert np.isfinite(samples.image).all()


def test_what_a_detector_raises_is_told_with_its_name() -> None:
    def fail(view: View) -> None:
        raise KeyError("weights")

    with pytest.raises(RuntimeError, match=r"Detector `Odd` .* but raised KeyError: 'weights'") as caught:
        environment(fail).reset(seed=1)
    assert isinstance(caught.value.__cause__, KeyError)


def repeated(detector: str, colours: int, robots: int = 2, kind: str = "sphere") -> None:
    marker: dict[str, Any] = {"kind": kind, "colours": [(214, 40, 40), (30, 90, 214), (40, 170, 60)][:colours]}
    RellocEnv(
        camera={**SMALL, "image": {"detector": detector}}, targets=3, robots=robots, marker=marker, estimator=None
    )  # fmt: skip


def test_colours_that_repeat_are_warned_of_where_robots_may_differ() -> None:
    with pytest.warns(UserWarning, match="Of 3 targets, 1 have the colour of another: .* `marker.colours`"):
        repeated("colour", 2)
    repeated("colour", 3)  # warnings are errors here
    repeated("colour", 2, robots=1)
    repeated("apriltag", 2, kind="tag")
