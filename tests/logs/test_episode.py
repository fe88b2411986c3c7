import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relloc_env.logs import Log, LogError, LogWriter, Truth, read_log, write_log
from relloc_env.samples import Prior, Samples

Edit = Callable[[Path, int, str], None]


def make_log(seed: int = 0, robots: int = 2, points: int = 3, count: int = 40) -> Log:
    """Numbers of every kind that a log may hold: tiny, negative zero, bearings without a height, late messages."""
    rng = np.random.default_rng(seed)
    pairs = robots * (robots - 1)
    period = rng.uniform(0.0, 0.3, (1, count))
    period[0, 0] = 0.0
    seen = rng.random((1, count, robots, points)) < 0.6
    image = rng.standard_normal((1, count, robots, points, 2)).astype(np.float32)
    image[~seen] = 0.0
    image[..., 1][seen & (rng.random(seen.shape) < 0.3)] = np.nan
    image[0, 0, 0, 0, 0] = -0.0
    odometry = (rng.standard_normal((1, count, robots, 3)) * 10.0 ** rng.integers(-30, 1, 3)).astype(np.float32)
    arrived = rng.integers(0, 2**64, (1, count, pairs), dtype=np.uint64)
    for k in range(count):  # no message is older than the log
        arrived[:, k] &= np.uint64(min(2 ** (k + 1) - 1, 2**64 - 1))
    poses = rng.standard_normal((count, robots, 3))
    poses[3] = np.nan
    sensed = rng.uniform(1.0, 5.0, (count, robots, points))
    sensed[rng.random(sensed.shape) < 0.5] = np.nan
    return Log(
        name="made up",
        kind="relloc",
        robots=tuple(f"robot_{r}" for r in range(robots)),
        points=tuple(f"p{m}" for m in range(points)),
        samples=Samples(period, odometry, image, seen, arrived),
        prior=Prior(
            rng.uniform(1.0, 5.0, (1, robots, points)),
            rng.standard_normal((1, pairs, 3)),
            1.0 / 3.0,
            np.array([1, 1, 2.0]),
        ),
        truth=Truth(poses, rng.standard_normal((points, 3)), sensed),
        velocity="odometry",
        start=12.1,
        configuration={"task": "test", "seed": seed},
    )


def assert_same(a: Log, b: Log) -> None:
    for name in Samples._fields:
        x, y = getattr(a.samples, name), getattr(b.samples, name)
        assert x.dtype == y.dtype
        assert x.shape == y.shape
        assert y.flags.c_contiguous
        assert x.tobytes() == y.tobytes()
    np.testing.assert_equal(b.prior._asdict(), a.prior._asdict())
    assert (a.truth is None) == (b.truth is None)
    if a.truth is not None and b.truth is not None:
        np.testing.assert_array_equal(a.truth.poses, b.truth.poses)
        np.testing.assert_array_equal(a.truth.points, b.truth.points)
        assert (a.truth.sensed_depth is None) == (b.truth.sensed_depth is None)
        if a.truth.sensed_depth is not None and b.truth.sensed_depth is not None:
            np.testing.assert_array_equal(a.truth.sensed_depth, b.truth.sensed_depth)
    for field in ("name", "robots", "points", "velocity", "start", "configuration"):
        assert getattr(a, field) == getattr(b, field)


@pytest.mark.parametrize(("robots", "points"), [(1, 1), (2, 3), (3, 4)])
def test_a_log_comes_back_bit_for_bit(tmp_path: Path, robots: int, points: int) -> None:
    for seed in range(5):
        log = make_log(seed, robots, points)
        assert_same(log, read_log(write_log(tmp_path / str(seed), log)))


def test_a_log_without_truth_comes_back(tmp_path: Path) -> None:
    log = make_log()
    bare = Log(**{**{name: getattr(log, name) for name in log.__dataclass_fields__}, "truth": None})
    folder = write_log(tmp_path / "log", bare)
    assert not (folder / "truth.csv").exists()
    assert_same(bare, read_log(folder))


def test_a_batch_is_written_block_by_block(tmp_path: Path) -> None:
    logs = [make_log(seed) for seed in range(3)]
    batch = Samples._make(np.concatenate(parts) for parts in zip(*(log.samples for log in logs), strict=True))
    prior = Prior(
        np.concatenate([log.prior.depth for log in logs]),
        np.concatenate([log.prior.pose for log in logs]),
        logs[0].prior.depth_sd,
        logs[0].prior.pose_sd,
    )
    truth = logs[1].truth
    assert truth is not None
    with LogWriter(tmp_path / "episode", prior, truth.points, configuration={"a": [1, 2]}, row=1) as writer:
        for k in range(0, 40, 8):
            block = Samples._make(value[:, k : k + 8] for value in batch)
            writer.add(block, truth.poses[k : k + 8])
    back = read_log(tmp_path / "episode")
    for name in Samples._fields:
        assert getattr(logs[1].samples, name).tobytes() == getattr(back.samples, name).tobytes()
    assert back.robots == ("robot_a", "robot_b")
    assert back.points == ("point_1", "point_2", "point_3")
    assert back.truth is not None
    np.testing.assert_array_equal(back.truth.poses, truth.poses)
    np.testing.assert_array_equal(back.prior.depth, logs[1].prior.depth)


