"""Pictures against a ray caster in NumPy, OpenCV's projection, and statistics."""

import math
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from relloc_env.config import load_config
from relloc_env.kernels.image_columns import WALL_HEIGHT
from relloc_env.vision.lens import from_pixels, to_pixels
from relloc_env.vision.sensor import Sensor

PURE = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0), (255, 0, 255), (0, 255, 255)]
CLEAN = {"noise": 0.0}
POSES = np.array([[-1.0, 0.4, 0.2], [1.6, -0.6, 2.0]])
POINTS = np.array([[2.5, 1.2, 0.9], [3.0, -0.2, 0.2]])
OBSTACLES = [
    {"shape": "box", "position": (1.5, 1.6), "size": (0.8, 0.3), "angle": 0.7, "height": 0.8, "colour": PURE[2]},
    {"shape": "box", "position": (2.2, 0.5), "size": (0.5, 0.6), "angle": -0.3, "height": 0.15, "colour": PURE[3]},
    {"shape": "disc", "position": (3.4, 0.6), "radius": 0.3, "height": 1.2, "colour": PURE[4]},
]


def camera(width: int = 160, height: int = 120, **image: Any) -> dict[str, Any]:
    return {"kind": "image", "width": width, "height": height, "field_of_view": 70.0, "image": {**CLEAN, **image}}


def take(config, poses=POSES, points=POINTS, velocities=None, seed=0, size=None, robot=0, planar=False):
    sensor = Sensor(config, robot, size)
    height, width = sensor.view.height, sensor.view.width
    out = np.zeros((1, 3, height, width) if planar else (1, height, width, 3), np.uint8)
    velocities = np.zeros((1, config.robots, 3)) if velocities is None else np.asarray(velocities)[None]
    sensor.take(out, np.asarray(poses)[None], velocities, np.asarray(points)[None], np.array([seed], np.uint64))
    return out[0]


def cast(config, poses, points, view):
    """Which thing each pixel shows, by solid geometry in three dimensions: 0 floor or sky, 1 wall, then bodies."""
    mount = config.camera_of(0).mount_height
    rows, columns = np.mgrid[: view.height, : view.width] + 0.5
    rays = view.rays(np.stack([columns, rows], -1))
    x, y, theta = poses[0]
    ahead, right = np.array([math.cos(theta), math.sin(theta), 0.0]), np.array([math.sin(theta), -math.cos(theta), 0.0])
    d = ahead + rays[..., :1] * right + rays[..., 1:] * np.array([0.0, 0.0, -1.0])
    eye = np.array([x, y, mount])
    best, what = np.full(d.shape[:2], np.inf), np.zeros(d.shape[:2], int)

    def show(number, t, extra=True):
        nearer = (t > 1e-6) & (t < best) & extra
        best[nearer], what[nearer] = t[nearer], number

    half = 0.5 * np.array(config.arena)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in range(2):
            for side in (-half[axis], half[axis]):
                t = (side - eye[axis]) / d[..., axis]
                hit = eye + t[..., None] * d
                inside = np.abs(hit[..., 1 - axis]) <= half[1 - axis] + 1e-9
                show(1, t, inside & (hit[..., 2] >= 0.0) & (hit[..., 2] <= WALL_HEIGHT))
        number = 2
        robot = config.robot_of(1)
        solids = [("disc", poses[1][:2], robot.radius, 0.0, 0.0, robot.height)]
        for one in config.obstacles:
            if one.shape == "disc":
                solids.append(("disc", one.position, one.radius, 0.0, 0.0, one.height))
            else:
                solids.append(("box", one.position, 0.5 * one.size[0], 0.5 * one.size[1], one.angle, one.height))
        for shape, centre, a, b, angle, top in solids:
            c, s = math.cos(angle), math.sin(angle)
            turn = np.array([[c, s], [-s, c]])
            p, v = turn @ (eye[:2] - np.array(centre)), d[..., :2] @ turn.T
            low_z, high_z = np.sort(np.stack([(0.0 - mount) / d[..., 2], (top - mount) / d[..., 2]]), axis=0)
            level = d[..., 2] == 0.0
            low_z, high_z = np.where(level, -np.inf, low_z), np.where(level, np.inf if mount < top else -np.inf, high_z)
            if shape == "disc":
                vv, pv = np.sum(v * v, -1), v @ p
                square = pv**2 - vv * (p @ p - a * a)
                low, high = (-pv - np.sqrt(square)) / vv, (-pv + np.sqrt(square)) / vv
            else:
                ends = np.stack([(-np.array([a, b]) - p) / v, (np.array([a, b]) - p) / v])
                low, high = ends.min(0).max(-1), ends.max(0).min(-1)
            enter, leave = np.maximum(low, low_z), np.minimum(high, high_z)
            show(number, enter, (enter <= leave) & np.isfinite(enter))
            number += 1
        for m, point in enumerate(points):
            c = point - eye
            dd, dc = np.sum(d * d, -1), d @ c
            square = dc**2 - dd * (c @ c - config.marker.radius**2)
            show(10 + m, np.where(square >= 0.0, (dc - np.sqrt(square)) / dd, np.inf))
    return what


