"""Configuration: frozen, checked where it is built, and plain data (dict, YAML, JSON) and back without loss.

`load_config` is the one way in: from keyword arguments, a mapping, a file, or the name of a scenario.
"""

from relloc_env.config.imaging import ImageConfig, MarkerConfig
from relloc_env.config.loading import TASKS, load_config, merge, override, put, read_file, validate
from relloc_env.config.models import REWARD_TERMS, ConfigError, EnvConfig, hint
from relloc_env.config.parts import (
    CAMERAS,
    BoxConfig,
    CameraConfig,
    DiscConfig,
    GainsConfig,
    GuessConfig,
    NetworkConfig,
    RobotConfig,
    ShieldConfig,
    StartConfig,
)

__all__ = [
    "CAMERAS",
    "REWARD_TERMS",
    "TASKS",
    "BoxConfig",
    "CameraConfig",
    "ConfigError",
    "DiscConfig",
    "EnvConfig",
    "GainsConfig",
    "GuessConfig",
    "ImageConfig",
    "MarkerConfig",
    "NetworkConfig",
    "RobotConfig",
    "ShieldConfig",
    "StartConfig",
    "hint",
    "load_config",
    "merge",
    "override",
    "put",
    "read_file",
    "validate",
]
