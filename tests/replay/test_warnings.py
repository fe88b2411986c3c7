"""What a replay says beside its figures, and what it refuses to run on."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from relloc_env.__main__ import app
from relloc_env.estimators import PRESETS
from relloc_env.logs import Log, LogError, Truth, write_log
from relloc_env.replay import open_logs, replay, run_estimator
from relloc_env.replay.settings import configure
from relloc_env.samples import Samples
from tests.logs.conftest import write_mrclam

MakeLog = Callable[..., Log]


@pytest.fixture
def mrclam(tmp_path: Path) -> Path:
    return write_mrclam(tmp_path / "MRCLAM_Dataset0", seconds=8.0)


def swap_first_rows(folder: Path) -> None:
    path = folder / "Robot1_Odometry.dat"
    head, first, second, *rest = path.read_text("utf-8").splitlines()
    path.write_text("\n".join([head, second, first, *rest]) + "\n", "utf-8")


def test_warnings_are_printed_and_written(mrclam: Path, tmp_path: Path) -> None:
    swap_first_rows(mrclam)
    call = ["replay", str(mrclam), "--estimator", "cascade", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, call)
    assert done.exit_code == 0, done.output
    data = json.loads((tmp_path / "out" / "replay.json").read_text("utf-8"))
    (words,) = data["warnings"]
    assert "Robot1_Odometry.dat, line 3: a row out of order" in words
    assert f"Warning: {words}." in " ".join(done.output.split())
    done = CliRunner().invoke(app, [*call, "--limit", "disorder=0.001"])
    assert done.exit_code == 2
    assert "Robot1_Odometry.dat, line 3: time must not go back" in " ".join(done.output.split())
    done = CliRunner().invoke(app, [*call, "--limit", "disorders=1"])
    assert done.exit_code == 2
    assert "Argument `limit` must be one of speed, turn, gap" in done.output
    done = CliRunner().invoke(app, [*call, "--limit", "gap=90"])
    assert json.loads((tmp_path / "out" / "replay.json").read_text("utf-8"))["options"]["limits"]["gap"] == 90.0


def test_a_recording_that_is_in_order_has_no_warnings(mrclam: Path) -> None:
    result = replay(mrclam, estimator="cascade")
    assert result.to_dict()["warnings"] == []
    assert not any("Warning" in words for words in result.notes())


@pytest.mark.parametrize("estimator", ["map-alignment-mocap", "map-alignment-commands"])
@pytest.mark.parametrize("velocity", ["commands", "mocap"])
def test_the_estimator_that_was_asked_for_runs_and_says_so(mrclam: Path, estimator: str, velocity: str) -> None:
    result = replay(mrclam, estimator=estimator, velocity=velocity, stop=3.0)
    fits = estimator.endswith(velocity)
    expected = PRESETS[estimator].model_dump() | {"align_every": 4}
    assert result.runs[estimator][0].config.model_dump() == expected
    told = [words for words in result.warnings if estimator in words]
    assert bool(told) == (not fits)
    assert all(f'the log has "{velocity}"' in words for words in told)


def test_names_that_say_nothing_of_velocities_take_those_of_the_log(mrclam: Path) -> None:
    (log,) = open_logs(mrclam)
    assert configure(log, "map-alignment").model_dump() == PRESETS["map-alignment-commands"].model_dump() | {
        "align_every": 4
    }


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        (["Robot2_Odometry.dat"], r"Robot2_Odometry\.dat: file not found"),
        (["Robot2_Odometry.dat", "Robot2_Groundtruth.dat"], r"Robot2_Odometry\.dat: file not found"),
        (["Robot2_Measurement.dat"], r"Robot2_Measurement\.dat: file not found"),
        (["Robot1_Odometry.dat", "Robot2_Odometry.dat"], r"Robot1_Odometry\.dat: file not found"),
        (
            ["Robot2_Odometry.dat", "Robot2_Groundtruth.dat", "Robot2_Measurement.dat"],
            r"Dataset0: must hold two robots .* holds robot 1 alone .*`robots=\(1,\)`",
        ),
    ],
)
def test_what_a_folder_lacks_is_named(mrclam: Path, missing: list[str], message: str) -> None:
    for name in missing:
        (mrclam / name).unlink()
    with pytest.raises(LogError, match=message):
        replay(mrclam, estimator="cascade")
    if "alone" in message:
        assert replay(mrclam, robots=(1,), estimator="cascade").runs["cascade"][0].log.robots == ("robot_1",)


def twice(log: Log, at: list[int]) -> Log:
    """Give some stamps a second sample, as two sources have it."""
    rows = np.sort(np.append(np.arange(len(log)), at))
    samples = Samples._make(np.ascontiguousarray(part[:, rows]) for part in log.samples)
    samples.period[0, 1:][np.diff(rows) == 0] = 0.0
    truth = log.truth
    assert truth is not None
    return replace(log, samples=samples, truth=Truth(truth.poses[rows], truth.points))


@pytest.mark.parametrize("estimator", sorted(PRESETS))
def test_a_period_of_zero_inside_a_log_is_scored(tmp_path: Path, make_log: MakeLog, estimator: str) -> None:
    log = make_log(8.0)
    once, again = (
        replay(write_log(tmp_path / str(k), part), estimator=estimator)
        for k, part in enumerate((log, twice(log, [5, 12, 12, 13])))
    )
    assert all(np.isfinite(part).all() for part in again.runs[estimator][0].trace)
    json.dumps(again.to_dict(), allow_nan=False)
    first, second = (result.to_dict()["estimators"][estimator]["depth"] for result in (once, again))
    assert second["tracks"] == first["tracks"] == 6
    assert second["median_final_error_m"] == pytest.approx(first["median_final_error_m"], abs=0.1)


@pytest.mark.parametrize("what", ["a height", "a point", "all points", "a pose"])
def test_a_truth_that_is_known_in_part_is_scored_in_part(tmp_path: Path, what: str) -> None:
    """The log's environment states its noise: but for what is not known there would be a bound."""
    import gymnasium

    from relloc_env.replay.bound import NEEDS
    from relloc_env.wrappers import RecordLog

    env = RecordLog(gymnasium.make("relloc_env/RelativePose-v0", max_cycles=4), tmp_path / "logs")
    env.reset(seed=0)
    for _ in range(4):
        env.step(np.full(env.action_space.shape, 0.5, np.float32))
    env.close()
    (log,) = open_logs(tmp_path / "logs" / "episode_000")
    assert log.truth is not None
    points, poses = log.truth.points.copy(), log.truth.poses.copy()
    {"a height": points[0, 2:], "a point": points[0], "all points": points, "a pose": poses[7]}[what][...] = np.nan
    part = write_log(tmp_path / "part", replace(log, truth=Truth(poses, points)))
    data = replay(part, estimator="cascade").to_dict()
    assert json.loads(json.dumps(data, allow_nan=False))["bound"] == NEEDS
    whole = replay(tmp_path / "logs" / "episode_000", estimator="cascade").to_dict()
    assert whole["bound"] != NEEDS
    tracks = [found["estimators"]["cascade"]["depth"]["tracks"] for found in (whole, data)]
    assert (tracks[1] < tracks[0]) == (what in ("a point", "all points"))


