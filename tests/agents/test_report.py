import base64
import html
import io
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy import stats
from typer.testing import CliRunner

from agents.__main__ import app
from agents.benchmark import benchmark
from agents.jobs import Asked
from agents.registry import SCRIPTED
from agents.report import cells, figures, report
from agents.report.films import film
from agents.report.summary import NEVER, summarise
from agents.results import load, of
from relloc_env import numerals
from tests.agents.conftest import tiny

pytestmark = pytest.mark.usefixtures("tiny_suites")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PROBE = """
<script>
for (const part of document.querySelectorAll("details")) part.open = true;
const shown = (what) => [...document.querySelectorAll(what)].filter((e) => e.getClientRects().length).length;
const found = { window: innerWidth, page: document.documentElement.scrollWidth, boxes: [], errors: 0 };
for (const e of document.querySelectorAll("main *")) {
  const box = e.closest(".box"), right = e.getBoundingClientRect().right;
  if (!box && right > innerWidth + 1 && !e.closest("svg")) found.boxes.push(e.tagName + "." + e.className);
}
found.first = [shown(".e0"), shown(".e1"), shown("figure.pick"), shown("g.pick")];
document.querySelector(".bar input[type=checkbox]").click();
found.fewer = [shown("figure.pick"), shown("g.pick")];
document.querySelector("#e1").click();
found.second = [shown(".e0"), shown(".e1")];
parent.postMessage(JSON.stringify(found), "*");
</script>
"""
FRAME = """<!doctype html><script>onmessage = (e) => (document.documentElement.dataset.found = e.data);</script>
<iframe src="probed.html" style="width: WIDTHpx; height: 900px; border: 0"></iframe>"""


@pytest.fixture(scope="module")
def pages(results):
    """Folder of each id, with its page and summary."""
    made = {}
    for env in ("RelativePose-v0", "ActiveDepth-v0"):
        folder = results(env)
        with tiny():
            report(folder, animations=False)
        made[env] = folder, json.loads((folder / "summary.json").read_text("utf-8"))
    return made


@pytest.fixture(scope="module")
def pose(pages):
    return pages["RelativePose-v0"]


def number(value):
    """As JSON says it: infinity and NaN have names."""
    return NEVER if np.isinf(value) else None if np.isnan(value) else pytest.approx(value, rel=1e-12, abs=1e-12)


def figures_of(summary):
    """(file's parts, agent, its figures) of all that a summary holds."""
    for suite, about in summary["suites"].items():
        for estimator, part in about["estimators"].items():
            for agent, one in part["agents"].items():
                yield (suite, estimator), agent, one["figures"], part


@pytest.mark.parametrize("env", ["RelativePose-v0", "ActiveDepth-v0"])
def test_figures_are_those_of_the_files(env, pages):
    """Recomputed with NumPy from the arrays alone."""
    folder, summary = pages[env]
    arrays = {}
    for path in folder.glob("*.npz"):
        with np.load(path) as data:
            job = json.loads(str(data["job"]))
            arrays[(job["suite"], job["estimator"]), job["agent"]] = {
                name[len("score/") :]: data[name] for name in data.files if name.startswith("score/")
            }
    compared = 0
    for where, agent, found, part in figures_of(summary):
        scores = arrays[where, agent]
        for key, figure in found.items():
            if key.endswith("_difference"):
                score = key.removesuffix("_difference")
                scripted = [arrays[where, a][score] for a in part["agents"] if a in SCRIPTED]
                expected = np.mean(scores[score] - max(scripted, key=np.mean))
            elif key.endswith("_mean") and key not in scores:
                expected = np.mean(scores[key.removesuffix("_mean")])
            elif key.endswith("_rms"):
                expected = np.sqrt(np.mean(scores[key.removesuffix("_rms")] ** 2))
            elif key.endswith("_inside"):
                low, high = (stats.chi2.ppf(tail, 3) for tail in (0.025, 0.975))
                expected = np.mean((scores["nees"] >= low) & (scores["nees"] <= high))
            else:
                expected = np.median(scores[key])
            assert figure["value"] == number(expected), (where, agent, key)
            if key.startswith("time_"):
                assert figure["share"] == np.mean(np.isfinite(scores[key]))
            if "low" in figure and NEVER not in figure.values():
                assert figure["low"] <= figure["value"] <= figure["high"]
            compared += 1
    assert compared == 16 * (27 if env == "RelativePose-v0" else 17)


@pytest.mark.parametrize("env", ["RelativePose-v0", "ActiveDepth-v0"])
def test_every_key_has_its_column_on_the_page(env, pages):
    folder, summary = pages[env]
    page = html.unescape((folder / "report.html").read_text("utf-8"))
    for _, _, found, _ in figures_of(summary):
        assert summary["columns"].keys() == {key for key in found if not key.endswith("_difference")}
    for key, column in summary["columns"].items():
        assert f"<dt>{column['head']}</dt><dd>{column['about']} (<code>{key}</code>" in page
        assert re.search(rf'<th scope="col"[^>]*>{re.escape(column["head"])}[<(]', page)


