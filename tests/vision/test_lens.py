"""Lenses against OpenCV's inverse, and against continuation from the middle of the picture."""

import os
import subprocess
import sys

import cv2
import numpy as np
import pytest

from relloc_env.config import ConfigError, load_config
from relloc_env.envs.centralised import RellocEnv
from relloc_env.samples import Float
from relloc_env.vision import view_of
from relloc_env.vision.lens import from_pixels, picture_rays, to_pixels

STRONG = [
    (-0.25, 0.0, 0.0, 0.0, 0.0),
    (-0.35, 0.1, 0.0, 0.0, 0.0),
    (0.8, 0.0, 0.0, 0.0, 0.0),
    (1.5, 0.0, 0.0, 0.0, 0.0),
    (-0.3, 0.1, 0.01, -0.01, -0.01),
]


def with_lens(lens, **camera):
    return load_config(None, camera={"kind": "image", "image": {"distortion": lens}, **camera})


@pytest.mark.parametrize("lens", STRONG)
def test_pixels_lead_where_opencv_says(lens) -> None:
    """All of a picture, to 1e-6 px, where twenty steps of a fixed-point iteration were up to hundreds of pixels off."""
    view = view_of(with_lens(lens), 0)
    f_x, f_y, c_x, c_y = view.intrinsics
    rays = picture_rays(view.width, view.height, view.intrinsics, view.lens)
    rows, columns = np.mgrid[: view.height : 20, : view.width : 20] + 0.5
    pixels = np.stack([columns, rows], axis=-1)
    matrix = np.array([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]])
    enough = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 1000, 1e-14)
    truth = cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, view.lens, criteria=enough).reshape(pixels.shape)
    assert f_x * np.abs(rays[::20, ::20] - truth).max() < 1e-6
    ahead = np.column_stack([rays[::20, ::20].reshape(-1, 2), np.ones(pixels.size // 2)])
    there = cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), matrix, view.lens)[0].reshape(pixels.shape)
    assert np.abs(there - pixels).max() < 1e-6


def test_without_distortion_pixels_are_scaled_and_no_more() -> None:
    view = view_of(load_config(None, camera="image"), 0)
    rays = picture_rays(view.width, view.height, view.intrinsics, view.lens)
    rows, columns = np.mgrid[: view.height, : view.width] + 0.5
    assert np.array_equal(rays[..., 0], (columns - 320.0) / view.intrinsics[0])
    assert np.array_equal(rays[..., 1], (rows - 240.0) / view.intrinsics[1])


def folded(view) -> bool:
    """Whether a lens shows a place near one corner or side's middle at two pixels, found by walking to it.

    Walks in small steps of the picture, by finite differences: where an eigenvalue passes zero, the lens folds.
    """
    size, f, c = np.array([view.width, view.height]), view.intrinsics[:2], view.intrinsics[2:]
    ends = (np.array([(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0), (0.5, 1), (0, 0.5), (1, 0.5)]) * size - c) / f
    places: Float = np.zeros_like(ends)

    def show(places):
        return (to_pixels(places, view.intrinsics, view.lens) - c) / f

    for share in np.linspace(0.0, 1.0, 201)[1:]:
        h = 1e-6
        columns = [(show(places + h * d) - show(places - h * d)) / (2.0 * h) for d in np.eye(2)]
        slopes = np.stack(columns, axis=-1)
        if np.linalg.eigvalsh(0.5 * (slopes + np.swapaxes(slopes, -1, -2))).min() < 1e-4:
            return True
        places = places + np.linalg.solve(slopes, (share * ends - show(places))[..., None])[..., 0]
    return False


def test_lenses_that_fold_the_picture_are_refused_and_no_others() -> None:
    """30 lenses; those are refused, and only those, that a walk from the middle to the edge finds folded."""
    rng, refused = np.random.default_rng(0), 0
    plain = view_of(load_config(None, camera={"kind": "image", "width": 64, "height": 48, "field_of_view": 62.2}), 0)
    for k in range(30):
        lens = np.array(
            [rng.uniform(-0.9, 0.6), rng.uniform(-0.5, 0.8), *rng.uniform(-0.02, 0.02, 2), rng.uniform(-0.3, 0.3)]
        )
        view = plain._replace(lens=lens)
        try:
            picture_rays(view.width, view.height, view.intrinsics, view.lens)
        except ConfigError:
            refused += 1
            assert folded(view), (k, lens)
        else:
            assert not folded(view), (k, lens)
    assert 3 < refused < 20


@pytest.mark.parametrize("options", [{}, {"observation": "image", "image_size": (32, 24)}])
def test_a_lens_that_folds_the_picture_is_named_at_the_door(options) -> None:
    with pytest.raises(
        ConfigError, match=r"`camera.image.distortion` must .* \(-0.35, 0.0, .* folds the picture: make"
    ):
        RellocEnv(with_lens((-0.35, 0.0, 0.0, 0.0, 0.0)), **options)


def test_outside_the_picture_there_may_be_nothing_to_see() -> None:
    """k1 = -0.25 folds at 1/sqrt(0.75), which it shows 0.77 from the middle; the corner is at 0.754."""
    view = view_of(with_lens((-0.25, 0.0, 0.0, 0.0, 0.0)), 0)
    f, middle = view.intrinsics[0], view.intrinsics[2:]
    at = middle + f * np.array([[0.7, 0.0], [0.769, 0.0], [0.771, 0.0], [3.0, 0.0], [0.0, -1.5]])
    rays = view.rays(at)
    assert np.isfinite(rays).all(axis=1).tolist() == [True, True, False, False, False]
    assert 0.7 < rays[0, 0] < rays[1, 0] < 1.0 / np.sqrt(0.75)
    assert np.isnan(from_pixels(at[2:], view.intrinsics, view.lens)).all()


def test_works_where_nothing_is_compiled() -> None:
    """NUMBA_DISABLE_JIT is how kernels are debugged."""
    code = "import numpy as np; from relloc_env.vision.lens import to_pixels; \
print(to_pixels(np.zeros((1, 2)), np.array([100.0, 100.0, 32.0, 24.0]), np.full(5, 0.1)).tolist())"
    quiet = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    told = subprocess.run([sys.executable, "-c", code], env=quiet, capture_output=True, text=True, check=False)
    assert told.stdout.strip() == "[[32.0, 24.0]]", told.stderr
