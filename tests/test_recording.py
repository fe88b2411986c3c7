"""Recorded episodes: where they go, what happens to earlier ones, and that none is lost or impossible."""

import copy
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env  # noqa: F401 - registers the ids
from relloc_env.folders import FolderLock, open_file, open_folder
from relloc_env.logs import read_log
from relloc_env.replay import replay
from relloc_env.wrappers import RecordLog

OPTIONS: dict[str, Any] = {"estimator": "cascade", "max_cycles": 3}
ID = "relloc_env/RelativePose-v0"


def _record(folder: Path | str, episodes: int = 1, **options: Any) -> None:
    env = RecordLog(gym.make(ID, **OPTIONS), folder, **options)
    for seed in range(episodes):
        env.reset(seed=seed)
        while not env.step(np.full(4, 0.3))[3]:
            pass
    env.close()


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_second_run_goes_on_and_overwrites_where_asked(tmp_path: Path) -> None:
    _record(tmp_path, 2)
    first = read_log(tmp_path / "episode_000").samples.odometry.copy()
    _record(tmp_path)
    assert _names(tmp_path) == ["episode_000", "episode_001", "episode_002"]
    assert np.array_equal(read_log(tmp_path / "episode_002").samples.odometry, first)
    (tmp_path / "notes").mkdir()
    (tmp_path / "episode_007").mkdir()  # no log: not ours to remove
    _record(tmp_path, 1, overwrite=True)
    assert _names(tmp_path) == ["episode_007", "episode_008", "notes"]


def test_the_folder_is_where_it_was_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    env = RecordLog(gym.make(ID, **OPTIONS), "logs")
    assert (tmp_path / "here" / "logs").is_dir()
    monkeypatch.chdir(tmp_path / "there")
    env.reset(seed=1)
    env.close()
    assert _names(tmp_path / "here" / "logs") == ["episode_000"]
    assert _names(tmp_path / "there") == []


@pytest.mark.parametrize("where", ["file", "file/below", "file/further/below"])
def test_a_folder_that_cannot_be_is_told_at_the_start(tmp_path: Path, where: str) -> None:
    (tmp_path / "file").write_text("mine", "utf-8")
    with pytest.raises(OSError, match=r"Argument `folder` must be a folder, but .*file is a file"):
        RecordLog(gym.make(ID, **OPTIONS), tmp_path / where)
    assert (tmp_path / "file").read_text("utf-8") == "mine"


def test_two_recorders_of_one_folder_are_told_at_the_start(tmp_path: Path) -> None:
    first = RecordLog(gym.make(ID, **OPTIONS), tmp_path / "logs")
    (tmp_path / "link").symlink_to(tmp_path / "logs")
    for same in (tmp_path / "logs", tmp_path / "link"):
        with pytest.raises(OSError, match="in use by another writer"):
            RecordLog(gym.make(ID, **OPTIONS), same)
    code = f"from relloc_env.folders import *; FolderLock(open_folder({str(tmp_path / 'logs')!r}))"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "in use by another writer" in other.stderr
    first.close()
    second = RecordLog(gym.make(ID, **OPTIONS), tmp_path / "logs")
    with pytest.raises(OSError, match="in use"):
        first.reset()
    second.close()
    first.reset(seed=1)  # after `close` it may go on
    first.close()
    with pytest.raises(TypeError, match="cannot be copied"):
        copy.deepcopy(RecordLog(gym.make(ID, **OPTIONS), tmp_path / "other"))


def test_who_is_killed_keeps_no_folder(tmp_path: Path) -> None:
    code = f"""
        import os, signal
        from relloc_env.folders import FolderLock, open_folder
        lock = FolderLock(open_folder({str(tmp_path)!r}))
        os.kill(os.getpid(), signal.SIGKILL)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=False)
    FolderLock(tmp_path).release()
    assert _names(tmp_path) == []


def test_what_was_never_closed_is_written_with_a_warning(tmp_path: Path) -> None:
    env = RecordLog(gym.make(ID, **OPTIONS), tmp_path)
    env.reset(seed=1)
    env.step(np.zeros(4))
    left = [env]
    del env
    with pytest.warns(UserWarning, match=r"never closed: .*episode_000 holds its last episode so far"):
        left.clear()
    assert len(read_log(tmp_path / "episode_000")) == 6
    assert _names(tmp_path) == ["episode_000"]


@pytest.mark.parametrize("end", ["", "raise RuntimeError", "sys.exit(3)"])
def test_what_was_never_closed_is_written_at_exit(tmp_path: Path, end: str) -> None:
    code = f"""
        import os, sys
        import gymnasium as gym, numpy as np, relloc_env
        from relloc_env.wrappers import RecordLog
        os.chdir({str(tmp_path)!r})
        env = RecordLog(gym.make({ID!r}, estimator="cascade"), "logs")
        env.reset(seed=1)
        env.step(np.zeros(4))
        {end}
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
    )  # fmt: skip
    assert "never closed" in done.stderr
    assert len(read_log(tmp_path / "logs" / "episode_000")) == 6


