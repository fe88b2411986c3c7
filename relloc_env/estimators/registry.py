"""One registry of estimator names, used alike in configuration, on the command line, in results and in the docs."""

from collections.abc import Callable, Mapping
from typing import Any

from relloc_env.estimators.config import (
    PRESETS,
    AnyConfig,
    CascadeConfig,
    InverseDepthConfig,
    OwnConfig,
    from_mapping,
    suggest,
)
from relloc_env.estimators.protocol import Estimator
from relloc_env.quoting import quote

Factory = Callable[..., Estimator]
"""Builds an estimator: `factory(num_envs, robots, points, message_window=...)`."""


def names() -> list[str]:
    """Return the names of all estimators."""
    return sorted(PRESETS)


def resolve(estimator: str | AnyConfig | Mapping[str, Any] | Factory) -> AnyConfig:
    """Return the configuration behind a name, a configuration, plain data with a `kind`, or a factory or its place."""
    if callable(estimator) or (isinstance(estimator, str) and ":" in estimator):
        return OwnConfig(factory=estimator)
    if isinstance(estimator, str):
        if estimator not in PRESETS:
            raise ValueError(
                f"Argument `estimator` must be the name of an estimator, but is {quote(estimator)}."
                f"{suggest(estimator, names())}"
            )
        return PRESETS[estimator]
    if isinstance(estimator, AnyConfig):
        return estimator
    if isinstance(estimator, Mapping):
        return from_mapping(estimator)
    raise TypeError(
        "Argument `estimator` must be a name, a configuration, a mapping or a factory, "
        f"but is {type(estimator).__name__}."
    )


def make(
    estimator: str | AnyConfig | Mapping[str, Any] | Factory,
    num_envs: int,
    robots: int,
    points: int,
    *,
    message_window: int = 1,
) -> Estimator:
    """Build an estimator; its compiled kernels are loaded here, not before.

    Args:
        estimator: a name (see `names`), a configuration, plain data with a `kind`, or a factory or its place
            (`config.OwnConfig`).
        num_envs: number N of environments.
        robots: number R of robots.
        points: number M of points.
        message_window: [samples] 1 + the greatest age at which a message may arrive, at most 64.
    """
    config = resolve(estimator)
    for label, value, high in (
        ("num_envs", num_envs, None),
        ("robots", robots, None),
        ("points", points, None),
        ("message_window", message_window, 64),
    ):
        if value < 1 or (high is not None and value > high):
            span = "at least 1" if high is None else f"from 1 to {high}"
            raise ValueError(f"Argument `{label}` must be {span}, but is {quote(value)}.")
    if isinstance(config, OwnConfig):
        from relloc_env.estimators.own import make_own

        return make_own(config, num_envs, robots, points, message_window)
    if isinstance(config, CascadeConfig):
        from relloc_env.estimators.cascade import Cascade

        return Cascade(num_envs, robots, points, config, message_window=message_window)
    if isinstance(config, InverseDepthConfig):
        from relloc_env.estimators.inverse_depth import InverseDepth

        return InverseDepth(num_envs, robots, points, config, message_window=message_window)
    from relloc_env.estimators.map_alignment import MapAlignment

    return MapAlignment(num_envs, robots, points, config, message_window=message_window)
