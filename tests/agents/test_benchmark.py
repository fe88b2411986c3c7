import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from agents.__main__ import app
from agents.benchmark import benchmark, run
from agents.jobs import Asked, Job
from agents.learned import POLICIES
from agents.policy import Task
from agents.registry import make
from agents.report import report
from agents.results import Failure, failures, load, of
from agents.rollout import rollout
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.scenarios import seeds
from tests.agents.conftest import EPISODES, ROOT

pytestmark = pytest.mark.usefixtures("tiny_suites")

WAITS = """
import time
from pathlib import Path

from agents.scripted import Scripted, circle


class Waits(Scripted):
    def __init__(self, task):
        super().__init__(task, law=circle)
        self.here = Path(__file__).parent

    def act(self, observations):
        (self.here / "started").touch()
        while not (self.here / "go").exists():
            time.sleep(0.02)
        return super().act(observations)
"""
TINY_COMMAND = """
from relloc_env import scenarios
scenarios.SUITES = {"tiny": scenarios.Suite("tiny", "", ({"max_cycles": 12},))}
from agents.__main__ import app
app()
"""


def marks(folder):
    """What each file holds, and when it was written."""
    return {p.name: (hashlib.sha256(p.read_bytes()).digest(), p.stat().st_mtime_ns) for p in folder.glob("*.npz")}


def call(*words):
    return CliRunner().invoke(app, ["benchmark", *map(str, words)])


class TestResults:
    def test_everything_asked_for_is_there(self, results):
        asked, found = load(results("RelativePose-v0"))
        assert [r.job for r in found] == list(asked.jobs())
        assert len(found) == 2 * 2 * 4
        for result in found:
            assert all(len(values) == EPISODES for values in result.scores.values())

    def test_scores_are_those_of_episodes_played_one_by_one(self, results):
        """The last of the seeds through the PettingZoo door (where actions are single precision), scored by itself."""
        _, found = load(results("RelativePose-v0"))
        (result,) = of(found, suite="tiny", agent="edge", estimator="cascade")
        env = RellocParallelEnv(result.job.configurations()[0][0], bound=True)
        alone = rollout(env, make("edge", Task.of(env)), seeds("validation", EPISODES)[-1])
        summary, scores = alone.summary(), {name: values[-1] for name, values in result.scores.items()}
        assert scores["information_end"] == pytest.approx(alone.information[-1], rel=1e-6)
        assert scores["path"] == pytest.approx(summary["path_m"], rel=1e-6)
        assert scores["seen"] == pytest.approx(summary["all_seen_by_all"])
        assert scores["position_error_end"] == pytest.approx(alone.pose_error[-1, 0, 0], rel=1e-6)
        assert scores["heading_error_end"] == pytest.approx(np.degrees(alone.pose_error[-1, 0, 1]), rel=1e-6)

    def test_variants_keep_the_order_of_the_seeds(self, results):
        """Of two variants in turn: every second episode is one of the suite that has that variant alone."""
        _, found = load(results("RelativePose-v0"))
        (result,) = of(found, suite="split", agent="circle", estimator="cascade")
        (two, its_seeds), (three, _) = result.job.configurations()
        assert (two.targets, three.targets) == (2, 3)
        assert its_seeds == seeds("validation", EPISODES)[::2]
        env = RellocParallelEnv(three, bound=True)
        alone = rollout(env, make("circle", Task.of(env)), seeds("validation", EPISODES)[3])
        assert result.scores["information_end"][3] == pytest.approx(alone.information[-1], rel=1e-6)

    def test_agents_of_one_file_name_do_not_share_results(self):
        jobs = [Job("relloc_env/RelativePose-v0", "far", f"{p}.py:A", "cascade", 1, "test") for p in "ab"]
        assert jobs[0].file != jobs[1].file


class TestKilled:
    def test_goes_on_where_it_was(self, tmp_path):
        (tmp_path / "waits.py").write_text(WAITS, "utf-8")
        out, own = tmp_path / "out", f"{tmp_path / 'waits.py'}:Waits"
        words = ["--out", out, "--suite", "tiny", "--agents", f"straight,{own},circle", "--estimators", "cascade"]
        words += ["--episodes", EPISODES, "--seeds", "validation", "--cores", 1]
        path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        command = [sys.executable, "-c", TINY_COMMAND, "benchmark", *map(str, words)]
        with subprocess.Popen(command, env=os.environ | {"PYTHONPATH": path}, stderr=subprocess.DEVNULL) as process:
            end = time.monotonic() + 300.0
            while not (tmp_path / "started").exists():
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(0.05)
            process.send_signal(signal.SIGKILL)
        before = marks(out)
        assert list(before) == ["tiny--straight--cascade.npz"]
        assert len(load(out)[1]) == 1
        (tmp_path / "go").touch()
        result = call(*words)
        assert result.exit_code == 0, result.output
        after = marks(out)
        assert len(after) == 3
        assert after.items() > before.items()
        # Moved as `circle` does, in the same episodes.
        _, (_, waited, circled) = load(out)
        np.testing.assert_array_equal(waited.scores["information_end"], circled.scores["information_end"])
        assert call(*words).exit_code == 0
        assert marks(out) == after

    def test_nothing_is_half_written(self, tmp_path, monkeypatch):
        asked = Asked("relloc_env/RelativePose-v0", ("tiny",), ("straight",), ("cascade",), 2, "validation")

        def torn(file, **arrays):
            file.write(b"PK half of it")
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(np, "savez_compressed", torn)
            with pytest.raises(KeyboardInterrupt):
                benchmark(asked, tmp_path, cores=1)
        assert list(tmp_path.glob("*.npz")) == []
        assert load(tmp_path)[1] == []
        (path,) = benchmark(asked, tmp_path, cores=1)
        assert path.exists()
        assert len(load(tmp_path)[1]) == 1


