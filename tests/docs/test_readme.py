"""Every figure of README's results has its twin in the docs; its caption says what the picture's episodes end with."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from agents.jobs import shown_in
from agents.policy import Task
from agents.registry import agent
from agents.rollout import rollout
from relloc_env.config import load_config
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.metrics import pose_errors
from relloc_env.paper.claim import Verdict
from relloc_env.paper.geometries import PAPER_TIMES

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text("utf-8")
NUMBER = re.compile(r"(?<![\w-])[+−]?\d+(?:\.\d+)?(?:e\+\d+)?")


def rows(page: str) -> Iterator[tuple[str, list[str], list[str]]]:
    """Of each row of each table: the line above the table, heads, and cells; an empty first cell is the one above."""
    above, heads, first = "", list[str](), ""
    for line in page.splitlines():
        if not line.startswith("|"):
            above, heads = line or above, []
            continue
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if not heads:
            heads, first = cells, ""
        elif not set(line) <= set("|-: "):
            first = cells[0] or first
            yield above, heads, [first, *cells[1:]]


def look(page: str, column: str, *patterns: str) -> str:
    """The cell in this column of the one row in which all patterns are found."""
    text = (ROOT / "docs" / page).read_text("utf-8")
    found = [
        cells[heads.index(column)]
        for _, heads, cells in rows(text)
        if column in heads and all(any(re.search(one, cell) for cell in cells) for one in patterns)
    ]
    assert len(found) == 1, (page, column, patterns, found)
    return found[0]


def numbers(text: str) -> list[str]:
    return NUMBER.findall(re.sub(r"\]\([^)]*\)", "]", text))


def rounded(text: str, digits: int) -> str:
    return f"{float(numbers(text)[0]):.{digits}f}"


def paper_times() -> list[str]:
    measured = look("paper.md", "measured", "`depth-times`").split("<br>")
    of = {line.rsplit(": ", 1)[0]: line.rsplit(": ", 1)[1] for line in measured}
    later = [max((of[f"{robot}, target {i} [s]"] for i in (1, 2)), key=float) for robot in "AB"]
    share = of["random geometries with the times of each robot's later target, guess too far [%]"]
    return [*later, *(f"{time:g}" for time in PAPER_TIMES), share]


def verdicts() -> list[str]:
    text = (ROOT / "docs" / "paper.md").read_text("utf-8")
    found = re.search(r"\d+ printed sentences: (.*)\.", text)
    assert found is not None
    return [re.findall(rf"{verdict} (\d+)", found[1])[0] for verdict in Verdict]


def whitened() -> list[str]:
    first, _, last = look("estimator.md", "whitened", "random, 20 % missed$").split(" / ")[:3]
    cascade = look("estimator.md", "`cascade`", "random, 20 % missed$").split(";")[0]
    return [first, "10", last, "40", cascade]


def recorded(kind: str) -> list[str]:
    found = []
    for name, digits in (("`map-alignment`", (2, 1)), ("`cascade`", (1, 0) if kind == "logged commands" else (2, 1))):
        found += [
            rounded(look("recorded-data.md", column, "set 7", kind, name), places)
            for column, places in zip(("position [m]", "heading"), digits, strict=True)
        ]
    if kind == "logged commands":
        share = numbers(look("recorded-data.md", "seconds with an estimate", "set 7", kind, "`map-alignment`"))[-1]
        found.insert(2, rounded(share, 0))
    return found


def pixels() -> list[str]:
    names = ("`cascade-critical`", "`cascade`", "`map-alignment`")
    ends, sure = (
        [numbers(look("recorded-data.md", column, "zigzag_s4", name))[k] for name in names]
        for column, k in (("depth, first → last [m]", 1), ("where sure [m]", 0))
    )
    return [*ends, *(rounded(one, 2) for one in sure)]


def motions() -> list[str]:
    told, j, bound = "`open-field`, what the motions tell", "J at the end [nats]", "pose known [s]"
    page = (ROOT / "docs" / "benchmark.md").read_text("utf-8").split("## One robot")[0]
    of = {
        cells[0]: dict(zip(heads, cells, strict=True))
        for line, heads, cells in rows(page)
        if told in line and bound in heads and "estimator" not in heads
    }
    law, script = (
        max((name for name in of if ("edge" in name) == law), key=lambda name: float(numbers(of[name][j])[0]))
        for law in (True, False)
    )
    # Only two robots have a pose to know, and only the planner's table names its estimator.
    (planner,) = (
        cells[heads.index(j)]
        for _, heads, cells in rows((ROOT / "docs" / "benchmark.md").read_text("utf-8"))
        if cells[0] == "`planner`" and {"estimator", j, bound} <= set(heads)
    )
    parts = [of["`straight`"][j], of[script][j], of[script][bound], of[law][j], of[law][bound], planner]
    return [rounded(part, 1) for part in parts]


def trained() -> list[str]:
    seeds = (1, 2, 3)
    one, two = (
        sorted(numbers(look("training.md", column, f"`{name}`, seed {seed}"))[0] for seed in seeds)
        for name, column in (
            ("active-depth", "J at the end [nats], over it"),
            ("relative-pose", "J after 10 s, over it"),
        )
    )
    many = [
        numbers(cell)[0]
        for _, heads, cells in rows((ROOT / "docs" / "training.md").read_text("utf-8").replace("\n  |", "\n|"))
        if heads[0] == "points" and "seed 2" in heads
        for cell in cells[2:]
    ]
    return [*(f"+{end}" for end in (one[0], one[-1], min(many), max(many), two[0], two[-1])), "10"]


RESULTS = {
    "the paper's experiment": paper_times,
    "the paper's 34 printed sentences": verdicts,
    "`map-alignment` in 1000": whitened,
    "real robots, MR.CLAM": lambda: recorded("logged commands"),
    "the same with motion-capture": lambda: recorded("motion capture"),
    "real pixels": pixels,
    "two robots, `RelativePose`": motions,
    "the trained policies": trained,
}


def results() -> dict[str, str]:
    return {cells[0]: cells[1] for _, heads, cells in rows(README) if heads == ["what", "result", "command"]}


def test_no_result_is_without_a_twin() -> None:
    assert [sum(what.startswith(start) for start in RESULTS) for what in results()] == [1] * len(RESULTS)


@pytest.mark.parametrize("start", RESULTS)
def test_results_are_those_of_the_docs(start: str) -> None:
    (result,) = (result for what, result in results().items() if what.startswith(start))
    assert numbers(result) == RESULTS[start]()


def test_caption_says_what_the_episodes_of_the_picture_end_with() -> None:
    caption = re.search(r"^\*From one start.*?\*$", README, re.DOTALL | re.MULTILINE)
    assert caption is not None
    said = [float(one) for one in numbers(caption[0].split("half a minute")[1])]
    ends = []
    for name in ("learned:relative-pose", "straight"):
        env = RellocParallelEnv(
            shown_in("relloc_env/RelativePose-v0", "open-field", name, "map-alignment", ()), bound=True
        )
        episode = rollout(env, agent(name)(Task.of(env)), seed=0)
        assert episode.time[-1] == pytest.approx(30.0)
        ends += (100.0 * episode.pose_error[-1, :, 0]).tolist()
    assert said == pytest.approx([max(ends[:2]), *ends[2:]], rel=0.1)


def test_errors_below_the_code_are_its_medians_over_200_seeds() -> None:
    text = README.split("`map-alignment`, is")[1].split("\n\n")[0]
    (near, turn), (far, turned) = re.findall(r"([\d.]+) c?m and ([\d.]+)° off", text)
    action = np.tile(np.array([1.0, 0.1, 1.0, -0.1], np.float32), (200, 1))
    for name, said in (("map-alignment", (0.01 * float(near), float(turn))), ("cascade", (float(far), float(turned)))):
        env = RellocVectorEnv(200, load_config(robots=2, estimator=name), autoreset_mode="Disabled", info=())
        env.reset(seed=list(range(200)))
        for _ in range(120):
            env.step(action)
        error = pose_errors(env.core.onboard.estimate, env.core.simulation.world.pose)
        found = np.median(np.hypot(error[..., 0], error[..., 1])), np.degrees(np.median(np.abs(error[..., 2])))
        assert said == pytest.approx(found, rel=0.1)


def test_words_beside_the_figure_of_filtered_depths_are_its_data() -> None:
    data = json.loads((ROOT / "docs" / "images" / "consistency.json").read_text("utf-8"))
    text = " ".join((ROOT / "docs" / "estimator.md").read_text("utf-8").split())

    def at(name: str, key: str, digits: int) -> list[str]:
        values = (data["estimators"][name][key][data["time_s"].index(time)] for time in (10.0, 40.0))
        return [f"{value:.{digits}f}" for value in values]

    (off, off_end), (sure, sure_end) = at("cascade", "rmse_position_m", 1), at("cascade", "claimed_position_m", 3)
    assert f"claims {sure} m and is {off} m off" in text
    assert f"after 40 s, {sure_end} m and {off_end} m." in text
    for digits, time, words in ((2, 0, "({} m claimed and {} m off after 10 s"), (3, 1, "{} and {} m after 40 s)")):
        claimed, found = (at("cascade-critical", key, digits)[time] for key in ("claimed_depth_m", "rmse_depth_m"))
        assert words.format(claimed, found) in text
    (off, off_end), (sure, _) = (
        at("cascade-critical", "rmse_position_m", 1),
        at("cascade-critical", "claimed_position_m", 2),
    )
    assert f"Its pose is {off} m off after 10 s and claims {sure} m" in text
    assert f"it is {off_end} m off and claims {at('cascade-critical', 'claimed_position_m', 3)[1]} m" in text
    (off, off_end), (sure, sure_end) = (at("map-alignment", f"{kind}_position_m", 3) for kind in ("rmse", "claimed"))
    assert f"{off} m after 10 s and {off_end} m after 40 s, where it claims {sure} and {sure_end} m" in text
