"""The bound along a log is the one that the environment carries, and it is held against the errors."""

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import relloc_env  # noqa: F401 - registers the ids
from relloc_env.logs import Log, read_log
from relloc_env.replay import replay
from relloc_env.replay.bound import bound_of
from relloc_env.wrappers import RecordLog
from tests.replay.conftest import MakeLog

OPTIONS = {"max_cycles": 30, "camera": {"preset": "pi", "miss_probability": 0.2}, "guess": {"depth_sd": 0.7}}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A log of two robots over 7.5 s, and the environment's own bound at its end."""
    folder = tmp_path_factory.mktemp("logs")
    env = RecordLog(gym.make("relloc_env/RelativePose-v0", estimator=None, bound=True, **OPTIONS), folder)  # type: ignore[arg-type]
    env.reset(seed=2)
    for k in range(30):
        env.step(np.array([1.0, 0.3 * np.sin(k), 0.8, -0.2], np.float32))
    bound = env.unwrapped.core.score.pose_covariance[0].copy()  # type: ignore[attr-defined]
    env.close()
    return folder / "episode_000", bound


def test_the_bound_of_a_log_is_that_of_its_environment(recorded: tuple[Path, np.ndarray]) -> None:
    path, wanted = recorded
    bound = bound_of(read_log(path))
    assert bound is not None
    np.testing.assert_allclose(bound.pose[-1, 0], wanted, rtol=1e-6)


def test_the_error_is_held_against_the_bound(recorded: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    path, wanted = recorded
    result = replay(path, estimator=["map-alignment", "cascade"], out=tmp_path / "out")
    written = json.loads((tmp_path / "out" / "replay.json").read_text("utf-8"))
    for name, (run,) in result.runs.items():
        there, back = run.poses
        assert there.bound is not None
        assert there.ratio is not None
        sd = np.sqrt(np.diag(wanted)) * [1.0, 1.0, np.degrees(1.0)]
        pose = written["estimators"][name]["logs"][0]["pose"][0]
        assert [pose["bound"][key][-1] for key in ("sd_x_m", "sd_y_m", "sd_heading_deg")] == pytest.approx(sd)
        error = there.error[-1]
        assert there.ratio[-1] == pytest.approx(np.sqrt(error @ np.linalg.inv(wanted) @ error / 3.0), rel=1e-6)
        assert back.bound is not None
    ours, papers = (written["estimators"][name]["pose"]["whitened_error"] for name in result.runs)
    assert 0.2 < ours < 2.5 < papers
    assert "error / bound" in result.table()[0]
    assert "1 is at the bound" in " ".join(result.notes())


def test_a_robot_alone_has_a_bound_of_its_depths(tmp_path: Path) -> None:
    env = RecordLog(gym.make("relloc_env/ActiveDepth-v0", targets=1, max_cycles=8), tmp_path / "logs")
    env.reset(seed=4)
    for _ in range(8):
        *_, info = env.step(np.array([0.5, 0.0], np.float32))
    env.close()
    result = replay(tmp_path / "logs" / "episode_000", estimator="cascade-critical")
    (track,) = result.runs["cascade-critical"][0].tracks
    # Nearly ahead, the depth is the range, whose bound the environment tells.
    assert track["final_bound_sd_m"] == pytest.approx(info["bound_sd"][0], rel=0.02)
    wanted = abs(track["final_error_m"]) / track["final_bound_sd_m"]
    heads, (row,) = result.table()
    assert float(row[heads.index("error / bound")]) == pytest.approx(wanted, abs=0.006)
    assert result.to_dict()["bound"].endswith("1 is at the bound")


def test_other_logs_have_no_bound_and_say_why(make_log: MakeLog, recorded: tuple[Path, np.ndarray]) -> None:
    log = make_log(3.0)
    assert bound_of(log) is None
    own = read_log(recorded[0])
    bare = Log(**{**{name: getattr(own, name) for name in own.__dataclass_fields__}, "truth": None})
    assert bound_of(bare) is None


def test_a_replay_without_a_bound_says_so(make_log: MakeLog, tmp_path: Path) -> None:
    from relloc_env.logs import write_log

    result = replay(write_log(tmp_path / "log", make_log(3.0)), estimator="cascade")
    assert result.to_dict()["bound"].startswith("the bound needs the truth")
    assert "error / bound" not in result.table()[0]
    assert result.to_dict()["estimators"]["cascade"]["logs"][0]["pose"][0]["bound"] is None
    assert result.to_dict()["estimators"]["cascade"]["pose"]["whitened_error"] is None