def test_best_first_and_against_the_best_scripted(pose):
    _, summary = pose
    for part in (p for suite in summary["suites"].values() for p in suite["estimators"].values()):
        ends = [one["figures"]["information_end"]["value"] for one in part["agents"].values()]
        assert ends == sorted(ends, reverse=True)
        reference = part["references"]["information_end"]
        assert reference in SCRIPTED
        assert part["agents"][reference]["figures"]["information_end_difference"]["value"] == 0.0


def test_band_of_the_mean_nees(pose):
    low, high = pose[1]["nees_band_of_the_mean"]
    assert stats.chi2.cdf((8 * low, 8 * high), 24) == pytest.approx((0.025, 0.975))


def test_page_says_what_the_summary_says(pose):
    folder, summary = pose
    page = (folder / "report.html").read_text("utf-8")
    part = summary["suites"]["tiny"]["estimators"]["cascade"]
    body = page[page.index("What the motion tells") :]
    for agent, one in part["agents"].items():
        row = re.search(rf'<tr><th scope="row" title="{re.escape(html.escape(agent))}">.*?</tr>', body, re.DOTALL)
        assert row is not None
        text = re.sub(r"<[^>]*>", " ", row[0])
        figure = one["figures"]["information_end"]
        for value in figure.values():
            assert f"{value:.2f}".replace("-", "−") in text
    assert summary["command"] in html.unescape(page)


def test_page_stands_alone(pose):
    page = (pose[0] / "report.html").read_text("utf-8")
    places = re.findall(r"(?:src|href)=\"([^\"]*)\"|url\(([^)]*)\)|@import", page)
    assert places
    assert [one or two for one, two in places if not (one or two).startswith(("#", "data:"))] == []
    assert "nan" not in re.sub(r"<[^>]*>", " ", page[page.index("<main>") :]).lower().split()


def test_names_are_escaped(tmp_path):
    """Names of files come from outside."""
    own = tmp_path / "<b>&.py"
    own.write_text("from agents.feedback import Edge\n", "utf-8")
    asked = Asked("relloc_env/RelativePose-v0", ("tiny",), (f"{own}:Edge",), ("cascade",), 2, "validation")
    benchmark(asked, tmp_path / "out", cores=1)
    page = report(tmp_path / "out", animations=False).read_text("utf-8")
    assert "<b>&.py" not in page
    assert "&lt;b&gt;&amp;.py" in page
    # Nobody to be held against.
    assert "Δ end" not in page


def test_part_of_a_benchmark_has_its_page_too(tmp_path, results):
    full, part = results("RelativePose-v0"), ("tiny--edge", "split--circle", "tiny--circle")
    for name in ("benchmark.json", *(f"{one}--cascade.npz" for one in part)):
        shutil.copy(full / name, tmp_path)
    page = report(tmp_path, animations=False).read_text("utf-8")
    assert "3 of 16 results are there" in page


def test_order_is_over_what_all_have(results):
    """`edge` has the least in `tiny` and the most in `split`, where `circle` is not: they are compared in `tiny`."""
    folder = results("RelativePose-v0")
    asked, found = load(folder)
    ends = {("tiny", "edge"): 1.0, ("tiny", "circle"): 2.0, ("split", "edge"): 9.0, ("tiny", "straight"): 1.5}
    some = [
        replace(r, scores=r.scores | {"information_end": np.full(8, ends[r.job.suite, r.job.agent])})
        for r in of(found, estimator="cascade")
        if (r.job.suite, r.job.agent) in ends
    ]
    summary = summarise(asked, some, [], folder)
    assert summary["ranking"] == ["circle", "straight", "edge"]
    assert summary["ranking_over"] == [{"suite": "tiny", "estimator": "cascade"}]
    assert summary["parts"] == 2
    # Where nothing is common, each has the mean of its own.
    apart = summarise(asked, [r for r in some if r.job.suite != "tiny" or r.job.agent != "edge"], [], folder)
    assert apart["ranking"] == ["edge", "circle", "straight"]
    assert apart["ranking_over"] == []


def test_films_that_cannot_be_drawn_are_told(tmp_path):
    own = tmp_path / "gone.py"
    own.write_text("from agents.feedback import Edge\n", "utf-8")
    name = f"{own}:Edge"
    asked = Asked("relloc_env/RelativePose-v0", ("tiny",), (name, "straight"), ("cascade",), 2, "validation")
    benchmark(asked, tmp_path / "out", cores=1)
    own.unlink()
    sys.modules.pop(str(own.resolve()))
    lines: list[str] = []
    page = report(tmp_path / "out", warn=lines.append).read_text("utf-8")
    assert len(lines) == 1
    assert lines[0].startswith(f"no film of {name}: ValueError: Argument `agents` must lead to a class or function")
    assert html.escape(f"No film of {name}: ValueError: Argument `agents`", quote=False) in html.unescape(page)
    assert page.count("data:image/webp") == 1


