import importlib
import json
import re
import sys
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import relloc_env
from relloc_env.__main__ import app
from relloc_env.envs.centralised import RellocEnv
from relloc_env.extras import extra as need
from relloc_env.logs import read_log
from relloc_env.wrappers import RecordLog
from tests.rendering.scenes import columns_of

run = CliRunner()


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of 2 s of two simulated robots."""
    folder = tmp_path_factory.mktemp("logs")
    pillar = {"shape": "disc", "position": (-4.0, -4.0), "radius": 0.2}
    env = RecordLog(RellocEnv(max_cycles=8, obstacles=[pillar]), folder)
    env.reset(seed=3)
    for _ in range(8):
        env.step(np.array([1.0, 0.1, 1.0, -0.1], np.float32))
    env.close()
    return folder / "episode_000"


def plain(text):
    """Without the colours that help pages may have."""
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def fails(*words, code=2):
    """The one line that a command ends with."""
    result = run.invoke(app, [str(word) for word in words])
    assert result.exit_code == code
    assert isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.output
    return plain(result.output).strip()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ((), ("paper", "replay", "play", "version")),
        (("play",), ("--config", "--suite", "--robots", "--estimator", "--seed", "--out", "--size")),
        (("paper",), ("--out",)),
        (("replay",), ("--robots", "--from", "--to", "--velocity", "--estimator", "--pose-model", "--out")),
        (("replay",), ("--initial-depth GUESS SD", "--initial-pose-error X Y DEG")),
        (("version",), ("version",)),
    ],
)
def test_help(command, words):
    result = run.invoke(app, [*command, "--help"], env={"COLUMNS": "120"})
    assert result.exit_code == 0
    for word in words:
        assert word in plain(result.output)


def test_version():
    result = run.invoke(app, ["version"])
    assert result.output.strip() == relloc_env.__version__


def test_replay_for_rerun(log, tmp_path):
    chunk = pytest.importorskip("rerun.chunk")
    file = tmp_path / "replay.rrd"
    words = ["replay", str(log), "--out", str(tmp_path / "out"), "--estimator", "cascade", "--rerun", str(file)]
    result = run.invoke(app, words)
    assert result.exit_code == 0, result.output
    truth = read_log(log).truth
    assert truth is not None
    found: dict[str, dict[int, Any]] = {}
    still: dict[str, dict[str, Any]] = {}
    for part in chunk.RrdReader(str(file)).stream():
        columns = columns_of(part)
        if part.is_static:
            still.setdefault(part.entity_path, {}).update({name: values[0] for name, values in columns.items()})
        else:
            for k, time in enumerate(columns["episode"]):
                found.setdefault(part.entity_path, {})[round(20.0 * time.total_seconds())] = {
                    name: values[k] for name, values in columns.items()
                }
    assert still["/world/obstacles/discs"]["Cylinders3D:centers"][0] == pytest.approx([-4.0, -4.0, 1.0])
    places = found["/world/robot_b"]
    assert sorted(places) == list(range(0, 41, 5))
    for sample, row in places.items():
        assert row["Transform3D:translation"][0] == pytest.approx([*truth.poses[sample, 1, :2], 0.0], rel=1e-5)
    series = np.load(tmp_path / "out" / "replay.npz")
    told = [found["/pose_error/robot_a"][sample]["Scalars:scalars"][0] for sample in sorted(places)]
    assert told == pytest.approx(np.hypot(*series["cascade/0/pose_error_0"][::5, :2].T), rel=1e-4)


def test_play_needs_a_display(tmp_path, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "none-such")
    words = fails("play", "--estimator", "cascade", "--out", tmp_path)
    assert words.startswith("Error: There is no display to open a window on")
    assert not list(tmp_path.iterdir())


def test_play_needs_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pygame", None)
    assert "pip install 'relloc-env[render]'" in fails("play", "--estimator", "cascade", "--out", tmp_path)


def test_replay_of_a_simulated_log(log, tmp_path):
    out = tmp_path / "new" / "folder"
    result = run.invoke(app, ["replay", str(log), "--out", str(out), "--estimator", "cascade", "--to", "1.5"])
    assert result.exit_code == 0, result.output
    data = json.loads((out / "replay.json").read_text("utf-8"))
    assert list(data["estimators"]) == ["cascade"]
    assert data["options"]["to_s"] == 1.5
    assert data["estimators"]["cascade"]["logs"][0]["to_s"] == pytest.approx(1.48, abs=0.03)
    assert "cascade" in result.output
    assert any(out.glob("*.png"))


def test_options_reach_the_replay(monkeypatch, tmp_path):
    seen: dict[str, Any] = {}

    class Result:
        def __init__(self):
            self.options = {"velocity": "mocap"}

        def table(self):
            return ["estimator"], [["cascade"]]

        def notes(self):
            return ["What it means."]

    def replay(path, **options):
        seen.update(options, path=path)
        return Result()

    monkeypatch.setattr("relloc_env.replay.replay", replay)
    words = "--robots 2 3 --from 10 --to 20.5 --velocity mocap --estimator cascade --estimator cascade-critical"
    words += " --pose-model velocity --initial-depth 3 2 --initial-pose-error 1 -2 90"
    result = run.invoke(app, ["replay", "some", *words.split(), "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "What it means." in result.output
    assert seen.pop("progress") is not None
    assert {key: str(value) if key in {"path", "out"} else value for key, value in seen.items()} == {
        "path": "some",
        "robots": (2, 3),
        "start": 10.0,
        "stop": 20.5,
        "velocity": "mocap",
        "estimator": ["cascade", "cascade-critical"],
        "pose_model": "velocity",
        "initial_depth": (3.0, 2.0),
        "initial_depth_error": None,
        "initial_pose_error": (1.0, -2.0, pytest.approx(np.pi / 2)),
        "out": str(tmp_path),
    }


class TestBadInput:
    def test_no_such_folder(self, tmp_path):
        line = fails("replay", tmp_path / "none", "--out", tmp_path / "out")
        assert line == f"Error: {tmp_path / 'none'}: folder not found"
        assert not (tmp_path / "out").exists()

    def test_folder_without_a_log(self, tmp_path):
        assert fails("replay", tmp_path, "--out", tmp_path / "out").startswith(f"Error: {tmp_path}: holds no log")

    def test_unreadable_log_names_file_and_line(self, log, tmp_path):
        folder = tmp_path / "log"
        folder.mkdir()
        for file in log.iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        lines = (folder / "samples.csv").read_text("utf-8").splitlines()
        lines[4] = lines[4].replace(lines[4].split(",")[0], "soon", 1)
        (folder / "samples.csv").write_text("\n".join(lines) + "\n", "utf-8")
        line = fails("replay", folder, "--out", tmp_path / "out")
        assert "samples.csv, line 5" in line
        assert len(line.splitlines()) == 1

    def test_unknown_estimator(self, log, tmp_path):
        line = fails("replay", log, "--estimator", "cascad", "--out", tmp_path)
        assert line.startswith("Error: ")
        assert "'cascad'" in line
        assert "map-alignment" in line

    def test_empty_stretch(self, log, tmp_path):
        assert "must be before `stop`" in fails("replay", log, "--from", 2, "--to", 1, "--out", tmp_path)

    def test_robots_of_a_log_that_has_its_own(self, log, tmp_path):
        line = fails("replay", log, "--robots", 1, 2, "--out", tmp_path)
        assert line.startswith("Error: Argument `robots` must be left out")

    @pytest.mark.parametrize(
        ("words", "named"),
        [
            (["--velocity", "wheels"], "--velocity"),
            (["--pose-model", "best"], "--pose-model"),
            (["--robots", "2"], "--robots"),
            (["--from", "noon"], "--from"),
            (["--initial-depth", "3"], "--initial-depth"),
        ],
    )
    def test_bad_option(self, log, tmp_path, words, named):
        assert named in fails("replay", log, *words, "--out", tmp_path)

    def test_out_is_a_file(self, log, tmp_path):
        (tmp_path / "file").write_text("", "utf-8")
        assert "--out" in fails("replay", log, "--out", tmp_path / "file")
        assert "--out" in fails("paper", "--out", tmp_path / "file")

    def test_out_is_required(self, log):
        assert "--out" in fails("replay", log)

    @pytest.mark.parametrize(("package", "extra"), [("pygame", "render"), ("matplotlib", "logs")])
    def test_missing_package_names_the_extra(self, monkeypatch, log, tmp_path, package, extra):
        def replay(*args, **options):
            with need(extra):
                importlib.import_module(f"{package}.absent_part")

        monkeypatch.setattr("relloc_env.replay.replay", replay)
        monkeypatch.setitem(sys.modules, package, None)
        line = fails("replay", log, "--out", tmp_path)
        assert f"`{package}` is missing" in line
        assert f"relloc-env[{extra}]" in line


def test_paper_is_handed_over(monkeypatch, tmp_path):
    from relloc_env.paper import Claim, Verdict

    calls = []

    def reproduce(out, report):
        report("something")
        calls.append(out)
        return [
            Claim("one", "text", "III", {"x": 1.0}, Verdict.HOLDS, ""),
            Claim("two", "text", "IV", {}, Verdict.CONSISTENT, ""),
        ]

    monkeypatch.setattr("relloc_env.paper.reproduce", reproduce)
    result = run.invoke(app, ["paper", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert calls == [tmp_path]
    assert "2 printed sentences: holds 1, does not hold 0, consistent with 1, undetermined 0; see" in " ".join(
        result.output.split()
    )
