import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relloc_env.kernels.motion import advance
from relloc_env.logs import CommandModel, LogError, read_mrclam

Edit = Callable[[Path, int, str], None]


@pytest.mark.parametrize("velocity", ["commands", "mocap"])
def test_bearings_and_odometry_fit_the_truth(mrclam: Path, velocity: str) -> None:
    log = read_mrclam(mrclam).log((1, 2), velocity=velocity)  # type: ignore[arg-type]
    truth, s = log.truth, log.samples
    assert truth is not None
    assert s.period[0, 0] == 0.0
    assert (s.period[0, 1:] > 0.0).all()
    assert s.period.max() <= 0.25 + 1e-9
    seen = s.seen[0]
    assert seen.any(axis=(0, 2)).tolist() == [True, True]
    offset = truth.points[None, None, :, :2] - truth.poses[:, :, None, :2]
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - truth.poses[:, :, None, 2]
    np.testing.assert_allclose(s.image[0, ..., 0][seen], -np.tan(bearing)[seen], atol=1e-5)
    assert np.isnan(s.image[0, ..., 1][seen]).all()
    assert not s.image[0][~seen].any()
    assert truth.sensed_depth is not None
    np.testing.assert_allclose(truth.sensed_depth[seen], truth.depth[seen], atol=1e-4)
    for r in range(2):
        pose = tuple(truth.poses[0, r])
        for k in range(1, len(log)):
            pose = advance(*pose, *(float(u) for u in s.odometry[0, k, r]), s.period[0, k])
        assert pose == pytest.approx(tuple(truth.poses[-1, r]), abs=2e-3)


def test_samples_are_at_the_frames_of_both_robots(mrclam: Path) -> None:
    folder = read_mrclam(mrclam)
    log = folder.log((1, 2))
    time = log.time + folder.start
    for i in (1, 2):
        frames = np.unique(folder.robots[i].measurement[:, 0])
        kept = log.samples.seen[0, :, i - 1].any(axis=1)
        np.testing.assert_allclose(time[kept], frames, atol=1e-6)


def test_command_model_is_applied(mrclam: Path) -> None:
    commands = np.array([[0.1, 0.4], [0.1, -0.4], [0.1, 0.0]])
    moved = CommandModel(turn_scale=0.5, speed_scale=2.0, turn_loss=0.1, axle=0.02).velocity(commands)
    np.testing.assert_allclose(moved, [[0.16, 0.004, 0.2], [0.16, -0.004, -0.2], [0.2, 0.0, 0.0]])
    slow = read_mrclam(mrclam).log((1,), command_model={1: CommandModel(speed_scale=0.5)})
    full = read_mrclam(mrclam).log((1,))
    np.testing.assert_allclose(slow.samples.odometry[0, 5:, 0, 0], 0.5 * full.samples.odometry[0, 5:, 0, 0], rtol=1e-5)


def test_lag_shifts_the_commands(tmp_path: Path, mrclam: Path, edit: Edit) -> None:
    path = mrclam / "Robot1_Odometry.dat"
    lines = path.read_text("utf-8").splitlines()
    step = [line if i < 500 else line.replace("0.1 0.02", "0.2 0.02") for i, line in enumerate(lines)]
    path.write_text("\n".join(step) + "\n", "utf-8")
    rise = {}
    for lag in (0.0, 0.2):
        log = read_mrclam(mrclam, [1]).log((1,), command_model=CommandModel(lag=lag), longest_step=0.02)
        rise[lag] = log.time[int(np.argmax(log.samples.odometry[0, :, 0, 0] > 0.15))]
    assert rise[0.2] - rise[0.0] == pytest.approx(0.2, abs=0.025)


def test_points_out_of_the_cut_are_left_out_and_time_is_kept(mrclam: Path) -> None:
    log = read_mrclam(mrclam).log((1, 2), start=5.0, stop=8.0)
    assert log.time[0] >= 5.0
    assert log.time[-1] <= 8.0
    assert log.samples.period[0, 0] == 0.0
    assert not log.samples.odometry[0, 0].any()
    assert len(log.points) == log.samples.seen.shape[3] == log.prior.depth.shape[2]


