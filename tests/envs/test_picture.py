"""What the picture of an environment tells of errors, honesty and the bound, against NumPy on `info` and the state."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import chi2

import relloc_env  # noqa: F401 - registers the ids
from relloc_env.envs.picture import scene


def _after(name: str, actions: int, **options: Any) -> tuple[Any, dict[str, Any]]:
    env = gym.make(f"relloc_env/{name}-v0", **options).unwrapped
    env.reset(seed=5)
    info: dict[str, Any] = {}
    for _ in range(actions):
        info = env.step(np.array([1.0, 0.2, 0.8, -0.2], np.float32)[: env.action_space.shape[0]])[4]  # type: ignore[index]
    return env, info


def test_honesty_and_bound_of_a_pose() -> None:
    env, info = _after("RelativePose", 20, estimator="cascade")
    believed, (a, b) = env.core.onboard.estimate, info["truth"]["poses"]
    readings = [r for r in scene(env.core, 0, []).readings if r.gauge is not None]
    assert [(r.label, r.robot) for r in readings] == [("NEES", 0), ("NEES", 1), ("error / bound", -1)]
    toward = complex(b[0] - a[0], b[1] - a[1]) * np.exp(-1j * a[2])
    error = believed.pose[0, 0] - [toward.real, toward.imag, b[2] - a[2]]
    error[2] = np.angle(np.exp(1j * error[2]))
    wanted = error @ np.linalg.inv(believed.pose_covariance[0, 0]) @ error
    assert readings[0].gauge == pytest.approx([wanted, chi2.ppf(0.025, 3), chi2.ppf(0.975, 3)], rel=1e-3)
    ratio = np.sqrt(error @ np.linalg.inv(env.core.score.pose_covariance[0]) @ error / 3.0)
    assert readings[2].gauge == pytest.approx([ratio, *np.sqrt(np.divide(chi2.ppf([0.025, 0.975], 3), 3.0))], rel=1e-3)


def test_ranges_of_a_single_robot_against_the_bound() -> None:
    env, info = _after("ActiveDepth", 8, targets=1)
    honest, ratio = (r for r in scene(env.core, 0, []).readings if r.gauge is not None)
    # One target: the bound's worst standard deviation is that of its range.
    assert ratio.gauge is not None
    assert honest.gauge is not None
    assert ratio.gauge[0] == pytest.approx(abs(info["errors"]["range"][0, 0]) / info["bound_sd"][0], rel=1e-6)
    assert ratio.gauge[1:] == pytest.approx(np.sqrt(chi2.ppf([0.025, 0.975], 1)), rel=1e-3)
    assert honest.gauge[1:] == pytest.approx(chi2.ppf([0.025, 0.975], 3), rel=1e-3)


def test_what_is_not_known_is_not_told() -> None:
    labels = {r.label for r in scene(_after("RelativePose", 1, estimator=None, bound=True)[0].core, 0, []).readings}
    assert labels == {"information"}
    without = {"estimator": "cascade", "reward": {"visibility": 1.0}}
    labels = {r.label for r in scene(_after("RelativePose", 1, **without)[0].core, 0, []).readings}
    assert labels == {"depth error", "pose error", "NEES"}


def test_a_singular_covariance_has_no_nees() -> None:
    env, _ = _after("RelativePose", 1, estimator="cascade")
    env.core.onboard.estimate.pose_covariance[:] = 0.0
    told = [r for r in scene(env.core, 0, []).readings if r.label == "NEES"]
    assert [r.value for r in told] == ["none", "none"]
