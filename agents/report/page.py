"""The page: everything together, and the file it is written to."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.jobs import Asked
from agents.playing import DEPTH_SHARE, POSE
from agents.registry import group, short
from agents.report import cells, columns, figures
from agents.report.films import film
from agents.report.maps import maps
from agents.report.summary import plain, summarise
from agents.results import Result, failures, load, of
from relloc_env.extras import extra
from relloc_env.files import write_json, write_whole
from relloc_env.metrics import chi2_quantile

with extra("agents"):
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup


CHOSEN = 3
"""Agents that are chosen at first: the best ones, and the best of those that move by the clock."""
COSTLY = 1.0
"""[ms] from which an action's cost is told apart from those of agents that cost next to nothing."""

Tell = Callable[[str, float], None]
"""Called with what is being done, and the part of all the work that is done."""
Warn = Callable[[str], None]
"""Called with a line about what is amiss."""


def report(
    out: Path,
    *,
    animations: bool = True,
    trust: bool = False,
    tell: Tell = lambda *_: None,
    warn: Warn = lambda _: None,
) -> Path:
    """Write `report.html` and `summary.json` into a folder of results; return the page's place.

    Args:
        out: folder that `agents.benchmark.benchmark` has filled.
        animations: whether each agent's first episode is drawn, which takes some seconds each.
        trust: whether those are drawn too for which code runs that the folder names: agents, estimators and detectors
            that are not the project's, pickled policies.
        tell: told what is being done.
        warn: called with each job of the benchmark that has failed, each damaged result, each film that is not drawn.

    Raises:
        ValueError: a folder without results.
    """
    asked, results = load(out, warn)
    failed = failures(out)
    if not results:
        what = f"; failed: {'; '.join(map(str, failed))}" if failed else " yet"
        raise ValueError(f"Argument `out` must be a folder of results, but {out} has none{what}")
    for failure in failed:
        warn(f"failed, and is not on the page: {failure}")
    tell("tables", 0.0)
    summary = summarise(asked, results, failed, out)
    write_json(out / "summary.json", plain(summary), allow_nan=False)
    places = {name: k for k, name in enumerate(summary["ranking"])}
    suites = []
    for k, name in enumerate(summary["suites"]):
        tell(f"figures: {name}", 0.1 + 0.5 * k / len(summary["suites"]))
        suites.append(_suite(name, summary, of(results, suite=name), places))
    films: dict[str, str] = {}
    unfilmed: dict[str, str] = {}
    for k, name in enumerate(places if animations else ()):
        tell(f"film: {name}", 0.6 + 0.4 * k / len(places))
        try:
            films[name] = film(_filmed(asked, results, name).job, trust=trust)
        except Exception as error:  # noqa: BLE001 - anyone's agent may raise anything, or be there no more
            unfilmed[name] = f"{type(error).__name__}: {error}"
            warn(f"no film of {name}: {unfilmed[name]}")
    oracles = {result.job.agent for result in results if result.knows_truth}
    page = _environment().get_template("page.html.j2").render(
        **_about(asked, summary, places, oracles), suites=suites, films=films, unfilmed=unfilmed,
        film_of=_film_of(asked, results, films),
    )  # fmt: skip
    place = out / "report.html"
    write_whole(place, page)
    tell("", 1.0)
    return place


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["short"] = short
    return environment


def _about(asked: Asked, summary: Mapping[str, Any], places: Mapping[str, int], oracles: set[str]) -> dict[str, Any]:
    """What the head of the page says."""
    scripted = next((name for name in places if group(name) == "scripted"), None)
    chosen = [*list(places)[:CHOSEN], *([scripted] if scripted else [])]
    return {
        "summary": summary,
        "task": asked.env.rpartition("/")[2],
        "agents": [_agent(name, place, name in chosen, name in oracles) for name, place in places.items()],
        "estimators": [e for e in asked.estimators if any(e in s["estimators"] for s in summary["suites"].values())],
        "overview": _overview(summary),
        "costs": _costs(summary),
        "costly": COSTLY,
        "pose": POSE,
        "depth": DEPTH_SHARE,
        "single_band": [chi2_quantile(tail, columns.POSE_SIZE) for tail in (0.025, 0.975)],
    }


