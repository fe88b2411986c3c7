import csv
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

import relloc_env
from agents import Task, demo, demo_tables, make
from agents.__main__ import app
from agents.rollout import Episode, rollout
from relloc_env.envs.information import Information
from relloc_env.replay.report import table as replay_table

ROOT = Path(__file__).resolve().parents[2]
PNG = b"\x89PNG\r\n\x1a\n"


def episode(**changes):
    """Four instants of two robots that found each other at 10 s."""
    values: dict[str, Any] = {
        "time": np.array([0.0, 5.0, 10.0, 15.0]),
        "poses": np.zeros((4, 2, 3)),
        "points": np.zeros((2, 3)),
        "depth_error": np.full((4, 2, 2), 0.01),
        "pose_error": np.zeros((4, 2, 2)),
        "bound": np.array([[1.0, 1.0], [0.04, 0.5], [0.04, 0.02], [0.04, 0.02]]),
        "information": np.array([0.0, 1.0, 3.0, 4.0]),
        "seen": np.ones((4, 2, 2), np.bool_),
        "blocked": np.zeros((4, 2)),
        "reward": 2.0,
    }
    return Episode(**(values | changes))


class TestSummary:
    def test_times(self):
        pose_error = np.zeros((4, 2, 2))
        pose_error[1, 1, 0] = 0.06
        depth_error = np.full((4, 2, 2), -0.01)
        depth_error[2, 0, 1] = -0.2
        found = episode(pose_error=pose_error, depth_error=depth_error).summary()
        assert found["bound_reached_s"] == 10.0
        assert found["errors_settled_s"] == 15.0
        assert found["information_10s_nats"] == 3.0

    def test_never(self):
        pose_error = np.zeros((4, 2, 2))
        pose_error[-1, 0, 1] = np.radians(1.6)
        found = episode(pose_error=pose_error, bound=np.ones((4, 2))).summary()
        assert found["bound_reached_s"] is None
        assert found["errors_settled_s"] is None
        assert found["heading_error_end_deg"] == pytest.approx(1.6)

    def test_points_not_known_are_not_settled(self):
        depth_error = np.full((4, 2, 2), 0.01)
        depth_error[:, 1, 1] = np.nan
        found = episode(depth_error=depth_error).summary()
        assert found["errors_settled_s"] is None
        assert found["worst_depth_error_end_m"] is None

    def test_path_is_the_mean_of_both(self):
        poses = np.zeros((4, 2, 3))
        poses[:, 0, 0] = [0.0, 1.0, 2.0, 1.0]
        poses[:, 1, :2] = [[0.0, 0.0], [0.3, 0.4], [0.3, 0.4], [0.3, 0.4]]
        assert episode(poses=poses).summary()["path_m"] == pytest.approx(0.5 * (3.0 + 0.5))


def test_rollout_notes_what_the_doors_tell():
    env = relloc_env.parallel_env(max_cycles=12, estimator="cascade")
    played = rollout(env, make("straight", Task.of(env)), seed=2)
    assert played.time.tolist() == [0.25 * k for k in range(13)]
    # Straight ahead at 0.3 m/s for 3 s.
    assert played.summary()["path_m"] == pytest.approx(0.9, abs=1e-9)
    info = Information(env.core).one(0)
    np.testing.assert_array_equal(played.poses[-1], info["truth/poses"])
    np.testing.assert_array_equal(played.pose_error[-1], info["errors/pose"])
    assert played.information[-1] == info["information/pose"]
    # Depth is range times the cosine of the bearing, for the estimate and for the truth; bearings are nearly known.
    to = played.points[None, :, :2] - played.poses[-1, :, None, :2]
    bearing = np.arctan2(to[..., 1], to[..., 0]) - played.poses[-1, :, None, 2]
    np.testing.assert_allclose(played.depth_error[-1], np.cos(bearing) * info["errors/range"], atol=0.02)


class TestTables:
    def results(self, **scores):
        one = dict.fromkeys(demo_tables.HEADS, 1.0) | scores
        motions = {"stationary": {"map-alignment": one, "cascade": one}}
        robots = dict.fromkeys(("robot_a", "robot_b"), 1.0)
        keys = (
            "depth_settled_s",
            "depth_settled_paper_s",
            "depth_error_end_m",
            "position_error_end_m",
            "heading_error_end_deg",
        )
        paper = dict.fromkeys(keys, robots)
        return {"paper_experiment": paper, "motions": motions, "seeds": [4, 5], "replays": [], "seconds": 1.0}

    def row(self, **scores):
        out = io.StringIO()
        demo_tables.show(self.results(**scores), Path("out"), Console(file=out, width=120))
        (line,) = (line for line in out.getvalue().splitlines() if "stationary" in line)
        return line

    def test_errors_that_say_nothing_are_not_shown_in_digits(self):
        line = self.row(position_error_end=342.398, depth_error_end=3.42398)
        assert "> 10 m" in line
        assert "> 100 %" in line
        assert "342" not in line

    def test_a_time_that_did_not_come_is_never(self):
        assert "never" in self.row(time_bound_pose=None)

    def test_every_column_of_a_replay_is_one_that_replays_have(self):
        pose = {"median_position_error_m": 1.0}
        data = {"estimators": {"cascade": {"depth": {"tracks": 1}, "pose": pose}}, "bound": "none"}
        assert set(demo_tables.REPLAY_HEADS) <= set(replay_table(data)[0])


