"""Cameras that take pictures inside environments: through every door, for every estimator."""

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env
from relloc_env.config import ConfigError, load_config
from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.estimators import names
from relloc_env.wrappers import EstimateObservation, RecordLog

SMALL = {"kind": "image", "width": 320, "height": 240, "field_of_view": 62.2}
ACTION = np.array([0.5, 0.15, 0.4, -0.2], np.float32)


def truth(core, n=0):
    """Normalised image coordinates of the targets in the last sample, (R, M, 2)."""
    world = core.simulation.world
    image = np.empty((core.config.robots, core.config.targets, 2))
    for r, (x, y, theta) in enumerate(world.pose[n]):
        for m, (p_x, p_y, p_z) in enumerate(world.points[n]):
            ahead = np.cos(theta) * (p_x - x) + np.sin(theta) * (p_y - y)
            image[r, m] = (np.sin(theta) * (p_x - x) - np.cos(theta) * (p_y - y)) / ahead, (0.3 - p_z) / ahead
    return image


def test_samples_are_what_is_found_in_the_pictures() -> None:
    """Within half a pixel of the truth, and of the world that the analytic camera has, 160 pictures."""
    env, plain = RellocEnv(camera=SMALL), RellocEnv(camera={**SMALL, "kind": "analytic"})
    env.reset(seed=3)
    plain.reset(seed=3)
    focal, seen, visible = env.config.camera_of(0).focal_length, 0, 0
    for _ in range(16):
        env.step(ACTION)
        plain.step(ACTION)
        samples, other = env.core.simulation.samples, plain.core.simulation.samples
        assert np.array_equal(env.core.simulation.world.pose, plain.core.simulation.world.pose)
        assert np.array_equal(samples.odometry, other.odometry)
        found = samples.seen[0, -1]
        assert np.abs(samples.image[0, -1] - truth(env.core))[found].max(initial=0.0) * focal < 0.5
        assert not samples.image[~samples.seen].any()
        assert np.array_equal(env.core.simulation.truth.visible, samples.seen)
        seen, visible = seen + found.sum(), visible + env.core.simulation.world.visible.sum()
    assert seen > 0.95 * visible > 0


@pytest.mark.parametrize("estimator", [*names(), None])
def test_every_estimator_lives_on_pictures(estimator) -> None:
    env = gym.make("relloc_env/RelativePose-v0", camera=SMALL, estimator=estimator, max_cycles=20)
    env.reset(seed=4)
    for _ in range(6):
        observation, reward, *_, info = env.step(ACTION)
        assert env.observation_space.contains(observation)
        assert np.isfinite(float(reward))
    if estimator == "map-alignment":
        assert info["errors/pose"][0, 0] < 0.3  # from 2 m


def test_alone_in_a_batch_and_on_two_threads_the_same_bits() -> None:
    """70 environments, of which two are run alone as well."""
    options: dict[str, Any] = {"camera": {**SMALL, "width": 64, "height": 48, "field_of_view": 62.2}, "max_cycles": 3}
    batches = [RellocVectorEnv(70, threads=threads, **options) for threads in (1, 2)]
    shown = [[envs.reset(seed=7)[0]] for envs in batches]
    for _ in range(5):  # past the end of an episode
        for envs, kept in zip(batches, shown, strict=True):
            kept.append(envs.step(np.tile(ACTION, (70, 1)))[0])
    assert np.array_equal(shown[0], shown[1])
    for n in (0, 69):
        env = RellocEnv(**options)
        assert np.array_equal(env.reset(seed=7 + n)[0], shown[0][0][n])
        for k in range(3):
            assert np.array_equal(env.step(ACTION)[0], shown[0][k + 1][n])


def test_state_and_copies_go_on_bit_for_bit() -> None:
    env = RellocEnv(camera=SMALL)
    env.reset(seed=5)
    for _ in range(3):
        env.step(ACTION)
    state, twin = env.get_state(), copy.deepcopy(env)
    ahead = [env.step(ACTION)[0] for _ in range(3)]
    assert np.array_equal([twin.step(ACTION)[0] for _ in range(3)], ahead)
    other = RellocEnv(camera=SMALL)
    other.reset(seed=99)
    other.set_state(state)
    assert np.array_equal([other.step(ACTION)[0] for _ in range(3)], ahead)
    clones = RellocVectorEnv(2, camera=SMALL)
    clones.reset(seed=5)
    assert np.array_equal(*clones.clone(0, 2, same_streams=True).step(np.tile(ACTION, (2, 1)))[0])


