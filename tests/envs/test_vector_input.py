"""What the vector door refuses, and how it says so."""

import pickle
import re
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from relloc_env.config import ConfigError
from relloc_env.envs.vector import RellocVectorEnv
from tests.envs.batches import ROUGH

WRONG_ACTIONS: dict[str, tuple[Any, str]] = {
    "nan": ([[0, 0, 0, 0], [0, np.nan, 0, 0]], r"must be finite, but is \[0.0, nan, 0.0, 0.0\] in row 1"),
    "one environment's": (np.zeros(4), r"must have shape \(2, 4\), but has \(4,\)"),
    "by robot": (np.zeros((2, 2, 2)), r"must have shape \(2, 4\), but has \(2, 2, 2\)"),
    "words": ("fast", r"must be numbers of shape \(2, 4\), but is 'fast'"),
    "masked": (np.ma.masked_array(np.zeros((2, 4)), True), r"must be numbers of shape \(2, 4\), but is masked"),
    "lists of masked": (
        [np.ma.masked_array(np.zeros(4), True)] * 2,
        r"must be numbers of shape \(2, 4\), but is masked",
    ),
    "complex": (np.zeros((2, 4), complex), r"must be numbers of shape \(2, 4\), but is an array of complex128"),
    "durations": (np.zeros((2, 4), "m8[s]"), r"must be numbers of shape \(2, 4\), but is an array of timedelta64"),
    "objects": (np.zeros((2, 4), object), r"must be numbers of shape \(2, 4\), but is an array of object"),
    "truth values": (np.zeros((2, 4), bool), r"must be numbers of shape \(2, 4\), but is an array of bool"),
}


@pytest.mark.parametrize("name", WRONG_ACTIONS)
def test_wrong_actions(name: str) -> None:
    """Refused at the call, and nothing has happened."""
    actions, message = WRONG_ACTIONS[name]
    env = RellocVectorEnv(2, **ROUGH)
    with pytest.raises(ResetNeeded, match="Call `reset` before `step`"):
        env.step(np.zeros((2, 4)))
    env.reset(seed=1)
    before = pickle.dumps(env.get_state())
    with pytest.raises(ValueError, match=f"Argument `actions` {message}"):
        env.step(actions)
    assert pickle.dumps(env.get_state()) == before
    env.step([[0, 1, 0, 1], [1, 0, 1, 0]])


def test_seeds_of_any_integer_type_are_the_same_seeds() -> None:
    env = RellocVectorEnv(2, estimator=None)
    expected, _ = env.reset(seed=3)
    forms: tuple[Any, ...] = (
        np.array(3),
        np.uint8(3),
        [3, 4],
        (3, np.int64(4)),
        np.array([3, 4]),
        range(3, 5),
        [3, np.array(4)],
    )
    for seed in forms:
        found, _ = env.reset(seed=seed)
        np.testing.assert_array_equal(found, expected)
    first, _ = env.reset(seed=2**70)
    again, _ = env.reset(seed=[2**70, 2**70 + 1])
    np.testing.assert_array_equal(first, again)


def test_wrong_resets() -> None:
    env = RellocVectorEnv(2, estimator=None)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"seed": -1}, "Argument `seed` must be a non-negative integer, but is -1"),
        ({"seed": [1]}, "Argument `seed` must be one integer or 2 of them, but is [1]"),
        ({"seed": [1, -2]}, "Argument `seed` must be a non-negative integer, but is -2"),
        ({"seed": True}, "Argument `seed` must be one integer or 2 of them, but is True"),
        ({"seed": 3.0}, "Argument `seed` must be one integer or 2 of them, but is 3.0"),
        ({"seed": np.array(3.0)}, "Argument `seed` must be one integer or 2 of them, but is array(3.)"),
        ({"seed": np.zeros((2, 1), int)}, "Argument `seed` must be one integer or 2 of them, but is array"),
        ({"seed": [1, True]}, "Argument `seed` must be a non-negative integer, but is True"),
        ({"seed": {1, 2}}, "Argument `seed` must be one integer or 2 of them, but is {1, 2}"),
        ({"seed": "12"}, "Argument `seed` must be one integer or 2 of them, but is '12'"),
        ({"options": {"reset_mask": [True, False]}}, "must be an array of (2,), bool, but is list"),
        ({"options": {"reset_mask": np.ones(3, np.bool_)}}, "must be an array of (2,), bool, but is (3,), bool"),
        ({"options": {"reset_mask": np.zeros(2, np.bool_)}}, "must be True somewhere"),
        ({"options": {"poses": [(0, 0, 0)]}}, "Argument `poses` must have shape (2, 3)"),
        ({"options": 5}, "Argument `options` must be a mapping, but is int"),
    ]
    for given, message in wrong:
        with pytest.raises(ValueError, match=re.escape(message)):
            env.reset(**given)
    env.reset(seed=1, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match="not all environments have an episode"):
        env.step(np.zeros((2, 4)))
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step(np.zeros((2, 4)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "`num_envs` must be a positive integer, but is 0"),
        (
            {"autoreset_mode": "same"},
            "`autoreset_mode` must be one of 'NextStep', 'SameStep', 'Disabled', but is 'same'",
        ),
        ({"render_mode": "human"}, "`render_mode` must be None or 'rgb_array', but is 'human'"),
        ({"estimater": "cascade"}, "Unknown option `estimater`; did you mean `estimator`"),
    ],
)
def test_impossible_configurations(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)):
        RellocVectorEnv(**options)
