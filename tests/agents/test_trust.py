"""A stranger's files: opening them runs nothing, unless one says so."""

import contextlib
import hashlib
import json
import pickle
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

pytest.importorskip("stable_baselines3")

import numpy as np

from agents.__main__ import app as agents
from agents.alone import alone
from agents.benchmark import benchmark
from agents.jobs import Asked
from agents.learned import POLICIES, trained_with
from agents.policy import Task
from agents.registry import agent
from agents.results import ASKED
from relloc_env.__main__ import app as relloc_env
from relloc_env.config import load_config, read_file
from relloc_env.envs.centralised import RellocEnv
from relloc_env.places import UntrustedError, load
from relloc_env.wrappers import RecordLog
from train import checkpoints, plain
from train.__main__ import app as train
from train.config import TrainConfig
from train.config import load as load_run
from train.folder import CHECKPOINT, CONFIG, DONE, EVALUATION, SCRIPTS
from train.run import train as run

TINY: dict[str, Any] = {
    "name": "tiny",
    "environment": {"robots": 1, "options": {"estimator": "cascade", "max_cycles": 8}},
    "algorithm": {"name": "PPO", "n_steps": 8, "batch_size": 32, "n_epochs": 2},
    "network": {"hidden": [8]},
    "num_envs": 4,
    "steps": 64,
    "checkpoint": 32,
    "evaluation": {"every": 32, "episodes": 2, "test": 2, "scripts": ["straight"]},
    "film": "",
}


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A file of code that leaves a mark where it runs: its name as a class, and the mark."""
    mark = tmp_path / "it-ran"
    (tmp_path / "evil_code.py").write_text(
        f"from pathlib import Path\nPath({str(mark)!r}).touch()\nfrom agents.feedback import Edge as Evil\n", "utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield f"{tmp_path / 'evil_code.py'}:Evil", mark
    for name in ("evil_code", str((tmp_path / "evil_code.py").resolve())):
        sys.modules.pop(name, None)


class Marks:
    """What touches a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def call(app, *words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.parametrize("form", ["file", "module"])
@pytest.mark.parametrize(
    "options",
    [
        {"estimator": "EVIL"},
        {"estimator": {"kind": "own", "factory": "EVIL"}},
        {"camera": {"image": {"detector": "EVIL"}, "kind": "image"}},
        {"camera": [{"image": {"detector": "EVIL"}, "kind": "image"}]},
    ],
)
def test_a_configuration_names_code_on_request_alone(options, form, evil, tmp_path):
    name, mark = evil
    path = tmp_path / "config.json"
    text = json.dumps(options).replace("EVIL", name if form == "file" else "evil_code:Evil")
    path.write_text(text, "utf-8")
    with pytest.raises(UntrustedError, match=r"names code that would run, .*: say `--trust`"):
        RellocEnv(config=path)
    assert load_config(path, trust=True) == load_config(json.loads(text))
    assert not mark.exists()  # what is read does not run yet
    with pytest.raises(Exception):  # noqa: B017, PT011 - it runs now, and makes no estimator
        RellocEnv(config=path, trust=True).reset(seed=0)
    assert mark.exists()


RUNS = [
    {"evaluation": {"scripts": ["EVIL"]}},
    {"evaluation": {"scripts": ["learned:policy.zip"]}},
    {"evaluation": {"options": {"estimator": "EVIL"}}},
    {"evaluation": {"variants": [{"estimator": "EVIL"}]}},
    {"environment": {"options": {"estimator": "EVIL"}}},
    {"environment": {"stages": [{"options": {"estimator": "EVIL"}}]}},
    {"environment": {"stages": [{"vary": {"estimator": {"choices": ["EVIL"]}}}]}},
    {"search": {"environment.options.estimator": {"choices": ["EVIL", "cascade"]}}},
]


@pytest.mark.parametrize("changes", RUNS)
def test_a_runs_configuration_names_code_on_request_alone(changes, evil, tmp_path):
    name, mark = evil
    out = tmp_path / "run"
    out.mkdir()
    path = out / CONFIG
    text = json.dumps({**TINY, **changes}).replace("EVIL", name)
    path.write_text(text, "utf-8")
    for words in (["run", path, "--out", tmp_path / "other"], ["export", out], ["tune", path, "--out", tmp_path / "t"]):
        told = call(train, *words)
        assert told.exit_code == 2
        assert "say `--trust`" in told.output
    call(train, "curves", out)
    assert not mark.exists()


def test_learned_policies_are_no_code(tmp_path):
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps({**TINY, "evaluation": {**TINY["evaluation"], "scripts": ["learned:many"]}}), "utf-8")
    assert load_run(path).evaluation.scripts == ("learned:many",)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "run"
    run(load_run(TINY), folder)
    return folder