class TestAnyonesAgent:
    def test_the_docs_agent_is_played(self, results, shown_agent):
        _, found = load(results("RelativePose-v0"))
        mine, straight = (of(found, suite="tiny", agent=a, estimator="cascade")[0] for a in (shown_agent, "straight"))
        # Full speed, 0.3 m/s for 3 s, unless the shield holds a robot; and it turns.
        free = mine.scores["blocked"] == 0.0
        assert free.any()
        np.testing.assert_allclose(mine.scores["path"][free], 0.9, atol=0.01)
        assert not np.allclose(mine.ways[..., 2], straight.ways[..., 2], atol=0.01)

    @pytest.mark.parametrize(
        ("agent", "message"),
        [
            ("none.py:MyAgent", "Argument `agents` must lead to a class or function, but 'none.py:MyAgent' does not"),
            ("math:pi", "Argument `agents` must lead to a class or function, but 'math:pi' is float"),
            ("back-and-fort", "Unknown agent `back-and-fort`; did you mean `back-and-forth`?"),
            ("my_agent.py", "Unknown agent `my_agent.py`: say `my_agent.py:` and the name of the class in it"),
            ("policy.zip", "Unknown agent `policy.zip`: say `learned:policy.zip`"),
            (",", "Argument `agents` must name at least one"),
        ],
    )
    def test_paths_that_lead_nowhere(self, agent, message, tmp_path):
        result = call("--out", tmp_path / "out", "--agents", agent)
        assert result.exit_code == 2
        assert message in result.output
        assert not (tmp_path / "out").exists()


FAILS = """
class Fails:
    def __init__(self, task): pass
    def reset(self, n, seed): pass
    def act(self, rows):
        if FAR and rows.shape[1] == 2:
            raise RuntimeError("out of fuel")
        return 0.0 * rows[..., :2]
"""


class TestFailed:
    def test_who_failed_is_told_and_not_listed(self, tmp_path):
        path, out = tmp_path / "fails.py", tmp_path / "out"
        name = f"{path}:Fails"
        asked = Asked("relloc_env/RelativePose-v0", ("tiny",), (name, "straight"), ("cascade",), 2, "validation")
        path.write_text(FAILS.replace("FAR", "True"), "utf-8")
        told = "RuntimeError: out of fuel (fails.py, line 7)"
        with pytest.raises(ValueError, match=r"what was is kept. tiny: .*:Fails \(cascade\): " + re.escape(told)):
            benchmark(asked, out, cores=1)
        kept, found = load(out)
        assert kept.agents == ("straight",)
        assert [r.job.agent for r in found] == ["straight"]
        assert failures(out) == [Failure("tiny", name, "cascade", told)]
        lines: list[str] = []
        page = report(out, animations=False, warn=lines.append).read_text("utf-8")
        assert lines == [
            f"failed, and is not on the page: tiny: {name} (cascade): RuntimeError: out of fuel (fails.py, line 7)"
        ]
        assert "on tiny with cascade: RuntimeError: out of fuel" in page
        summary = json.loads((out / "summary.json").read_text("utf-8"))
        assert summary["failed"] == [
            {
                "suite": "tiny",
                "agent": name,
                "estimator": "cascade",
                "error": "RuntimeError: out of fuel (fails.py, line 7)",
            }
        ]
        assert (summary["jobs"], summary["done"], name in summary["command"]) == (1, 1, False)
        # Mended, it is as any other.
        path.write_text(FAILS.replace("FAR", "False"), "utf-8")
        sys.modules.pop(str(path.resolve()))
        benchmark(asked, out, cores=1)
        assert failures(out) == []
        assert set(load(out)[0].agents) == set(asked.agents)

    def test_who_failed_in_part_keeps_the_rest(self, tmp_path):
        path, out = tmp_path / "fails.py", tmp_path / "out"
        path.write_text(FAILS.replace("FAR and rows.shape[1] == 2", "rows.shape[0] == 3"), "utf-8")
        name = f"{path}:Fails"  # of three episodes, `split` has two and one side by side
        asked = Asked("relloc_env/RelativePose-v0", ("tiny", "split"), (name,), ("cascade",), 3, "validation")
        with pytest.raises(ValueError, match="out of fuel"):
            benchmark(asked, out, cores=1)
        kept, found = load(out)
        assert (kept.suites, kept.agents) == (("split",), (name,))
        assert [failure.suite for failure in failures(out)] == ["tiny"]
        assert len(found) == 1

    def test_what_cannot_be_built_is_told(self, tmp_path):
        path = tmp_path / "odd.py"
        path.write_text("class Odd:\n    def __init__(self, task): self.none.such\n", "utf-8")
        result = call("--out", tmp_path / "out", "--agents", f"{path}:Odd", "--suite", "tiny")
        assert result.exit_code == 2
        assert "Error: Argument `agents` must lead to a class that takes a task, but" in result.output
        assert "AttributeError: 'Odd' object has no attribute 'none'" in result.output


