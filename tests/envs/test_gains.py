"""Actions that set the gains of the depth observers: the same at every door, and they reach the observers."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import relloc_env
from agents.playing import play
from agents.registry import agent
from relloc_env.config import ConfigError, load_config
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.estimators import CascadeConfig, make

LOSSY: dict[str, Any] = {
    "estimator": "cascade",
    "action": "motion+gains",
    "targets": 3,
    "robot": {"lag": (0.1, 0.05), "actuator_noise": (0.02, 0.05)},
    "camera": {"preset": "pi", "miss_probability": 0.1},
    "network": {"latency": 0.1, "jitter": 0.15, "loss": 0.2},
    "max_cycles": 12,
}
SEEDS = list(range(37))
STEPS = 20
"""Actions: an episode, the autoreset, and a part of the next episode."""
Array = NDArray[np.float64]


def chosen(seed: int) -> Array:
    """(STEPS, R, A) some of them beyond the bounds."""
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (STEPS, 2, 8))


def batch(threads: int | None = None) -> Array:
    """(N, STEPS + 1, D + 1) what environments show, and their rewards, in one batch."""
    env = RellocVectorEnv(len(SEEDS), LOSSY, info=(), threads=threads)
    actions = np.stack([chosen(seed) for seed in SEEDS], axis=1).reshape(STEPS, len(SEEDS), -1)
    lines = [np.column_stack([env.reset(seed=SEEDS)[0], np.zeros(len(SEEDS))])]
    for action in actions:
        line, reward, *_ = env.step(action)
        lines.append(np.column_stack([line, reward]))
    return np.stack(lines, axis=1)


@pytest.fixture(scope="module")
def reference() -> Array:
    return batch()


def test_threads_do_not_matter(reference: Array) -> None:
    np.testing.assert_array_equal(batch(3), reference)


def test_gymnasium_and_pettingzoo_give_the_same(reference: Array) -> None:
    """Six seeds, one after the other in one environment at each door."""
    single = gym.make("relloc_env/RelativePose-v0", config=LOSSY, disable_env_checker=True).unwrapped
    parallel = relloc_env.parallel_env(LOSSY)
    for seed in SEEDS[::7]:
        lines, over = [np.append(single.reset(seed=seed)[0], 0.0)], False
        shown = parallel.reset(seed=seed)[0]
        others = [np.append(np.concatenate(list(shown.values())), 0.0)]
        for action in chosen(seed):
            if over:
                line, reward = single.reset()[0], 0.0
                shown, rewards = parallel.reset()[0], {"": 0.0}
                over = False
            else:
                line, gained, _, over, _ = single.step(action.ravel())
                reward = float(gained)
                shown, rewards, *_ = parallel.step(dict(zip(parallel.agents, action, strict=True)))
            lines.append(np.append(line, reward))
            others.append(np.append(np.concatenate(list(shown.values())), sum(rewards.values()) / len(rewards)))
        np.testing.assert_array_equal(lines, reference[seed])
        np.testing.assert_array_equal(others, reference[seed])


@pytest.mark.parametrize("decentralised", [False, True])
def test_stable_baselines_gives_the_same(reference: Array, decentralised: bool) -> None:
    """The first episode of nine environments."""
    sb3 = pytest.importorskip("relloc_env.envs.sb3")
    env = sb3.RellocVecEnv(9, LOSSY, decentralised=decentralised)
    assert env.action_space.shape == ((8,) if decentralised else (16,))
    env.seed(0)
    shown = [env.reset().reshape(9, -1)]
    actions = np.stack([chosen(seed) for seed in SEEDS[:9]], axis=1)
    shown += [env.step(action.reshape(env.num_envs, -1))[0].reshape(9, -1) for action in actions[:11]]
    np.testing.assert_array_equal(np.stack(shown, axis=1), reference[:9, :12, :-1].astype(np.float32))


def test_restored_states_go_on_the_same() -> None:
    """Saved in mid-episode, and put back in another order into a batch of another size."""
    env, other = (RellocVectorEnv(n, LOSSY, info=()) for n in (11, 4))
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (10, 11, 16))
    env.reset(seed=3)
    for action in actions[:5]:
        env.step(action)
    rows = np.array([7, 0, 3, 10])
    other.reset(seed=50)
    other.set_state(env.get_state(rows))
    np.testing.assert_array_equal(other.observations(), env.observations()[rows])
    for action in actions[5:]:
        np.testing.assert_array_equal(other.step(action[rows])[0], env.step(action)[0][rows])


def test_each_observer_has_the_gains_that_the_action_gave_it() -> None:
    """Held over an episode, gains are those of an estimator that is configured so, point by point and robot by robot.

    The entries -0.5 and 0.5 stand a quarter and three quarters of the way between the logarithms of the bounds.
    """
    options: dict[str, Any] = {"robots": 2, "targets": 2, "reward": {}, "max_cycles": 30}
    bounds = {"h": (0.5, 8.0), "alpha_lambda": (20.0, 1620.0)}
    env = RellocVectorEnv(3, estimator="cascade", action="motion+gains", gains=bounds, **options)
    slow = RellocVectorEnv(3, estimator={"kind": "cascade", "h": 1.0, "alpha_lambda": 60.0}, **options)
    quick = RellocVectorEnv(3, estimator={"kind": "cascade", "h": 4.0, "alpha_lambda": 540.0}, **options)
    gains = np.array([[-0.5, -0.5, 0.5, 0.5], [0.5, 0.5, -0.5, -0.5]])  # A: slow, quick; B: quick, slow
    for each in (env, slow, quick):
        each.reset(seed=1)
    rng = np.random.default_rng(2)
    for _ in range(20):
        motion = rng.uniform(-1.0, 1.0, (3, 2, 2))
        env.step(np.concatenate([motion, np.tile(gains, (3, 1, 1))], axis=2).reshape(3, -1))
        for each in (slow, quick):
            each.step(motion.reshape(3, -1))
    found, a, b = (each.core.onboard.estimate.points[..., 2] for each in (env, slow, quick))
    expected = np.stack([[a[:, 0, 0], b[:, 0, 1]], [b[:, 1, 0], a[:, 1, 1]]]).transpose(2, 0, 1)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert (np.abs(a - b) > 1e-3 * a).all()


@pytest.mark.parametrize(("estimator", "names"), [("cascade", 2), ("cascade-critical", 1)])
def test_the_observation_tells_the_gains(estimator: str, names: int) -> None:
    """Zeros at the start, which is the middle of the bounds; then what was set, clipped."""
    env = RellocVectorEnv(2, robots=2, targets=3, estimator=estimator, action="motion+gains", reward={})
    live: Any = env.core.onboard.estimator
    size = 2 + 3 * names
    assert env.single_action_space.shape == (2 * size,)
    first = env.reset(seed=0)[0]
    assert env.single_observation_space.contains(first[0])
    middle = [2.5, 120.0] if names == 2 else [120.0]
    np.testing.assert_allclose(live.gains[..., 2 - names :], np.broadcast_to(middle, (2, 2, 3, names)))
    action = np.random.default_rng(0).uniform(-1.5, 1.5, (2, 2, size))
    shown = env.step(action.reshape(2, -1))[0]
    for r, robot in enumerate(("robot_a", "robot_b")):
        part = env.field_slices[f"{robot}/gains"]
        np.testing.assert_array_equal(first[:, part], 0.0)
        np.testing.assert_array_equal(shown[:, part], np.clip(action[:, r, 2:], -1.0, 1.0).astype(np.float32))
    share = np.clip(action[..., 2:], -1.0, 1.0).reshape(2, 2, 3, names)
    np.testing.assert_allclose(np.log10(live.gains[..., 2 - names :] / middle), share)
    env.reset(seed=5)
    np.testing.assert_allclose(live.gains[..., 2 - names :], np.broadcast_to(middle, (2, 2, 3, names)))


def test_motion_alone_has_nothing_of_it() -> None:
    env = relloc_env.parallel_env(estimator="cascade")
    assert env.action_space("robot_a").shape == (2,)
    assert "gains" not in env.field_slices


@pytest.mark.parametrize("estimator", ["map-alignment", "inverse-depth", None])
def test_estimators_without_gains_are_refused(estimator: Any) -> None:
    with pytest.raises(ConfigError, match=r'with gains \(`cascade`, `cascade-critical`\) for `action` "motion\+gains"'):
        gym.make("relloc_env/RelativePose-v0", action="motion+gains", estimator=estimator)


def test_an_object_needs_gains() -> None:
    options: dict[str, Any] = {"config": {"estimator": "cascade"}, "action": "motion+gains"}
    env = relloc_env.parallel_env(**options, estimator=make(CascadeConfig(), 1, 2, 2))
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, np.zeros(6)))
    with pytest.raises(ConfigError, match=r"must have an array `gains` of \(1, 2, 2, 2\)"):
        relloc_env.parallel_env(**options, estimator=make("inverse-depth", 1, 2, 2))


def test_two_numbers_a_robot_are_too_few() -> None:
    env = relloc_env.parallel_env(estimator="cascade", action="motion+gains")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"Argument `actions\['robot_a'\]` must have shape \(6,\), but has \(2,\)"):
        env.step(dict.fromkeys(env.agents, np.zeros(2)))


@pytest.mark.parametrize("gains", [{"h": (5.0, 2.0)}, {"alpha_lambda": (0.0, 2.0)}])
def test_bounds_have_an_order(gains: Any) -> None:
    with pytest.raises(ConfigError, match=r"gains"):
        relloc_env.parallel_env(estimator="cascade", action="motion+gains", gains=gains)


def test_agents_that_know_of_motion_alone_are_refused() -> None:
    config = load_config(estimator="cascade", action="motion+gains")
    words = r"gives \(2, 2, 6\) numbers with `action` \"motion\+gains\", but Scripted gives \(2, 2, 2\)"
    with pytest.raises(ValueError, match=words):
        play(config, agent("straight"), [0, 1])