@pytest.mark.parametrize("where", ["whole", "inside"])
def test_a_pickled_checkpoint_is_damaged(where, trained, tmp_path):
    mark, out = tmp_path / "it-ran", tmp_path / "run"
    shutil.copytree(trained, out)
    (out / DONE).unlink()
    if where == "whole":
        (out / CHECKPOINT).write_bytes(pickle.dumps(Marks(mark)))
    else:
        np.savez(out / CHECKPOINT, tree=np.array([Marks(mark)], dtype=object), allow_pickle=True)
    for words in (["export", out], ["run", out / CONFIG, "--out", out]):
        told = call(train, *words)
        assert told.exit_code == 2
        assert "is damaged" in told.output
    assert not mark.exists()


def test_a_checkpoint_names_no_code_that_its_run_does_not(evil, trained, tmp_path):
    name, mark = evil
    out = tmp_path / "run"
    shutil.copytree(trained, out)
    (out / DONE).unlink()
    state = checkpoints.read(out / CHECKPOINT)
    checkpoints.write(out / CHECKPOINT, {**state, "seconds": {"config": {"estimator": name}}})
    told = call(train, "export", out)
    assert told.exit_code == 2
    assert "names code that would run" in told.output
    assert not mark.exists()
    checkpoints.read(out / CHECKPOINT, {name})


def test_a_checkpoint_of_objects_is_not_written(tmp_path):
    for value in (object(), {"a": [Marks(tmp_path)]}, np.array([None])):
        with pytest.raises(TypeError, match="Argument `state` must hold"):
            plain.write(tmp_path / "state.npz", value)
    assert list(tmp_path.iterdir()) == []


def test_a_replay_runs_nothing_that_its_log_names(evil, tmp_path):
    name, mark = evil
    with contextlib.closing(RecordLog(RellocEnv(max_cycles=4, estimator="cascade"), tmp_path / "logs")) as env:
        env.reset(seed=3)
        for _ in range(4):
            env.step(np.array([1.0, 0.1, 1.0, -0.1], np.float32))
    header = next((tmp_path / "logs").glob("*/*.json"))
    data = json.loads(header.read_text("utf-8"))
    data["configuration"]["estimator"] = {"kind": "own", "factory": name}
    data["configuration"]["camera"] = [
        {**each, "image": {"detector": name}} for each in data["configuration"]["camera"]
    ]
    header.write_text(json.dumps(data), "utf-8")
    told = call(relloc_env, "replay", header.parent, "--estimator", "cascade", "--out", tmp_path / "replay")
    assert told.exit_code == 0, told.output
    assert not mark.exists()


