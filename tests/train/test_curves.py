"""Curves and table of runs, from folders written by hand."""

import json

import pytest
from typer.testing import CliRunner

from train.__main__ import app
from train.config import load
from train.folder import claim


@pytest.fixture
def runs(tmp_path):
    """Two seeds of one configuration, with three evaluations each."""
    for seed, last in ((1, 2.5), (2, 3.0)):
        out = tmp_path / f"active-depth-{seed}"
        claim(load("active-depth", [f"seed={seed}"]), out)
        lines = [
            {"steps": steps, "score": score, "script": "edge", "script_score": 2.0}
            for steps, score in ((0, -2.0), (1000, 1.5), (2000, last))
        ]
        (out / "evaluation.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
        value = {name: {"value": last, "low": last - 0.1, "high": last + 0.1} for name in
                 ("information_end", "information_10s", "information_mean")}  # fmt: skip
        card = {"observation": {}, "metrics": {"script": "edge", "scores": value, "over_script": value}}
        (out / "policy.json").write_text(json.dumps(card), encoding="utf-8")
    return [tmp_path / "active-depth-1", tmp_path / "active-depth-2"]


def test_a_picture_and_a_row_for_each_run(runs, tmp_path):
    out = tmp_path / "pictures" / "curves.svg"
    done = CliRunner().invoke(app, ["curves", *map(str, runs), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "<svg" in out.read_text("utf-8")
    assert "| `active-depth-2` | 3.00 [2.90, 3.10] |" in done.output
    assert "2.50 [2.40, 2.60]" in done.output


def test_a_folder_that_is_none_is_told(tmp_path, runs):
    (runs[1] / "evaluation.jsonl").unlink()
    done = CliRunner().invoke(app, ["curves", *map(str, runs), "--out", str(tmp_path / "a.svg")])
    assert done.exit_code == 2
    assert "active-depth-2 is none" in done.output.replace("\n", "")


@pytest.mark.parametrize(
    ("metrics", "row"),
    [
        ({}, "| - | - | - | - | - | - | - |"),
        ({"scores": {"information_end": {"value": 2.0, "low": 1.5, "high": 2.5}}},
         "| 2.00 [1.50, 2.50] | - | - | - | - | - | - |"),
        ({"script": "edge", "scores": {"information_end": {"value": 2.0, "low": None, "high": None},
                                       "information_10s": {"value": None, "low": None, "high": None}},
          "over_script": {}}, "| 2.00 | - | - | `edge` | - | - | - |"),
    ],
    ids=["no test episodes", "no scripts", "never"],
)  # fmt: skip
def test_runs_without_scripts_and_with_scores_that_never_were(runs, tmp_path, metrics, row):
    run, out = runs[0], tmp_path / "a.svg"
    scores = [-1.0, None, None] if metrics else [None, None, None]
    lines = [{"steps": k, "score": score, "script": "", "script_score": None} for k, score in enumerate(scores)]
    (run / "evaluation.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    (run / "policy.json").write_text(json.dumps({"observation": {}, "metrics": metrics}), encoding="utf-8")
    done = CliRunner().invoke(app, ["curves", str(run), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert f"| `active-depth-1` {row}" in done.output
    assert "<svg" in out.read_text("utf-8")
