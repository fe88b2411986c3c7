"""Hard cases for a detector: single pictures of random places, and what it finds in them."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import EnvConfig, load_config
from relloc_env.pinhole import project
from relloc_env.samples import Float
from relloc_env.vision import make_detector
from relloc_env.vision.lens import to_pixels
from relloc_env.vision.sensor import Sensor

Tell = Callable[[float, str], object]
FALSE = 5.0
"""[px] a detection farther from its target than this is one of something else."""
TAG: Mapping[str, Any] = {"marker": {"kind": "tag"}}


def _image(**options: Any) -> dict[str, Any]:
    return {"camera": {"kind": "image", "image": options}}


CASES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "plain": ("", {}),
    "a third of the light": ("", _image(exposure=0.33)),
    "a tenth of the light": ("", _image(exposure=0.1)),
    "a tenth of the light, a green target": (
        "",
        {**_image(exposure=0.1), "marker": {"colours": [(40, 170, 60)]}},
    ),
    "twice the light": ("", _image(exposure=2.0)),
    "warm light": ("", _image(white_balance=(1.15, 1.0, 0.75))),
    "cold light": ("", _image(white_balance=(0.8, 1.0, 1.2))),
    "noise of 10 levels": ("", _image(noise=10.0)),
    "blur of 20 ms at 0.8 rad/s": ("turn", _image(shutter=0.02)),
    "a lens that distorts": ("", _image(distortion=(-0.25, 0.06, 0.001, -0.001, 0.0))),
    "at the image's border": ("border", {}),
    "partly hidden by a post": ("post", {}),
    "partly hidden, a tenth of the light": ("post", _image(exposure=0.1)),
    "a post of the same colour": ("alike", {}),
    "a ball of a similar colour": ("similar", {}),
    "320 x 240": ("", {"camera": {"kind": "image", "width": 320, "height": 240, "field_of_view": 62.2}}),
    "AprilTag": ("", {**_image(detector="apriltag"), **TAG}),
    "AprilTag, a third of the light": ("", {**_image(detector="apriltag", exposure=0.33), **TAG}),
    "AprilTag, a lens that distorts": (
        "",
        {**_image(detector="apriltag", distortion=(-0.25, 0.06, 0.001, -0.001, 0.0)), **TAG},
    ),
    "AprilTag, partly hidden by a post": ("post", {**_image(detector="apriltag"), **TAG}),
    "AprilTag, blur of 20 ms at 0.8 rad/s": ("turn", {**_image(detector="apriltag", shutter=0.02), **TAG}),
}
"""What is special about the scene, and options of the environment."""


def trials(pictures: int, tell: Tell) -> dict[str, dict[str, float | None]]:
    """Take so many pictures of each case, and compare what is found with where the target is.

    Returns:
        By case: share of pictures in which the target is found, median and 95 % quantile of the error [px], share of
        pictures in which something else is taken for it.
    """
    found = {}
    for k, (name, (scene, options)) in enumerate(CASES.items()):
        tell(k / len(CASES), name)
        found[name] = _trial(scene, options, pictures)
    return found


def _trial(scene: str, options: Mapping[str, Any], pictures: int) -> dict[str, float | None]:
    """One case: target 0 is looked for; its distance is 1.5 to 7 m."""
    rng = np.random.default_rng(7)
    errors, false = [], 0
    for k in range(pictures):
        config, pose, points = _scene(scene, options, rng)
        sensor = Sensor(config, 0)
        view = sensor.view
        picture: NDArray[np.uint8] = np.zeros((view.height, view.width, 3), np.uint8)
        rate = 0.8 if scene == "turn" else 0.0
        motion = np.array([[[0.3 if rate else 0.0, 0.0, rate]]])
        sensor.take(picture[None], pose[None, None], motion, points[None], np.array([k], np.uint64))
        detections = make_detector(config, 0).detect(picture)
        here = np.flatnonzero(detections.fits[:, 0])
        if here.size:
            ray = project(pose, config.camera_of(0).mount_height, points)[0, :2]
            best = here[np.argmax(detections.score[here])]
            truth = to_pixels(ray, view.intrinsics, view.lens)
            error = float(np.linalg.norm(detections.pixels[best] - truth))
            if error < FALSE:
                errors.append(error)
            else:
                false += 1
    quantile = np.quantile(errors, (0.5, 0.95)).tolist() if errors else [None, None]
    return {
        "found": len(errors) / pictures,
        "median_px": quantile[0],
        "error_95_px": quantile[1],
        "false": false / pictures,
    }


def _scene(scene: str, options: Mapping[str, Any], rng: np.random.Generator) -> tuple[EnvConfig, Float, Float]:
    """A configuration, the robot's pose and the targets (2, 3); target 0 is in view."""
    plain = load_config(None, **{"camera": "image", **options, "robots": 1})
    camera = plain.camera_of(0)
    pose = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(-math.pi, math.pi)])
    distance, size = rng.uniform(1.5, 7.0), plain.marker.radius
    edge_x = 0.5 * camera.width / camera.focal_length
    edge_y = 0.5 * camera.height / camera.focal_length
    x = rng.uniform(-0.85, 0.85) * edge_x
    if scene == "border":  # part of it is out of the picture, its centre is not
        x = rng.choice([-1.0, 1.0]) * (edge_x - rng.uniform(0.0, 1.0) * size / distance)
    height = rng.uniform(-0.5, 0.8) * min(0.8 * edge_y * distance, 1.0)
    point = _place(pose, distance, x, camera.mount_height + height)
    other = _place(pose, rng.uniform(3.0, 6.0), rng.choice([-1.0, 1.0]) * 4.0, 0.5)  # out of view
    if scene == "post":  # its edge is somewhere before the target, which stays half in view or more
        near = 0.5 * distance
        radius = 0.03 + 0.3 * size
        edge = rng.uniform(-1.0, 0.0) * size / distance
        side = rng.choice([-1.0, 1.0])
        place = _place(pose, near, x + side * (edge - radius / near), 0.0)
        post = {"shape": "disc", "position": tuple(place[:2]), "radius": radius, "height": 2.0}
        return _with(options, post), pose, np.array([point, other])
    if scene == "alike":
        away = -0.5 * edge_x if x > 0.0 else 0.5 * edge_x
        place = _place(pose, rng.uniform(2.0, 5.0), away, 0.0)
        colour = plain.marker.colour_of(0)
        post = {"shape": "disc", "position": tuple(place[:2]), "radius": 0.15, "height": 0.8, "colour": colour}
        return _with(options, post), pose, np.array([point, other])
    if scene == "similar":  # red and orange, 12 degrees of hue apart
        away = -0.5 * edge_x if x > 0.0 else 0.5 * edge_x
        other = _place(pose, rng.uniform(2.0, 5.0), away, camera.mount_height + 0.1)
        colours = [(214, 40, 40), (214, 75, 40)]
        return _with({**options, "marker": {"colours": colours}}), pose, np.array([point, other])
    return _with(options), pose, np.array([point, other])


def _with(options: Mapping[str, Any], *obstacles: Mapping[str, Any]) -> EnvConfig:
    """A large arena with one robot and some obstacles."""
    given = {"camera": "image", **options, "robots": 1, "arena": (24.0, 24.0), "obstacles": list(obstacles)}
    return load_config(None, **given)


def _place(pose: Float, depth: float, x: float, z: float) -> Float:
    """The point at a depth [m] and an image coordinate [-], z [m] above the floor."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.array([pose[0] + depth * (cos + x * sin), pose[1] + depth * (sin - x * cos), z])
