"""The real clients' own conformance suites, unchanged, on every door."""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import (
    api_test,
    max_cycles_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
    state_test,
)

import relloc_env

ROOT = Path(__file__).resolve().parents[2]
IDS = ("relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0")
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "dict": {"observation": "dict"},
    "bare": {"estimator": None},
    "bare-lossy": {"estimator": None, "network": {"latency": 0.1, "jitter": 0.1, "loss": 0.2}},
    "lossy": {"network": {"latency": 0.1, "jitter": 0.1, "loss": 0.2}},
    "gains": {"estimator": "cascade", "action": "motion+gains"},
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", IDS)
def test_gymnasium_checker_has_nothing_to_say(name: str, variant: str) -> None:
    env = gym.make(name, **VARIANTS[variant]).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_checker_renders(name: str) -> None:
    env = gym.make(name, render_mode="rgb_array").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", IDS)
def test_stable_baselines_checker(name: str, variant: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gym.make(name, **VARIANTS[variant]).unwrapped)


@pytest.mark.filterwarnings("ignore:.*Unknown options of reset")  # the suites pass an option of their own
@pytest.mark.filterwarnings("ignore:We recommend agents to be named")  # the paper's names
@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array")  # a Dict, as asked for
@pytest.mark.filterwarnings("ignore:Observation space for each agent probably should be")  # likewise
@pytest.mark.parametrize("robots", [1, 2])
@pytest.mark.parametrize("variant", VARIANTS)
def test_pettingzoo_suites(robots: int, variant: str) -> None:
    options = {"robots": robots, "max_cycles": 50, **VARIANTS[variant]}

    def parallel() -> Any:
        return relloc_env.parallel_env(**options)

    def aec() -> Any:
        return relloc_env.env(**options)

    parallel_api_test(parallel(), num_cycles=120)
    api_test(aec(), num_cycles=60)
    parallel_seed_test(parallel)
    seed_test(aec, num_cycles=20)
    state_test(aec(), parallel())


def test_pettingzoo_module_suites() -> None:
    max_cycles_test(relloc_env)
    render_test(relloc_env.env)  # type: ignore[arg-type]  # annotated there with the wrong `Env`


WRAPPERS: dict[str, Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]] = {
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "FlattenObservation": wrappers.FlattenObservation,
    "NormalizeObservation": wrappers.NormalizeObservation,
    "TimeAwareObservation": wrappers.TimeAwareObservation,
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 3),
}


needs_gymnasium_1_3 = pytest.mark.skipif(
    tuple(map(int, gym.__version__.split(".")[:2])) < (1, 3),
    reason="`Box` before 1.3 takes no `Horizon` for an integer",
)


@needs_gymnasium_1_3
@pytest.mark.parametrize("flatten", [True, False])
@pytest.mark.parametrize("name", IDS)
def test_time_aware_observation_of_a_dict(name: str, flatten: bool) -> None:
    """The wrapper's own entry `time` counts the actions, beside our fields."""
    env: Any = wrappers.TimeAwareObservation(
        gym.make(name, estimator="cascade", observation="dict", max_cycles=4), flatten=flatten
    )
    observation, _ = env.reset(seed=1)
    for k in range(5):
        assert env.observation_space.contains(observation)
        if not flatten:
            assert observation["time"] == k
        if k < 4:
            observation, *_ = env.step(env.action_space.sample())


@pytest.mark.parametrize(
    "wrapper",
    [pytest.param(name, marks=needs_gymnasium_1_3 if name == "TimeAwareObservation" else ()) for name in WRAPPERS],
)
@pytest.mark.parametrize("name", IDS)
def test_gymnasium_wrappers(name: str, wrapper: str) -> None:
    env = WRAPPERS[wrapper](gym.make(name, max_cycles=8))
    env.action_space.seed(3)
    observation, _ = env.reset(seed=3)
    assert env.observation_space.contains(observation)
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        ended = terminated or truncated
        assert np.shape(observation) == env.observation_space.shape
    if wrapper == "RecordEpisodeStatistics":
        assert info["episode"]["l"] == 8


def test_record_video(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    env = wrappers.RecordVideo(gym.make(IDS[1], max_cycles=4, render_mode="rgb_array"), str(tmp_path / "videos"))
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    (video,) = (tmp_path / "videos").glob("*.mp4")
    assert video.stat().st_size > 10_000


@pytest.mark.parametrize("name", IDS)
def test_id_without_import(name: str) -> None:
    env = gym.make(f"relloc_env:{name}")
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)


FRESH = """
import sys
import gymnasium as gym

def make():
    return gym.make("relloc_env:{name}", estimator="cascade")

if __name__ == "__main__":
    assert "relloc_env" not in sys.modules
    make().reset(seed=1)
    batch = gym.make_vec("relloc_env:{name}", num_envs=2, estimator="cascade")
    for context in ("fork", "spawn"):
        workers = gym.vector.AsyncVectorEnv([make, make], context=context)
        assert (workers.reset(seed=1)[0] == batch.reset(seed=1)[0]).all()
        workers.close()
    print("done")
"""


@pytest.mark.parametrize("name", IDS)
def test_id_in_a_process_that_imported_nothing(name: str, tmp_path: Path) -> None:
    """As workers of RLlib and scripts of CleanRL make environments; also in processes that they start in turn."""
    script = tmp_path / "fresh.py"
    script.write_text(FRESH.replace("{name}", name), "utf-8")
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    surroundings = {**os.environ, "PYTHONPATH": paths}
    command = [sys.executable, str(script)]
    run = subprocess.run(command, cwd=tmp_path, env=surroundings, capture_output=True, text=True, check=False)
    assert run.stdout == "done\n", run.stderr


@pytest.mark.parametrize("name", IDS)
def test_pettingzoo_registry(name: str) -> None:
    if not hasattr(pettingzoo, "parallel_registry"):
        pytest.skip("PettingZoo before 1.27 has no registry")
    env = pettingzoo.make("parallel", name, max_cycles=3)
    observations, _ = env.reset(seed=0)
    assert set(observations) == set(env.agents)
    assert pettingzoo.make("aec", name).possible_agents == env.possible_agents
