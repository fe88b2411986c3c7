"""Recordings that are odd or broken as real ones are: refused with file and line, or read and told."""

import gzip
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relloc_env.logs import Limits, LogError, read_log, read_mrclam, read_starloc, write_log
from relloc_env.logs.starloc import DETECTIONS
from tests.logs.conftest import START
from tests.logs.test_episode import assert_same, make_log

Edit = Callable[[Path, int, str], None]


def lines_of(path: Path) -> list[str]:
    return path.read_text("utf-8").splitlines()


def put(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", "utf-8")


def restamp(path: Path, change: Callable[[float], float]) -> None:
    """Change all time stamps of a file."""
    head, *rows = lines_of(path)
    put(path, [head, *(f"{change(float(t)):.3f} {rest}" for t, rest in (row.split(" ", 1) for row in rows))])


def test_a_clock_not_set_yet_is_named_before_anything_is_filled(mrclam: Path, edit: Edit) -> None:
    """As boards without a battery write: the first row has the stamp 0."""
    measured = mrclam / "Robot2_Measurement.dat"
    edit(measured, 2, " ".join(["0.000", *lines_of(measured)[1].split()[1:]]))
    with pytest.raises(LogError, match=r"Robot2_Measurement\.dat, line 2: time must be near those of the .*1e\+06 s"):
        read_mrclam(mrclam)
    edit(mrclam / "Robot2_Odometry.dat", 2, "0.000 0.1 0.0")
    with pytest.raises(LogError, match=r"Robot2_Odometry\.dat, line 3: time must not jump by more than 60 s"):
        read_mrclam(mrclam)


@pytest.mark.parametrize("kind", ["Odometry", "Measurement", "Groundtruth"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: 1e9 * t, r"line \d+: .*are these (micro|nano)seconds"),
        (lambda t: t + 7200.0 * (t > START + 5.0), r"line \d+: time must .* jumps by 7\.2e\+03 s"),
        (lambda t: t - 7200.0 * (t > START + 5.0), r"line \d+: time must not go back"),
    ],
    ids=["nanoseconds", "forward", "back"],
)
def test_other_units_and_clocks_that_jump(
    mrclam: Path, kind: str, change: Callable[[float], float], message: str
) -> None:
    path = mrclam / f"Robot1_{kind}.dat"
    restamp(path, change)
    with pytest.raises(LogError, match=rf"{path.name}, {message}"):
        read_mrclam(mrclam)


def test_milliseconds_since_the_start_are_told_by_the_size_of_the_log(mrclam: Path) -> None:
    """Steps of 20 ms look like steps of 20 s, which alone could be."""
    for path in mrclam.glob("Robot*.dat"):
        restamp(path, lambda t: 1000.0 * (t - START + 1.0))
    with pytest.raises(LogError, match=r"must have at most 1000 samples.*milliseconds"):
        read_mrclam(mrclam, limits=Limits(uncovered=1000.0, cells=1e3)).log((1, 2))


def test_a_swapped_first_row_is_sorted_and_told(mrclam: Path) -> None:
    """As in the published set 9."""
    whole = read_mrclam(mrclam).log((1, 2))
    assert whole.warnings == ()
    for number in (1, 2):
        path = mrclam / f"Robot{number}_Odometry.dat"
        head, first, second, *rest = lines_of(path)
        put(path, [head, second, first, *rest])
    log = read_mrclam(mrclam).log((1, 2))
    assert [words.split(" by up to")[0] for words in log.warnings] == [
        f"Robot{number}_Odometry.dat, line 3: a row out of order," for number in (1, 2)
    ]
    assert log.time.tolist() == whole.time.tolist()
    assert log.samples.odometry.tobytes() == whole.samples.odometry.tobytes()


def test_an_error_after_sorting_names_the_line_in_the_file(mrclam: Path) -> None:
    path = mrclam / "Robot1_Measurement.dat"
    head, first, *rest = lines_of(path)
    other = next(k for k, row in enumerate(rest) if row.split()[0] != first.split()[0])
    rows = [*rest[: other + 1], first, *rest[other + 1 :]]
    rows[-1] = " ".join([*rows[-1].split()[:2], "-1", "0"])
    put(path, [head, *rows])
    with pytest.raises(LogError, match=rf"{path.name}, line {1 + len(rows)}: must have a positive range"):
        read_mrclam(mrclam)