@pytest.mark.parametrize(
    ("robots", "start", "stop", "message"),
    [
        ((1, 1), None, None, "`robots` must be distinct"),
        ((1, 9), None, None, "`robots` must be distinct"),
        ((), None, None, "`robots` must be distinct"),
        ((1, 2), 9.0, 3.0, "`start` must be before `stop`"),
        ((1, 2), 900.0, None, "must enclose samples"),
    ],
)
def test_wrong_arguments(mrclam: Path, robots: tuple[int, ...], start: float, stop: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_mrclam(mrclam).log(robots, start=start, stop=stop)


def test_velocity_must_be_one_of_two(mrclam: Path) -> None:
    with pytest.raises(ValueError, match=r"`velocity` must be .* but is 'wheels'"):
        read_mrclam(mrclam).log((1, 2), velocity="wheels")  # type: ignore[arg-type]


def test_motion_capture_needs_its_file(mrclam: Path) -> None:
    (mrclam / "Robot2_Groundtruth.dat").unlink()
    folder = read_mrclam(mrclam)
    assert folder.log((2,)).truth is None
    with pytest.raises(ValueError, match="has no truth of robot 2"):
        folder.log((2,), velocity="mocap")


@pytest.mark.parametrize(
    ("file", "line", "text", "message"),
    [
        ("Robot1_Odometry.dat", 7, "1000000.0 0.1", r"Odometry\.dat, line 7: must have 3 columns .* but has 2"),
        ("Robot1_Odometry.dat", 9, "1000000.0 fast 0.1", r"line 9: `v` must be a number, but is 'fast'"),
        ("Robot1_Odometry.dat", 9, "1000000.0 nan 0.1", r"line 9: `v` must be finite"),
        ("Robot1_Odometry.dat", 20, "999990.0 0.1 0.0", r"line 20: time must not go back"),
        ("Robot2_Measurement.dat", 5, "1000001.1 63.5 1 0", r"line 5: `barcode` must be a whole number, but is 63\.5"),
        ("Robot2_Measurement.dat", 5, "1000001.04 63 -1 0", r"line 5: must have a positive range"),
        ("Robot2_Measurement.dat", 5, "1000001.04 63 1 2.5", r"line 5: .*bearing within"),
        ("Robot1_Groundtruth.dat", 4, "inf 0 0 0", r"line 4: `time` must be finite"),
        ("Barcodes.dat", 3, "2 5", r"Barcodes\.dat, line 3: barcode 5 is listed twice"),
        ("Landmark_Groundtruth.dat", 2, "6 1", r"Landmark_Groundtruth\.dat, line 2: must have 5 columns"),
    ],
)
def test_a_wrong_line_is_named(mrclam: Path, edit: Edit, file: str, line: int, text: str, message: str) -> None:
    edit(mrclam / file, line, text)
    with pytest.raises(LogError, match=message):
        read_mrclam(mrclam)


def test_unlisted_barcodes_are_passed_over_while_few_and_named_when_many(mrclam: Path, edit: Edit) -> None:
    path = mrclam / "Robot1_Measurement.dat"
    lines = path.read_text("utf-8").splitlines()
    edit(path, 4, re.sub(r" (63|81|7|14) ", " 99 ", lines[3], count=1))
    assert read_mrclam(mrclam).robots[1].misread == 1
    path.write_text("\n".join(re.sub(r" 63 ", " 99 ", line) for line in lines) + "\n", "utf-8")
    with pytest.raises(LogError, match=r"Robot1_Measurement\.dat, line 2: barcode 99 .* must be listed"):
        read_mrclam(mrclam)


@pytest.mark.parametrize(
    ("target", "source", "message"),
    [
        ("Robot1_Odometry.dat", "Robot1_Groundtruth.dat", "line 1: must hold Odometry data, .* says Groundtruth"),
        ("Robot1_Measurement.dat", "Robot1_Odometry.dat", "line 1: must hold Measurement data"),
        ("Barcodes.dat", "Landmark_Groundtruth.dat", "Barcodes.dat, line 2: must have 2 columns"),
    ],
)
def test_mixed_up_files_are_named(mrclam: Path, target: str, source: str, message: str) -> None:
    (mrclam / target).write_bytes((mrclam / source).read_bytes())
    with pytest.raises(LogError, match=message):
        read_mrclam(mrclam)


def test_mixed_up_files_without_headers_are_named(mrclam: Path) -> None:
    rows = (mrclam / "Robot1_Groundtruth.dat").read_text("utf-8").splitlines()[1:]
    (mrclam / "Robot1_Measurement.dat").write_text("\n".join(rows), "utf-8")
    with pytest.raises(LogError, match=r"Robot1_Measurement.dat, line \d+: "):
        read_mrclam(mrclam)


@pytest.mark.parametrize("name", ["Robot1_Odometry.dat", "Robot2_Measurement.dat", "Barcodes.dat"])
@pytest.mark.parametrize(("content", "message"), [("", "is empty"), ("# only\n", "holds no data")])
def test_empty_files_are_named(mrclam: Path, name: str, content: str, message: str) -> None:
    (mrclam / name).write_text(content, "utf-8")
    with pytest.raises(LogError, match=f"{name}.*{message}"):
        read_mrclam(mrclam)


def test_binary_files_are_named(mrclam: Path) -> None:
    (mrclam / "Robot1_Odometry.dat").write_bytes(bytes(range(128, 256)))
    with pytest.raises(LogError, match=r"Robot1_Odometry\.dat: is not a text file"):
        read_mrclam(mrclam)


def test_missing_files_are_named(mrclam: Path) -> None:
    (mrclam / "Robot2_Measurement.dat").unlink()
    with pytest.raises(LogError, match=r"Robot2_Measurement\.dat: file not found"):
        read_mrclam(mrclam)
    with pytest.raises(LogError, match="must be a folder"):
        read_mrclam(mrclam / "nowhere")


def test_truncated_files_are_told_by_their_times(long_mrclam: Path) -> None:
    path = long_mrclam / "Robot1_Odometry.dat"
    path.write_text("\n".join(path.read_text("utf-8").splitlines()[:300]) + "\n", "utf-8")
    with pytest.raises(LogError, match=r"Robot1_Odometry\.dat: must cover the times .* too early: truncated"):
        read_mrclam(long_mrclam)


@pytest.mark.parametrize("tail", ["", " ", "\t", " \t ", " # a comment"])
def test_a_number_cut_short_is_named_whatever_the_rows_before_end_with(mrclam: Path, tail: str) -> None:
    path = mrclam / "Robot1_Groundtruth.dat"
    rows = [row if row.startswith("#") else row.rstrip() + tail for row in path.read_text("utf-8").splitlines()]
    path.write_text("\n".join(rows).removesuffix(tail)[:-1], "utf-8")
    with pytest.raises(LogError, match=r"Robot1_Groundtruth\.dat, line \d+: .* cut inside a number"):
        read_mrclam(mrclam)


def test_a_line_cut_short_is_named(mrclam: Path) -> None:
    path = mrclam / "Robot1_Groundtruth.dat"
    path.write_text(path.read_text("utf-8")[:-25], "utf-8")
    with pytest.raises(LogError, match=r"Robot1_Groundtruth\.dat, line \d+: must have 4 columns"):
        read_mrclam(mrclam)
