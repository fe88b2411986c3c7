"""The vector door is N single environments, to the last bit; and what Gymnasium's vector interface asks for."""

import copy
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers

import relloc_env
from relloc_env.config import ConfigError
from relloc_env.envs.vector import RellocVectorEnv
from tests.envs.batches import CASES, IDS, ROUGH, both, drive, same


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("case", CASES)
def test_same_as_single_environments(case: str, mode: str) -> None:
    """40 steps of 6 environments beside Gymnasium's vector of single ones: all that is handed out, in every mode."""
    vector, single = both(6, CASES[case], mode)
    assert vector.observation_space == single.observation_space
    assert vector.action_space == single.action_space
    rng = np.random.default_rng(1)
    same(vector.reset(seed=7), single.reset(seed=7))
    ended = np.zeros(2, np.int64)
    for step in range(40):
        actions = drive(rng, vector)
        found, expected = vector.step(actions), single.step(actions)
        same(found, expected, f"step {step}")
        assert vector.observation_space.contains(found[0])
        ended += found[2].sum(), found[3].sum()
        over = found[2] | found[3]
        if mode == "Disabled" and over.any():
            # Gymnasium's takes the mask out of the options, and hands the single environments an empty rest.
            same(vector.reset(options={"reset_mask": over}), single.reset(options={"reset_mask": over}))
    assert ended.sum() > 6
    assert ended[0] > 0
    assert ended[1] > 0 or case == "success"


def test_any_size_gives_the_same() -> None:
    """Environment k with seed s, in batches of 1, 3 and 40."""
    rng = np.random.default_rng(2)
    actions = [drive(rng, RellocVectorEnv(40, **ROUGH)) for _ in range(15)]
    runs = []
    for count in (40, 3, 1):
        env = RellocVectorEnv(count, **ROUGH)
        shown = [env.reset(seed=3)[0][0]]
        shown += [env.step(action[:count])[0][0] for action in actions]
        runs.append(np.array(shown))
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])


