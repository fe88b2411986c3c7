"""Detectors on single pictures, against OpenCV's projection of where things are."""

import colorsys
import math
from typing import Any

import cv2
import numpy as np
import pytest

from relloc_env.config import ConfigError, load_config
from relloc_env.vision import Detections, View, make_detector, view_of
from relloc_env.vision.sensor import Sensor

LENS = (-0.25, 0.06, 0.001, -0.001, 0.0)
TAG = {"marker": {"kind": "tag"}}
PARTS = np.array([[-0.36, -0.12, 0.12, 0.36], [0.1, -0.1, 0.1, -0.1]])
"""Normalised image coordinates, far apart."""


def world(image: Any = None, **options: Any):
    """One robot at the origin of a large hall, looking along x."""
    camera = {"kind": "image", "image": image or {}}
    return load_config(None, **{"camera": camera, "robots": 1, "arena": (30.0, 30.0), **options})


def look(config, points, seed=0):
    """What is found, and where the targets are by OpenCV's account [px]."""
    sensor, points = Sensor(config, 0), np.asarray(points, float)
    view = sensor.view
    picture = np.zeros((view.height, view.width, 3), np.uint8)
    sensor.take(picture[None], np.zeros((1, 1, 3)), np.zeros((1, 1, 3)), points[None], np.array([seed], np.uint64))
    f_x, f_y, c_x, c_y = view.intrinsics
    matrix = np.array([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]])
    seen = np.column_stack([-points[:, 1], 0.3 - points[:, 2], points[:, 0]])
    truth = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), matrix, view.lens)[0][:, 0]
    return make_detector(config, 0).detect(picture), truth


def errors(found: Detections, truth):
    """[px] of each target, NaN where it is not found."""
    result = []
    for m, place in enumerate(truth):
        here = np.flatnonzero(found.fits[:, m])
        best = here[np.argmax(found.score[here])] if here.size else None
        result.append(math.nan if best is None else float(np.linalg.norm(found.pixels[best] - place)))
    return np.array(result)


@pytest.mark.parametrize(
    ("image", "options", "limit"),
    [
        ({}, {}, 0.5),
        ({"distortion": LENS}, {}, 0.5),
        ({"exposure": 0.33}, {}, 0.5),
        ({"exposure": 0.15}, {}, 0.5),
        ({"white_balance": (1.15, 1.0, 0.75)}, {}, 0.5),
        ({"noise": 10.0}, {}, 0.5),
        ({"detector": "apriltag"}, TAG, 1.0),
        ({"detector": "apriltag", "distortion": LENS}, TAG, 1.0),
    ],
)
def test_targets_are_found_where_opencv_projects_them(image, options, limit) -> None:
    """20 pictures of 4 targets, up to 6 m away, each in its part of the picture."""
    rng = np.random.default_rng(5)
    config, worst = world(image, targets=4, **options), []
    for k in range(20):
        depth = rng.uniform(1.6 if config.marker.kind == "sphere" else 3.5, 6.0, 4)
        x, y = PARTS + rng.uniform(-0.03, 0.03, (2, 4))
        found, truth = look(config, np.column_stack([depth, -x * depth, 0.3 - y * depth]), k)
        assert found.pixels.shape == (4, 2)
        worst.append(errors(found, truth).max())
    assert max(worst) < limit
    assert np.median(worst) < 0.4 * limit


def test_the_centre_of_a_near_tag_is_right_through_a_lens() -> None:
    """20 pictures: with diagonals that cross as if they were straight in the picture, the worst is 2 px off."""
    rng = np.random.default_rng(6)
    config, worst = world({"detector": "apriltag", "distortion": LENS}, targets=1, **TAG), []
    for k in range(20):
        depth, x, y = rng.uniform(1.5, 2.5), rng.uniform(-0.4, 0.4), rng.uniform(-0.25, 0.25)
        found, truth = look(config, [(depth, -x * depth, 0.3 - y * depth)], k)
        worst += [errors(found, truth).max()] if len(found.pixels) else []
    assert len(worst) > 15
    assert max(worst) < 0.6


def test_near_targets_are_corrected_for_the_ellipse() -> None:
    """At 1 m and below, where the middle of the patch is 2 px and more from the projected centre."""
    config = world(targets=2)
    points = [(0.9, 0.45, 0.55), (0.8, -0.35, 0.15)]
    found, truth = look(config, points)
    assert errors(found, truth).max() < 0.3


