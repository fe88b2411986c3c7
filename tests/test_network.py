"""When messages arrive, against the statistics that were asked for; and that they tell what was known when made."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import relloc_env
from relloc_env.config import load_config
from relloc_env.simulation import Simulation

DT = 0.05


def arrivals(network: dict[str, Any], num_envs: int = 8, samples: int = 1000) -> NDArray[np.int64]:
    """Rows (environment, pair, tick, age) of all messages that arrive at rest."""
    config = load_config(
        poses=[(0.0, 0.0, 0.0), (0.0, 2.0, 0.0)], points=[(5.0, 0.0, 0.4), (5.0, 1.0, 0.4)], network=network,
        samples_per_action=samples, shield=None, estimator=None,
    )  # fmt: skip
    simulation, rows = Simulation(config, num_envs), np.arange(num_envs)
    simulation.seed(rows, list(range(num_envs)))
    simulation.reset(rows)
    blocks = [simulation.first.arrived.copy()]
    simulation.step(np.zeros((num_envs, 2, 2)), rows)
    blocks.append(simulation.samples.arrived)
    bits = np.concatenate(blocks, axis=1)
    ages = np.arange(64, dtype=np.uint64)
    hits = (bits[..., None] >> ages) & np.uint64(1)
    n, tick, pair, age = np.nonzero(hits)
    return np.stack([n, pair, tick, age], axis=1)


def test_perfect_by_default() -> None:
    """Every message arrives at once, the first included."""
    found = arrivals({})
    assert (found[:, 3] == 0).all()
    assert len(found) == 8 * 2 * 1001


@pytest.mark.parametrize(("latency", "age"), [(0.05, 1), (0.1, 2), (0.101, 3), (0.12, 3), (1.0, 20), (3.1, 62)])
def test_latency_is_the_age_at_arrival(latency: float, age: int) -> None:
    """A message is there at the first sample that is not before its time, and each one once."""
    found = arrivals({"latency": latency})
    assert (found[:, 3] == age).all()
    assert len(found) == 8 * 2 * (1001 - age)
    assert found[:, 2].min() == age


def test_jitter_is_uniform() -> None:
    """16,000 messages, latency 0.1 s and jitter 0.2 s: ages 3 to 6 samples, each as often (chi², p > 10⁻⁴)."""
    found = arrivals({"latency": 0.1, "jitter": 0.2})
    ages = found[found[:, 2] - found[:, 3] <= 990, 3]
    counts = np.bincount(ages, minlength=8)
    assert counts[:3].sum() == 0
    assert counts[7:].sum() == 0
    assert stats.chisquare(counts[3:7]).pvalue > 1e-4
    made = {tuple(row) for row in np.column_stack([found[:, 0], found[:, 1], found[:, 2] - found[:, 3]])}
    assert len(made) == len(found)


def test_jitter_within_a_sample() -> None:
    """Jitter of 0.075 s: a third of it arrives at age 2, two thirds at age 1."""
    found = arrivals({"jitter": 0.075})
    counts = np.bincount(found[:, 3], minlength=4)
    assert counts[[0, 3]].sum() == 0
    assert stats.binomtest(int(counts[1]), int(counts.sum()), 2.0 / 3.0).pvalue > 1e-4


def test_loss_rate_and_independence() -> None:
    """30 % are lost, in both directions, independently of each other and of the message before."""
    found = arrivals({"loss": 0.3, "latency": 0.1})
    got = np.zeros((8, 2, 999), np.bool_)
    got[found[:, 0], found[:, 1], found[:, 2] - found[:, 3]] = True
    lost = ~got
    for group in (lost, lost[:, 0], lost[:, 1]):
        assert stats.binomtest(int(group.sum()), group.size, 0.3).pvalue > 1e-4
    assert stats.binomtest(int((lost[:, 0] & lost[:, 1]).sum()), lost[:, 0].size, 0.09).pvalue > 1e-4
    assert stats.binomtest(int((lost[..., 1:] & lost[..., :-1]).sum()), lost[..., 1:].size, 0.09).pvalue > 1e-4


def test_everything_may_be_lost() -> None:
    assert len(arrivals({"loss": 1.0})) == 0


@pytest.mark.parametrize(("rate", "every"), [(20.0, 1), (10.0, 2), (7.0, 3), (1.0, 20)])
def test_rate_is_a_limit(rate: float, every: int) -> None:
    """Messages are made at regular samples, the first included, never more often than allowed."""
    found = arrivals({"rate": rate, "latency": 0.1}, num_envs=2)
    for pair in (0, 1):
        made = np.sort((found[:, 2] - found[:, 3])[(found[:, 0] == 0) & (found[:, 1] == pair)])
        assert (np.diff(made) == every).all()
        assert made[0] == 0
        assert 1.0 / (every * DT) <= rate + 1e-9


LOSSY = {"latency": 0.1, "jitter": 0.25, "loss": 0.3, "rate": 10.0}


@pytest.mark.parametrize("estimator", ["cascade-critical", "inverse-depth", "map-alignment", None])
@pytest.mark.parametrize("network", [LOSSY, {}], ids=["lossy", "perfect"])
def test_messages_tell_what_was_known_when_they_were_made(network: dict[str, Any], estimator: str | None) -> None:
    """60 samples: what A was told of B is what B observed itself `message_age` ago, and the other way round."""
    env = relloc_env.parallel_env(network=network, estimator=estimator, samples_per_action=1, max_cycles=100)
    rng = np.random.default_rng(1)
    where = env.field_slices
    seen, _ = env.reset(seed=3)
    past = [seen]
    ages: list[int] = []
    for _ in range(60):
        for own, other in (("robot_a", "robot_b"), ("robot_b", "robot_a")):
            line = past[-1][own]
            age = float(line[where["message_age"]][0])
            told = line[where["message_points"]]
            if age == 100.0:
                assert not told.any()
                continue
            ages.append(round(age / DT))
            then = past[-1 - ages[-1]][other]
            np.testing.assert_array_equal(line[where["message_motion"]], then[where["dead_reckoning"]])
            if estimator is None:
                image, sight = then[where["image"]].reshape(-1, 2), then[where["seen"]]
                np.testing.assert_array_equal(told, np.column_stack([sight, image]).ravel())
            else:
                np.testing.assert_array_equal(told, then[where["points"]])
        seen, *_ = env.step({agent: rng.uniform(-1, 1, 2).astype(np.float32) for agent in env.agents})
        past.append(seen)
    if network:
        assert min(ages) >= 3
        assert max(ages) > 8
    else:
        assert set(ages) == {0}


@pytest.mark.parametrize(
    "estimator", ["cascade-critical", "inverse-depth", {"kind": "map-alignment", "align_every": 1}, None], ids=str
)
@pytest.mark.parametrize("network", [LOSSY, {}], ids=["lossy", "perfect"])
def test_actions_of_many_samples_tell_the_same(network: dict[str, Any], estimator: Any) -> None:
    """An action of five samples ends in the same observation as five actions of one, in what is told and reckoned."""
    rng = np.random.default_rng(2)
    options: dict[str, Any] = {"network": network, "estimator": estimator, "max_cycles": 1000}
    long, short = (relloc_env.parallel_env(samples_per_action=k, **options) for k in (5, 1))
    names = ["dead_reckoning", "message_age", "message_motion", "message_points"]
    if estimator is not None:
        names += ["points", "pose", "pose_log_sd", "pose_correlation", "pose_log_det"]
    long.reset(seed=5)
    short.reset(seed=5)
    for _ in range(12):
        actions = {agent: rng.uniform(-1, 1, 2).astype(np.float32) for agent in long.agents}
        a, *_ = long.step(actions)
        for _ in range(5):
            b, *_ = short.step(actions)
        for agent in actions:
            for name in names:
                np.testing.assert_allclose(
                    a[agent][long.field_slices[name]], b[agent][short.field_slices[name]], rtol=1e-5, atol=1e-5,
                    err_msg=name,
                )  # fmt: skip


def test_silence_reads_as_the_greatest_age() -> None:
    env = relloc_env.parallel_env(network={"loss": 1.0})
    observations, _ = env.reset(seed=1)
    for _ in range(5):
        for line in observations.values():
            assert line[env.field_slices["message_age"]][0] == 100.0
            assert not line[env.field_slices["message_points"]].any()
            assert not line[env.field_slices["message_motion"]].any()
        observations, *_ = env.step({agent: np.zeros(2, np.float32) for agent in env.agents})


def test_late_message_has_its_bit_in_the_bare_observation() -> None:
    """`arrived` says at which sample of the action a message of which age came in."""
    env = relloc_env.parallel_env(network={"latency": 0.12}, estimator=None, samples_per_action=4)
    observations, _ = env.reset(seed=1)
    window = 4  # ages 0 to 3: 0.12 s is ceil(2.4) samples
    for step in range(4):
        for line in observations.values():
            bits = line[env.field_slices["arrived"]].reshape(4, 1, window)
            expected = np.zeros((4, 1, window))
            if step > 0:
                ticks = 4 * (step - 1) + 1 + np.arange(4)
                expected[ticks >= 3, 0, 3] = 1.0
            np.testing.assert_array_equal(bits, expected)
            age = line[env.field_slices["message_age"]][0]
            assert math.isclose(age, 3 * DT if step > 0 else 100.0, rel_tol=1e-6)
        observations, *_ = env.step({agent: np.zeros(2, np.float32) for agent in env.agents})
