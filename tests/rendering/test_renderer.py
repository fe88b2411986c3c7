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
from relloc_env.rendering.renderer import layout
from relloc_env.rendering.scene import Reading, robot_colour
from relloc_env.rendering.theme import LIGHT, mix
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
    changes = {"estimate": None, "obstacles": None, "trails": (), "readings": ()} | changes
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


@pytest.mark.parametrize("size", [(320, 180), (480, 270), (960, 540), (700, 700), (1920, 1080)])
@pytest.mark.parametrize("robots", [1, 2])
def test_shape_and_parts_within_the_picture(size: tuple[int, int], robots: int) -> None:
    scene = random_scene(0, robots=robots)
    picture = paint(scene, size)
    assert picture.shape == (size[1], size[0], 3)
    assert picture.dtype == np.uint8
    parts = layout(size, scene.cameras)
    for left, top, width, height in (parts.rail, parts.world, *parts.images):
        assert min(left, top) >= 0.0
        assert min(width, height) > 40.0
        assert left + width <= size[0]
        assert top + height <= size[1]


@pytest.mark.parametrize("size", [(480, 270), (960, 540), (1920, 1080)])
@pytest.mark.parametrize("seed", range(4))
def test_true_points_are_where_the_camera_has_them(size: tuple[int, int], seed: int) -> None:
    scene = bare(seed)
    picture, parts = paint(scene, size), layout(size, scene.cameras)
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
    left, top, width, height = layout(size, scene.cameras).world
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
    box = layout((960, 540), scene.cameras).world
    found = centre_of(paint(scene), robot_colour(0), box)
    off = found - [box[0] + 0.5 * box[2], box[1] + 0.5 * box[3]]
    assert np.hypot(*off) > 1.0
    assert np.cos(np.arctan2(-off[1], off[0]) - heading) > 0.9


def test_unlimited_camera_shows_all_in_view() -> None:
    camera = CameraGeometry(limited=False, focal=300.0)
    scene = random_scene(0, robots=1, cameras=[camera])
    image = np.array([[[0.2, 0.1], [5.0, 4.0], [-3.0, -6.0], [0.0, 0.0]]])
    wide = random_scene(0, robots=1, cameras=[camera], true_image=image, in_view=np.ones((1, 4), bool))
    box = layout((960, 540), scene.cameras).images[0]
    shown = image_frame(box, wide, 0).pixels(image[0])
    assert (shown > box[:2]).all()
    assert (shown < np.add(box[:2], box[2:])).all()


def broken_estimate(scene: Scene, scale: float) -> Estimate:
    assert scene.estimate is not None
    believed = scene.estimate
    return believed._replace(
        points_covariance=believed.points_covariance * scale, pose_covariance=believed.pose_covariance * scale
    )


@pytest.mark.parametrize("scale", [0.0, 1e3, 1e6, 1e12, 1e300])
def test_no_uncertainty_leaves_the_map(scale: float) -> None:
    scene = random_scene(2, readings=(), title="")
    scene = random_scene(2, readings=(), title="", estimate=broken_estimate(scene, scale))
    picture, parts = paint(scene), layout((960, 540), scene.cameras)
    gap = picture[:, round(parts.rail[0] + parts.rail[2]) + 1 : round(parts.world[0]) - 1]
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


@pytest.mark.parametrize("size", [(480, 270), (960, 540)])
def test_mark_of_a_gauge_is_red_above_its_band_only(size: tuple[int, int]) -> None:
    """Marks move to the right as numbers grow, on a logarithmic scale."""
    places = []
    for number in (0.1, 1.0, 10.0, 100.0):
        reading = Reading("NEES", "", gauge=(number, 0.2, 9.0))
        picture = paint(random_scene(0, readings=[reading], title=""), size)
        left, top, width, height = (round(v) for v in layout(size, random_scene(0).cameras).rail)
        rail = picture[top : top + height, left : left + width]
        red = (rail == np.array(LIGHT.alarm)).all(axis=2)
        assert red.any() == (number > 9.0)
        places.append(np.nonzero(red)[1].mean() if red.any() else None)
        if number == 1.0:
            band = np.nonzero((rail == np.array(mix(LIGHT.page, LIGHT.muted, 0.35))).all(axis=2))
            assert len(band[0]) > 10
    assert places[2] is not None
    assert places[3] is not None
    decade = places[3] - places[2]
    assert decade == pytest.approx(width / np.log10(100.0 * 9.0 / 0.02), abs=1.0)


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
