"""Estimators: what a robot makes of what it sees and is told."""

from relloc_env.estimators.config import (
    PRESETS,
    CascadeConfig,
    EstimatorConfig,
    InverseDepthConfig,
    MapAlignmentConfig,
    OwnConfig,
)
from relloc_env.estimators.protocol import Estimator
from relloc_env.estimators.registry import make, names, resolve

__all__ = [
    "PRESETS",
    "CascadeConfig",
    "Estimator",
    "EstimatorConfig",
    "InverseDepthConfig",
    "MapAlignmentConfig",
    "OwnConfig",
    "make",
    "names",
    "resolve",
]