def test_film_is_a_moving_picture(results):
    _, found = load(results("RelativePose-v0"))
    head, _, data = film(of(found, suite="tiny", agent="edge")[0].job).partition(",")
    assert head == "data:image/webp;base64"
    with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
        assert (picture.width, picture.height) == (480, 270)
        # Twelve actions: every second instant from the first to the last.
        assert picture.n_frames == 7


def test_curves_are_the_medians(results):
    """The line of an agent in the picture, back in nats."""
    _, found = load(results("RelativePose-v0"))
    (result,) = of(found, suite="tiny", agent="circle", estimator="cascade")
    svg = dict(figures.panels([result], {"circle": 0}, "x"))["Information J [nats]"]
    line = re.search(r'<g class="a a0 line"><path d="([^"]*)"', svg)
    assert line is not None
    drawn = -np.array([float(y) for _, y in re.findall(r"[ML] ([\d.]+) ([\d.]+)", line[1])])
    median = result.curves["information"][1]
    # Lines are simplified: ends and range are kept.
    scale = (drawn.max() - drawn.min()) / (median.max() - median.min())
    assert drawn[-1] - drawn[0] == pytest.approx(scale * (median[-1] - median[0]), abs=0.2)


def test_numbers():
    assert [numerals.number(v, 2) for v in (1.234, -0.5, 123.4, 25200.0, np.inf, np.nan)] == [
        "1.23", "−0.50", "123", "3e4", "never", "–",
    ]  # fmt: skip
    assert numerals.number(0.5, 2, sign=True) == "+0.50"


def test_censored_times_are_told(results):
    asked, found = load(results("RelativePose-v0"))
    late = np.array([1.0, 2.0, 3.0, np.inf, np.inf, np.inf, np.inf, np.inf])
    results_ = [replace(r, scores=r.scores | {"time_pose": late, "time_bound_pose": late}) for r in found]
    part = summarise(asked, results_, [], results("RelativePose-v0"))["suites"]["tiny"]["estimators"]["cascade"]
    (told, made, _) = cells.tables(part, (2.0, 4.0), 2)
    for table, head in ((told, "pose known"), (made, "pose found")):
        k = [one.text for one in table.heads].index(head)
        assert {row[k].text for row in table.rows.values()} == {"never"}
        assert all(row[k].note.endswith("–never · 38 %") for row in table.rows.values())


class TestCommand:
    def test_folder_without_results(self, tmp_path):
        result = CliRunner().invoke(app, ["report", str(tmp_path)])
        assert result.exit_code == 2
        message = f"Argument `out` must be a folder of `benchmark`, but {tmp_path} has no benchmark.json"
        assert result.output.strip().endswith(f"Error: {message}")

    def test_writes_the_page(self, pose):
        folder, _ = pose
        before = (folder / "report.html").read_bytes()
        result = CliRunner().invoke(app, ["report", str(folder), "--no-animations"])
        assert result.exit_code == 0
        assert f"Page: {folder / 'report.html'}" in result.output
        assert (folder / "report.html").read_bytes() == before


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
@pytest.mark.parametrize("env", ["RelativePose-v0", "ActiveDepth-v0"])
@pytest.mark.parametrize("width", [390, 1280])
def test_page_fits_the_window(width, env, pages, tmp_path):
    """Only the boxes around tables are wider than the window; what is chosen is shown."""
    page = (pages[env][0] / "report.html").read_text("utf-8")
    (tmp_path / "probed.html").write_text(page.replace("</body>", PROBE + "</body>"), "utf-8")
    # A window is at least 500 px wide, a frame in it is not.
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME.replace("WIDTH", str(width)), "utf-8")
    assert CHROMIUM is not None
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
        "--disable-component-update", "--disable-sync", f"--user-data-dir={tmp_path / 'browser'}",
        "--window-size=1400,900", "--virtual-time-budget=10000", "--dump-dom", frame.as_uri(),
    ]  # fmt: skip
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    probe = re.search(r'data-found="([^"]*)"', output)
    assert probe is not None
    found = json.loads(html.unescape(probe[1]))
    assert found["window"] == width
    assert found["page"] <= width
    assert found["boxes"] == []
    one, other, figures_shown, parts_shown = found["first"]
    assert one > 0
    assert other == 0
    assert figures_shown > 0
    assert all(0 < now < before for now, before in zip(found["fewer"], (figures_shown, parts_shown), strict=True))
    assert found["second"][0] == 0
    assert found["second"][1] > 0