def _agent(name: str, place: int, chosen: bool, oracle: bool) -> dict[str, Any]:
    title = group(name) + (", knows the truth" if oracle else "")
    dashed, colour = figures.dash(place) != "-", place % figures.REPEAT
    return {"name": name, "k": place, "colour": colour, "dashed": dashed, "chosen": chosen, "group": title}


def _suite(
    name: str, summary: Mapping[str, Any], results: Sequence[Result], places: Mapping[str, int]
) -> dict[str, Any]:
    """Tables and figures of one suite."""
    about, robots = summary["suites"][name], summary["robots"]
    score, title = (
        ("time_bound_pose", "Time until the pose is known, and way") if robots > 1
        else ("time_bound_depth", "Time until the depths are known, and way")
    )  # fmt: skip
    parts = []
    for estimator, part in about["estimators"].items():
        within = of(results, estimator=estimator)
        drawn = figures.panels(within, places, f"{name}-{estimator}")
        drawn.append((title, figures.pareto(within, places, score, f"{name}-{estimator}", title)))
        config = within[0].job.configurations()[0][0]
        ways = {agent: [Markup(one) for one in svgs] for agent, svgs in maps(within, config).items()}  # noqa: S704 - ours
        parts.append(
            {
                "estimator": estimator,
                "tables": cells.tables(part, summary["nees_band_of_the_mean"], robots),
                "panels": [(head, Markup(svg)) for head, svg in drawn],  # noqa: S704 - ours
                "ways": {agent: ways[agent] for agent in places if agent in ways},
                "best": next(iter(part["agents"])),
            }
        )
    several = len(about["estimators"]) > 1
    return {
        "name": name,
        "about": about["about"],
        "parts": parts,
        "alike": about["moves_alike"],
        "compared": cells.compared(about["estimators"], robots) if several else [],
    }


def _overview(summary: Mapping[str, Any]) -> dict[str, dict[str, list[dict[str, Any]]]]:
    """For each estimator and agent, J at the end on each suite: text, interval, and place between worst and best."""
    found: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for suite in summary["suites"].values():
        for estimator, part in suite["estimators"].items():
            values = {name: about["figures"][columns.J_END.key] for name, about in part["agents"].items()}
            low, high = (pick(figure.value for figure in values.values()) for pick in (min, max))
            rows = found.setdefault(estimator, {})
            for name in summary["ranking"]:
                one = cells.cell(values[name], columns.J_END) if name in values else cells.Cell("–")
                height = (values[name].value - low) / (high - low) if name in values and high > low else math.nan
                share = 0 if math.isnan(height) else round(100 * height)
                rows.setdefault(name, []).append({"cell": one, "share": share, "best": share == 100})
    return found


def _costs(summary: Mapping[str, Any]) -> list[tuple[str, str, float]]:
    """Agent, group and greatest cost of an action [ms], the costliest first."""
    found: dict[str, float] = {}
    for suite in summary["suites"].values():
        for part in suite["estimators"].values():
            for name, about in part["agents"].items():
                found[name] = max(found.get(name, 0.0), about["action_ms"])
    return [(name, group(name), found[name]) for name in sorted(found, key=lambda name: -found[name])]


def _filmed(asked: Asked, results: Sequence[Result], agent: str) -> Result:
    """The result whose first episode is drawn: of the first suite, with the estimator that was named last."""
    own = of(results, agent=agent)
    first = next(suite for suite in asked.suites if of(own, suite=suite))
    return of(own, suite=first)[-1]


def _film_of(asked: Asked, results: Sequence[Result], films: Mapping[str, str]) -> str:
    """What the films show, in words."""
    if not films:
        return ""
    job = _filmed(asked, results, next(iter(films))).job
    return f"the first {job.seeds} episode of {job.suite}, with {job.estimator}"
