"""What the picture of an environment tells of errors, honesty and the bound, against NumPy on `info` and the state."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import chi2

import relloc_env  # noqa: F401 - registers the ids
from relloc_env.envs.picture import Picture
from relloc_env.rendering.course import least_excitation
from relloc_env.rendering.scene import Strip
from relloc_env.samples import empty_samples


def _after(name: str, actions: int, **options: Any) -> tuple[Any, dict[str, Any], dict[str, Strip]]:
    env = gym.make(f"relloc_env/{name}-v0", **options).unwrapped
    env.reset(seed=5)
    picture = Picture(env.core, "rgb_array")  # type: ignore[attr-defined]
    picture.follow(new=True)
    info: dict[str, Any] = {}
    for _ in range(actions):
        info = env.step(np.array([1.0, 0.2, 0.8, -0.2], np.float32)[: env.action_space.shape[0]])[4]  # type: ignore[index]
        picture.follow()
    return env, info, {strip.label: strip for strip in picture.scene().strips}


def test_errors_honesty_and_bound_of_a_pose() -> None:
    env, info, strips = _after("RelativePose", 20, estimator="cascade")
    assert list(strips) == ["depth error [m]", "pose error [m, °]", "NEES", "excitation [m/s]"]
    for strip in strips.values():
        assert strip.time == pytest.approx(np.arange(0.0, 5.01, 0.25))
    believed, (a, b) = env.core.onboard.estimate, info["truth/poses"]
    toward = complex(b[0] - a[0], b[1] - a[1]) * np.exp(-1j * a[2])
    error = believed.pose[0, 0] - [toward.real, toward.imag, b[2] - a[2]]
    error[2] = np.angle(np.exp(1j * error[2]))
    wanted = error @ np.linalg.inv(believed.pose_covariance[0, 0]) @ error
    honest, pose = strips["NEES"], strips["pose error [m, °]"]
    assert honest.lines[0, -1] == pytest.approx(wanted, rel=1e-3)
    assert honest.band == pytest.approx([chi2.ppf(0.025, 3), chi2.ppf(0.975, 3)], rel=1e-3)
    assert pose.lines[0, -1] == pytest.approx(np.hypot(*error[:2]))
    assert pose.lines[:, -1] == pytest.approx(info["errors/pose"][:, 0])
    square = np.trace(env.core.score.pose_covariance[0, :2, :2])
    assert pose.bound is not None
    assert pose.bound[-1] == pytest.approx(np.sqrt(square))
    depth = strips["depth error [m]"]
    assert depth.lines[:, -1] == pytest.approx(np.abs(info["errors/range"]).max(axis=1))
    excitation = strips["excitation [m/s]"].lines
    assert np.isnan(excitation[:, [0, -1]]).all()  # before there was motion, and when nothing is in view any more


def test_ranges_of_a_single_robot_against_the_bound() -> None:
    _, info, strips = _after("ActiveDepth", 8, targets=1)
    assert list(strips) == ["depth error [m]", "NEES", "excitation [m/s]"]
    # One target: the bound's worst standard deviation is that of its range.
    depth = strips["depth error [m]"]
    assert depth.bound is not None
    assert depth.bound[-1] == pytest.approx(info["bound_sd"][0], rel=1e-6)
    assert depth.lines[0, -1] == pytest.approx(abs(info["errors/range"][0, 0]), rel=1e-6)
    assert strips["NEES"].band == pytest.approx(chi2.ppf([0.025, 0.975], 3), rel=1e-3)
    gained = strips["excitation [m/s]"].lines[0, -1] ** 2 * 0.25
    assert gained == pytest.approx(info["reward/excitation"], rel=0.05)  # which goes by the truth


def test_excitation_is_that_of_the_points_in_view() -> None:
    samples = empty_samples(n=2, k=2, r=3, m=2, p=6)
    samples.odometry[1, :, :, 0] = 0.5
    samples.odometry[1, :, 2, 1] = 0.1
    samples.image[1, :, 0] = (0.3, 0.4), (9.0, 9.0)  # the second is not seen
    samples.seen[1, :, 0, 0] = True
    samples.image[1, :, 2] = (-0.2, 0.1), (0.6, 0.8)
    samples.seen[1, 0, 2] = True
    first_of_c = np.hypot(0.5 * -0.2 + 0.1, 0.5 * 0.1)
    assert least_excitation(samples, 1, slice(None)) == pytest.approx([0.25, np.nan, first_of_c], nan_ok=True)


def test_what_is_not_known_is_not_told() -> None:
    bare = _after("RelativePose", 2, estimator=None, bound=True)[2]
    assert list(bare) == ["depth error [m]", "pose error [m, °]", "excitation [m/s]"]
    assert list(bare["depth error [m]"].values) == ["–", "–"]
    without = _after("RelativePose", 1, estimator="cascade", reward={"visibility": 1.0})[2]
    assert list(without) == ["depth error [m]", "pose error [m, °]", "NEES", "excitation [m/s]"]
    assert all(strip.bound is None for strip in without.values())


def test_a_singular_covariance_has_no_nees() -> None:
    env, *_ = _after("RelativePose", 1, estimator="cascade")
    env.core.onboard.estimate.pose_covariance[:] = 0.0
    picture = Picture(env.core, "rgb_array")
    picture.follow(new=True)
    assert "NEES" not in {strip.label for strip in picture.scene().strips}


def test_pictures_of_cameras_are_shown() -> None:
    pytest.importorskip("cv2")
    camera = [{"kind": "image", "width": 160, "height": 120}, "pi"]
    env, *_ = _after("RelativePose", 1, estimator="cascade", camera=camera)
    picture = Picture(env.core, "rgb_array")
    picture.follow(new=True)
    scene = picture.scene()
    taken, none = scene.pictures
    assert none is None
    assert taken is not None
    assert taken.shape == (120, 160, 3)
    focal = env.config.camera_of(0).focal_length
    for m in np.flatnonzero(scene.in_view[0]):
        column, row = (80.0, 60.0) + focal * scene.true_image[0, m]
        seen = taken[int(row), int(column)].astype(float)
        # The middle of a target is of its colour, up to the light.
        cosine = seen @ scene.colours[m] / np.linalg.norm(seen) / np.linalg.norm(scene.colours[m].astype(float))
        assert cosine > 0.97
    assert scene.in_view[0].any()