def test_shows_what_a_ray_caster_shows() -> None:
    config = load_config(
        None, camera=camera(), obstacles=OBSTACLES, arena=(12.0, 9.0), marker={"radius": 0.2, "colours": PURE[:2]}
    )
    picture = take(config).astype(float)
    what = cast(config, POSES, POINTS, Sensor(config, 0).view)
    brightest = picture.max(-1, keepdims=True)
    share = picture / np.maximum(brightest, 1.0)
    seen = np.full(what.shape, -1)
    for number, colour in ((3, PURE[2]), (4, PURE[3]), (5, PURE[4]), (10, PURE[0]), (11, PURE[1])):
        seen[np.abs(share - np.array(colour) / 255.0).max(-1) < 0.1] = number
    inner = np.ones(what.shape, bool)  # pixels with an edge in them or beside them show a mixture
    for axis in (0, 1):
        for step in (-1, 1):
            inner &= np.roll(what, step, axis) == what
    for number in (3, 4, 5, 10, 11):
        assert (what == number).sum() > 15, f"{number} is not in the picture"
        assert np.array_equal((seen == number)[inner], (what == number)[inner]), number
    grey = np.ptp(picture, axis=-1)
    assert grey[inner & np.isin(what, (0, 1, 2))].max() < 20
    robot = picture[inner & (what == 2)]
    assert robot.shape[0] > 15
    assert robot.max() < 125  # darker than all that is around


@pytest.mark.parametrize("arena", [None, (12.0, 9.0)])
@pytest.mark.parametrize("size", [(84, 84), (50, 40), (160, 120)])
def test_short_cuts_of_level_rows_show_what_the_way_through_a_lens_shows(arena, size) -> None:
    """A lens that hardly distorts takes the general way: every layer of every pixel, one by one."""
    rng = np.random.default_rng(2)
    pictures = []
    for _ in range(10):
        poses = np.column_stack([rng.uniform(-3.0, 3.0, (2, 2)), rng.uniform(-3.1, 3.1, 2)])
        points = np.column_stack([rng.uniform(-4.0, 4.0, (2, 2)), rng.uniform(0.1, 1.0, 2)])
        for distortion in ((0.0,) * 5, (1e-12, 0.0, 0.0, 0.0, 0.0)):
            config = load_config(None, camera=camera(distortion=distortion), obstacles=OBSTACLES, arena=arena)
            pictures.append(take(config, poses, points, size=size).astype(int))
    level, general = np.array(pictures[::2]), np.array(pictures[1::2])
    assert (np.abs(level - general) > 1).mean() < 1e-4  # at the edges of tiles, rounding decides
    assert general.std() > 20


