"""The figure of filtered depths fed in as white: its numbers, and that a small one shows what it is meant to show."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.consistency import FROM, Course, figures, run


def test_figures_of_known_errors() -> None:
    """4000 runs: poses drawn from what is claimed; one depth whose error stays, one whose error is white."""
    rng = np.random.default_rng(3)
    time = np.array([5.0, FROM, FROM + 1.0, FROM + 2.0])
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, 0.05, 0.1]])
    error = rng.standard_normal((4, 4000, 3)) @ root.T
    stays = np.broadcast_to(rng.standard_normal((1, 4000)), (4, 4000))
    depth = np.stack([stays, rng.standard_normal((4, 4000))], axis=-1)
    found = figures(
        time, Course(error, np.broadcast_to(root @ root.T, (4, 4000, 3, 3)), depth, np.full((4, 4000, 2), 0.81))
    )
    assert found["nees"] == pytest.approx([3.0] * 4, rel=0.05)
    sd = np.sqrt(np.diag(root @ root.T))
    assert found["claimed_position_m"] == pytest.approx([np.hypot(sd[0], sd[1])] * 4, rel=1e-4)
    assert found["rmse_position_m"] == pytest.approx(found["claimed_position_m"], rel=0.05)
    assert found["rmse_heading_deg"] == pytest.approx([np.degrees(sd[2])] * 4, rel=0.05)
    assert found["rmse_depth_m"] == pytest.approx([1.0] * 4, rel=0.05)
    assert found["claimed_depth_m"] == pytest.approx([0.9] * 4)
    assert found["lag_s"] == [0.0, 1.0, 2.0]
    # The mean over both depths.
    assert found["depth_correlation"] == pytest.approx([1.0, 0.5, 0.5], abs=0.03)


def test_a_small_one(tmp_path: Path) -> None:
    """12 runs of 11 s: the bound of docs/equations.md, section 5, and who is honest."""
    found = run(tmp_path, runs=12, seconds=11.0, seed=1, tell=lambda *_: None)
    assert json.loads((tmp_path / "consistency.json").read_text("utf-8")) == found
    assert (tmp_path / "consistency.png").stat().st_size > 20_000
    at = found["time_s"].index(FROM)
    assert found["bound"]["position_m"][at] == pytest.approx(np.hypot(0.032, 0.103), rel=0.02)
    assert found["bound"]["heading_deg"][at] == pytest.approx(1.0, rel=0.05)
    white, ours = (found["estimators"][name] for name in ("cascade", "map-alignment"))
    assert white["rmse_position_m"][at] > 20.0 * white["claimed_position_m"][at]
    assert ours["rmse_position_m"][at] < 2.0 * found["bound"]["position_m"][at]
    assert 1.0 < ours["nees"][at] < 6.0
    assert white["depth_correlation"][-1] > 0.9
    # The depths' own covariances are right, and what is made of them is not.
    damped = found["estimators"]["cascade-critical"]
    assert damped["claimed_depth_m"][at] == pytest.approx(damped["rmse_depth_m"][at], rel=0.2)
    assert damped["nees"][at] > 100.0
