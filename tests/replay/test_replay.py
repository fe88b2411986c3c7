import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relloc_env.estimators import CascadeConfig
from relloc_env.logs import Log, LogError, write_log
from relloc_env.replay import open_logs, replay, run_estimator

MakeLog = Callable[..., Log]


@pytest.fixture
def folder(tmp_path: Path, make_log: MakeLog) -> Path:
    return write_log(tmp_path / "log", make_log())


def test_estimators_converge_on_exact_measurements(folder: Path) -> None:
    result = replay(folder, estimator=["cascade", "map-alignment"])
    data = result.to_dict()["estimators"]
    assert data["map-alignment"]["pose"]["median_position_error_m"] < 0.05
    assert data["map-alignment"]["depth"]["median_final_error_m"] < 0.02
    assert data["cascade"]["depth"]["median_final_error_m"] < 0.5 * data["cascade"]["depth"]["median_initial_error_m"]


def test_results_are_written_and_say_the_same(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = replay(folder, estimator="cascade", out=out, start=2.0, stop=20.0)
    names = {path.name for path in out.iterdir()}
    assert names == {
        "replay.json",
        "replay.npz",
        "depth_error.png",
        "pose_error.png",
        "ellipses.png",
        "consistency.png",
    }
    written = json.loads((out / "replay.json").read_text("utf-8"))
    assert written == json.loads(json.dumps(result.to_dict()))
    run = result.runs["cascade"][0]
    with np.load(out / "replay.npz") as arrays:
        np.testing.assert_array_equal(arrays["cascade/0/time"], run.log.time)
    assert run.log.time[0] >= 2.0
    assert run.log.time[-1] <= 20.0
    heads, rows = result.table()
    assert [len(row) for row in rows] == [len(heads)]


def test_figures_hold_something(folder: Path, tmp_path: Path) -> None:
    from matplotlib.image import imread

    replay(folder, estimator=["cascade", "map-alignment"], out=tmp_path / "out", stop=10.0)
    for path in (tmp_path / "out").glob("*.png"):
        assert np.asarray(imread(path))[..., :3].std() > 0.03


def test_a_log_without_truth_is_run_and_not_scored(tmp_path: Path, make_log: MakeLog) -> None:
    log = make_log(5.0)
    bare = Log(**{**{name: getattr(log, name) for name in log.__dataclass_fields__}, "truth": None})
    result = replay(write_log(tmp_path / "log", bare), estimator="cascade", out=tmp_path / "out")
    data = result.to_dict()["estimators"]["cascade"]
    assert data["depth"] == {"tracks": 0}
    assert data["pose"] is None
    assert result.runs["cascade"][0].trace.known[-1].all()


def test_points_out_of_view_keep_their_estimate(make_log: MakeLog) -> None:
    log = make_log()
    late = len(log) // 2
    log.samples.seen[0, late:, 1, 0] = False
    log.samples.image[0, late:, 1, 0] = 0.0
    run = run_estimator(log, "cascade", CascadeConfig())
    truth = log.truth
    assert truth is not None
    assert run.trace.known[-1, 1, 0]
    places = []
    for k in (late - 1, -1):
        beta, _, rho = run.trace.points[k, 1, 0]
        x, y, theta = truth.poses[k, 1]
        places.append([x + np.cos(theta + beta) / rho, y + np.sin(theta + beta) / rho])
    np.testing.assert_allclose(places[1], places[0], atol=1e-4)


def test_progress_rises_to_the_end(folder: Path) -> None:
    told: list[float] = []
    replay(folder, estimator=["cascade", "cascade-critical"], progress=lambda _, part: told.append(part))
    assert told == sorted(told)
    assert 0.0 <= told[0] < 0.5 <= told[-1] <= 1.0


def test_pose_model_goes_to_the_cascade_alone(folder: Path) -> None:
    result = replay(folder, pose_model="velocity", stop=3.0)
    config = result.runs["cascade"][0].config
    assert isinstance(config, CascadeConfig)
    assert config.pose_model == "velocity"
    with pytest.raises(ValueError, match="`pose_model` must be left out for map-alignment"):
        replay(folder, estimator="map-alignment", pose_model="velocity")
    with pytest.raises(ValueError, match="pose_model"):
        replay(folder, pose_model="speed")


def test_one_guess_for_every_depth_uses_no_truth(folder: Path) -> None:
    result = replay(folder, estimator="cascade", stop=3.0, initial_depth=(3.0, 2.0))
    run = result.runs["cascade"][0]
    assert (run.log.prior.depth == 3.0).all()
    assert run.log.prior.depth_sd == 2.0
    truth = run.log.truth
    assert truth is not None
    for track in run.tracks:
        r, m = run.log.robots.index(track["robot"]), run.log.points.index(track["point"])
        assert track["initial_error_m"] == pytest.approx(3.0 - truth.depth[0, r, m], abs=0.01)
    assert result.options["initial_depth_m"] == [3.0, 2.0]


def test_first_pose_is_off_by_what_was_asked_for(folder: Path) -> None:
    result = replay(folder, estimator="cascade", stop=1.0, initial_pose_error=(1.0, -2.0, 0.5))
    prior, truth = result.runs["cascade"][0].log.prior, result.runs["cascade"][0].log.truth
    assert truth is not None
    np.testing.assert_allclose(prior.pose[0] - truth.relative[0], [[1.0, -2.0, 0.5]] * 2)
    np.testing.assert_allclose(prior.pose_sd, [1.0, 2.0, 0.5])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"initial_depth": (3.0, 0.0)}, "`guess`, `sd` must be positive, but are 3.0 and 0.0"),
        ({"initial_depth": (3.0, 2.0), "initial_depth_error": 1.0}, "`initial_depth` must be left out where"),
        ({"estimator": "cascades"}, "`estimator` must be the name .* Did you mean 'cascade'"),
        ({"robots": (1, 2)}, "`robots` must be left out"),
        ({"velocity": "mocap"}, "`velocity` must be left out"),
        ({"start": 900.0}, "must enclose samples"),
        ({"start": 5.0, "stop": 2.0}, "`start` must be before `stop`"),
    ],
)
def test_wrong_options_are_named(folder: Path, options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replay(folder, **options)  # type: ignore[arg-type]


def test_what_is_no_log_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="folder not found"):
        open_logs(tmp_path / "nowhere")
    with pytest.raises(LogError, match="holds no log"):
        open_logs(tmp_path)
    (tmp_path / "file").write_text("x", "utf-8")
    with pytest.raises(LogError, match="must be the folder of a log"):
        open_logs(tmp_path / "file")