class TestAsked:
    @pytest.mark.parametrize(
        ("option", "value", "message"),
        [
            ("--suite", "open-feld", "Unknown suite `open-feld`; did you mean `open-field`?"),
            ("--estimators", "cascad", "'cascade'?"),
            ("--seeds", "tests", "Unknown set of seeds `tests`; did you mean `test`?"),
            ("--env", "relloc_env/RelativePose", "Argument `env` must be one of relloc_env/ActiveDepth-v0"),
            ("--episodes", "10001", "Argument `episodes` must be from 1 to 10000 for the seeds `test`, but is 10001"),
        ],
    )
    def test_unknown_names(self, option, value, message, tmp_path):
        result = call("--out", tmp_path / "out", option, value)
        assert result.exit_code == 2
        assert message in result.output
        # One line: there is no bar over what was never begun.
        assert result.output.startswith("Error: ")
        assert result.output.count("\n") == 1

    def test_a_folder_holds_results_of_one_kind(self, results):
        asked, _ = load(results("RelativePose-v0"))
        other = Asked(asked.env, ("far",), ("edge",), ("cascade",), EPISODES + 1, asked.seeds)
        with pytest.raises(ValueError, match="has results of episodes 8, not 9"):
            benchmark(other, results("RelativePose-v0"), cores=1)


def test_one_robot(results):
    _, found = load(results("ActiveDepth-v0"))
    for result in found:
        assert np.isnan(result.scores["position_error_end"]).all()
        assert np.isfinite(result.scores["depth_error_end"]).all()


def test_estimators_see_the_same_motion(results):
    """Scripted motion does not depend on the estimator, nor does what it tells."""
    _, found = load(results("RelativePose-v0"))
    one, other = of(found, suite="tiny", agent="circle")
    for name in ("information_end", "time_bound_pose", "path", "seen"):
        np.testing.assert_array_equal(one.scores[name], other.scores[name])
    assert not np.allclose(one.scores["position_error_end"], other.scores["position_error_end"])


def test_alignment_is_once_a_second():
    job = Job("relloc_env/RelativePose-v0", "open-field", "edge", "map-alignment", 1, "test")
    config = job.configurations()[0][0]
    assert config.estimator is not None
    stated = config.estimator.model_dump()
    assert stated["align_every"] * config.sample_period == pytest.approx(1.0)


def test_runs_alike_each_time(results):
    _, found = load(results("RelativePose-v0"))
    (kept,) = of(found, suite="split", agent="edge", estimator="cascade")
    again = run(Job(kept.job.env, "split", "edge", "cascade", EPISODES, "validation"))
    for name, values in kept.scores.items():
        np.testing.assert_array_equal(again.scores[name], values)


def test_help_shows_the_options():
    result = CliRunner().invoke(app, ["benchmark", "--help"], env={"COLUMNS": "120", "NO_COLOR": "1"})
    assert result.exit_code == 0
    for option in ("--env", "--suite", "--agents", "--estimators", "--episodes", "--seeds", "--out"):
        assert option in result.output


def test_an_agent_that_was_changed_is_played_again(tmp_path: Path) -> None:
    """Results of a file that is not what it was are not results of what it is."""
    path = tmp_path / "mine.py"
    law = "class Mine:\n    def __init__(self, task): self.task = task\n    def reset(self, n, seed): pass\n"
    law += "    def act(self, rows): return 0.0 * rows[..., :2] + {}\n"
    asked = Asked("relloc_env/ActiveDepth-v0", ("tiny",), (f"{path}:Mine",), ("cascade",), 4, "validation")
    found = []
    for speed in ("0.0", "0.0", "1.0"):
        path.write_text(law.format(speed), "utf-8")
        sys.modules.pop(str(path.resolve()), None)  # a new process would read it anew
        benchmark(asked, tmp_path / "out", cores=1)
        found.append(load(tmp_path / "out")[1][0].scores["path"])
    assert np.all(found[0] == 0.0)
    assert np.all(found[1] == 0.0)
    assert np.all(found[2] > 0.0)


