"""Named scenarios: what each changes from the default task. The paper's, and the benchmark's."""

import math
from typing import Any

from relloc_env.config import ConfigError, hint

_PAPER: dict[str, Any] = {
    "arena": None,
    "shield": None,
    "samples_per_action": 1,
    "estimator": "cascade",
    "robot": {"max_speed": 0.2, "max_yaw_rate": 0.5, "odometry_noise": (0.0, 0.0)},
    "camera": {"preset": "unlimited"},
    "start": {"in_view": False},
    "max_cycles": 800,
}

SCENARIOS: dict[str, dict[str, Any]] = {
    "open-field": {},
    "paper-depth": _PAPER
    | {
        "robots": 1,
        "poses": [(0.0, 0.0, 0.0)],
        "points": [(5.0, 0.0, 0.3), (5.0, 0.0, -4.7), (5.0, -5.0, 0.3), (5.0, -5.0, -4.7)],
        "guess": {"kind": "positive", "depth": 1.0},
    },
    "paper-simulation": _PAPER
    | {
        "poses": [(0.0, 0.0, 0.0), (-1.0, -1.5, math.radians(10.0))],
        "points": [(5.0, 0.0, 0.3), (5.0, -5.0, -4.7)],
        "guess": {"kind": "positive", "depth": 1.0, "position": 1.5, "heading": 15.0},
    },
    "paper-experiment": _PAPER
    | {
        "camera": {"width": 640, "height": 480, "field_of_view": 80.0, "pixel_noise": 0.0},
        "poses": [(0.0, 0.0, 0.0), (0.3, 1.1, math.radians(61.0))],
        "points": [(5.8, 3.9, 1.3), (9.1, 6.0, 2.8)],
        "guess": {"kind": "positive", "depth": 1.0, "position": 1.5, "heading": 60.0},
    },
}
"""Options over the defaults, by name; plain data."""


def scenario(name: str) -> dict[str, Any]:
    """Return the options of a named scenario."""
    if not isinstance(name, str) or name not in SCENARIOS:
        raise ConfigError(
            f"Unknown scenario `{name}`{hint(str(name), tuple(SCENARIOS))}; known: {', '.join(SCENARIOS)}"
        )
    return SCENARIOS[name]
