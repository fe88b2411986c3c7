"""Curricula and drawn options for Stable-Baselines3: what is drawn when, and rows as single environments give them."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from relloc_env.config import ConfigError, load_config
from relloc_env.envs.sb3 import RellocVecEnv
from relloc_env.envs.varied import VariedVecEnv

SHORT: dict[str, Any] = {"estimator": "cascade", "max_cycles": 4}
MANY: dict[str, Any] = {
    "vary": {
        "targets": [2, 4],
        "camera.pixel_noise": [0.8, 3.2],
        "robot.odometry_noise": [[0.005, 0.01], [0.02, 0.04]],
        "network.loss": [0, 1],
        "robot.max_speed": {"choices": [0.2, 0.4]},
    }
}


def actions_of(env: Any, seed: int, steps: int) -> Any:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, env.num_envs, *env.action_space.shape))


def play(env: VariedVecEnv, seed: int, steps: int) -> list[Any]:
    """What rows show, step by step, with rewards, ends and configurations."""
    env.seed(seed)
    shown: list[Any] = [(env.reset(), env.configs)]
    for action in actions_of(env, seed, steps):
        observations, rewards, ends, infos = env.step(action)
        shown.append((observations, rewards, ends, infos, env.configs))
    return shown


@pytest.mark.parametrize("decentralised", [False, True])
def test_a_group_is_an_environment_of_its_configuration(decentralised: bool) -> None:
    """The first life of each group beside a `RellocVecEnv` of what was drawn, from the same seeds."""
    env = VariedVecEnv(5, **SHORT, stages=[MANY], groups=2, decentralised=decentralised)
    env.seed(7)
    first = env.reset()
    actions = actions_of(env, 1, 4)
    shown: Any = [first] + [env.step(action) for action in actions[:3]]
    names, each = env.field_slices, env.rows_each
    for config, part, seed in zip(env.configs, (slice(0, 2 * each), slice(2 * each, 5 * each)), (7, 9), strict=True):
        other = RellocVecEnv(2 if seed == 7 else 3, config, decentralised=decentralised)
        other.seed(seed)
        line: Any = other.reset()
        for k in range(4):
            seen = shown[0] if k == 0 else shown[k][0]
            for name, where in other.field_slices.items():
                wide, narrow = seen[part, names[name]], line[:, where]
                count, least = narrow.shape
                if name.endswith("points"):
                    wide, rest = wide[:, :least], wide[:, least:]
                    assert not rest.any()
                np.testing.assert_array_equal(wide.reshape(count, -1), narrow, err_msg=name)
            if k < 3:
                line, rewards, *_ = other.step(actions[k, part])
                np.testing.assert_array_equal(shown[k + 1][1][part], rewards)


def test_what_is_drawn_is_in_its_bounds_and_never_the_same() -> None:
    """Five lives of four groups: 20 configurations."""
    env = VariedVecEnv(4, **SHORT, stages=[MANY], groups=4)
    shown = play(env, 3, 16)
    drawn = [config for k in range(0, 17, 4) for config in shown[k][-1]]
    assert len(drawn) == 20
    assert {config.targets for config in drawn} == {2, 3, 4}
    assert {config.robot_of(0).max_speed for config in drawn} == {0.2, 0.4}
    noise = np.array([config.camera_of(0).pixel_noise for config in drawn])
    loss = np.array([config.network.loss for config in drawn])
    speed, turn = np.array([config.robot_of(1).odometry_noise for config in drawn]).T
    for values, least, greatest in ((noise, 0.8, 3.2), (loss, 0.0, 1.0), (speed, 0.005, 0.02)):
        assert least <= values.min() < least + 0.3 * (greatest - least)
        assert greatest - 0.3 * (greatest - least) < values.max() <= greatest
        assert len(set(values)) == 20
    np.testing.assert_allclose((turn - 0.01) / 0.03, (speed - 0.005) / 0.015)


def test_estimators_believe_what_is_said_without_the_draw() -> None:
    env = VariedVecEnv(3, **SHORT, stages=[{"suite": "noisy", "vary": {"camera.pixel_noise": [8.0, 9.0]}}], groups=3)
    said = load_config(SHORT, camera={"pixel_noise": 4.8})
    for config in env.configs:
        assert config.camera_of(0).pixel_noise >= 8.0
        assert config.camera_of(0).miss_probability == 0.2
        estimator: Any = config.estimator
        assert estimator.image_noise == said.camera_of(0).image_noise
        assert estimator.odometry_noise == (0.03, 0.03)


@pytest.mark.parametrize("ends", [{}, {"terminate_on_success": True, "success": (0.5, 30.0)}])
def test_lives_are_whole_episodes_or_truncated(ends: dict[str, Any]) -> None:
    """Every fourth step ends every row; early ends lie between. Each end has its last observation, and says how."""
    env = VariedVecEnv(6, **SHORT, **ends, stages=[MANY], groups=2, decentralised=True)
    shown = play(env, 5, 12)
    early = 0
    for k, (_, _, over, infos, configs) in enumerate(shown[1:], 1):
        early += int(over.sum()) if k % 4 else 0
        assert over.all() or k % 4
        for row in range(12):
            assert ("terminal_observation" in infos[row]) == over[row]
            if over[row]:
                assert infos[row]["terminal_observation"].shape == env.observation_space.shape
                assert env.observation_space.contains(infos[row]["terminal_observation"])
                assert k % 4 == 0 or not infos[row]["TimeLimit.truncated"]
                assert k % 4 or ends or infos[row]["TimeLimit.truncated"]
        assert (configs == shown[k - 1][-1]) == bool(k % 4)
    assert (early > 0) == bool(ends)


def test_the_same_seed_gives_the_same_and_another_does_not() -> None:
    first, again, other = (play(VariedVecEnv(4, **SHORT, stages=[MANY], groups=2), seed, 9) for seed in (1, 1, 2))
    np.testing.assert_equal(first, again)
    assert first[0][-1] != other[0][-1]


def test_stages_follow_one_another() -> None:
    """Three stages of two lives each; the variants of a suite are dealt out among the groups."""
    stages: list[dict[str, Any]] = [
        {"until": 24, "vary": {"camera.field_of_view": [40.0, 50.0]}},
        {"until": 48, "options": {"robot": {"lag": [0.2, 0.1]}}},
        {"suite": "many-points"},
    ]
    env = VariedVecEnv(3, **SHORT, stages=stages, groups=3)
    shown = play(env, 0, 24)
    assert env.config.targets == 6
    for k in range(24):
        configs, stage = shown[k][-1], k // 8
        views = [2.0 * np.degrees(config.camera_of(0).half_view) for config in configs]
        assert all(40.0 <= view <= 50.0 for view in views) if stage == 0 else np.allclose(views, 62.2)
        assert [config.robot_of(1).lag for config in configs] == [(0.2, 0.1) if stage == 1 else (0.0, 0.0)] * 3
        assert [config.targets for config in configs] == ([3, 4, 5] if stage == 2 else [2, 2, 2])


def test_goes_on_from_a_state_bit_for_bit() -> None:
    """Saved in the middle of a life, put back elsewhere; on into the next two lives."""
    env, other = (VariedVecEnv(4, **SHORT, stages=[MANY], groups=2) for _ in range(2))
    play(env, 1, 6)
    state = env.get_state()
    other.seed(9)
    other.reset()
    actions = actions_of(env, 4, 9)
    other.set_state(state)
    for action in actions:
        np.testing.assert_equal(other.step(action), env.step(action))
    np.testing.assert_array_equal(other.set_state(env.get_state()), other.set_state(other.get_state()))


def test_gains_of_points_that_are_not_there_are_left() -> None:
    env = VariedVecEnv(2, **SHORT, action="motion+gains", stages=[{"vary": {"targets": {"choices": [2, 3]}}}], groups=2)
    assert env.action_space.shape == (16,)
    play(env, 0, 9)


def test_ppo_learns_on_it() -> None:
    env = VecMonitor(VariedVecEnv(4, **SHORT, stages=[MANY], groups=2, decentralised=True))
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, seed=1, device="cpu").learn(256)
    assert model.num_timesteps == 256
    assert env.unwrapped.timesteps == 256  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("stages", "words"),
    [
        ([{"vary": {"camera.pixel_nose": [0, 1]}}], ("pixel_nose", "pixel_noise")),
        ([{"vary": {"camera.pixel_noise": [-1.0, 1.0]}}], ("pixel_noise", "-1")),
        ([{"vary": {"robot.lag": [[0.1, 0.1], 0.2]}}], ("finite numbers to as many", "0.2")),
        ([{"suite": "open-feld"}], ("open-feld", "open-field")),
        ([{}, {}], ("until",)),
        ([{"until": 5}, {"until": 3}, {}], ("until", "in order")),
        ([{"options": {"robots": 1}, "until": 5}, {}], ("one `robots`",)),
        ([{"untl": 5}], ("untl", "until")),
        ([], ("stages",)),
    ],
)
def test_stages_that_cannot_be(stages: Any, words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as caught:
        VariedVecEnv(2, **SHORT, stages=stages, groups=1)
    assert all(word in str(caught.value) for word in words), str(caught.value)