def test_a_robot_with_pictures_beside_one_without() -> None:
    env = relloc_env.parallel_env(camera=[SMALL, {**SMALL, "kind": "analytic", "pixel_noise": 3.0}])
    env.reset(seed=6)
    miss = []
    for _ in range(10):
        env.step({"robot_a": ACTION[:2], "robot_b": ACTION[2:]})
        samples = env.core.simulation.samples
        both = np.where(samples.seen[0, -1], np.abs(samples.image[0, -1] - truth(env.core)).max(-1), np.nan)
        miss.append(np.nanmax(both, axis=1))
    a, b = env.config.camera_of(0).focal_length * np.nanmedian(miss, axis=0)
    assert a < 0.3
    assert b > 1.0


def test_pictures_are_taken_at_the_frame_rate_alone() -> None:
    env = RellocEnv(camera={**SMALL, "frame_rate": 5.0}, samples_per_action=1, estimator=None)
    env.reset(seed=3)
    seen = [bool(env.core.simulation.first.seen.any())]
    for _ in range(12):
        env.step(0.2 * ACTION)
        seen.append(bool(env.core.simulation.samples.seen.any()))
        assert seen[-1] or not env.core.simulation.samples.image.any()
    assert seen == [k % 4 == 0 for k in range(13)]


def test_estimators_outside_see_the_same(tmp_path) -> None:
    inner = RellocEnv(camera=SMALL, estimator="map-alignment")
    outer = EstimateObservation(RellocEnv(camera=SMALL, estimator=None), "map-alignment")
    assert np.array_equal(inner.reset(seed=8)[0], outer.reset(seed=8)[0])
    for _ in range(3):
        assert np.array_equal(inner.step(ACTION)[0], outer.step(ACTION)[0])


def test_what_was_seen_can_be_recorded_and_replayed(tmp_path) -> None:
    from relloc_env.replay import replay

    env = RecordLog(RellocEnv(camera=SMALL, max_cycles=8), tmp_path)
    env.reset(seed=9)
    for _ in range(8):
        env.step(ACTION)
    env.close()
    result = replay(tmp_path / "episode_000", estimator=["map-alignment"], out=tmp_path / "out")
    assert result.table()[1]


def test_estimators_are_told_the_noise_of_the_detector() -> None:
    camera = load_config(camera={"kind": "image", "image": {"detection_noise": 0.3}, "pixel_noise": 5.0}).camera_of(0)
    assert camera.image_noise == pytest.approx(0.3 / camera.focal_length)
    assert load_config(camera="image").camera_of(0).kind == "image"
    assert load_config("paper-experiment", camera="image").camera_of(0).half_view == pytest.approx(np.radians(40.0))


def test_planners_imagine_without_pictures() -> None:
    envs = RellocVectorEnv(1, camera=SMALL)
    envs.reset(seed=3)
    model = envs.from_belief(envs.core.onboard.estimate, 4)
    assert model.core.config.camera_of(0).kind == "analytic"


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="`limited` true with `kind` image"):
        load_config(camera={"preset": "unlimited", "kind": "image"})
    with pytest.raises(ConfigError, match="at least one colour"):
        load_config(marker={"colours": []})
    tags: dict[str, Any] = {"marker": {"kind": "tag"}}
    for marker, detector, fits in (({}, "apriltag", "colour"), (tags, "colour", "apriltag")):
        for camera in (
            {"kind": "image", "image": {"detector": detector}},
            ["pi", {"kind": "image", "image": {"detector": detector}}],
        ):
            with pytest.raises(ConfigError, match=f"such as '{fits}', but it is '{detector}'"):
                load_config(camera=camera, **marker)
        assert load_config(camera={"image": {"detector": detector}}, **marker).camera_of(0).kind == "analytic"
    for grey in ((128, 128, 128), (255, 255, 255), (0, 0, 0), (255, 180, 180)):
        with pytest.raises(ConfigError, match=r"tells from grey.*one is \(\d"):
            load_config(camera="image", marker={"colours": [(214, 40, 40), grey]})
        load_config(camera="image", targets=1, marker={"colours": [(214, 40, 40), grey]})  # of no target
        load_config(marker={"colours": [grey]})
    with pytest.raises(ConfigError, match=r"Unknown option `camera\.image\.exposur`; did you mean `exposure`"):
        load_config(camera={"image": {"exposur": 1.0}})
    with pytest.raises(ConfigError, match="detector"):
        load_config(camera={"image": {"detector": "color"}})