def test_late_and_lost_messages_of_an_episode_are_read(tmp_path: Path) -> None:
    import gymnasium

    from relloc_env.wrappers import RecordLog

    network = {"latency": 0.1, "jitter": 0.3, "loss": 0.2}
    env = RecordLog(gymnasium.make("relloc_env/RelativePose-v0", max_cycles=4, network=network), tmp_path)
    env.reset(seed=0)
    for _ in range(4):
        env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()
    (log,) = open_logs(tmp_path / "episode_000")
    assert (log.samples.arrived > 1).any()


def test_a_configuration_that_is_none_is_an_error_of_the_file(tmp_path: Path, make_log: MakeLog) -> None:
    stated = {"robot": 1, "camera": {}, "guess": 3}
    folder = write_log(tmp_path / "log", replace(make_log(2.0), configuration=stated))
    with pytest.raises(LogError, match=r"log\.json: `configuration` must be an environment's"):
        replay(folder, estimator="cascade")


def test_a_log_made_in_python_is_looked_through(make_log: MakeLog) -> None:
    log = make_log(3.0)
    log.samples.odometry[0, 9, 1, 0] = np.nan
    with pytest.raises(ValueError, match=r"`samples\.odometry` must be finite, but is nan in sample 9 .* of robot 1"):
        run_estimator(log, "cascade", configure(log, "cascade"))


def test_results_are_put_in_place_whole(tmp_path: Path, make_log: MakeLog, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that ends while it writes leaves the results of the run before, and nothing else."""
    folder, out = write_log(tmp_path / "log", make_log(3.0)), tmp_path / "out"
    replay(folder, estimator="cascade", out=out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}

    def half(file: Path, **arrays: object) -> None:
        Path(file).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", half)
    with pytest.raises(KeyboardInterrupt):
        replay(folder, estimator="cascade", out=out)
    after = {path.name: path.read_bytes() for path in out.iterdir()}
    assert after.keys() == before.keys()
    assert after["replay.npz"] == before["replay.npz"]


def test_files_take_their_place_at_the_end(tmp_path: Path) -> None:
    from relloc_env.files import whole, write_whole

    target = write_whole(tmp_path / "a.txt", "one")
    with whole(target) as partial:
        partial.write_text("two", "utf-8")
        assert partial.suffix == ".txt"
        assert target.read_text("utf-8") == "one"
    assert target.read_text("utf-8") == "two"
    assert list(tmp_path.iterdir()) == [target]
    write_whole(target, b"\x00")
    assert target.read_bytes() == b"\x00"