@pytest.mark.parametrize("estimator", ["cascade", None])
@pytest.mark.parametrize("name", IDS)
def test_make_vec(name: str, estimator: str | None) -> None:
    """The ids give the native environment, without a word of warning; and again from its specification."""
    env = gym.make_vec(name, num_envs=3, estimator=estimator, autoreset_mode="SameStep")
    assert isinstance(env, RellocVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert gym.make_vec(name, num_envs=2, estimator=None).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert env.spec is not None
    again = gym.make_vec(env.spec)
    same(env.reset(seed=1), again.reset(seed=1))
    assert isinstance(gym.make_vec(name, num_envs=2, vectorization_mode="sync", estimator=None), SyncVectorEnv)


WRAPPERS: dict[str, Callable[[Any], Any]] = {
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "NormalizeObservation": wrappers.NormalizeObservation,
    "NormalizeReward": wrappers.NormalizeReward,
    "ClipReward": lambda env: wrappers.ClipReward(env, -0.01, 0.01),
    "DictInfoToList": wrappers.DictInfoToList,
    "FlattenObservation": wrappers.FlattenObservation,
    "RescaleAction": lambda env: wrappers.RescaleAction(env, -2.0, 2.0),
    "ClipAction": wrappers.ClipAction,
}


SAME_STEP_TOO = ("RecordEpisodeStatistics", "ClipReward", "DictInfoToList", "RescaleAction", "ClipAction")
"""Wrappers that Gymnasium allows on SAME_STEP."""


@pytest.mark.filterwarnings("ignore:.*precision lowered by casting to float32")  # RescaleAction's own spaces
@pytest.mark.parametrize(
    ("wrapper", "mode"), [(name, "NextStep") for name in WRAPPERS] + [(name, "SameStep") for name in SAME_STEP_TOO]
)
def test_gymnasium_wrappers(wrapper: str, mode: str) -> None:
    """On the native environment each does what it does on Gymnasium's vector of single ones, for 30 steps."""
    options = {**ROUGH, "observation": "dict"} if wrapper == "FlattenObservation" else ROUGH
    vector, single = (WRAPPERS[wrapper](env) for env in both(4, options, mode))
    rng = np.random.default_rng(3)
    runs = [env.reset(seed=1) for env in (vector, single)]
    episodes = 0
    for _ in range(30):
        actions = drive(rng, vector)
        runs = [env.step(actions) for env in (vector, single)]
        for part in range(4):
            same(runs[0][part], runs[1][part])
        if wrapper == "RecordEpisodeStatistics" and "episode" in runs[0][4]:
            for entry in ("r", "l"):
                same(runs[0][4]["episode"][entry], runs[1][4]["episode"][entry])
            episodes += int(runs[0][4]["_episode"].sum())
        if wrapper == "DictInfoToList":
            for found, expected in zip(runs[0][4], runs[1][4], strict=True):
                np.testing.assert_equal(found, expected)
    assert episodes > 3 or wrapper != "RecordEpisodeStatistics"


def test_options_survive_autoresets_and_masked_resets() -> None:
    """Fixed poses hold for every later episode, also where a mask alone resets, until {} draws them again."""
    poses = [(-2.0, -0.5, 0.1), (-2.0, 1.5, -0.2)]
    env = RellocVectorEnv(3, estimator=None, max_cycles=2, autoreset_mode="Disabled", shield=None)
    _, info = env.reset(seed=1, options={"poses": poses})
    np.testing.assert_array_equal(info["truth/poses"], [poses] * 3)
    for _ in range(2):
        env.step(np.ones((3, 4)))
    mask = np.array([True, False, True])
    options = {"reset_mask": mask}
    _, info = env.reset(options=options)
    assert options == {"reset_mask": mask}
    np.testing.assert_array_equal(info["truth/poses"][mask], [poses] * 2)
    np.testing.assert_array_equal(info["_truth/poses"], mask)
    with pytest.raises(ResetNeeded, match=r"over are environments \[1\]"):
        env.step(np.ones((3, 4)))
    _, info = env.reset(options={"reset_mask": ~mask, "poses": None})
    assert not np.array_equal(info["truth/poses"][1], poses)
    env.step(np.ones((3, 4)))
    for mode in ("NextStep", "SameStep"):
        env = RellocVectorEnv(2, estimator=None, max_cycles=1, autoreset_mode=mode)
        env.reset(seed=1, options={"poses": poses})
        for _ in range(2):
            *_, info = env.step(np.ones((2, 4)))
        np.testing.assert_array_equal(info["truth/poses"], [poses] * 2)
        env.reset(options={})
        assert not np.array_equal(env.core.simulation.world.pose[0], poses)


def test_a_seed_for_each() -> None:
    env = RellocVectorEnv(3, **ROUGH)
    first, _ = env.reset(seed=5)
    np.testing.assert_array_equal(env.reset(seed=[5, 6, 7])[0], first)
    np.testing.assert_array_equal(env.reset(seed=np.array([7, 6, 5]))[0], first[::-1])
    some, _ = env.reset(seed=[5, None, 7])
    np.testing.assert_array_equal(some[[0, 2]], first[[0, 2]])
    assert not np.array_equal(some[1], first[1])
    assert len({line.tobytes() for line in env.reset()[0]}) == 3


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_what_is_handed_out_stays_as_it_was(form: str) -> None:
    """12 steps whose results are kept, and written into by another run: neither the results nor the runs change."""
    runs = []
    for spoil in (False, True):
        env = RellocVectorEnv(3, **ROUGH, observation=form)
        rng = np.random.default_rng(4)
        kept: list[Any] = [env.reset(seed=2)]
        copies = [copy.deepcopy(kept[-1])]
        for _ in range(12):
            kept.append(env.step(drive(rng, env)))
            copies.append(copy.deepcopy(kept[-1]))
            if spoil:
                for part in kept[-1][:4]:
                    for array in part.values() if isinstance(part, dict) else (part,):
                        array[...] = 1
                kept[-1][4]["truth/poses"][:] = 9.0
                kept[-1][4]["_truth/poses"][:] = False
                kept[-1][4]["reward/effort"][:] = 9.0
        if not spoil:
            for found, expected in zip(kept, copies, strict=True):
                same(found[0], expected[0])
                same(found[-1], expected[-1])
        runs.append(copies)
    for found, expected in zip(*runs, strict=True):
        for a, b in zip(found, expected, strict=True):
            same(a, b)


def test_observations_without_copy_are_the_same_array() -> None:
    env = RellocVectorEnv(2, estimator=None, copy=False)
    first, _ = env.reset(seed=1)
    then, *_ = env.step(np.ones((2, 4)))
    np.testing.assert_array_equal(first, then)
    assert np.shares_memory(first, then)


def test_leaner_infos() -> None:
    env = RellocVectorEnv(2, **{**ROUGH, "max_cycles": 1}, info=(), autoreset_mode="SameStep")
    assert env.reset(seed=1)[1] == {}
    *_, info = env.step(np.zeros((2, 4)))
    assert set(info) == {"final_obs", "_final_obs", "final_info", "_final_info"}
    assert info["final_info"] == {}
    _, info = RellocVectorEnv(2, **ROUGH, info=["truth"]).reset(seed=1)
    assert set(info) == {"truth/poses", "_truth/poses", "truth/points", "_truth/points"}
    with pytest.raises(ConfigError, match=r"`info` must have names among .*, but has 'rewards'; did you mean `reward`"):
        RellocVectorEnv(2, info=["rewards"])
    with pytest.raises(ConfigError, match=r"`info` must be a sequence of names among .*, but is 'truth'"):
        RellocVectorEnv(2, info="truth")


def test_pictures() -> None:
    pytest.importorskip("pygame")
    env = gym.make_vec(IDS[1], num_envs=2, estimator=None, render_mode="rgb_array", max_cycles=2)
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.ones((2, 4)))
        frames = env.render()
        first, second = map(np.asarray, frames or ())
        assert first.shape == second.shape == (540, 960, 3)
        assert not np.array_equal(first, second)
    env.close()
    assert RellocVectorEnv(2, estimator=None).render() is None


def test_ids_are_registered_for_vectors() -> None:
    assert relloc_env.__version__
    for name in IDS:
        assert gym.spec(name).vector_entry_point == "relloc_env.envs.vector:RellocVectorEnv"
