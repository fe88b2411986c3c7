"""Names and configurations of the estimators."""

import json
import subprocess
import sys
from typing import Any

import pytest
from pydantic import ValidationError

from relloc_env.estimators import PRESETS, CascadeConfig, make, names, resolve
from relloc_env.estimators.cascade import Cascade


def test_names_resolve_to_their_presets():
    assert {"cascade", "cascade-critical", "inverse-depth", "map-alignment"} <= set(names())
    for name in names():
        assert resolve(name) is PRESETS[name]
        assert resolve(PRESETS[name]) is PRESETS[name]
        assert resolve(json.loads(PRESETS[name].model_dump_json())) == PRESETS[name]


def test_a_misspelt_name_gets_a_suggestion():
    with pytest.raises(ValueError, match=r"is 'cascade-critcal'\. Did you mean 'cascade-critical'"):
        resolve("cascade-critcal")
    with pytest.raises(ValueError, match="Known: cascade, cascade-critical, inverse-depth, map-alignment"):
        resolve("xyz")
    with pytest.raises(ValueError, match=r"is 'cascad'\. Did you mean 'cascade'"):
        resolve({"kind": "cascad"})
    with pytest.raises(ValueError, match=r"`kind` .* but is 'missing'"):
        resolve({"h": 1.0})
    with pytest.raises(ValidationError, match=r"Unknown option 'pose_modl'\. Did you mean 'pose_model'"):
        resolve({"kind": "cascade", "pose_modl": "printed"})
    wrong: Any = 3
    with pytest.raises(TypeError, match="but is int"):
        resolve(wrong)


@pytest.mark.parametrize(
    "option",
    [
        {"h": 0.0},
        {"h": ()},
        {"alpha_lambda": -1.0},
        {"z_min": 5.0, "z_max": 5.0},
        {"pose_model": "Position"},
        {"measurement_sd": float("nan")},
        {"image_noise": float("inf")},
    ],
)
def test_impossible_options_are_refused(option):
    with pytest.raises(ValidationError):
        CascadeConfig(**option)


def test_configurations_are_frozen():
    config: Any = CascadeConfig()
    with pytest.raises(ValidationError, match="frozen"):
        config.h = 3.0


@pytest.mark.parametrize(
    "option", [{"num_envs": 0}, {"robots": 0}, {"points": -1}, {"message_window": 0}, {"message_window": 65}]
)
def test_impossible_sizes_are_refused(option):
    sizes: dict[str, int] = {"num_envs": 1, "robots": 2, "points": 2, **option}
    (name,) = option
    with pytest.raises(ValueError, match=f"Argument `{name}` must be"):
        make("cascade", **sizes)


def test_gains_are_one_or_one_per_robot():
    assert isinstance(make(CascadeConfig(h=(1.0, 2.0)), 1, 2, 1), Cascade)
    with pytest.raises(ValueError, match="one for each of 2 robots"):
        make(CascadeConfig(h=(1.0, 2.0, 3.0)), 1, 2, 1)


def test_names_and_configurations_load_no_compiler():
    code = "import sys, relloc_env.estimators; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
