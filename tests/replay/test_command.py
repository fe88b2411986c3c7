import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from relloc_env.__main__ import app
from relloc_env.logs import Log, write_log

MakeLog = Callable[..., Log]


def test_the_command_prints_and_writes(tmp_path: Path, make_log: MakeLog) -> None:
    folder = write_log(tmp_path / "log", make_log(5.0))
    done = CliRunner().invoke(app, ["replay", str(folder), "--estimator", "cascade", "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "cascade" in done.output
    assert list(json.loads((tmp_path / "out" / "replay.json").read_text("utf-8"))["estimators"]) == ["cascade"]


@pytest.mark.parametrize("name", ["log.json", "samples.csv", "messages.csv", "truth.csv"])
def test_a_broken_file_is_one_line_and_no_traceback(tmp_path: Path, make_log: MakeLog, name: str) -> None:
    folder = write_log(tmp_path / "log", make_log(5.0))
    text = (folder / name).read_text("utf-8")
    (folder / name).write_text(text[: 2 * len(text) // 3], "utf-8")
    done = CliRunner().invoke(app, ["replay", str(folder), "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert isinstance(done.exception, SystemExit)
    assert name in done.output
    assert "Traceback" not in done.output
    assert not (tmp_path / "out" / "replay.json").exists()
