"""What the picture of an environment tells of errors, honesty and the bound, against NumPy on `info` and the state."""

import copy
import sys
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import chi2

import relloc_env  # noqa: F401 - registers the ids
from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.history import _BYTES, _MOST
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.envs.picture import Picture
from relloc_env.envs.sb3 import RellocVecEnv
from relloc_env.rendering.course import Table, least_excitation
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
    least = least_excitation(samples.odometry, samples.image, samples.seen)
    assert least[1] == pytest.approx([0.25, np.nan, first_of_c], nan_ok=True)
    assert np.isnan(least[0]).all()


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


def _calls(step: Callable[[], object]) -> int:
    """How many functions one call of `step` calls, those of NumPy included."""
    count = 0

    def note(frame: object, event: str, function: object) -> None:
        nonlocal count
        count += event in {"call", "c_call"}

    sys.setprofile(note)
    try:
        step()
    finally:
        sys.setprofile(None)
    return count


def _single(robots: int, mode: str | None, **options: Any) -> Callable[[], object]:
    env = RellocEnv(robots=robots, render_mode=mode, **options)
    env.reset(seed=1)
    action = np.zeros(2 * robots, np.float32)
    return lambda: env.step(action)


def _parallel(robots: int, mode: str | None, **options: Any) -> Callable[[], object]:
    env = RellocParallelEnv(robots=robots, render_mode=mode, **options)
    env.reset(seed=1)
    action = dict.fromkeys(env.agents, np.zeros(2, np.float32))
    return lambda: env.step(action)


def _vector(robots: int, mode: str | None, **options: Any) -> Callable[[], object]:
    name = {1: "ActiveDepth", 2: "RelativePose"}[robots]
    env = gym.make_vec(f"relloc_env/{name}-v0", 1, render_mode=mode, **options)
    env.reset(seed=1)
    action = np.zeros((1, 2 * robots), np.float32)
    return lambda: env.step(action)


def _stable_baselines(robots: int, mode: str | None, **options: Any) -> Callable[[], object]:
    env = RellocVecEnv(1, robots=robots, render_mode=mode, **options)
    env.reset()
    action = np.zeros((1, 2 * robots), np.float32)
    return lambda: env.step(action)


@pytest.mark.parametrize("robots", [1, 2])
@pytest.mark.parametrize("interface", [_single, _parallel, _vector, _stable_baselines])
def test_a_mode_costs_copies_alone_until_somebody_looks(interface: Any, robots: int) -> None:
    """A step of an episode of 240 actions calls at most four functions more with "rgb_array" than without."""
    with_mode, without = (interface(robots, mode, estimator="cascade", max_cycles=240) for mode in ("rgb_array", None))
    for _ in range(2):
        with_mode(), without()
    assert max(_calls(with_mode) - _calls(without) for _ in range(230)) <= 4


@pytest.mark.parametrize("estimator", ["cascade", None])
@pytest.mark.parametrize("robots", [1, 2])
def test_pictures_do_not_depend_on_when_somebody_looks(robots: int, estimator: str | None) -> None:
    """Looked at after every action, and once after `_MOST` and some more: the same pixels, the same numbers."""
    options: dict[str, Any] = {"estimator": estimator, "robots": robots, "bound": True, "max_cycles": 2 * _MOST}
    often, late = (RellocEnv(**options, render_mode="rgb_array") for _ in range(2))
    rng = np.random.default_rng(3)
    for env in (often, late):
        env.reset(seed=4)
        env.step(np.ones(2 * robots))  # of an episode that nobody sees
        env.reset(seed=5)
    for k in range(_MOST + 40):
        action = rng.uniform(-1.0, 1.0, 2 * robots)
        often.step(action)
        late.step(action)
        if k < 3 or k % 16 == 0 or k > _MOST + 36:
            before = often.render()
    assert np.array_equal(before, late.render())
    one, two = (env._picture.scene() for env in (often, late))
    assert len(one.strips[0].time) == _MOST + 41
    for strip, other in zip(one.strips, two.strips, strict=True):
        assert strip.lines == pytest.approx(other.lines, rel=1e-12, nan_ok=True)
    for trail, other_trail in zip(one.trails, two.trails, strict=True):
        assert np.array_equal(trail, other_trail)


def test_a_copy_of_a_drawn_environment_draws_what_it_does_itself() -> None:
    env = RellocEnv(estimator="cascade", render_mode="rgb_array")
    env.reset(seed=5)
    env.step(np.ones(4))
    env.render()
    other = copy.deepcopy(env)
    for _ in range(3):
        env.step(np.array([1.0, 0.3, 1.0, -0.3]))
        other.step(np.array([-1.0, 0.3, 0.5, -0.3]))
    assert not np.array_equal(env.render(), other.render())
    (ours, theirs), now = (each._picture.scene() for each in (env, other)), other.core.simulation.world.pose[0, :, :2]
    assert np.array_equal(ours.trails[0][:6], theirs.trails[0][:6])
    assert [trail[-1] for trail in theirs.trails] == pytest.approx(now)


def test_what_is_remembered_is_bounded() -> None:
    """Of 10^6 rows added in pieces, 2^10 at most stay: evenly spread, with the first and the newest among them."""
    table, rng, count = Table(2, 2**10), np.random.default_rng(0), 0
    while count < 10**6:
        piece = int(rng.integers(1, 400))
        times = np.arange(count, count + piece, dtype=np.float64)
        table.add(np.stack([times, -times], axis=1))
        count += piece
        kept = table.rows[:, 0]
        assert len(kept) <= 2**10
        assert (kept[0], kept[-1]) == (0.0, count - 1)
        assert len(set(np.diff(kept[:-1]))) <= 1
    assert len(table.rows) > 2**9
    assert np.array_equal(table.rows[:, 1], -table.rows[:, 0])
    many = RellocEnv(targets=16, bound=True, estimator="cascade", render_mode="rgb_array")
    many.reset(options={"poses": [[-2, 0, 0], [-2, 1, 0]], "points": [[1, 0.1 * m - 0.8, 0.5] for m in range(16)]})
    raw = many._picture._history._raw  # type: ignore[union-attr]
    assert sum(array.nbytes for array in raw.values()) <= _BYTES


def test_only_the_past_that_is_shown_is_remembered_in_full() -> None:
    table = Table(1, 2**10, past=60.0)
    for k in range(5000):
        table.add(np.array([[0.25 * k]]))
    shown = table.rows[table.rows[:, 0] >= 0.25 * 4999 - 60.0, 0]
    assert shown == pytest.approx(np.arange(0.25 * 4999 - 60.0, 0.25 * 4999 + 0.1, 0.25))
