"""What is damaged is made again, what is killed leaves nothing, and two do not work on one folder."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from agents import workers
from agents.__main__ import app
from agents.alone import alone
from agents.benchmark import benchmark
from agents.jobs import Asked
from agents.results import ASKED, CHECKSUM, DamagedError, Result, _checksum, done, load
from tests.agents.conftest import ROOT

pytestmark = pytest.mark.usefixtures("tiny_suites")

TINY = Asked("relloc_env/ActiveDepth-v0", ("tiny",), ("straight", "circle"), ("cascade",), 3, "validation")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder of results, and what its first file holds."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        from relloc_env import scenarios
        from tests.agents.conftest import TINY as SUITES

        patch.setattr(scenarios, "SUITES", {**scenarios.SUITES, **SUITES})
        first, _ = benchmark(TINY, folder, cores=1)
    return folder, first.read_bytes()


def _without(path: Path, name: str) -> None:
    with np.load(path) as file:
        arrays: dict[str, Any] = {key: file[key] for key in file if key not in (name, CHECKSUM)}
    np.savez_compressed(path, **{**arrays, CHECKSUM: np.array(_checksum(arrays))})


def _with(path: Path, name: str, value: object, *, checksum: bool) -> None:
    with np.load(path) as file:
        arrays = dict(file) | {name: np.array(value)}
    if checksum:
        arrays[CHECKSUM] = np.array(_checksum({key: arrays[key] for key in arrays if key != CHECKSUM}))
    np.savez_compressed(path, **arrays)


DAMAGES = {
    "empty": lambda path: path.write_bytes(b""),
    "half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "short by one": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "text": lambda path: path.write_text("nothing", "utf-8"),
    "other numbers": lambda path: _with(path, "score/path", [1.0, 2.0, 3.0], checksum=False),
    "odd JSON": lambda path: _with(path, "job", "[[[", checksum=True),
    "other JSON": lambda path: _with(path, "job", "{}", checksum=True),
    "deep JSON": lambda path: _with(path, "job", "[" * 100_000, checksum=True),
    "a part is missing": lambda path: _without(path, "ways"),
    "objects": lambda path: np.savez(path, job=np.array([{}], dtype=object)),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_told_and_made_again(damage, whole):
    folder, right = whole
    first = folder / next(iter(TINY.jobs())).file
    first.write_bytes(right)
    before = {name: getattr(Result.load(first), name) for name in ("scores", "ways")}
    DAMAGES[damage](first)
    assert not done(next(iter(TINY.jobs())), folder)
    with pytest.raises(DamagedError, match=r"is damaged .* makes it again"):
        load(folder)
    made = CliRunner().invoke(app, ["report", str(folder), "--no-animations"])
    assert made.exit_code == 0, made.output
    assert "Warning" in made.output
    assert "is damaged" in made.output.replace("\n", " ")
    benchmark(TINY, folder, cores=1)
    again = load(folder)[1][0]
    np.testing.assert_array_equal(again.ways, before["ways"])
    for name, values in before["scores"].items():
        np.testing.assert_array_equal(again.scores[name], values)


def test_any_byte_that_turns_is_noticed(whole):
    """Whatever byte is another, the file is damaged or holds what it held (zip has fields that nobody reads)."""
    folder, right = whole
    path = folder / "turned.npz"
    path.write_bytes(right)
    held = Result.load(path)
    noticed = 0
    for place in np.random.default_rng(0).integers(len(right), size=200).tolist():
        path.write_bytes(right[:place] + bytes([right[place] ^ 0xFF]) + right[place + 1 :])
        try:
            found = Result.load(path)
        except DamagedError:
            noticed += 1
        else:
            np.testing.assert_array_equal(found.ways, held.ways)
            assert found.job == held.job
    path.unlink()
    assert noticed > 150


@pytest.mark.parametrize("text", ["", "[]", "{", '{"env": 3}', "[" * 100_000, "null"])
def test_an_odd_list_of_jobs_is_one_line(text, tmp_path):
    (tmp_path / ASKED).write_text(text, "utf-8")
    for words in (["report", str(tmp_path)], ["tables", str(tmp_path)], ["benchmark", "--out", str(tmp_path)]):
        told = CliRunner().invoke(app, words)
        assert told.exit_code == 2
        assert f"{ASKED} is not as `benchmark` writes it" in told.output


def test_two_do_not_work_on_one_folder(tmp_path):
    code = "import sys; from agents.alone import alone; from pathlib import Path\n"
    code += "with alone(Path(sys.argv[1])):\n    print('has it', flush=True)\n    sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"has it\n"
        with pytest.raises(ValueError, match="is in use: wait"):
            benchmark(TINY, tmp_path, cores=1)
        other.kill()
    with alone(tmp_path):  # though the file of the lock is there
        pass


WAITS = """
import os, time
from pathlib import Path
class Waits:
    def __init__(self, task): pass
    def reset(self, n, seed): pass
    def act(self, rows):
        Path(__file__).with_name(f"started.{os.getpid()}").touch()
        while True: time.sleep(0.02)
"""


@pytest.mark.skipif(os.name != "posix" or not Path("/proc").is_dir(), reason="looks into /proc")
@pytest.mark.parametrize("stage", ["start-up", "work"])
@pytest.mark.parametrize("how", ["SIGKILL", "SIGTERM", "SIGINT"])
def test_workers_end_with_their_parent(how, stage, tmp_path):
    """A Ctrl-C goes to all processes of a terminal, a kill to one."""
    for name in "ab":
        (tmp_path / f"{name}.py").write_text(WAITS, "utf-8")
    agents = ",".join(f"{tmp_path / name}.py:Waits" for name in "ab")
    words = ["--suite", "open-field", "--agents", agents, "--estimators", "cascade", "--episodes", "2", "--cores", "2"]
    command = [sys.executable, "-m", "agents", "benchmark", *words, "--out", str(tmp_path / "out")]
    main = subprocess.Popen(command, cwd=ROOT, start_new_session=True, stderr=subprocess.PIPE, text=True)
    try:
        _until(lambda: _workers(main.pid) if stage == "start-up" else len(list(tmp_path.glob("started.*"))) == 2)
        (os.killpg if how == "SIGINT" else os.kill)(main.pid, getattr(signal, how))
        told = main.communicate(timeout=60)[1]
        _until(lambda: not _workers(main.pid))
    finally:
        for pid in (*_workers(main.pid), main.pid):
            if main.poll() is None or pid != main.pid:
                os.kill(pid, signal.SIGKILL)
    if how == "SIGINT":
        assert main.returncode == 2
        assert "Stopped; the same command goes on" in told
        assert "Traceback" not in told


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be put off")
def test_a_ctrl_c_waits_until_all_processes_are_started():
    """Also where another thread takes the signal: a process whose parent is gone half way ends in a traceback."""
    done, over = [], threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()

    def interrupted():
        with workers._deaf():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.2)
            done.append(True)

    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        over.set()
        other.join()
    assert done == [True]


def _workers(session: int) -> list[int]:
    """Worker processes of a session that are there and not over."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, in_session = (folder / "stat").read_text("utf-8").rpartition(")")[2].split()[:4]
            words = (folder / "cmdline").read_text("utf-8")
        except OSError:
            continue
        if int(in_session) == session and state != "Z" and "spawn_main" in words:
            found.append(int(folder.name))
    return found


def _until(so, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not so():
        assert time.monotonic() < end
        time.sleep(0.02)