@pytest.mark.parametrize(
    ("file", "line", "text", "message"),
    [
        ("Robot1_Odometry.dat", 9, f"{START - 0.06:.3f} 20.5 0", r"line 9: `v` must be at most 20 m/s .* is 20\.5"),
        ("Robot1_Odometry.dat", 9, f"{START - 0.06:.3f} 0 1e300", r"line 9: `w` must be at most 100 rad/s"),
        ("Robot1_Groundtruth.dat", 9, f"{START + 0.14:.3f} 1e300 0 0", r"line 9: `x` must be at most 1e\+08"),
        ("Landmark_Groundtruth.dat", 2, "6 1e30 0 0 0", r"line 2: `x` must be at most"),
        ("Landmark_Groundtruth.dat", 2, "7 1 0 0 0", r"line 3: landmark 7 is listed twice"),
        ("Barcodes.dat", 3, "1.5 5", r"line 3: `subject` must be a whole number"),
    ],
)  # fmt: skip
def test_numbers_that_cannot_be_are_named(
    mrclam: Path, edit: Edit, file: str, line: int, text: str, message: str
) -> None:
    edit(mrclam / file, line, text)
    with pytest.raises(LogError, match=rf"{file}, {message}"):
        read_mrclam(mrclam)


def test_limits_let_a_fast_robot_through(mrclam: Path, edit: Edit) -> None:
    edit(mrclam / "Robot1_Odometry.dat", 300, f"{START + 5.76:.3f} 25 0")
    assert read_mrclam(mrclam, limits=Limits(speed=30.0)).log((1,)).samples.odometry.max() > 1.0


def test_a_truth_that_jumps_makes_no_velocities(mrclam: Path, edit: Edit) -> None:
    edit(mrclam / "Robot1_Groundtruth.dat", 300, f"{START + 5.96:.3f} 1e6 0 0")
    with pytest.raises(LogError, match=r"Dataset0: \d+\.\d+ s: velocities must be at most 20 m/s .*`robot_1\.v`"):
        read_mrclam(mrclam).log((1,), velocity="mocap")


def test_detections_that_contradict_each_other_are_told(mrclam: Path) -> None:
    path = mrclam / "Robot1_Measurement.dat"
    lines = lines_of(path)
    stamp, code, length, bearing = lines[1].split()
    put(path, [*lines[:2], f"{stamp} {code} {length} {float(bearing) + 0.3}", *lines[2:]])
    (words,) = read_mrclam(mrclam).log((1, 2)).warnings
    assert words.startswith("Robot1_Measurement.dat, line 3: a detection of a point unlike another")
    put(path, [*lines[:2], *lines[1:]])
    assert read_mrclam(mrclam).log((1, 2)).warnings == ()


def test_odometry_that_ends_early_is_told(mrclam: Path) -> None:
    path = mrclam / "Robot1_Odometry.dat"
    put(path, lines_of(path)[:-300])
    (words,) = read_mrclam(mrclam).log((1, 2)).warnings
    assert re.match(r"the odometry of robot 1 ends 6\.\d s before the log", words)
    with pytest.raises(LogError, match="must cover the times"):
        read_mrclam(mrclam, limits=Limits(uncovered=5.0))


@pytest.mark.parametrize(("shift", "told"), [(40.0, True), (-40.0, True), (5.0, False)])
def test_clocks_far_apart_are_told(long_mrclam: Path, shift: float, told: bool) -> None:
    for kind in ("Odometry", "Measurement", "Groundtruth"):
        restamp(long_mrclam / f"Robot2_{kind}.dat", lambda t: t + shift)
    log = read_mrclam(long_mrclam).log((1, 2))
    assert any("40 s apart" in words and "clocks" in words for words in log.warnings) == told


def test_clocks_without_a_common_time_are_an_error(mrclam: Path) -> None:
    for kind in ("Odometry", "Measurement", "Groundtruth"):
        restamp(mrclam / f"Robot2_{kind}.dat", lambda t: t + 1e9)
    folder = read_mrclam(mrclam)
    with pytest.raises(LogError, match=r"robots 1, 2 must have recorded at the same time, but 1e\+09 s .* clocks"):
        folder.log((1, 2))
    assert len(folder.log((2,))) > 10


def test_a_broken_robot_that_is_not_read_is_told(mrclam: Path, edit: Edit) -> None:
    edit(mrclam / "Robot2_Odometry.dat", 2, "0.000 0.1 0.0")
    log = read_mrclam(mrclam, [1]).log((1,))
    assert log.time[0] == pytest.approx(1.2, abs=0.1)  # since the first command of robot 1
    assert any("Robot2_Odometry.dat, line 3" in words for words in log.warnings)


