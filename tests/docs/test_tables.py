"""The site's tables, which are read off the code, hold what the environments are."""

import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import relloc_env
from docs._extensions import tables
from docs._extensions.from_root import PAGES, ROOT, text_of
from docs._extensions.options import describe
from relloc_env.config import EnvConfig

IDS = [name for name in gym.registry if name.startswith("relloc_env/")]


def rows(markdown: str) -> list[list[str]]:
    """Cells of a table without its heads."""
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in markdown.splitlines()[2:]]


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("kind", ["", "bare"])
def test_every_entry_of_an_observation_is_in_one_row(name: str, kind: str) -> None:
    env: Any = gym.make(name, estimator=None) if kind else gym.make(name)
    robots = env.unwrapped.config.robots
    told = [place for row in rows(tables.observation(name, kind)) for place in row[1 : 1 + robots]]
    entries: list[int] = []
    for place in told:
        first, _, last = place.replace("\u2060", "").partition("–")
        entries += range(int(first), int(last or first) + 1)
    assert sorted(entries) == list(range(env.observation_space.shape[0]))


@pytest.mark.parametrize("name", IDS)
def test_bounds_of_an_observation_are_those_of_its_space(name: str) -> None:
    env: Any = gym.make(name)
    for row in rows(tables.observation(name)):
        field = row[0].strip("`")
        key = field if env.unwrapped.config.robots == 1 else f"robot_a/{field}"
        place, (low, high) = env.unwrapped.field_slices[key], row[-3:-1]
        assert np.all(env.observation_space.low[place] == float(low.replace("−", "-")))
        assert np.all(env.observation_space.high[place] == float(high))


@pytest.mark.parametrize("name", IDS)
def test_an_id_has_a_page_a_row_per_action_and_its_reward(name: str) -> None:
    page = re.sub(r"(?<!^)(?=[A-Z])", "_", name.split("/")[1].partition("-")[0]).lower()
    assert name in (ROOT / "docs" / "environments" / f"{page}.md").read_text("utf-8")
    env: Any = gym.make(name)
    assert len(rows(tables.actions(name))) == env.action_space.shape[0]
    weights = {row[0].strip("`"): float(row[1]) for row in rows(tables.rewards(name)) if row[1]}
    assert weights == env.unwrapped.config.reward_weights


def test_a_table_that_only_the_site_has_says_so_in_the_source() -> None:
    inside = [
        block.splitlines()[1:]
        for page in (ROOT / "docs").rglob("*.md")
        for block in page.read_text("utf-8").split("```")[1::2]
        if block.startswith("{from-code}")
    ]
    assert len(inside) > 10
    assert {tuple(lines) for lines in inside} == {("(made from the code: see the built site, `make docs`)",)}


def test_every_option_stands_in_the_tables_with_its_meaning() -> None:
    told = {row[0].strip("`") for row in rows(tables.arguments())}
    assert told | {"robots"} == set(EnvConfig.model_fields)
    text = tables.configuration()
    for part in ("RobotConfig", "CameraConfig", "MapAlignmentConfig"):
        assert f"## {part}" in text
    assert "| `mount_height` | float ≥ 0.001 and ≤ 100000 | `0.3` | [m] of the camera above the floor. |" in text


def test_types_and_ranges_in_words() -> None:
    field = EnvConfig.model_fields["samples_per_action"]
    assert describe(field.annotation, field.metadata) == "int ≥ 1 and ≤ 1000"
    assert describe(float | None) == "float or None"
    assert describe(tuple[float, float]) == "(float, float)"


def test_citation_has_both_works() -> None:
    text = tables.citation()
    assert f"version = {{{relloc_env.__version__}}}" in text
    assert "A Framework for Depth Estimation and Relative Localization" in text


@pytest.mark.parametrize("page", PAGES)
def test_links_of_pages_from_the_root_lead_somewhere(page: str) -> None:
    text = text_of(page)
    assert text.startswith("# ")
    targets = [t for t in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text) if "://" not in t]
    assert [t for t in targets if not (ROOT / "docs" / t).exists()] == []
