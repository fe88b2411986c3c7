"""The picture: what is where, the same bytes each time, no display, nothing that breaks it."""

import os
import subprocess
import sys
import textwrap
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.rendering import CameraGeometry, Renderer, Scene, target_colours
from relloc_env.rendering.camera_view import image_frame
from relloc_env.rendering.layout import layout
from relloc_env.rendering.scene import Strip, robot_colour
from relloc_env.rendering.strip_view import band_colour, chart_of
from relloc_env.rendering.theme import LIGHT, THEMES
from relloc_env.samples import Estimate
from tests.rendering.scenes import random_scene, true_images

Box = tuple[float, float, float, float]


def paint(scene: Scene, size: tuple[int, int] = (960, 540)) -> NDArray[np.uint8]:
    picture = Renderer(size).draw(scene)
    assert picture is not None
    return picture


def centre_of(picture: NDArray[np.uint8], colour: Any, box: Box) -> NDArray[np.float64]:
    """Centre [px] of the pixels of a colour within a box; pixel (0, 0) covers [0, 1] x [0, 1]."""
    left, top, right, bottom = (round(v) for v in (box[0], box[1], box[0] + box[2], box[1] + box[3]))
    rows, columns = np.nonzero((picture[top:bottom, left:right] == np.array(colour)).all(axis=2))
    assert len(rows) > 5
    return np.array([columns.mean() + left + 0.5, rows.mean() + top + 0.5])


def bare(scene_seed: int, **changes: Any) -> Scene:
    """Make a scene of robots and targets alone."""
    changes = {"estimate": None, "obstacles": None, "trails": (), "strips": ()} | changes
    scene = random_scene(scene_seed, **changes)
    scene.seen[:] = False
    return scene