@pytest.mark.parametrize("name", [SCRIPTS, DONE, EVALUATION, CHECKPOINT])
@pytest.mark.parametrize("text", ["", "[]", "nothing\n", "[" * 100_000 + "\n"])
def test_damaged_files_of_a_run_are_one_line_or_made_again(name, text, trained, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(trained, out)
    if name != DONE:
        (out / DONE).unlink()
    (out / name).write_text(text, "utf-8")
    told = call(train, "run", out / CONFIG, "--out", out)
    if told.exit_code:
        assert told.exit_code == 2
        assert "damaged" in told.output
        assert name in told.output.replace("\n", "")
    else:
        assert name in (SCRIPTS, EVALUATION)  # an empty journal is one


def test_two_runs_or_searches_do_not_work_on_one_folder(tmp_path):
    with alone(tmp_path):
        path = tmp_path / "run.yaml"
        path.write_text(json.dumps({**TINY, "search": {"algorithm.gamma": {"choices": [0.9, 0.99]}}}), "utf-8")
        for command in ("run", "tune"):
            told = call(train, command, path, "--out", tmp_path)
            assert told.exit_code == 2
            assert "is in use" in told.output
    assert sorted(each.name for each in tmp_path.iterdir()) == [".lock", "run.yaml"]


class TestReport:
    @pytest.fixture
    def folder(self, evil, tmp_path):
        """Results of an agent by the name of code that was harmless when it was played."""
        name, mark = evil
        asked = Asked("relloc_env/ActiveDepth-v0", ("open-field",), (name, "straight"), ("cascade",), 1, "validation")
        benchmark(asked, tmp_path / "out", cores=1)
        sys.modules.pop(str((tmp_path / "evil_code.py").resolve()))
        mark.unlink()
        return tmp_path / "out", mark

    def test_a_report_reads(self, folder):
        out, mark = folder
        told = call(agents, "report", out)
        assert told.exit_code == 0, told.output
        assert "no film of" in told.output
        assert "--trust" in told.output
        assert not mark.exists()
        assert call(agents, "tables", out).exit_code == 0
        assert not mark.exists()

    def test_and_films_all_on_request(self, folder):
        out, mark = folder
        told = call(agents, "report", out, "--trust")
        assert told.exit_code == 0, told.output
        assert "no film of" not in told.output
        assert mark.exists()

    @pytest.mark.parametrize(
        ("key", "value"),
        [("estimators", ["EVIL"]), ("options", ["camera.kind=image", "camera.image.detector=EVIL"])],
    )
    def test_nor_does_it_run_estimators_and_detectors(self, key, value, folder, tmp_path):
        out, mark = folder
        asked = json.loads((out / ASKED).read_text("utf-8"))
        asked[key] = [text.replace("EVIL", f"{tmp_path / 'evil_code.py'}:Evil") for text in value]
        (out / ASKED).write_text(json.dumps(asked), "utf-8")
        for result in out.glob("*.npz"):
            shutil.copy(result, out / "kept")
        call(agents, "report", out)
        assert not mark.exists()


@pytest.mark.parametrize(
    ("app", "words"),
    [(agents, ["benchmark", "--out", "OUT", "--agents"]), (agents, ["film", "--out", "OUT", "--motion"]),
     (train, ["evaluate", "--out", "OUT"])],
)  # fmt: skip
def test_pickled_policies_are_read_on_request_alone(app, words, tmp_path):
    mark, path = tmp_path / "it-ran", tmp_path / "policy.zip"
    path.write_bytes(pickle.dumps(Marks(mark)))
    name = str(path) if app is train else f"learned:{path}"
    told = call(app, *(word.replace("OUT", str(tmp_path / "out.gif")) for word in words), name)
    assert told.exit_code == 2
    assert "say `--trust`" in told.output
    assert not mark.exists()


@pytest.mark.parametrize("kind", ["EVIL", ["EVIL"], None, 3, {"EVIL": 1}])
def test_a_card_names_no_code(kind, evil, tmp_path):
    """As the estimator that a policy was trained with, which is the default of an evaluation."""
    name, mark = evil
    for suffix in ("onnx", "json"):
        shutil.copy(POLICIES / f"active-depth.{suffix}", tmp_path / f"p.{suffix}")
    card = json.loads((tmp_path / "p.json").read_text("utf-8"))
    card["environments"][0]["estimator"] = {"kind": json.loads(json.dumps(kind).replace("EVIL", name))}
    (tmp_path / "p.json").write_text(json.dumps(card), "utf-8")
    assert trained_with(str(tmp_path / "p.onnx")) == (1, "map-alignment")
    assert not mark.exists()


@pytest.mark.parametrize("change", ["network", "digest", "none", "other"])
def test_a_policy_is_the_one_that_its_card_belongs_to(change, tmp_path):
    path = tmp_path / "p.onnx"
    for suffix in ("onnx", "json"):
        shutil.copy(POLICIES / f"active-depth.{suffix}", path.with_suffix(f".{suffix}"))
    task = Task.of(load_config(robots=1))
    agent(f"learned:{path}")(task)
    card = json.loads(path.with_suffix(".json").read_text("utf-8"))
    if change == "network":
        path.write_bytes(path.read_bytes()[:-1] + b"\0")
    elif change == "other":
        shutil.copy(POLICIES / "many.onnx", path)
    else:
        card |= {"sha256": "0" * 64 if change == "digest" else None}
        path.with_suffix(".json").write_text(json.dumps(card), "utf-8")
    with pytest.raises(ValueError, match=r"p\.onnx is not the file that its card p\.json belongs to"):
        agent(f"learned:{path}")(task)


@pytest.mark.parametrize("path", sorted(POLICIES.glob("*.onnx")), ids=lambda path: path.stem)
def test_policies_that_ship_have_their_digest(path):
    assert (
        json.loads(path.with_suffix(".json").read_text("utf-8"))["sha256"]
        == hashlib.sha256(path.read_bytes()).hexdigest()
    )


@pytest.mark.parametrize(
    "text", ["evil_code.py:", "evil-code:Evil", "evil_code:Ev-il", "evil code:Evil", ":Evil", "evil_code"]
)
def test_nothing_of_another_form_is_imported(text, evil):
    with pytest.raises(ValueError, match="must lead to a class or function, as"):
        load(text)
    assert not evil[1].exists()


def test_trust_in_python_is_the_same_word(evil, tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text(f"estimator: {evil[0]}\n", "utf-8")
    with pytest.raises(UntrustedError):
        read_file(path)
    assert read_file(path, trust=True) == {"estimator": evil[0]}
    assert isinstance(load_run(TINY), TrainConfig)
