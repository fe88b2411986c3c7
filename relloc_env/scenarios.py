"""Named scenarios, and suites of them: what each changes from the default task. The paper's, and the benchmark's."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from relloc_env.config import ConfigError, hint
from relloc_env.quoting import word

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
            f"Unknown scenario `{word(name)}`{hint(word(name), tuple(SCENARIOS))}; known: {', '.join(SCENARIOS)}"
        )
    return SCENARIOS[name]


@dataclass(frozen=True)
class Suite:
    """A distribution over scenarios: options over the default task; each episode's seed draws the rest.

    A suite of several variants deals its episodes out among them in turn.
    """

    name: str
    about: str
    variants: tuple[Mapping[str, Any], ...]
    """Options over the defaults, plain data; they leave the number of robots to the id."""

    def deal(self, seeds: Sequence[int]) -> list[tuple[Mapping[str, Any], list[int]]]:
        """The options of each variant, and the seeds of its episodes."""
        count = len(self.variants)
        return [(options, list(seeds[i::count])) for i, options in enumerate(self.variants) if len(seeds) > i]


def _suites() -> dict[str, Suite]:
    pillars = [
        {"shape": "disc", "position": place, "radius": 0.25, "height": 1.5}
        for place in ((-1.6, -1.6), (1.6, -1.6), (-1.6, 1.6), (1.6, 1.6))
    ]
    paper: dict[str, Any] = {
        **{name: value for name, value in _PAPER.items() if name != "estimator"},
        "samples_per_action": 5,
        "max_cycles": 160,
        "shield": {},
        "robot": {"max_speed": 0.2, "max_yaw_rate": 0.5, "odometry_noise": (0.005, 0.005)},
        "camera": {"preset": "unlimited", "pixel_noise": 0.64},
        "start": {"target_distance": (4.0, 8.0), "heading_error": 20.0},
    }
    many = tuple({"targets": m} for m in (3, 4, 5, 6))
    suites = (
        Suite("paper", "the paper's robots and noise, a view without borders, no walls, 40 s", (paper,)),
        Suite("open-field", "the default task", ({},)),
        Suite("narrow-view", "a field of view of 40 degrees in place of 62", ({"camera": {"field_of_view": 40.0}},)),
        Suite("many-points", "3 to 6 points", many),
        Suite("occluded", "four pillars that hide points", ({"obstacles": pillars},)),
        Suite(
            "noisy",
            "three times the noise, one detection in five missed",
            ({"camera": {"pixel_noise": 4.8, "miss_probability": 0.2}, "robot": {"odometry_noise": (0.03, 0.03)}},),
        ),
        Suite(
            "lossy-network",
            "messages at 5 Hz, 0.2 to 0.4 s late, one in two lost",
            ({"network": {"latency": 0.2, "jitter": 0.2, "loss": 0.5, "rate": 5.0}},),
        ),
        Suite(
            "far",
            "points 5 to 9 m away",
            ({"arena": (16.0, 16.0), "start": {"target_distance": (5.0, 9.0)}},),
        ),
    )
    return {each.name: each for each in suites}


SUITES: Mapping[str, Suite] = MappingProxyType(_suites())
"""The benchmark's suites, by name."""

SEEDS: Mapping[str, range] = MappingProxyType(
    {"train": range(1_000_000), "validation": range(1_000_000, 1_010_000), "test": range(2_000_000, 2_010_000)}
)
"""Seeds of episodes for training, for choosing among what was trained, and for figures that are reported; disjoint."""


def suite(name: str) -> Suite:
    """Return a suite by its name."""
    if name not in SUITES:
        raise ConfigError(f"Unknown suite `{word(name)}`{hint(word(name), tuple(SUITES))}; known: {', '.join(SUITES)}")
    return SUITES[name]


def seeds(name: str, count: int) -> list[int]:
    """Return the first `count` seeds of a named set."""
    if name not in SEEDS:
        raise ConfigError(
            f"Unknown set of seeds `{word(name)}`{hint(word(name), tuple(SEEDS))}; known: {', '.join(SEEDS)}"
        )
    if not 1 <= count <= len(SEEDS[name]):
        raise ConfigError(f"Argument `count` must be from 1 to {len(SEEDS[name])} for `{name}`, but is {count}")
    return list(SEEDS[name][:count])