def fresh(code: str, **environment: str) -> str:
    """Run code in a fresh interpreter and return what it prints."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("SDL_") and k not in {"DISPLAY", "WAYLAND_DISPLAY"}}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(code)],
        env=kept | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_no_display_is_touched_and_nothing_heavy_imported() -> None:
    printed = fresh(
        """
        import sys
        import relloc_env.rendering
        from tests.rendering.scenes import random_scene
        assert "pygame" not in sys.modules
        picture = relloc_env.rendering.Renderer().draw(random_scene(0))
        import pygame
        print(picture.shape, pygame.display.get_init(), pygame.mixer.get_init(), "matplotlib" in sys.modules)
        """
    )
    assert printed == "(540, 960, 3) False None False"


def test_window_shows_scenes_until_it_is_closed() -> None:
    printed = fresh(
        """
        import numpy as np
        from relloc_env.rendering import Renderer
        from tests.rendering.scenes import random_scene
        scene = random_scene(0)
        renderer = Renderer(mode="human", fps=0.0)
        print(renderer.draw(scene), renderer.closed, end=" ")
        import pygame
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        print((shown == Renderer().draw(scene)).all(), end=" ")
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        print(renderer.draw(scene), renderer.closed, pygame.display.get_init(), end=" ")
        print(renderer.draw(scene), pygame.display.get_init())
        renderer.close()
        """,
        SDL_VIDEODRIVER="dummy",
        PYGAME_HIDE_SUPPORT_PROMPT="1",
    )
    assert printed == "None False True None True False None False"


def test_window_without_a_display_is_an_error_that_says_so() -> None:
    printed = fresh(
        """
        from relloc_env.rendering import Renderer
        from tests.rendering.scenes import random_scene
        try:
            Renderer(mode="human").draw(random_scene(0))
        except RuntimeError as error:
            print(error)
        """,
        SDL_VIDEODRIVER="none-such",
    )
    assert printed.startswith("Mode 'human' needs a display")


def test_same_scene_same_bytes() -> None:
    renderer, scene = Renderer(), random_scene(3)
    first = renderer.draw(scene)
    for other in (random_scene(4, robots=1), random_scene(5, arena=None), random_scene(6, obstacles=None)):
        renderer.draw(other)
    assert first is not None
    assert np.array_equal(first, paint(random_scene(3)))
    again = renderer.draw(scene)
    assert again is not None
    assert np.array_equal(first, again)


@pytest.mark.parametrize("size", [(320, 180), (480, 270), (960, 540), (480, 480), (420, 700), (1920, 1080)])
@pytest.mark.parametrize("robots", [1, 2, 3])
def test_shape_and_parts_within_the_picture(size: tuple[int, int], robots: int) -> None:
    scene = random_scene(0, robots=robots)
    picture = paint(scene, size)
    assert picture.shape == (size[1], size[0], 3)
    assert picture.dtype == np.uint8
    parts = layout(size, scene.cameras, len(scene.strips))
    boxes = (parts.header, parts.world, *parts.images, *parts.strips)
    for left, top, width, height in boxes:
        assert min(left, top) >= 0.0
        assert min(width, height) > 15.0
        assert left + width <= size[0] + 1e-9
        assert top + height <= size[1] + 1e-9
    for j, (left, top, width, height) in enumerate(boxes):
        for x, y, w, h in boxes[:j]:
            assert x + w <= left + 1e-9 or left + width <= x + 1e-9 or y + h <= top + 1e-9 or top + height <= y + 1e-9


@pytest.mark.parametrize("size", [(480, 270), (960, 540), (1920, 1080)])
@pytest.mark.parametrize("seed", range(4))
def test_true_points_are_where_the_camera_has_them(size: tuple[int, int], seed: int) -> None:
    scene = bare(seed)
    picture, parts = paint(scene, size), layout(size, scene.cameras, 0)
    checked = 0
    for robot, (left, top, width, height) in enumerate(parts.images):
        camera = scene.cameras[robot]
        for j in np.flatnonzero(scene.in_view[robot]):
            u = camera.c_x + camera.focal * scene.true_image[robot, j, 0]
            v = camera.c_y + camera.focal * scene.true_image[robot, j, 1]
            expected = np.array([left + u * width / camera.width, top + v * height / camera.height])
            others = np.delete(np.arange(len(scene.points)), j)
            apart = scene.true_image[robot, others] - scene.true_image[robot, j]
            if np.abs(apart).max(axis=1).min() < 0.1 or not 30 < u < 610 or not 30 < v < 450:
                continue  # another target, or the frame, covers a part of it
            found = centre_of(picture, scene.colours[j], (expected[0] - 12, expected[1] - 12, 24, 24))
            assert np.abs(found - expected).max() < 1.0
            checked += 1
    assert checked >= 2


@pytest.mark.parametrize("size", [(480, 270), (960, 540)])
def test_map_has_one_scale_with_x_right_and_y_up(size: tuple[int, int]) -> None:
    points = np.array([[-4.0, -3.0, 0.2], [4.0, -3.0, 0.2], [-4.0, 4.0, 0.2]])
    scene = bare(0, points=3, time=1.0)
    scene.points[:] = points
    left, top, width, height = layout(size, scene.cameras, 0).world
    found = [centre_of(paint(scene, size), colour, (left, top, width, height)) for colour in scene.colours]
    right, up = found[1] - found[0], found[2] - found[0]
    metre = min(width, height) / (10.0 * 1.04)  # the arena, and 2 % of it beyond each wall
    assert right == pytest.approx([8.0 * metre, 0.0], abs=1.0)
    assert up == pytest.approx([0.0, -7.0 * metre], abs=1.0)
    middle = np.array([left + 0.5 * width, top + 0.5 * height])
    assert found[0] - middle == pytest.approx([-4.0 * metre, 3.0 * metre], abs=1.0)


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0, -1.6])
def test_nose_of_a_robot_points_along_its_heading(heading: float) -> None:
    blind = CameraGeometry(limited=False)
    scene = bare(0, robots=1, poses=np.array([[0.0, 0.0, heading]]), cameras=[blind], robot_radius=0.5)
    scene.points[:] = [4.5, 4.5, 0.0]
    box = layout((960, 540), scene.cameras, 0).world
    found = centre_of(paint(scene), robot_colour(0), box)
    off = found - [box[0] + 0.5 * box[2], box[1] + 0.5 * box[3]]
    assert np.hypot(*off) > 1.0
    assert np.cos(np.arctan2(-off[1], off[0]) - heading) > 0.9


def test_unlimited_camera_shows_all_in_view() -> None:
    camera = CameraGeometry(limited=False, focal=300.0)
    scene = random_scene(0, robots=1, cameras=[camera])
    image = np.array([[[0.2, 0.1], [5.0, 4.0], [-3.0, -6.0], [0.0, 0.0]]])
    wide = random_scene(0, robots=1, cameras=[camera], true_image=image, in_view=np.ones((1, 4), bool))
    box = layout((960, 540), scene.cameras, 0).images[0]
    shown = image_frame(box, wide, 0).pixels(image[0])
    assert (shown > box[:2]).all()
    assert (shown < np.add(box[:2], box[2:])).all()


def test_what_a_camera_took_is_shown() -> None:
    taken = np.zeros((480, 640, 3), np.uint8)
    taken[:240, :320], taken[240:, 320:] = (200, 30, 60), (20, 90, 210)
    scene = bare(0, pictures=[taken, None])
    box = layout((960, 540), scene.cameras, 0).images[0]
    picture = paint(scene)
    for x, y, colour in ((0.25, 0.25, (200, 30, 60)), (0.75, 0.75, (20, 90, 210)), (0.75, 0.25, (0, 0, 0))):
        assert picture[int(box[1] + y * box[3]), int(box[0] + x * box[2])] == pytest.approx(colour, abs=6)


def broken_estimate(scene: Scene, scale: float) -> Estimate:
    assert scene.estimate is not None
    believed = scene.estimate
    return believed._replace(
        points_covariance=believed.points_covariance * scale, pose_covariance=believed.pose_covariance * scale
    )


@pytest.mark.parametrize("scale", [0.0, 1e3, 1e6, 1e12, 1e300])
def test_no_uncertainty_leaves_the_map(scale: float) -> None:
    scene = random_scene(2, strips=(), title="")
    scene = random_scene(2, strips=(), title="", estimate=broken_estimate(scene, scale))
    picture, parts = paint(scene), layout((960, 540), scene.cameras, 0)
    gap = picture[:, round(parts.world[0] + parts.world[2]) + 1 : round(parts.images[0][0]) - 3]
    assert gap.size > 0
    assert (gap == LIGHT.page).all()


@pytest.mark.parametrize("robots", [1, 2, 3, 4])
@pytest.mark.parametrize("points", [1, 8])
@pytest.mark.parametrize("believes", [False, True])
def test_any_number_of_robots_and_points(robots: int, points: int, believes: bool) -> None:
    changes: dict[str, Any] = {} if believes else {"estimate": None}
    assert paint(random_scene(0, robots=robots, points=points, **changes)).std() > 10.0


def test_points_behind_unknown_and_without_height() -> None:
    scene = random_scene(0)
    poses = scene.poses + np.array([0.0, 0.0, np.pi])
    image, in_view = true_images(poses, scene.points, scene.cameras[0])
    assert not in_view.any()
    assert scene.estimate is not None
    believed = scene.estimate._replace(known=np.zeros_like(scene.estimate.known))
    plain = random_scene(0, poses=poses, true_image=image, in_view=in_view, seen=in_view, estimate=believed)
    assert paint(plain).std() > 10.0
    upright = np.array(scene.image)
    upright[..., 1] = np.nan
    assert paint(random_scene(0, image=upright)).std() > 10.0


@pytest.mark.parametrize("flag", ["contact", "blocked"])
def test_flags_are_shown(flag: str) -> None:
    changes: dict[str, Any] = {flag: np.array([True, False])}
    assert (paint(random_scene(0)) != paint(random_scene(0, **changes))).any()


@pytest.mark.parametrize("size", [(480, 270), (960, 540), (480, 480)])
def test_a_strip_is_a_logarithmic_axis_with_its_band(size: tuple[int, int]) -> None:
    """A constant line lies where its value is, on a scale from 0.1 to 1000, and the band from 1 to 100."""
    heights = []
    for number in (1.0, 10.0, 100.0, 300.0):
        line = np.full((1, 61), number)
        strip = Strip("NEES", np.arange(0.0, 30.1, 0.5), line, [""], (0.1, 1000.0), band=(1.0, 100.0))
        scene = random_scene(0, robots=1, time=30.0, strips=[strip], title="")
        parts = layout(size, scene.cameras, 1)
        left, top, width, height = (round(v) for v in chart_of(parts.strips[0], parts.letters))
        chart = paint(scene, size)[top - 2 : top + height, left + 10 : left + width // 2]
        blue = np.maximum(chart[..., 2].astype(float) - chart[..., 0] - 20.0, 0.0).sum(axis=1)
        heights.append((blue @ np.arange(len(blue)) / blue.sum() - 1.5) / height)
        band = np.nonzero((chart == np.array(band_colour(LIGHT))).all(axis=2))[0]
        assert [(band.min() - 2) / height, (band.max() - 1) / height] == pytest.approx([0.25, 0.75], abs=2.0 / height)
    assert heights == pytest.approx([0.75, 0.5, 0.25, 0.131], abs=2.5 / height)


def test_a_line_is_broken_where_there_is_no_number() -> None:
    strip = Strip("NEES", np.arange(0.0, 31.0), np.ones((1, 31)), ["1"], (0.1, 10.0))
    scene = random_scene(0, robots=1, time=30.0, strips=[strip], title="")
    strip.lines[0, 10:21] = np.nan
    parts = layout((960, 540), scene.cameras, 1)
    left, top, width, height = (round(v) for v in chart_of(parts.strips[0], parts.letters))
    blue = (paint(scene)[top : top + height, left : left + width] == np.array(robot_colour(0))).all(axis=2).any(axis=0)
    drawn = np.flatnonzero(blue) / width * 30.0
    assert ((drawn < 9.3) | (drawn > 20.7)).all()
    assert drawn.min() < 0.5
    assert drawn.max() > 29.5


def test_a_number_above_its_band_is_red() -> None:
    for value, red in ((1.0, False), (9.9, False), (10.1, True)):
        strip = Strip("NEES", np.zeros(1), np.full((1, 1), value), ["10.0"], (0.1, 100.0), band=(0.5, 10.0))
        picture = paint(random_scene(0, robots=1, strips=[strip], obstacles=None))
        assert (picture == np.array(LIGHT.alarm)).all(axis=2).any() == red


def test_notes_cover_the_corner_of_the_map() -> None:
    scene = random_scene(0, notes=[("space", "pause"), ("n", "new seed")])
    left, top, *_ = layout((960, 540), scene.cameras, 3).world
    corner = paint(scene)[round(top) + 3 : round(top) + 30, round(left) + 3 : round(left) + 60]
    assert (corner == np.array(LIGHT.page)).all(axis=2).mean() > 0.5


# G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, IEEE Trans. Vis. Comp. Graph. 15(6), 2009, table 1, severity 1.0.
VISION = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}


def seen_as(colours: Any, vision: str) -> NDArray[np.float64]:
    """CIELAB (D65) of sRGB colours as people of a kind of vision see them."""
    scaled = np.asarray(colours, float) / 255.0
    linear = np.where(scaled <= 0.04045, scaled / 12.92, ((scaled + 0.055) / 1.055) ** 2.4) @ np.array(VISION[vision]).T
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.072175], [0.0193339, 0.119192, 0.9503041]]
    )
    ratio = np.clip(linear, 0.0, 1.0) @ to_xyz.T / np.array([0.95047, 1.0, 1.08883])
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16.0 / 116.0)
    return np.stack(
        [116.0 * f[..., 1] - 16.0, 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])], axis=-1
    )


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("theme", THEMES)
def test_robots_and_targets_are_told_apart_with_any_colour_vision(vision: str, theme: str) -> None:
    """A difference of 20 is large: that of 2.3 is just noticed (M. Mahy et al., Color Res. Appl. 19(2), 1994)."""
    chosen = THEMES[theme]
    colours = seen_as([*chosen.robots[:2], *target_colours(6), chosen.floor, chosen.alarm], vision)
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=2)
    assert apart[:9, :9][~np.eye(9, dtype=bool)].min() > 14.0
    assert apart[:2, :2][0, 1] > 50.0


def test_dark_is_dark() -> None:
    scene = random_scene(0)
    dark = Renderer(theme="dark").draw(scene)
    assert dark is not None
    assert dark.mean() < 80.0
    assert paint(scene).mean() > 200.0


def test_colours_of_targets_differ() -> None:
    colours = target_colours(8).astype(float)
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=2)[~np.eye(8, dtype=bool)]
    assert apart.min() > 50.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seen": np.zeros((2, 3), bool)}, r"`seen` must have shape \(2, 4\), but has \(2, 3\)"),
        ({"cameras": [CameraGeometry()]}, "`cameras` must have one entry for each of 2 robots, but has 1"),
        ({"trails": [np.zeros((3, 2))]}, "`trails` must be empty or have one entry for each of 2 robots, but has 1"),
        ({"pictures": [None]}, "`pictures` must be empty or have one entry for each of 2 robots, but has 1"),
        ({"contact": np.zeros(3, bool)}, r"`contact` must have shape \(2,\), but has \(3,\)"),
    ],
)
def test_wrong_scenes_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        random_scene(0, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size": (100, 540)}, r"`size` must be at least \(320, 180\), but is \(100, 540\)"),
        ({"mode": "ansi"}, "`mode` must be 'rgb_array' or 'human', but is 'ansi'"),
        ({"theme": "blue"}, r"`theme` must be one of \['dark', 'light'\], but is 'blue'"),
    ],
)
def test_wrong_renderers_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Renderer(**changes)
