"""Batches beside Gymnasium's of single environments, and how alike they must be."""

from typing import Any

import numpy as np
from gymnasium.vector import SyncVectorEnv, VectorEnv

from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.vector import RellocVectorEnv

IDS = ("relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0")


ROUGH: dict[str, Any] = {
    "estimator": "cascade",
    "shield": None,
    "arena": (4.0, 3.0),
    "obstacles": [{"shape": "disc", "position": (0.9, 0.2), "radius": 0.3, "height": 0.35}],
    "robot": {"lag": (0.1, 0.05), "actuator_noise": (0.02, 0.05)},
    "camera": {"preset": "pi", "miss_probability": 0.1, "frame_rate": 15.0},
    "start": {"target_distance": (0.5, 3.5), "in_view": False, "robot_distance": 0.45, "margin": 0.25},
    "network": {"latency": 0.1, "jitter": 0.15, "loss": 0.2},
    "terminate_on_collision": True,
    "max_cycles": 12,
}
"""Episodes that end at different times, some by a collision, some at the horizon."""


CASES: dict[str, dict[str, Any]] = {
    "rough": ROUGH,
    "rough-dict": {**ROUGH, "observation": "dict"},
    "rough-bare": {**ROUGH, "estimator": None},
    "one": {**ROUGH, "robots": 1},
    "success": {"estimator": "cascade", "terminate_on_success": True, "success": (0.9, 40.0), "max_cycles": 15},
}


def both(count: int, options: dict[str, Any], mode: str) -> tuple[RellocVectorEnv, SyncVectorEnv]:
    single = SyncVectorEnv([lambda: RellocEnv(**options)] * count, autoreset_mode=mode)
    return RellocVectorEnv(count, autoreset_mode=mode, **options), single


def same(found: Any, expected: Any, where: str = "") -> None:
    """The same to the last bit: names, shapes, types, numbers."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys(), where
        for name, part in expected.items():
            same(found[name], part, f"{where}.{name}")
    elif isinstance(expected, tuple):
        assert len(found) == len(expected)
        for n, part in enumerate(expected):
            same(found[n], part, f"{where}[{n}]")
    elif isinstance(expected, np.ndarray) and expected.dtype == object:
        for n, part in enumerate(expected):
            same(found[n], part, f"{where}[{n}]")
    elif isinstance(expected, np.ndarray):
        assert isinstance(found, np.ndarray), where
        assert (found.shape, found.dtype) == (expected.shape, expected.dtype), where
        np.testing.assert_array_equal(found, expected, where)
    else:
        assert found == expected, where


def drive(rng: np.random.Generator, env: VectorEnv[Any, Any, Any]) -> Any:
    shape = env.action_space.shape
    assert shape is not None
    actions = rng.uniform(-1, 1, shape).astype(np.float32)
    actions[:, ::2] = np.sign(actions[:, ::2] + 0.5)
    return actions


def mask_of(count: int, rows: Any) -> Any:
    mask = np.zeros(count, np.bool_)
    mask[rows] = True
    return mask
