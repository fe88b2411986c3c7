"""Whole episodes are the same to the last bit: again, at every door, after other episodes, and in a fresh process."""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import relloc_env

ROUGH: dict[str, Any] = {
    "shield": None,
    "arena": [4.0, 3.0],
    "obstacles": [
        {"shape": "disc", "position": [0.9, 0.2], "radius": 0.3, "height": 0.35},
        {"shape": "box", "position": [-0.8, -0.4], "size": [0.7, 0.4], "angle": 0.6, "height": 1.0},
    ],
    "robot": [{"lag": [0.1, 0.05], "actuator_noise": [0.02, 0.05]}, {"mass": 12.0, "radius": 0.22}],
    "camera": {"preset": "pi", "miss_probability": 0.1, "frame_rate": 15.0, "quantisation": 1.0},
    "start": {"target_distance": [0.5, 3.5], "in_view": False, "robot_distance": 0.45, "margin": 0.25},
    "network": {"latency": 0.1, "jitter": 0.15, "loss": 0.2},
    "samples_per_action": 2,
    "max_cycles": 800,
}
"""Contacts, occlusions, lost and late messages, noise of every kind."""

CASES: dict[str, dict[str, Any]] = {
    "rough": ROUGH,
    "rough-map": {**ROUGH, "estimator": "map-alignment", "max_cycles": 200},
    "rough-bare": {**ROUGH, "estimator": None},
    "default": {"max_cycles": 800},
    "paper": {"scenario": "paper-simulation"},
}
SEEDS = (1, 2, 3)


def choices(seed: int, robots: int = 2) -> Iterator[NDArray[np.float64]]:
    """Without end: full speed forward or backward, held for ten actions."""
    rng = np.random.default_rng(seed)
    while True:
        drawn = rng.uniform(-1, 1, (robots, 2))
        drawn[:, 0] = np.sign(drawn[:, 0] + 0.3)
        for _ in range(10):
            yield drawn


def parallel_episode(env: Any, seed: int) -> tuple[str, int]:
    """(digest of all observations and rewards, number of samples in contact) of an episode."""
    digest, contacts = hashlib.sha256(), 0
    observations, _ = env.reset(seed=seed)
    actions = choices(seed)
    names = env.possible_agents
    for line in observations.values():
        digest.update(line.tobytes())
    while env.agents:
        observations, rewards, *_ = env.step(dict(zip(names, next(actions), strict=False)))
        for name in names:
            digest.update(observations[name].tobytes() + np.float64(rewards[name]).tobytes())
        contacts += int(env.core.simulation.world.contact.sum())
    return digest.hexdigest(), contacts


def digests(case: str) -> list[str]:
    env = relloc_env.parallel_env(CASES[case])
    return [parallel_episode(env, seed)[0] for seed in SEEDS]


def aec_episode(env: Any, seed: int) -> str:
    digest = hashlib.sha256()
    env.reset(seed=seed)
    names = env.possible_agents
    actions = choices(seed)
    for name in names:
        digest.update(env.observe(name).tobytes())
    while env.agents:
        action = next(actions)
        for name, part in zip(names, action, strict=True):
            assert env.agent_selection == name
            env.step(part)
        for name in names:
            digest.update(env.observe(name).tobytes() + np.float64(env.rewards[name]).tobytes())
        while env.agents and (env.terminations[env.agent_selection] or env.truncations[env.agent_selection]):
            env.step(None)
    return digest.hexdigest()


def test_again_and_in_any_order() -> None:
    """Three seeds of 800 actions each; again in another environment, backwards, after an episode cut short."""
    env, other = (relloc_env.parallel_env(ROUGH) for _ in range(2))
    runs = {seed: parallel_episode(env, seed) for seed in SEEDS}
    assert min(contacts for _, contacts in runs.values()) > 30
    assert len({digest for digest, _ in runs.values()}) == len(SEEDS)
    for seed in reversed(SEEDS):
        other.reset(seed=77)
        for _ in range(seed):
            other.step({agent: np.ones(2) for agent in other.agents})
        assert parallel_episode(other, seed) == runs[seed]