@pytest.mark.parametrize(("cell", "cut"), [("1.234567890", 0), ("1.2345", 1), ("1.", 1), ("0.000000000", 0)])
def test_a_last_line_cut_inside_a_number(mrclam: Path, cell: str, cut: int) -> None:
    """All other rows have nine decimals there; without an end of the line a shorter number was cut."""
    path = mrclam / "Robot1_Groundtruth.dat"
    lines = lines_of(path)
    lines[-1] = " ".join([*lines[-1].split()[:-1], cell])
    path.write_text("\n".join(lines), "utf-8")
    if cut:
        with pytest.raises(LogError, match=rf"{path.name}, line {len(lines)}: `theta` must have 9 decimals"):
            read_mrclam(mrclam)
    else:
        assert read_mrclam(mrclam).log((1, 2)).warnings == ()


def test_a_last_line_of_which_nobody_can_tell_is_told(mrclam: Path) -> None:
    path = mrclam / "Barcodes.dat"
    path.write_text("\n".join(lines_of(path)), "utf-8")
    (words,) = read_mrclam(mrclam).log((1, 2)).warnings
    assert words.startswith("Barcodes.dat, line 6: the last line has no end")


@pytest.mark.parametrize("name", ["samples.csv", "messages.csv", "truth.csv"])
def test_a_table_of_our_own_ends_with_its_line(tmp_path: Path, name: str) -> None:
    path = write_log(tmp_path / "log", make_log()) / name
    path.write_bytes(path.read_bytes()[:-2])
    with pytest.raises(LogError, match=rf"{name}, line \d+: (the line must have an end|.* must be a number|must have)"):
        read_log(path.parent)


def test_every_reader_takes_a_byte_order_mark_and_gzip(tmp_path: Path, mrclam: Path, starloc: Path) -> None:
    episode = write_log(tmp_path / "log", make_log())
    readers: Any = ((mrclam, lambda p: read_mrclam(p).log((1, 2))), (starloc, read_starloc), (episode, read_log))
    plain = [read(folder) for folder, read in readers]
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    for path in files:
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    for (folder, read), log in zip(readers, plain, strict=True):
        assert_same(log, read(folder))
    for path in files:
        path.with_name(path.name + ".gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
    for (folder, read), log in zip(readers, plain, strict=True):
        assert_same(log, read(folder))
    packed = episode / "samples.csv.gz"
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(LogError, match=r"samples\.csv\.gz: cannot be unpacked: truncated"):
        read_log(episode)


def test_a_small_file_that_unpacks_to_very_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("relloc_env.logs.text.LARGEST", 2**22)
    (tmp_path / "log.json.gz").write_bytes(gzip.compress(b" " * 2**23))
    with pytest.raises(LogError, match=r"log\.json\.gz: must hold at most 4194304 bytes"):
        read_log(tmp_path)


def change(folder: Path, key: str, value: object) -> None:
    """Put a value into the header."""
    head = json.loads((folder / "log.json").read_text("utf-8"))
    *parents, last = key.split(".")
    part = head
    for parent in parents:
        part = part[parent]
    part[last] = value
    (folder / "log.json").write_text(json.dumps(head), "utf-8")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("prior.depth", [[1, 2, 0], [1, 2, 3]], r"`prior\.depth` must be positive, .* but is 0"),
        ("prior.depth", [[1, 2, -1], [1, 2, 3]], r"`prior\.depth` must be positive, .* but is -1"),
        ("prior.depth", [[1, 2, None], [1, 2, 3]], r"`prior\.depth` must be finite"),
        ("prior.pose", [[0, 0, None], [1, 2, 3]], r"`prior\.pose` must be finite"),
        ("prior.depth_sd", 0, r"`prior\.depth_sd` must be positive"),
        ("prior.pose_sd", [1, 1, 0], r"`prior\.pose_sd` must be positive"),
        ("velocity", "wheels", r"`velocity` must be one of odometry, commands, mocap, but is 'wheels'"),
        ("start", 1e300, r"`start` must be at most"),
        ("start", float("nan"), "numbers must be finite, but one is NaN"),
        ("start", 10**400, r"numbers must be finite, but one is 1000.*401 digits"),
        ("samples", 10**12, "the log must have at most"),
        ("robots", ["a", "a"], "`robots` must be list of distinct names"),
        ("robots", ["a", "\ud800"], "`robots` must be text"),
        ("robots", [f"r{k}" for k in range(500)], "`robots` must be at most 100"),
        ("configuration", 3, "`configuration` must be dict"),
    ],
)
def test_a_wrong_header_is_named(tmp_path: Path, key: str, value: object, message: str) -> None:
    folder = write_log(tmp_path / "log", make_log())
    change(folder, key, value)
    with pytest.raises(LogError, match=rf"log\.json: {message}"):
        read_log(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 200_000, "is nested too deeply"),
        ('{"a":' * 200_000, "is nested too deeply"),
        ('{"start": 1e999}', "numbers must be finite, but one is 1e999"),
        ('{"start": -Infinity}', "numbers must be finite, but one is -Infinity"),
    ],
    ids=["lists", "objects", "1e999", "infinity"],
)
def test_json_that_python_cannot_hold(tmp_path: Path, starloc: Path, text: str, message: str) -> None:
    (tmp_path / "log.json").write_text(text, "utf-8")
    with pytest.raises(LogError, match=rf"log\.json: {message}"):
        read_log(tmp_path)
    (starloc / "calib.json").write_text(text, "utf-8")
    with pytest.raises(LogError, match=rf"calib\.json: {message}"):
        read_starloc(starloc)