@pytest.mark.parametrize("planar", [False, True])
def test_pictures_side_by_side_in_memory_do_not_touch_each_other(planar) -> None:
    config = load_config(None, camera=camera(noise=3.0))
    sensor = Sensor(config, 0, (50, 40))
    out = np.full((5, 3, 40, 50) if planar else (5, 40, 50, 3), 7, np.uint8)
    seeds, places = np.array([4, 5], np.uint64), np.array([3, 1])
    sensor.take(out, np.stack([POSES, POSES]), np.zeros((2, 2, 3)), np.stack([POINTS, POINTS]), seeds, places)
    for place, seed in zip(places, seeds, strict=True):
        assert np.array_equal(out[place], take(config, seed=seed, size=(50, 40), planar=planar))
    assert np.all(out[[0, 2, 4]] == 7)


def _sampled(levels: NDArray[np.float64], pixels: NDArray[Any]) -> Any:
    """Levels at places of an image [px]; the centre of the first pixel is at 0.5."""
    x, y = (pixels - 0.5).astype(np.float32).T
    return cv2.remap(levels.astype(np.float32), x[None], y[None], cv2.INTER_LINEAR)


@pytest.mark.parametrize("lens", [(0.0,) * 5, (-0.25, 0.06, 0.002, -0.001, 0.0)])
def test_outline_of_a_sphere_is_where_opencv_projects_it(lens) -> None:
    """48 spheres. The outline: points of the sphere where its surface is seen edge on."""
    rng = np.random.default_rng(0)
    for _ in range(24):
        distance = rng.uniform(1.2, 4.0)
        points = np.array([[distance, rng.uniform(-0.4, 0.4) * distance, 0.3 + rng.uniform(-0.25, 0.25) * distance]])
        config = load_config(
            None, camera=camera(320, 240, distortion=lens), robots=1, targets=1, arena=None, marker={"radius": 0.3}
        )
        picture = take(config, [[0.0, 0.0, 0.0]], points).astype(float)
        centre = np.array([-points[0, 1], 0.3 - points[0, 2], points[0, 0]])  # camera frame of OpenCV
        length = np.linalg.norm(centre)
        side = np.linalg.svd(centre[None])[2][1:]  # two directions across
        angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)[:, None]
        circle = 0.3 * math.sqrt(1.0 - (0.3 / length) ** 2) * (np.cos(angle) * side[0] + np.sin(angle) * side[1])
        rim = centre * (1.0 - (0.3 / length) ** 2) + circle
        f_x, f_y, c_x, c_y = Sensor(config, 0).view.intrinsics
        matrix = np.array([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]])
        pixels = cv2.projectPoints(rim, np.zeros(3), np.zeros(3), matrix, np.array(lens))[0][:, 0]
        red = np.clip((picture[..., 0] - picture[..., 1]) / 60.0, 0.0, 1.0)  # 1 in the sphere, 0 on the grey around
        sample = _sampled(red, pixels)
        shape = cv2.contourArea(pixels.astype(np.float32))
        inside = cv2.pointPolygonTest(pixels.astype(np.float32), pixels.mean(0).tolist(), measureDist=False) > 0
        assert inside
        assert abs((red > 0.5).sum() / shape - 1.0) < 0.06
        assert 0.2 < np.median(sample) < 1.0  # on the edge, not inside and not outside
        outer = (pixels - pixels.mean(0)) * (1.0 + 3.0 / np.linalg.norm(pixels - pixels.mean(0), axis=1))[:, None]
        beyond = _sampled(red, outer + pixels.mean(0))
        assert beyond.max() < 0.1


def test_lens_is_opencvs() -> None:
    rng = np.random.default_rng(1)
    rays = rng.uniform(-0.6, 0.6, (200, 2))
    intrinsics, lens = np.array([500.0, 480.0, 320.0, 250.0]), np.array([-0.3, 0.1, 0.002, -0.001, -0.02])
    matrix = np.array([[500.0, 0.0, 320.0], [0.0, 480.0, 250.0], [0.0, 0.0, 1.0]])
    expected = cv2.projectPoints(np.column_stack([rays, np.ones(200)]), np.zeros(3), np.zeros(3), matrix, lens)[0]
    pixels = to_pixels(rays, intrinsics, lens)
    assert np.allclose(pixels, expected[:, 0], atol=1e-9)
    assert np.allclose(from_pixels(pixels, intrinsics, lens), rays, atol=1e-9)