@pytest.mark.parametrize("case", ["rough", "rough-bare", "default"])
def test_doors_give_the_same(case: str) -> None:
    """One episode of 800 actions by turns, at once, and jointly."""
    options = CASES[case]
    digest, _ = parallel_episode(relloc_env.parallel_env(options), 4)
    assert aec_episode(relloc_env.env(options), 4) == digest
    parallel = relloc_env.parallel_env(options)
    joint: Any = gym.make("relloc_env/RelativePose-v0", config=options, disable_env_checker=True)
    lines, _ = parallel.reset(seed=4)
    line, _ = joint.reset(seed=4)
    actions, ended = choices(4), False
    while not ended:
        np.testing.assert_array_equal(line, np.concatenate(list(lines.values())))
        action = next(actions)
        lines, rewards, terminations, truncations, _ = parallel.step(
            dict(zip(parallel.possible_agents, action, strict=True))
        )
        line, reward, terminated, truncated, _ = joint.step(action.ravel())
        assert reward == np.mean(list(rewards.values()))
        assert (terminated, truncated) == (terminations["robot_a"], truncations["robot_a"])
        ended = terminated or truncated


def test_one_robot_at_both_doors() -> None:
    parallel = relloc_env.parallel_env(robots=1)
    alone: Any = gym.make("relloc_env/ActiveDepth-v0")
    lines, _ = parallel.reset(seed=5)
    line, _ = alone.reset(seed=5)
    for action in (pair[0] for pair, _ in zip(choices(5), range(120), strict=False)):
        np.testing.assert_array_equal(line, lines["robot_a"])
        lines, rewards, *_ = parallel.step({"robot_a": action})
        line, reward, *_ = alone.step(action)
        assert reward == rewards["robot_a"]
    assert parallel.agents == []


@pytest.mark.parametrize("estimator", ["cascade", "cascade-critical", "inverse-depth", "map-alignment"])
def test_estimator_changes_nothing_in_the_world(estimator: str) -> None:
    """The same motion, images and messages with any estimator as without one."""
    bare = relloc_env.parallel_env({**ROUGH, "max_cycles": 60, "estimator": None})
    full = relloc_env.parallel_env({**ROUGH, "max_cycles": 60, "estimator": estimator})
    for env in (bare, full):
        env.reset(seed=6)
    for action, _ in zip(choices(6), range(60), strict=False):
        for env in (bare, full):
            env.step(dict(zip(env.possible_agents, action, strict=True)))
        for part in ("world", "samples", "truth"):
            for a, b in zip(getattr(bare.core.simulation, part), getattr(full.core.simulation, part), strict=True):
                np.testing.assert_array_equal(a, b)


def test_streams_do_not_shift_each_other() -> None:
    """More noise in the images, or a lossy network, leaves starts, motion and odometry as they were."""
    base: dict[str, Any] = {"estimator": None, "max_cycles": 60, "robot": {"actuator_noise": (0.01, 0.01)}}
    variants: list[dict[str, Any]] = [
        {},
        {"camera": {"preset": "pi", "pixel_noise": 5.0, "miss_probability": 0.2}},
        {"network": {"loss": 0.3, "jitter": 0.2}},
    ]
    runs = []
    for variant in variants:
        env = relloc_env.parallel_env(base, **variant)
        env.reset(seed=7)
        rows = []
        for action, _ in zip(choices(7), range(60), strict=False):
            env.step(dict(zip(env.possible_agents, action, strict=True)))
            rows.append([env.core.simulation.truth.pose.copy(), env.core.simulation.samples.odometry.copy()])
        runs.append(rows)
    for rows in runs[1:]:
        for a, b in zip(runs[0], rows, strict=True):
            np.testing.assert_array_equal(a[0], b[0])
            np.testing.assert_array_equal(a[1], b[1])


def test_unseeded_episodes_differ() -> None:
    """Two environments without a seed; and episode after episode."""
    starts = []
    for _ in range(2):
        env = relloc_env.parallel_env(estimator=None)
        for _ in range(3):
            _, infos = env.reset()
            starts.append(infos["robot_a"]["truth/poses"].tobytes())
    assert len(set(starts)) == 6


def test_fresh_process_gives_the_same() -> None:
    """All cases and seeds, whole episodes, in a new interpreter with another hash seed."""
    root = Path(__file__).resolve().parents[2]
    script = (
        "import importlib.util, json, sys;"
        f"spec = importlib.util.spec_from_file_location('cases', {__file__!r});"
        "cases = importlib.util.module_from_spec(spec);"
        "spec.loader.exec_module(cases);"
        "print(json.dumps({case: cases.digests(case) for case in cases.CASES}))"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "12345", "PYTHONPATH": str(root)}
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment, cwd=root
    )
    there = json.loads(result.stdout.splitlines()[-1])
    assert there == {case: digests(case) for case in CASES}