def test_whoever_is_shown_the_truth_is_marked(tmp_path: Path) -> None:
    path = tmp_path / "oracle.py"
    path.write_text(
        "class Oracle:\n    knows_truth = True\n    def __init__(self, task): pass\n"
        "    def reset(self, n, seed): pass\n"
        "    def see(self, poses, points): pass\n    def act(self, rows): return 0.0 * rows[..., :2]\n",
        "utf-8",
    )
    names = (f"{path}:Oracle", "straight")
    asked = Asked("relloc_env/ActiveDepth-v0", ("tiny",), names, ("cascade",), 4, "validation")
    benchmark(asked, tmp_path / "out", cores=1)
    assert [result.knows_truth for result in load(tmp_path / "out")[1]] == [True, False]


def test_a_policy_is_left_out_of_suites_that_it_was_not_made_for(tmp_path):
    """One robot and two points: not three to six; nor two robots, which is all that the other id has."""
    words = ["--env", "relloc_env/ActiveDepth-v0", "--suite", "open-field,many-points", "--estimators", "cascade"]
    words += ["--agents", "learned:active-depth,straight", "--episodes", "4", "--cores", "1"]
    done = CliRunner().invoke(app, ["benchmark", *words, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "Left out, since `learned:active-depth` was not made for it: many-points" in done.output
    _, found = load(tmp_path / "out")
    assert {(r.job.suite, r.job.agent) for r in found} == {
        ("open-field", "learned:active-depth"), ("open-field", "straight"), ("many-points", "straight"),
    }  # fmt: skip
    words[1] = "relloc_env/RelativePose-v0"  # for which it is of no use at all
    done = CliRunner().invoke(app, ["benchmark", *words, "--out", str(tmp_path / "none")])
    assert done.exit_code == 2
    assert not (tmp_path / "none").exists()


def test_results_outlive_the_policy_that_made_them(tmp_path):
    """A file that is gone makes no result disappear."""
    for name in ("active-depth.onnx", "active-depth.json"):
        shutil.copy(POLICIES / name, tmp_path / name)
    policy = f"learned:{tmp_path / 'active-depth.onnx'}"
    asked = Asked("relloc_env/ActiveDepth-v0", ("open-field",), (policy,), ("cascade",), 2, "test")
    benchmark(asked, tmp_path / "out", cores=1)
    (tmp_path / "active-depth.onnx").unlink()
    assert [result.job.agent for result in load(tmp_path / "out")[1]] == [policy]


def test_options_of_the_environment_go_over_those_of_a_suite(tmp_path):
    """Slower robots, of which one turns back at every action; the folder is of these options alone."""
    path = tmp_path / "flips.py"
    law = "class Flips:\n    def __init__(self, task): self.sign = 1.0\n    def reset(self, n, seed): pass\n"
    law += "    def act(self, rows):\n        self.sign = -self.sign\n"
    law += "        return [self.sign, 0.25] + 0.0 * rows[..., :2]\n"
    path.write_text(law, "utf-8")
    flips = f"{path}:Flips"
    words = ["--env", "relloc_env/ActiveDepth-v0", "--suite", "tiny", "--agents", f"{flips},straight", "--estimators"]
    words += [
        "cascade",
        "--episodes",
        "3",
        "--seeds",
        "validation",
        "--cores",
        "1",
        "--out",
        str(tmp_path / "out"),
        "--set",
    ]
    done = call(*words, "robot.max_speed=0.1")
    assert done.exit_code == 0, done.output
    asked, results = load(tmp_path / "out")
    assert asked.options == ("robot.max_speed=0.1",)
    found = {result.job.agent: result.scores for result in results}
    assert found["straight"]["path"] == pytest.approx(0.1 * 12 * 0.25)
    assert found[flips]["change_speed"] == pytest.approx(2.0)
    assert np.all(found["straight"]["change_speed"] == 0.0)
    assert np.all(found[flips]["change_yaw_rate"] == 0.0)
    figures = json.loads(report(tmp_path / "out", animations=False).with_name("summary.json").read_text("utf-8"))
    assert figures["command"].endswith("--set robot.max_speed=0.1")
    assert "folder of its own" in call(*words, "robot.max_speed=0.2").output.replace("\n", " ")
    assert "which `estimators` says" in call(*words, "estimator=cascade").output.replace("\n", " ")
    assert "did you mean `max_speed`" in call(*words, "robot.max_sped=0.2").output.replace("\n", " ")