def test_blur_is_the_mean_of_the_moments() -> None:
    """The camera on an exact arc while the shutter is open; the other robot stands still."""
    turning = camera(shutter=0.05)
    config, still = (
        load_config(None, camera=turning, arena=(9.0, 9.0)),
        load_config(None, camera=camera(), arena=(9.0, 9.0)),
    )
    room: Any = Sensor(config, 0)._room
    moments = room[0].shape[0]
    v, w = 0.3, 0.8
    total = np.zeros((120, 160, 3))
    for b in range(moments):
        t = 0.05 * ((b + 0.5) / moments - 0.5)
        theta = POSES[0, 2]
        x = POSES[0, 0] + v / w * (math.sin(theta + w * t) - math.sin(theta))
        y = POSES[0, 1] - v / w * (math.cos(theta + w * t) - math.cos(theta))
        total += take(still, [[x, y, theta + w * t], POSES[1]])
    blurred = take(config, velocities=[[v, 0.0, w], [0.0, 0.0, 0.0]])
    assert moments >= 4
    assert np.abs(total / moments - blurred).max() <= 1.0
    assert np.abs(take(still).astype(float) - blurred).max() > 30  # or else this would say nothing


def test_noise_has_the_spread_that_was_asked_for_and_its_own_seed() -> None:
    config = load_config(None, camera=camera(320, 240, noise=5.0))
    clean = take(load_config(None, camera=camera(320, 240))).astype(float)
    one, again, other = (take(config, seed=seed).astype(float) for seed in (1, 1, 2))
    noise = one - clean
    assert np.array_equal(one, again)
    assert abs(noise.std() - math.hypot(5.0, math.sqrt(1.0 / 12.0))) < 0.05  # and rounding
    assert abs(noise.mean()) < 0.05
    assert abs(np.corrcoef(noise.ravel(), (other - clean).ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(noise[:-1].ravel(), noise[1:].ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(noise[:, :-1].ravel(), noise[:, 1:].ravel())[0, 1]) < 0.02


def test_light_scales_the_levels() -> None:
    full = take(load_config(None, camera=camera())).astype(float)
    half = take(load_config(None, camera=camera(exposure=0.5, white_balance=(1.0, 0.8, 0.6)))).astype(float)
    assert np.abs(half - 0.5 * full * np.array([1.0, 0.8, 0.6])).max() <= 1.0
    assert take(load_config(None, camera=camera(exposure=50.0))).min() == 255


def test_channels_first_are_the_same_picture() -> None:
    config = load_config(None, camera=camera(noise=3.0), obstacles=OBSTACLES)
    assert np.array_equal(take(config, planar=True), np.moveaxis(take(config), -1, 0))


def test_another_size_shows_the_same_view() -> None:
    config = load_config(None, camera=camera(320, 240), obstacles=OBSTACLES, marker={"radius": 0.3})
    large = take(config).astype(np.float32)
    small = take(config, size=(80, 80)).astype(float)
    assert np.abs(cv2.resize(large, (80, 80), interpolation=cv2.INTER_AREA) - small).mean() < 3.0


def test_what_is_behind_or_around_the_camera_is_not_drawn() -> None:
    config = load_config(None, camera=camera(), robots=1, targets=3)
    here = POSES[0]
    behind = here - np.array([2.0 * math.cos(here[2]), 2.0 * math.sin(here[2]), 0.0])
    points = [[behind[0], behind[1], 0.5], [here[0], here[1], 0.3], [here[0] + 0.05, here[1], 0.3]]
    away = [[100.0 + k, 100.0, 0.5] for k in range(3)]
    assert np.array_equal(take(config, [here], points), take(config, [here], away))
