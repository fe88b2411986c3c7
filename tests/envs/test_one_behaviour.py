"""Environment k with seed s gives one episode, to the last bit, at each door, in any batch, in any process.

200 seeds play whole episodes of 800 actions at full speed in a small, cluttered arena, without a shield and with noise
of every kind, and go on after an autoreset. What each environment shows is folded into one number per action: the
checksum of everything up to there.
"""

import hashlib
import os
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import relloc_env
from relloc_env.envs.vector import RellocVectorEnv

CROWDED: dict[str, Any] = {
    "estimator": "cascade",
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
    "samples_per_action": 1,
    "max_cycles": 800,
}
SEEDS = np.arange(200)
STEPS = 840
"""Actions: an episode, the autoreset, and the start of the next episode."""
SIZES = (1, 2, 3, 5, 7, 16, 33, 133)
"""Batches that the seeds are split into; they sum up to all of them."""
Trace = NDArray[np.uint32]


def actions_of(seed: int) -> NDArray[np.float64]:
    """(STEPS, 4) full speed forward or backward with some turn, held for ten actions."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (STEPS // 10, 4))
    drawn[:, 0::2] = np.sign(drawn[:, 0::2] + 0.3)
    return drawn.repeat(10, axis=0)


def fold(before: int, line: NDArray[np.float32], reward: float, terminated: bool, truncated: bool) -> int:
    """Checksum of all that came before, and of this."""
    return zlib.crc32(
        line.tobytes() + np.float64(reward).tobytes() + bytes([bool(terminated), bool(truncated)]), before
    )


class Batch:
    """Seeds played as one vector environment."""

    def __init__(self, seeds: NDArray[np.int64], threads: int | None = None) -> None:
        self.env = RellocVectorEnv(len(seeds), CROWDED, info=(), copy=False, threads=threads)
        self.actions = np.stack([actions_of(seed) for seed in seeds.tolist()], axis=1)
        lines, _ = self.env.reset(seed=seeds.tolist())
        self.sums = [fold(0, line, 0.0, False, False) for line in lines]

    def play(self, begin: int, end: int) -> Iterator[list[int]]:
        """Checksum of each environment after each action from `begin` on."""
        for action in self.actions[begin:end]:
            shown = zip(self.sums, *self.env.step(action)[:4], strict=True)
            self.sums = [fold(before, *row) for before, *row in shown]
            yield self.sums

    def trace(self) -> Trace:
        """(STEPS, N) checksums."""
        return np.array(list(self.play(0, STEPS)), np.uint32)


def single_trace(env: Any, seed: int) -> Trace:
    """(STEPS,) checksums of a Gymnasium environment that is reset where its episode is over."""
    line, _ = env.reset(seed=seed)
    total = fold(0, line, 0.0, False, False)
    sums, over = [], False
    for action in actions_of(seed):
        row = (env.reset()[0], 0.0, False, False) if over else env.step(action)[:4]
        over = row[2] or row[3]
        total = fold(total, *row)
        sums.append(total)
    return np.array(sums, np.uint32)


class Joint:
    """A PettingZoo environment, its robots' observations in one line and their rewards in one number."""

    def __init__(self) -> None:
        self.env = relloc_env.parallel_env(CROWDED)

    def reset(self, seed: int | None = None) -> tuple[Any, None]:
        lines, _ = self.env.reset(seed=seed)
        return np.concatenate(list(lines.values())), None

    def step(self, action: NDArray[np.float64]) -> tuple[Any, ...]:
        lines, rewards, *ends, _ = self.env.step(dict(zip(self.env.agents, action.reshape(2, 2), strict=True)))
        (terminated,), (truncated,) = (set(end.values()) for end in ends)
        return np.concatenate(list(lines.values())), sum(rewards.values()) / 2, terminated, truncated


@pytest.fixture(scope="module")
def reference() -> Trace:
    """All seeds in one batch."""
    return Batch(SEEDS).trace()


def hidden(batch: Batch) -> int:
    """How many targets are within a camera's image, by pinhole geometry, and not visible."""
    world, robots = batch.env.core.simulation.world, batch.env.core.simulation.robots
    limits = {name: robots[name][:, None] for name in robots.dtype.names or ()}
    ahead = world.points[:, None, :, :2] - world.pose[:, :, None, :2]
    cos, sin = (f(world.pose[:, :, 2])[..., None] for f in (np.cos, np.sin))
    z = cos * ahead[..., 0] + sin * ahead[..., 1]
    x = (sin * ahead[..., 0] - cos * ahead[..., 1]) / z
    y = (limits["mount_height"] - world.points[:, None, :, 2]) / z
    inside = (z > limits["near"]) & (z < limits["far"]) & (limits["x_min"] < x) & (x < limits["x_max"])
    return int((inside & (limits["y_min"] < y) & (y < limits["y_max"]) & ~world.visible).sum())


def test_the_episodes_have_all_that_could_differ() -> None:
    """In 160,000 actions: contacts with walls, obstacles and each other, occlusions, lost and late messages."""
    batch = Batch(SEEDS)
    world, samples = batch.env.core.simulation.world, batch.env.core.simulation.samples
    reach = batch.env.core.simulation.robots["radius"].sum()
    contacts = pairs = occluded = late = 0
    touched = np.zeros(SEEDS.size, np.bool_)
    for step, _ in enumerate(batch.play(0, 800)):
        contacts += int(world.contact.sum())
        touched |= world.contact.any(axis=1)
        late += int((samples.arrived > 1).sum())
        if step % 20 == 0:
            pairs += int((np.hypot(*(world.pose[:, 0] - world.pose[:, 1])[:, :2].T) < reach + 1e-3).sum())
            occluded += hidden(batch)
    assert touched.mean() > 0.95
    assert contacts > 30_000
    assert late > 100_000
    assert 0.15 < (world.deliver == -1).mean() < 0.25
    assert pairs > 100
    assert occluded > 500


