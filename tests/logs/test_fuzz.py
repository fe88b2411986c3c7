"""Broken files: whatever a byte, a line or a number of a good recording becomes, it is read as numbers or refused."""

import gzip
import json
import resource
import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from relloc_env.logs import Limits, Log, LogError, read_log, read_mrclam, read_starloc, write_log
from tests.logs.conftest import write_mrclam, write_starloc

BAD = [
    "nan",
    "inf",
    "-inf",
    "1e300",
    "-1e300",
    "0",
    "-1",
    "1e18",
    "1248446190123456789",
    "1e",
    "٣",
    "1_0",
    "x",
    "3.7",
    "1e-300",
]
MEMORY = 2**30
"""[bytes] that reading a recording of some 100 kB may need at most, beside what is in use."""
SETTINGS = settings(
    max_examples=150, deadline=20_000, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(autouse=True)
def little_memory() -> Iterator[None]:
    """Have a reader that allocates by what a number says end in a MemoryError, which is no LogError."""
    used = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@st.composite
def damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Something that happens to a file."""
    kind = draw(st.sampled_from(["drop", "insert", "swap", "number", "number", "number", "cut", "repeat", "pack"]))
    at, other = draw(st.floats(0, 1, exclude_max=True)), draw(st.floats(0, 1, exclude_max=True))
    if draw(st.booleans()):
        other = at  # lines and cells near each other
    word, byte = draw(st.sampled_from(BAD)), draw(st.binary(min_size=1, max_size=2))

    def apply(data: bytes) -> bytes:
        if not data:
            return data
        k = int(at * len(data))
        if kind == "drop":
            return data[:k] + data[k + 1 :]
        if kind == "insert":
            return data[:k] + byte + data[k:]
        if kind == "cut":
            return data[:k]
        if kind == "pack":
            packed = gzip.compress(data, mtime=0)
            k = int(at * len(packed))
            return packed if other < 0.2 else packed[:k] + packed[k + 1 :]
        lines = data.split(b"\n")
        i, j = int(at * len(lines)), int(other * len(lines))
        if kind == "swap":
            j = min(i + 1, len(lines) - 1) if i == j else j
            lines[i], lines[j] = lines[j], lines[i]
        elif kind == "repeat":
            lines.insert(i, lines[j])
        else:
            mark = b"," if b"," in lines[i] else b" "
            cells = lines[i].split(mark)
            cells[int(other * len(cells)) % len(cells)] = word.encode()
            lines[i] = mark.join(cells)
        return b"\n".join(lines)

    return apply


def check(folder: Path, name: str, harm: list[Callable[[bytes], bytes]], read: Callable[[Path], list[Log]]) -> None:
    """Read a damaged copy; what is read is finite, and what is refused names a file of the copy."""
    with TemporaryDirectory() as where:
        copy = Path(shutil.copytree(folder.parent, Path(where) / "copy")) / folder.name
        path = next(copy.parent.rglob(name))
        data = path.read_bytes()
        for apply in harm:
            data = apply(data)
        path.write_bytes(data)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                logs, words = read(copy), str(copy)
            except LogError as error:
                logs, words = [], str(error)
        assert str(copy.parent) in words
        for log in logs:
            s, limits = log.samples, Limits()
            assert np.isfinite(s.period).all()
            assert s.period.max() <= limits.gap
            assert np.isfinite(s.odometry).all()
            assert np.abs(s.odometry[..., :2]).max() <= limits.speed
            assert np.isfinite(s.image[..., 0]).all()
            assert not np.isinf(s.image).any()
            assert np.isfinite(log.prior.depth).all()
            assert (log.prior.depth > 0.0).all()
            assert np.isfinite(log.time).all()


@pytest.fixture(scope="module")
def mrclam_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mrclam(tmp_path_factory.mktemp("good") / "MRCLAM_Dataset0", seconds=12.0)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_starloc(tmp_path_factory.mktemp("good") / "set")


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory, mrclam_set: Path) -> Path:
    return write_log(tmp_path_factory.mktemp("good") / "episode", read_mrclam(mrclam_set).log((1, 2)))


@SETTINGS
@given(
    name=st.sampled_from(
        [f"Robot{r}_{kind}.dat" for r in (1, 2) for kind in ("Odometry", "Measurement", "Groundtruth")]
        + ["Barcodes.dat", "Landmark_Groundtruth.dat"]
    ),
    harm=st.lists(damage(), min_size=1, max_size=2),
    velocity=st.sampled_from(["commands", "mocap"]),
)
def test_a_broken_mrclam_set(mrclam_set: Path, name: str, harm: list[Callable[[bytes], bytes]], velocity: str) -> None:
    def read(path: Path) -> list[Log]:
        return [read_mrclam(path).log((1, 2), velocity=velocity)]  # type: ignore[arg-type]

    check(mrclam_set, name, harm, read)


@SETTINGS
@given(
    name=st.sampled_from(["log.json", "samples.csv", "messages.csv", "truth.csv"]),
    harm=st.lists(damage(), min_size=1, max_size=2),
)
def test_a_broken_episode(episode: Path, name: str, harm: list[Callable[[bytes], bytes]]) -> None:
    check(episode, name, harm, lambda path: [read_log(path)])


@SETTINGS
@given(
    name=st.sampled_from(["apriltag_cal_individual.csv", "calib.json", "environment_v1.csv"]),
    harm=st.lists(damage(), min_size=1, max_size=2),
)
def test_a_broken_sequence(sequence: Path, name: str, harm: list[Callable[[bytes], bytes]]) -> None:
    check(sequence, name, harm, lambda path: [read_starloc(path)])


_ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400),
    lambda parts: st.lists(parts, max_size=3) | st.dictionaries(st.text(max_size=5), parts, max_size=3),
    max_leaves=6,
)


@SETTINGS
@given(
    key=st.sampled_from(
        ["format", "version", "name", "robots", "points", "samples", "messages", "start", "velocity", "prior", "truth",
         "configuration", "warnings", "prior.depth", "prior.depth_sd", "prior.pose", "prior.pose_sd", "truth.points",
         "truth.sensed_depth"]
    ),
    value=_ANY,
)  # fmt: skip
def test_any_value_in_a_header(episode: Path, key: str, value: object) -> None:
    def apply(data: bytes) -> bytes:
        head = json.loads(data)
        *parents, last = key.split(".")
        part = head
        for parent in parents:
            part = part[parent]
        part[last] = value
        return json.dumps(head).encode()

    check(episode, "log.json", [apply], lambda path: [read_log(path)])