def test_a_log_that_cannot_be_written_is_lost_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: Any) -> None:
        raise OSError("no space left")

    env = RecordLog(gym.make(ID, **OPTIONS), tmp_path)
    env.reset(seed=1)
    with monkeypatch.context() as patch:
        patch.setattr("relloc_env.logs.episode.write_log", fail)
        with pytest.raises(OSError, match="no space"):
            env.reset(seed=2)
    env.reset(seed=3)
    env.close()
    assert _names(tmp_path) == ["episode_001"]


@pytest.mark.parametrize("kind", ["fixed", "gaussian", "positive"])
@pytest.mark.parametrize("samples", [1, 5])
def test_another_state_begins_another_log(tmp_path: Path, samples: int, kind: str) -> None:
    """Each log is one that could be: its truth moves as its odometry says, no message is older than it; it replays."""
    env = RecordLog(
        gym.make(ID, estimator="cascade", max_cycles=30, samples_per_action=samples, guess={"kind": kind},
                 robot={"odometry_noise": (0.0, 0.0)}, network={"latency": 0.2, "jitter": 0.1}),
        tmp_path,
    )  # fmt: skip
    inner: Any = env.unwrapped
    env.reset(seed=3)
    beginning = inner.get_state()
    for _ in range(6):
        env.step(np.array([0.8, 0.2, 0.5, -0.3]))
    later = inner.get_state()
    for _ in range(4):
        env.step(np.array([-0.8, 0.2, 0.5, 0.3]))
    inner.set_state(later)
    for _ in range(8):
        env.step(np.array([0.1, 0.9, 0.2, 0.4]))
    inner.set_state(beginning)
    for _ in range(5):
        env.step(np.array([0.5, 0.1, 0.5, -0.1]))
    env.close()
    logs = [read_log(tmp_path / name) for name in _names(tmp_path)]
    assert [len(log) for log in logs] == [1 + samples * actions for actions in (10, 8, 5)]
    for log in logs:
        truth = log.truth
        assert truth is not None
        steps = np.diff(truth.poses, axis=0)
        moved = np.hypot(steps[..., 0], steps[..., 1])
        odometry, period = log.samples.odometry[0, 1:], log.samples.period[0, 1:, None]
        assert moved == pytest.approx(np.abs(odometry[..., 0]) * period, rel=1e-3, abs=1e-6)
        assert log.samples.period[0, 0] == 0.0
        ages = np.arange(len(log), dtype=np.uint64)[:, None]
        assert not np.any(log.samples.arrived[0] >> np.minimum(ages + 1, 63))
        guess = env.unwrapped.config.guess  # type: ignore[attr-defined]
        a, b = truth.poses[0]
        toward = complex(b[0] - a[0], b[1] - a[1]) * np.exp(-1j * a[2])
        error = log.prior.pose[0, 0, :2] - [toward.real, toward.imag]
        if kind != "gaussian":
            assert np.abs(error) == pytest.approx(guess.position)
    for field in ("image", "odometry", "seen"):  # the third is the first again, as far as actions are alike: its start
        assert np.array_equal(getattr(logs[0].samples, field)[0, 0], getattr(logs[2].samples, field)[0, 0])
    assert np.array_equal(logs[0].prior.depth, logs[2].prior.depth)
    result = replay(tmp_path / "episode_001", estimator="cascade", out=tmp_path / "replay")
    assert result.runs["cascade"]


@pytest.mark.parametrize("open_it", [open_folder, lambda path: open_file(path / "file.gif").parent])
def test_folders_are_made_resolved_and_tried(open_it: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    made = open_it(Path("some/folder"))
    assert made == tmp_path / "some" / "folder"
    assert _names(made) == []
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match=r"Argument `out` must be a folder, but .*/file is a file"):
        open_it(tmp_path / "file" / "below")
    monkeypatch.setattr("tempfile.TemporaryFile", _full)
    with pytest.raises(PermissionError, match=r"`out` must be a folder that can be written into, but .*: Read-only"):
        open_it(tmp_path / "some")
    with pytest.raises(IsADirectoryError, match="must be a file"):
        open_file(tmp_path)


def _full(**options: Any) -> None:
    raise PermissionError(30, "Read-only file system")