def test_each_seed_has_an_episode_of_its_own(reference: Trace) -> None:
    assert np.unique(reference[-1]).size == SEEDS.size


def test_any_batch_gives_the_same(reference: Trace) -> None:
    """The seeds in another order, in batches of one to 133."""
    order = np.random.default_rng(1).permutation(SEEDS)
    for seeds in np.split(order, np.cumsum(SIZES)[:-1]):
        np.testing.assert_array_equal(Batch(seeds).trace(), reference[:, seeds])


@pytest.mark.parametrize("part", range(4))
def test_gymnasium_gives_the_same(part: int, reference: Trace) -> None:
    """A quarter of the seeds, one after the other in one environment."""
    env = gym.make("relloc_env/RelativePose-v0", config=CROWDED, disable_env_checker=True).unwrapped
    for seed in SEEDS[part::4].tolist():
        np.testing.assert_array_equal(single_trace(env, seed), reference[:, seed])


def test_pettingzoo_gives_the_same(reference: Trace) -> None:
    """Every fifth seed."""
    env = Joint()
    for seed in SEEDS[::5].tolist():
        np.testing.assert_array_equal(single_trace(env, seed), reference[:, seed])


def test_restored_states_go_on_the_same(reference: Trace) -> None:
    """At three times, the environments that are in contact then and as many others, in a batch of another size."""
    batch, played, in_contact = Batch(SEEDS), 0, 0
    for time in (150, 437, 790):
        for _ in batch.play(played, time):
            pass
        touching = np.flatnonzero(batch.env.core.simulation.world.contact.any(axis=1))
        others = np.setdiff1d(SEEDS, touching)[: touching.size]
        rows = np.random.default_rng(time).permutation(np.concatenate([touching, others]))
        branch = Batch(rows)
        branch.env.set_state(batch.env.get_state(rows))
        branch.sums = [batch.sums[n] for n in rows]
        again = np.array(list(branch.play(time, time + 50)), np.uint32)
        np.testing.assert_array_equal(again, reference[time : time + 50, rows])
        played, in_contact = time, in_contact + touching.size
    assert in_contact > 50


def test_fresh_process_gives_the_same(reference: Trace) -> None:
    """All seeds, in a new interpreter with another hash seed."""
    root = Path(__file__).resolve().parents[2]
    script = (
        "import hashlib, importlib.util;"
        f"spec = importlib.util.spec_from_file_location('episodes', {__file__!r});"
        "episodes = importlib.util.module_from_spec(spec);"
        "spec.loader.exec_module(episodes);"
        "print(hashlib.sha256(episodes.Batch(episodes.SEEDS).trace().tobytes()).hexdigest())"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "4321", "PYTHONPATH": str(root)}
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment, cwd=root
    )
    assert run.stdout.split() == [hashlib.sha256(reference.tobytes()).hexdigest()]


@pytest.mark.parametrize("threads", [2, 5])
def test_any_number_of_threads(reference: Trace, threads: int) -> None:
    batch = Batch(SEEDS, threads)
    assert len(batch.env.core._parts(batch.env.core.everyone)) == threads
    np.testing.assert_array_equal(batch.trace(), reference)


NOISES: list[dict[str, Any]] = [
    {"robot": {"odometry_noise": odometry, "actuator_noise": actuator}, "camera": {"pixel_noise": pixels}}
    for odometry in ([0.0, 0.0], [0.01, 0.01])
    for actuator in ([0.0, 0.0], [0.01, 0.01])
    for pixels in (0.0, 1.6)
]


@pytest.mark.parametrize("noise", NOISES)
def test_contacts_do_not_touch_the_neighbours_whatever_the_noise(noise: dict[str, Any]) -> None:
    """Three blocks of robots that drive into each other, in every second environment, against environments alone."""
    options: dict[str, Any] = {"estimator": None, "shield": None, "max_cycles": 20, **noise}
    start = {"poses": [[-0.6, 0.0, 0.0], [0.6, 0.0, np.pi]], "points": [[0.0, 3.0, 0.5], [1.0, 3.0, 0.5]]}

    def played(seeds: list[int]) -> RellocVectorEnv:
        env = RellocVectorEnv(len(seeds), options, info=())
        env.reset(seed=seeds, options=start)
        ahead = [[1.0, 0.0, 1.0, 0.0] if seed % 2 else [-1.0, 0.5, -0.5, 0.0] for seed in seeds]
        for _ in range(10):
            env.step(np.array(ahead))
        return env

    batch = played(list(range(80)))
    world = batch.core.simulation.world
    assert world.collided.any(axis=1).sum() == 40
    assert np.isfinite(world.pose).all()
    for n in (3, 40, 41, 79):
        alone = played([n])
        assert np.array_equal(alone.core.simulation.world.pose[0], world.pose[n])
        assert np.array_equal(alone.observations()[0], batch.observations()[n])