def test_nothing_is_written_over_and_names_must_be_told_apart(tmp_path: Path) -> None:
    log = make_log()
    write_log(tmp_path / "log", log)
    with pytest.raises(ValueError, match="must be a new folder"):
        write_log(tmp_path / "log", log)
    twice = Log(**{**{name: getattr(log, name) for name in log.__dataclass_fields__}, "points": ("a", "a", "b")})
    with pytest.raises(ValueError, match="`points` must be distinct names"):
        write_log(tmp_path / "other", twice)


def test_the_tables_are_plain_csv(tmp_path: Path) -> None:
    """Python's own csv module and nothing of ours reads what a robot saw."""
    import csv

    log = make_log()
    with (write_log(tmp_path / "log", log) / "samples.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40
    assert float(rows[7]["period"]) == log.samples.period[0, 7]
    assert np.float32(rows[7]["robot_1.v"]) == log.samples.odometry[0, 7, 1, 0]
    assert int(rows[7]["robot_0.p2.seen"]) == log.samples.seen[0, 7, 0, 2]


@pytest.mark.parametrize(
    ("file", "line", "text", "message"),
    [
        ("samples.csv", 1, "period,a", r"samples\.csv, line 1: column 2 must be 'robot_0\.v', but is 'a'"),
        ("samples.csv", 4, "0.1,0.2", r"samples\.csv, line 4: must have 25 columns"),
        ("messages.csv", 3, "0,0,0,1", r"messages\.csv, line 3: must name a sample, two robots"),
        ("messages.csv", 3, "0,0,1,64", r"messages\.csv, line 3: must name a sample, two robots"),
        ("messages.csv", 3, "x,0,1,6", r"messages\.csv, line 3: `sample` must be a number, but is 'x'"),
        ("truth.csv", 2, "1,2,3", r"truth\.csv, line 2: must have 12 columns"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, edit: Edit, file: str, line: int, text: str, message: str) -> None:
    folder = write_log(tmp_path / "log", make_log())
    edit(folder / file, line, text)
    with pytest.raises(LogError, match=message):
        read_log(folder)


@pytest.mark.parametrize(
    ("column", "cell", "message"),
    [
        (0, "-1", "`period` must be 0 or more"),
        (0, "nan", "`period` must be 0 or more"),
        (2, "nan", "velocities must be finite"),
        (7, "2", "`seen` must be 0 or 1"),
        (8, "nan", "`x` must be finite"),
    ],
)
def test_a_wrong_cell_is_named(tmp_path: Path, edit: Edit, column: int, cell: str, message: str) -> None:
    folder = write_log(tmp_path / "log", make_log())
    cells = (folder / "samples.csv").read_text("utf-8").splitlines()[9].split(",")
    cells[column] = cell
    edit(folder / "samples.csv", 10, ",".join(cells))
    with pytest.raises(LogError, match=f"samples.csv, line 10: {message}"):
        read_log(folder)


@pytest.mark.parametrize("file", ["samples.csv", "messages.csv", "truth.csv"])
def test_truncated_missing_and_empty_tables_are_named(tmp_path: Path, file: str) -> None:
    folder = write_log(tmp_path / "log", make_log())
    path = folder / file
    lines = path.read_text("utf-8").splitlines()
    path.write_text("\n".join(lines[:-5]) + "\n", "utf-8")
    with pytest.raises(LogError, match=rf"{file}: must have \d+ rows as log\.json says, but has \d+: truncated"):
        read_log(folder)
    path.write_text("", "utf-8")
    with pytest.raises(LogError, match=f"{file}: is empty"):
        read_log(folder)
    path.unlink()
    with pytest.raises(LogError, match=f"{file}: file not found"):
        read_log(folder)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "other", "`format` must be"),
        ("version", 7, "`version` must be 1, but is 7"),
        ("robots", "robot_a", "`robots` must be list"),
        ("samples", 0, ".* must not be empty"),
        ("samples", None, "`samples` must be int, but is None"),
        ("prior", {}, "`prior.depth` must"),
        ("prior", {"depth": [[1.0]]}, r"`prior.depth` must have shape \(2, 3\), but has \(1, 1\)"),
        ("truth", {"points": [[0, 0, 0]], "sensed_depth": True}, r"`truth.points` must have shape \(3, 3\)"),
    ],
)
def test_a_wrong_header_is_named(tmp_path: Path, key: str, value: object, message: str) -> None:
    folder = write_log(tmp_path / "log", make_log())
    head = json.loads((folder / "log.json").read_text("utf-8"))
    head[key] = value
    (folder / "log.json").write_text(json.dumps(head), "utf-8")
    with pytest.raises(LogError, match=rf"log\.json: {message}"):
        read_log(folder)


def test_a_header_that_is_not_json_is_named(tmp_path: Path) -> None:
    folder = write_log(tmp_path / "log", make_log())
    text = (folder / "log.json").read_text("utf-8")
    (folder / "log.json").write_text(text[: len(text) // 2], "utf-8")
    with pytest.raises(LogError, match=r"log\.json, line \d+: is not JSON"):
        read_log(folder)
