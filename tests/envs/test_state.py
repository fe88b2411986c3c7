"""`get_state` and `set_state`: an episode goes on bit for bit, in contact too, here, elsewhere, and more than once."""

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import relloc_env
from relloc_env.envs.parallel import RellocParallelEnv

ROUGH: dict[str, Any] = {
    "shield": None,
    "arena": (4.0, 3.0),
    "obstacles": [
        {"shape": "disc", "position": (0.9, 0.2), "radius": 0.3, "height": 0.35},
        {"shape": "box", "position": (-0.8, -0.4), "size": (0.7, 0.4), "angle": 0.6, "height": 1.0},
    ],
    "robot": [{"lag": (0.1, 0.05), "actuator_noise": (0.02, 0.05)}, {"mass": 12.0, "radius": 0.22}],
    "camera": {"preset": "pi", "miss_probability": 0.1, "frame_rate": 15.0, "quantisation": 1.0},
    "start": {"target_distance": (0.5, 3.5), "in_view": False, "robot_distance": 0.45, "margin": 0.25},
    "network": {"latency": 0.1, "jitter": 0.15, "loss": 0.2},
    "samples_per_action": 3,
    "max_cycles": 400,
}
"""Everything that leaves something to remember: contacts, actuators, late messages, noise, frames."""

ESTIMATORS = ["cascade", "cascade-critical", "map-alignment", None]


def choices(seed: int, count: int) -> NDArray[np.float64]:
    """(count, 2, 2) full speed forward or backward, held for ten actions."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (count // 10 + 1, 2, 2))
    drawn[..., 0] = np.sign(drawn[..., 0] + 0.3)
    return drawn.repeat(10, axis=0)[:count]


def play(env: RellocParallelEnv, actions: NDArray[np.float64]) -> list[bytes]:
    """All that is handed out at each action."""
    shown = []
    for action in actions:
        given = env.step(dict(zip(env.possible_agents, action, strict=True)))
        shown.append(pickle.dumps((given, env.state(), env.agents)))
    return shown


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_episode_goes_on_bit_for_bit(estimator: str | None) -> None:
    """Saved at four places of an episode (one of them in contact) and played on for 40 actions: in the environment that
    went on, in a new one, and through a pickle."""
    env, other = (relloc_env.parallel_env(ROUGH, estimator=estimator) for _ in range(2))
    actions = choices(1, 200)
    states: list[tuple[str, int, dict[str, Any]]] = []
    env.reset(seed=3)
    touched = np.zeros(200, np.bool_)
    for step, action in enumerate(actions):
        if step in (0, 7, 60, 150) or (touched[:step].any() and not any(kind == "contact" for kind, *_ in states)):
            kind = "contact" if step and touched[step - 1] else "free"
            states.append((kind, step, env.get_state()))
        env.step(dict(zip(env.possible_agents, action, strict=True)))
        touched[step] = env.core.simulation.world.contact.any()
    assert "contact" in {kind for kind, *_ in states}
    other.reset(seed=99)
    for _, step, state in states:
        rest = actions[step : step + 40]
        stored = pickle.dumps(state)
        env.set_state(state)
        first = play(env, rest)
        other.set_state(state)
        assert play(other, rest) == first
        other.set_state(pickle.loads(stored))
        assert play(other, rest) == first
        assert pickle.dumps(state) == stored


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_next_episodes_are_the_same_too(estimator: str | None) -> None:
    """Random streams and the options of a reset are part of the state: unseeded resets go on alike."""
    env, other = (relloc_env.parallel_env(estimator=estimator, max_cycles=10) for _ in range(2))
    env.reset(seed=1)
    env.reset(options={"points": [(1.0, 0.0, 0.3), (1.0, 1.0, 0.5)]})
    other.reset(seed=2)
    other.set_state(env.get_state())
    for _ in range(3):
        runs = []
        for each in (env, other):
            observations, _ = each.reset()
            runs.append((pickle.dumps(observations), play(each, choices(2, 5))))
        assert runs[0] == runs[1]
        np.testing.assert_array_equal(other.core.simulation.world.points[0], [(1.0, 0.0, 0.3), (1.0, 1.0, 0.5)])


@pytest.mark.parametrize("estimator", ["cascade-critical", None])
@pytest.mark.parametrize("name", ["relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0"])
def test_gymnasium_door(name: str, estimator: str | None) -> None:
    env, other = (gym.make(name, estimator=estimator).unwrapped for _ in range(2))
    assert isinstance(env, gym.Env)
    rng = np.random.default_rng(3)
    size = env.action_space.shape
    assert size is not None
    actions = [rng.uniform(-1, 1, size) for _ in range(30)]
    env.reset(seed=4)
    for action in actions[:10]:
        env.step(action)
    state = env.get_state()  # type: ignore[attr-defined]
    runs = []
    for each in (env, other):
        each.set_state(state)  # type: ignore[attr-defined]
        shown = []
        for action in actions[10:]:
            observation, reward, terminated, truncated, info = each.step(action)
            shown.append(pickle.dumps((observation, reward, terminated, truncated, info)))
        runs.append(shown)
    assert runs[0] == runs[1]


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_copies_go_on_alike_and_apart(estimator: str | None) -> None:
    """A deep copy and a pickle of an environment in mid-episode: what one does leaves the others as they were."""
    env = relloc_env.parallel_env(ROUGH, estimator=estimator)
    env.reset(seed=5)
    actions = choices(4, 90)
    play(env, actions[:50])
    runs = [
        [pickle.loads(shown) for shown in play(each, actions[50:])]
        for each in (copy.deepcopy(env), pickle.loads(pickle.dumps(env)), env)
    ]
    np.testing.assert_equal(runs[0], runs[1])
    np.testing.assert_equal(runs[0], runs[2])


def test_end_of_the_episode_is_part_of_the_state() -> None:
    """Saved one action before its end, an episode ends again; saved after its end, it takes no more actions."""
    env = relloc_env.parallel_env(max_cycles=5)
    env.reset(seed=1)
    zero = np.zeros((1, 2, 2))
    play(env, zero.repeat(4, axis=0))
    before = env.get_state()
    play(env, zero)
    after = env.get_state()
    assert env.agents == []
    env.set_state(before)
    assert env.agents == ["robot_a", "robot_b"]
    play(env, zero)
    assert env.agents == []
    env.reset()
    env.set_state(after)
    with pytest.raises(gym.error.ResetNeeded):
        env.step({agent: np.zeros(2) for agent in env.possible_agents})


def test_state_of_another_configuration_is_refused() -> None:
    env, joint = relloc_env.parallel_env(), gym.make("relloc_env/ActiveDepth-v0").unwrapped
    env.reset(seed=1)
    joint.reset(seed=1)
    before = pickle.dumps(env.get_state())
    for options in (
        {"targets": 3}, {"robots": 1}, {"estimator": "cascade"}, {"estimator": None}, {"samples_per_action": 1},
    ):  # fmt: skip
        other = relloc_env.parallel_env(options)
        with pytest.raises(ValueError, match=r"Argument `state\['core'\].* must (be an array of|have the entries)"):
            env.set_state(other.get_state())
    wrong: list[Any] = [None, 5, {}, {"core": {}, "agents": []}, joint.get_state()]  # type: ignore[attr-defined]
    for state in wrong:
        with pytest.raises(ValueError, match="Argument `state"):
            env.set_state(state)
    assert pickle.dumps(env.get_state()) == before