class TestFindLogs:
    def test_at_hand(self, monkeypatch, tmp_path):
        monkeypatch.setenv("RELLOC_DATA", str(tmp_path))
        assert demo.find_logs(None) == []
        (tmp_path / "starloc" / "zigzag_s4").mkdir(parents=True)
        assert [found.path for found in demo.find_logs(None)] == [tmp_path / "starloc" / "zigzag_s4"]

    def test_nowhere_but_where_the_variable_says(self, monkeypatch):
        for value in ("", None):
            monkeypatch.delenv("RELLOC_DATA", raising=False)
            if value is not None:
                monkeypatch.setenv("RELLOC_DATA", value)
            assert demo.find_logs(None) == []

    def test_given(self, tmp_path):
        (found,) = demo.find_logs(tmp_path / "MRCLAM_Dataset7")
        assert found.options["robots"] == (2, 3)
        (found,) = demo.find_logs(tmp_path)
        assert found.options == {}


class TestCommand:
    def test_help(self):
        result = CliRunner().invoke(app, ["demo", "--help"], env={"COLUMNS": "120", "NO_COLOR": "1"})
        assert result.exit_code == 0
        for option in ("--out", "--seed", "--log"):
            assert option in result.output

    def test_log_that_is_not_there(self, tmp_path):
        result = CliRunner().invoke(app, ["demo", "--out", str(tmp_path / "out"), "--log", str(tmp_path / "none")])
        assert result.exit_code == 2
        assert result.output.strip() == f"Error: {tmp_path / 'none'}: folder not found"
        assert not (tmp_path / "out").exists()

    def test_bad_seed(self, tmp_path):
        assert CliRunner().invoke(app, ["demo", "--out", str(tmp_path), "--seed", "-1"]).exit_code == 2

    def test_runs_as_a_module(self):
        command = [sys.executable, "-m", "agents", "--help"]
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        assert "demo" in result.stdout


def test_demonstration_leaves_its_folder(monkeypatch, tmp_path):
    """Two motions, and a simulated log in place of the recorded ones."""
    monkeypatch.setenv("RELLOC_DATA", str(tmp_path / "none"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setattr(demo, "MOTIONS", {name: demo.MOTIONS[name] for name in ("edge-two", "learned")})
    monkeypatch.setattr(demo, "EPISODES", 3)
    out, text = tmp_path / "out", io.StringIO()
    demo.run(out, seed=5, console=Console(file=text, width=100))
    results = json.loads((out / "results.json").read_text("utf-8"))
    # The paper: converged after about 13 s (A) and 25 s (B).
    settled = results["paper_experiment"]["depth_settled_s"]
    assert settled["robot_a"] == pytest.approx(13.0, abs=2.0)
    assert settled["robot_b"] == pytest.approx(25.0, abs=2.0)
    assert list(results["motions"]) == ["edge-two", "learned"]
    (replayed,) = results["replays"]
    assert "error" not in replayed
    replay = json.loads((out / replayed["folder"] / "replay.json").read_text("utf-8"))
    # The log has noise, and the estimator that knows its size claims what it errs: 1 in 20 is outside the band.
    pose = replay["estimators"]["map-alignment"]["pose"]
    low, high = replay["nees_band_95"]
    assert low < pose["median_nees"] < high
    assert 0.5 < pose["whitened_error"] < 1.6
    for name in ("paper-experiment.png", "motions.png", "information.png"):
        assert (out / name).read_bytes().startswith(PNG)
    assert (out / "script-and-policy.mp4").read_bytes()[4:8] == b"ftyp"
    with (out / "motions.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["motion"], row["estimator"]) for row in rows] == [
        (motion, estimator) for motion in ("edge-two", "learned") for estimator in ("map-alignment", "cascade")
    ]
    # What is shown of each motion are medians over the starts; the one alone is played again by another way.
    assert results["seeds"] == [5, 6, 7]
    scores = results["motions"]["learned"]["cascade"]
    assert float(rows[-1]["information_end"]) == scores["information_end"]
    env = relloc_env.parallel_env(estimator="cascade")
    alone = [rollout(env, make(demo.MOTIONS["learned"], Task.of(env)), seed).information[-1] for seed in (5, 6, 7)]
    assert scores["information_end"] == pytest.approx(np.median(alone), rel=1e-3)
    printed = text.getvalue()
    assert "Consistent with the paper's times, no more" in printed
    assert all(head in printed for head in ("position [m]", "heading [°]", "NEES"))
    assert f"Where to look: {out}/" in printed
    for file in out.iterdir():
        assert file.name in printed
    assert "[13/13]" not in printed
    assert "RELLOC_DATA" in printed
    shutil.rmtree(out)
