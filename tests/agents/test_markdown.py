"""The tables for documents: figures are those of the results, differences are of the same episodes."""

import shutil

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from agents.__main__ import app
from agents.report.markdown import KINDS, markdown
from agents.results import load, of

pytestmark = pytest.mark.usefixtures("tiny_suites")


@pytest.fixture(scope="module")
def folder(results):
    return results("RelativePose-v0")


def table(text, caption):
    """Cells by the first cell of each row, of the table below a caption."""
    lines = iter(text.splitlines())
    next(line for line in lines if caption in line)
    rows = []
    for line in lines:
        if line.startswith("|"):
            rows.append([cell.strip(" `") for cell in line.strip("|").split("|")])
        elif rows:
            break
    return {row[0]: row[1:] for row in rows[2:]}, rows[0][1:]


def test_medians_and_the_command_are_those_of_the_results(folder):
    text = markdown([folder], ["told", "suites"])
    assert "--episodes 8" in text
    found, heads = table(text, "`tiny`, what the motions tell")
    every, suites = table(text, "in every suite")
    for result in of(load(folder)[1], suite="tiny", estimator="cascade"):
        median = f"{np.median(result.scores['information_end']):.2f}".replace("-", "−")
        assert found[result.job.agent][heads.index("J at the end [nats]")].split(" [")[0] == median
        assert every[result.job.agent][suites.index("tiny")] == median


def test_differences_are_paired_by_episode(folder):
    text = markdown([folder], ["over"], over=["straight"], agents=["edge"])
    found, heads = table(text, "`tiny`, paired differences")
    results = of(load(folder)[1], suite="tiny", estimator="cascade")
    edge, straight = (of(results, agent=name)[0].scores["information_end"] for name in ("edge", "straight"))
    assert list(found) == ["edge"]
    value = float(found["edge"][heads.index("end over `straight")].split(" [")[0].replace("−", "-"))
    assert value == pytest.approx(np.mean(edge - straight), abs=0.006)


def test_estimators_stand_beside_each_other_and_ranks_are_spearmans(folder, monkeypatch):
    monkeypatch.setattr("agents.report.markdown.FEWEST", 3)
    text = markdown([folder], ["made", "ranks"])
    assert text.count("`cascade-critical`") > 3
    found, heads = table(text, "`tiny`, rank correlations")
    part = of(load(folder)[1], suite="tiny", estimator="cascade")
    error, excitation = (
        np.array([np.median(r.scores[name]) for r in part]) for name in ("depth_error_end", "excitation")
    )
    expected = stats.spearmanr(error, excitation).statistic
    value = float(found["cascade"][heads.index("depth_error_end` with `excitation")].replace("−", "-"))
    assert value == pytest.approx(expected, abs=0.006)


def test_the_command_prints_and_says_what_is_wrong(folder, tmp_path):
    done = CliRunner().invoke(app, ["tables", str(folder), "--show", "told"])
    assert done.exit_code == 0
    assert "| `straight` |" in done.stdout
    wrong = CliRunner().invoke(app, ["tables", str(folder), "--show", "tolt"])
    assert wrong.exit_code == 2
    assert all(kind in wrong.stderr for kind in KINDS)
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    asked = (other / "benchmark.json").read_text("utf-8").replace("validation", "test")
    (other / "benchmark.json").write_text(asked, "utf-8")
    with pytest.raises(ValueError, match="one set of seeds"):
        markdown([folder, other], ["told"])