@pytest.mark.parametrize("cut", [0.0, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_target_at_the_border_is_found_by_what_shows_of_it(cut, side) -> None:
    """Its centre is in the picture, `cut` of its radius from the border to be out of it."""
    config = world(targets=1)
    edge = side * 320.0 / view_of(config, 0).intrinsics[0]
    x = edge * (1.0 - 0.1 / 3.0 * (1.0 - cut) / abs(edge))
    found, truth = look(config, [(3.0, -3.0 * x, 0.4)])
    assert errors(found, truth).max() < 0.5


@pytest.mark.parametrize("near", [0.0, 0.02])
def test_a_background_that_changes_beside_a_target_does_not_move_it(near) -> None:
    """A light post ends `near` [m] beside the outline, behind the target."""
    post = {"shape": "box", "position": (4.0, 0.0), "size": (0.2, 1.0), "height": 2.0, "colour": (215, 215, 215)}
    y = 0.5 * 3.0 / 3.9 + 0.1 + near
    found, truth = look(world(targets=1, obstacles=[post]), [(3.0, y, 0.4)])
    assert errors(found, truth).max() < 0.04


@pytest.mark.parametrize("out", [0.2, 0.6, 1.0, 1.4, 1.8])
def test_what_shows_of_a_target_mostly_out_of_the_picture_is_right_or_not_reported(out) -> None:
    """It reaches `out` radii beyond the border; every other one is partly behind a nearer target. 20 places."""
    config = world(targets=2)
    focal, reported = view_of(config, 0).intrinsics[0], 0
    rng = np.random.default_rng(6)
    for k in range(20):
        depth = rng.uniform(1.2, 4.0)
        x = 320.0 / focal + 0.1 / depth * (out - 1.0)
        y = rng.uniform(-0.3, 0.3)
        before = (x - 0.1 / depth * rng.uniform(-1.0, 1.5), y + rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 0.3))
        nearer = 0.5 * depth if k % 2 else -3.0
        points = [(nearer, -before[0] * nearer, 0.3 - before[1] * nearer), (depth, -x * depth, 0.3 - y * depth)]
        found, truth = look(config, points, k)
        away = errors(found, truth)[1]
        assert not away > 1.0, (k, away)
        reported += math.isfinite(away)
    assert reported > (5 if out < 1.0 else -1)


def test_a_corner_of_a_target_behind_a_nearer_one_is_right_or_not_reported() -> None:
    """At the border of the picture, its centre outside; a small circle fits what shows of it. 50 places and noises."""
    config, rng = world(targets=2), np.random.default_rng(6)
    for k in range(50):
        nearer, corner = np.array([(0.4413, -0.0901), (0.6175, -0.2423)]) + rng.uniform(-0.03, 0.03, (2, 2))
        points = [(z, -x * z, 0.3 - y * z) for z, (x, y) in ((0.4579, nearer), (1.2549, corner))]
        found, truth = look(config, points, k)
        assert not errors(found, truth)[1] > 1.0, k


@pytest.mark.parametrize("hidden", [0.2, 0.5, 0.8])
def test_a_target_partly_behind_a_post_is_found_by_what_shows_of_it(hidden) -> None:
    """A post hides its left side; with `hidden` of the radius before the edge the centre still shows."""
    edge = 0.1 * (1.0 - hidden)  # [m] beside the centre, as far away as the target
    post = {"shape": "disc", "position": (1.5, 0.5 * edge + 0.06), "radius": 0.06, "height": 2.0}
    config = world(targets=1, obstacles=[post])
    found, truth = look(config, [(3.0, 0.0, 0.5)])
    assert errors(found, truth).max() < 0.5


def test_a_target_behind_a_wall_is_not_found() -> None:
    box = {"shape": "box", "position": (2.0, 0.0), "size": (0.2, 1.0), "height": 2.0}
    found, _ = look(world(targets=1, obstacles=[box]), [(3.0, 0.0, 0.5)])
    assert found.pixels.shape == (0, 2)


@pytest.mark.parametrize("size", [0.2, 0.4])
def test_a_box_of_the_same_colour_is_not_taken_for_the_target(size) -> None:
    red = load_config().marker.colour_of(0)
    box = {"shape": "box", "position": (2.5, 0.6), "size": (size, size), "height": 0.3 + 0.5 * size, "colour": red}
    found, truth = look(world(targets=1, obstacles=[box]), [(4.0, -0.6, 0.5)])
    assert errors(found, truth).max() < 0.3
    alone, _ = look(world(targets=1, obstacles=[box]), [(-4.0, 0.0, 0.5)])
    assert alone.pixels.shape == (0, 2)


def test_colours_tell_targets_apart_and_equal_ones_do_not() -> None:
    points = [(3.0, 0.8, 0.5), (3.0, 0.0, 0.5), (3.0, -0.8, 0.5)]
    found, _ = look(world(targets=3), points)
    assert np.array_equal(found.fits.sum(axis=1), [1, 1, 1])
    red, blue = (214, 40, 40), (30, 90, 214)
    found, _ = look(world(targets=3, marker={"colours": [red, blue, red]}), points)
    assert sorted(found.fits.sum(axis=1).tolist()) == [1, 2, 2]


@pytest.mark.parametrize("exposure", [0.02, 0.05])
def test_the_noise_of_a_dark_picture_is_no_target(exposure) -> None:
    points = [(4.0, y, 0.4) for y in (-1.5, -0.5, 0.5, 1.5)]
    for seed in range(20):
        away = errors(*look(world({"exposure": exposure}, targets=4), points, seed))
        assert not np.any(away > 2.0)


def test_all_colours_of_the_palette_are_found_in_poor_light() -> None:
    points = [(5.0, 1.75 - 0.5 * m, 0.5) for m in range(8)]
    for exposure in (0.15, 0.33, 1.0, 1.5):
        found, truth = look(world({"exposure": exposure}, targets=8), points)
        assert np.array_equal(found.fits.sum(axis=0), np.ones(8)), exposure
        assert errors(found, truth).max() < 0.5


@pytest.mark.parametrize("exposure", [0.33, 1.0])
@pytest.mark.parametrize("targets", [12, 24])
def test_many_targets_have_colours_that_are_told_apart(targets, exposure) -> None:
    """A grid of six columns, each target at its place alone."""
    config, m = world({"exposure": exposure}, targets=targets), np.arange(targets)
    assert len({config.look.colour_of(k) for k in range(targets)}) == targets
    x, y = (m % 6 - 2.5) / 6.0, (m // 6 - 1.5) / 8.0
    found, truth = look(config, np.column_stack([np.full(targets, 4.0), -4.0 * x, 0.3 - 4.0 * y]))
    assert np.array_equal(found.fits.sum(axis=0), np.ones(targets))
    assert errors(found, truth).max() < 0.5


def test_the_detector_follows_the_marker() -> None:
    from relloc_env.vision.colour import ColourDetector

    assert type(make_detector(world(targets=1), 0)) is ColourDetector
    config = world(targets=1, **TAG)
    found, truth = look(config, [(3.0, 0.0, 0.5)])
    assert errors(found, truth).max() < 1.0


@pytest.mark.parametrize("hue", [0.05, 0.38, 0.72])
@pytest.mark.parametrize("share", [0.4, 0.6])
def test_colours_are_refused_where_they_are_not_seen(hue, share) -> None:
    """At a saturation of 0.40 targets are found and accepted; of 0.36 neither."""
    points = [(3.0, 0.3 * k, 0.4) for k in (-1, 0, 1)]
    for saturation, seen in ((0.41, True), (0.36, False)):
        colour = tuple(round(255.0 * level) for level in colorsys.hsv_to_rgb(hue, saturation, 0.2 + share))
        options: dict[str, Any] = {"targets": 3, "marker": {"colours": [colour]}}
        camera = load_config(robots=1, **options, camera={"image": {"detector": "colour"}})  # takes no pictures
        found, _ = look(camera, points)
        assert (len(found.pixels) == 3) is seen
        if seen:
            world(**options)
        else:
            with pytest.raises(ConfigError, match="tells from grey"):
                world(**options)


def test_an_empty_picture_has_no_targets() -> None:
    for image, options in (({}, {}), ({"detector": "apriltag"}, TAG)):
        found, _ = look(world(image, **options), [(-3.0, 0.0, 0.5), (-3.0, 1.0, 0.5)])
        assert [len(part) for part in found] == [0, 0, 0]
        assert found.fits.shape == (0, 2)


class Blind:
    """A detector that finds nothing."""

    def __init__(self, view: View) -> None:
        self.view = view

    def detect(self, picture: Any) -> Detections:
        return Detections(np.zeros((0, 2)), np.zeros((0, self.view.targets), np.bool_), np.zeros(0))


def test_a_detector_of_ones_own_by_object_and_by_place(tmp_path) -> None:
    for detector in (Blind, f"{__file__}:Blind"):
        made = make_detector(world({"detector": detector}), 0)
        assert type(made).__name__ == "Blind"
        assert vars(made)["view"].width == 640
    with pytest.raises(TypeError, match="`detector` must make something with `detect`, but it makes int"):
        make_detector(world({"detector": lambda _: 3}), 0)
    with pytest.raises(ValueError, match="`detector` must lead to a class or function"):
        make_detector(world({"detector": "no.such:Thing"}), 0)


def test_without_opencv_the_message_says_what_to_install(monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "cv2", None)
    for name in ("colour", "tags"):
        monkeypatch.delitem(sys.modules, f"relloc_env.vision.{name}", raising=False)
    with pytest.raises(ModuleNotFoundError, match="relloc-env\\[vision\\]") as caught:
        make_detector(world(), 0)
    assert caught.value.name == "cv2"
    with pytest.raises(ModuleNotFoundError, match="relloc-env\\[vision\\]"):
        Sensor(world(**TAG), 0)
    Sensor(world(), 0)  # spheres need no OpenCV
