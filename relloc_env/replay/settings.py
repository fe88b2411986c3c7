"""Options of the estimators for recorded sensors: what each kind of log measures, and how well.

Noise figures are of the sensors and of the commands, not of a run: they are the same for all robots of a set.
"""

from collections.abc import Mapping
from typing import Any

from relloc_env.config import EnvConfig, load_config
from relloc_env.envs.onboard import informed
from relloc_env.estimators import PRESETS, CascadeConfig, resolve
from relloc_env.estimators.config import AnyConfig
from relloc_env.estimators.registry import Factory
from relloc_env.logs.source import Log

Config = AnyConfig
_Table = Mapping[tuple[str, str], Mapping[str, Any]]

_CASCADE: _Table = {
    # Bearings of about 4 frames a second, points remembered while out of view.
    ("mrclam", "commands"): {"image_noise": 0.02, "odometry_noise": (0.08, 0.16), "max_gap": 1.5, "use_unseen": True},
    ("mrclam", "mocap"): {"image_noise": 0.02, "odometry_noise": (0.01, 0.02), "max_gap": 1.5, "use_unseen": True},
    # Residuals of 5 to 10 pixels at a focal length of 1077.
    ("starloc", "mocap"): {"image_noise": 0.007, "odometry_noise": (0.01, 0.01), "max_gap": 1.5},
}
_INVERSE_DEPTH: _Table = {
    key: {name: number for name, number in figures.items() if name != "max_gap"} for key, figures in _CASCADE.items()
}
_MAP_ALIGNMENT: _Table = {
    # An alignment a second: with some four frames a second the maps change little between them.
    ("mrclam", "commands"): {**PRESETS["map-alignment-commands"].model_dump(), "align_every": 4},
    ("mrclam", "mocap"): {**PRESETS["map-alignment-mocap"].model_dump(), "align_every": 4},
    ("starloc", "mocap"): {
        "image_noise": 0.007,
        "odometry_noise": (0.01, 0.01),
        "lateral_noise": 0.01,
    },
}
_TABLES = {"cascade": _CASCADE, "inverse-depth": _INVERSE_DEPTH, "map-alignment": _MAP_ALIGNMENT}


def environment_of(log: Log) -> EnvConfig | None:
    """Return the configuration of the environment that made a log; None where it states none, as real robots' do."""
    stated = dict(log.configuration)
    made_here = log.kind == "relloc" and {"robot", "camera", "guess"} <= stated.keys()
    return load_config(stated) if made_here else None


def meant_for(estimator: object) -> str | None:
    """Return the velocities that a named estimator's figures are for; None where its name does not say."""
    last = estimator.rpartition("-")[2] if isinstance(estimator, str) and estimator in PRESETS else ""
    return last if last in ("commands", "mocap") else None


def unfit(log: Log, estimator: object) -> str | None:
    """Return what is said where an estimator's figures are for other velocities than the log has."""
    meant = meant_for(estimator)
    if meant in (None, log.velocity):
        return None
    return f'{estimator} is for velocities of the kind "{meant}", but the log has "{log.velocity}": it ran as asked'


def configure(log: Log, estimator: str | Config | Mapping[str, Any] | Factory, pose_model: str | None = None) -> Config:
    """Return the configuration of an estimator for a log.

    Args:
        log: its kind and velocities decide the noise figures; a simulated one states them in its configuration. A name
            that says which velocities it is for keeps its own.
        estimator: a name, which takes on the log's figures; a configuration or a mapping is taken as it is.
        pose_model: observation model of the cascade's pose filter; default as configured.
    """
    config = resolve(estimator)
    environment, meant = environment_of(log), meant_for(estimator)
    if isinstance(estimator, str) and environment is not None:
        config = informed(environment, config)
    elif isinstance(estimator, str):
        key = (log.kind, meant or log.velocity)
        config = type(config)(**{**config.model_dump(), **_TABLES.get(config.kind, {}).get(key, {})})
    if pose_model is not None:
        if not isinstance(config, CascadeConfig):
            raise ValueError(f"Argument `pose_model` must be left out for {config.kind}: it has one model of the pose")
        config = CascadeConfig(**{**config.model_dump(), "pose_model": pose_model})
    return config