def test_points_that_are_not_known_are_null(tmp_path: Path) -> None:
    folder = write_log(tmp_path / "log", make_log())
    change(folder, "truth.points", [[1, 2, None], [None, None, None], [1, 2, 3]])
    truth = read_log(folder).truth
    assert truth is not None
    assert np.isnan(truth.points).tolist() == [[False, False, True], [True] * 3, [False] * 3]


@pytest.mark.parametrize(
    ("column", "cell", "message"),
    [
        (0, "61", "`period` must be 0 or more, and at most 60 s, but is 61"),
        (1, "21", r"velocities must be at most 20 m/s in size, but `robot_0\.v` is 21"),
        (3, "1e300", r"velocities must be at most 100 rad/s in size, but `robot_0\.w` is 1e\+300"),
        (8, "1e300", r"`x` must be at most 1e\+06 in size, but `robot_0\.p0\.x`"),
        (9, "inf", r"`y` must be finite, but `robot_0\.p0\.y` is inf"),
    ],
)
def test_a_wrong_cell_is_named(tmp_path: Path, edit: Edit, column: int, cell: str, message: str) -> None:
    path = write_log(tmp_path / "log", make_log()) / "samples.csv"
    cells = lines_of(path)[9].split(",")
    cells[column] = cell
    edit(path, 10, ",".join(cells))
    with pytest.raises(LogError, match=rf"samples\.csv, line 10: {message}"):
        read_log(path.parent)


def test_messages_and_truth_of_before_the_log_and_beyond_the_earth(tmp_path: Path, edit: Edit) -> None:
    folder = write_log(tmp_path / "log", make_log())
    edit(folder / "messages.csv", 3, "4,0,1,5")
    with pytest.raises(LogError, match=r"messages\.csv, line 3: `age` must be .* before the log began"):
        read_log(folder)
    edit(folder / "messages.csv", 3, "5,0,1,5")
    cells = lines_of(folder / "truth.csv")[4].split(",")
    edit(folder / "truth.csv", 5, ",".join(["1e300", *cells[1:]]))
    with pytest.raises(LogError, match=r"truth\.csv, line 5: `robot_0\.x` must be at most 1e\+08"):
        read_log(folder)


def test_a_part_of_a_log_can_be_written_and_read(tmp_path: Path) -> None:
    """Messages that are older than the part do not reach it."""
    part = make_log().cut(14.0, 16.0)
    assert len(part) > 5
    assert_same(part, read_log(write_log(tmp_path / "part", part)))


def test_warnings_stay_with_a_log(tmp_path: Path) -> None:
    from dataclasses import replace

    log = replace(make_log(), warnings=("something is odd",))
    assert read_log(write_log(tmp_path / "log", log)).warnings == ("something is odd",)


def test_a_sequence_with_odd_stamps_and_two_answers(starloc: Path) -> None:
    path = starloc / DETECTIONS
    lines = lines_of(path)
    cells = lines[9].split(",")
    put(path, [*lines[:10], ",".join([*cells[:2], "100.0", *cells[3:]]), *lines[10:]])
    assert any("line 11: a detection of a point unlike another" in words for words in read_starloc(starloc).warnings)
    put(path, [lines[0], *lines[5:9], *lines[1:5], *lines[9:]])
    assert any("out of order" in words for words in read_starloc(starloc).warnings)
    late = [",".join([f"{float(row.split(',')[0]) + 3600:.9f}", *row.split(",")[1:]]) for row in lines[200:]]
    put(path, [*lines[:200], *late])
    with pytest.raises(LogError, match=r"csv, line 201: time must not jump by more than 60 s.*3\.6e\+03 s"):
        read_starloc(starloc)
