"""The figures of one or several folders of results as Markdown, for documents: tables, differences, correlations."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from agents.report.columns import J_10, J_END, MADE, MOVED, TOLD, Column, shown
from agents.report.summary import command
from agents.results import Result, load, of
from agents.statistics import mean_difference
from relloc_env.config import TASKS
from relloc_env.extras import extra
from relloc_env.numerals import number

with extra("agents"):
    from scipy import stats


REASONS = ("excitation", "information_end", "seen")
"""Scores of a motion that its errors are held against."""
ERRORS = ("depth_error_end", "depth_error_area")
"""Errors of an estimator that are held against them; medians over the episodes."""
FEWEST = 5
"""Motions of which ranks are compared."""
Table = Callable[[list[Result], Sequence[str], int], Iterator[str]]


def markdown(
    folders: Sequence[Path],
    kinds: Sequence[str],
    over: Sequence[str] = (),
    agents: Sequence[str] = (),
    shown_suites: Sequence[str] = (),
) -> str:
    """The tables of some folders of one id, whose seeds are of the same set.

    Args:
        folders: that `agents.benchmark.benchmark` has filled.
        kinds: of `KINDS`.
        over: agents over which the others' differences are given, in the kind `over`.
        agents: that are shown; none for all.
        shown_suites: the same of suites.

    Raises:
        ValueError: folders without results or not of the same task, and kinds that are none.
    """
    for kind in kinds:
        if kind not in KINDS:
            raise ValueError(f"Argument `kinds` must be of {', '.join(KINDS)}, but has {kind!r}")
    found = [(folder, *load(folder)) for folder in folders]
    first = found[0][1]
    if any((a.env, a.seeds, a.options) != (first.env, first.seeds, first.options) for _, a, _ in found):
        raise ValueError(
            "Argument `folders` must be of one id, one set of seeds and the same options, but they are not"
        )
    wanted = {*agents, *over}
    results = [result for _, _, part in found for result in part if not agents or result.job.agent in wanted]
    lines = ["```sh", *(command(asked, folder) for folder, asked, _ in found), "```", ""]
    for name in dict.fromkeys(result.job.suite for result in results):
        if shown_suites and name not in shown_suites:
            continue
        within = of(results, suite=name)
        for kind in kinds:
            if kind != "suites":
                lines += [f"`{name}`, {CAPTIONS[kind]}:", "", *KINDS[kind](within, over, TASKS[first.env]), ""]
    if "suites" in kinds:
        lines += [f"{CAPTIONS['suites']}:", "", *suites(results, over, TASKS[first.env]), ""]
    return "\n".join(lines)


def told(results: list[Result], _: Sequence[str], robots: int) -> Iterator[str]:
    """What the motions tell, of one suite: each agent with the first estimator that it was played with."""
    return _columns(_alike(results), shown(TOLD, robots) + _named(MOVED, ("path",)), robots)


def made(results: list[Result], _: Sequence[str], robots: int) -> Iterator[str]:
    """What the estimators make of it."""
    keys = ("time_pose", "time_depth", "position_error_end", "heading_error_end", "depth_error_end", "over_bound",
            "nees_inside")  # fmt: skip
    return _columns(results, _named(shown(MADE, robots), keys) + _named(MOVED, ("excitation",)), robots)


def suites(results: list[Result], _: Sequence[str], __: int) -> Iterator[str]:
    """J at the end of each agent in each suite, medians."""
    names = list(dict.fromkeys(result.job.suite for result in results))
    agents = {r.job.agent: None for r in sorted(results, key=_worth)}
    yield from _head(["agent", *(f"`{name}`" for name in names)])
    for agent in agents:
        parts = [next(iter(of(results, suite=name, agent=agent)), None) for name in names]
        yield _row([f"`{agent}`", *("–" if p is None else number(-_worth(p), 2) for p in parts)])


def differences(results: list[Result], over: Sequence[str], _: int) -> Iterator[str]:
    """Paired differences of means of J over some agents, on the episodes that both have."""
    kept = {result.job.agent: result for result in _alike(results)}
    named = [name for name in over if name in kept]
    yield from _head(["agent", *(f"{when} over `{name}`" for name in named for when in ("end", "10 s")), "episodes"])
    for agent, result in kept.items():
        if agent in named:
            continue
        cells, counts = [], []
        for other in (kept[name] for name in named):
            count = min(result.job.episodes, other.job.episodes)
            counts.append(count)
            for score in (J_END.score, J_10.score):
                mean, low, high = mean_difference(result.scores[score][:count], other.scores[score][:count])
                cells.append(f"{number(mean, 2, sign=True)} [{number(low, 2)}, {number(high, 2)}]")
        yield _row([f"`{agent}`", *cells, str(min(counts, default=result.job.episodes))])


def correlations(results: list[Result], _: Sequence[str], __: int) -> Iterator[str]:
    """Spearman's rank correlations, over the motions, of errors with what is said to explain them."""
    pairs = [(error, reason) for error in ERRORS for reason in REASONS]
    yield from _head(["estimator", "motions", *(f"`{error}` with `{reason}`" for error, reason in pairs)])
    for estimator in dict.fromkeys(result.job.estimator for result in results):
        part = of(results, estimator=estimator)
        if len(part) < FEWEST:
            continue
        medians = {name: [float(np.median(r.scores[name])) for r in part] for name in (*ERRORS, *REASONS)}
        ranks = [float(stats.spearmanr(medians[error], medians[reason]).statistic) for error, reason in pairs]
        yield _row([f"`{estimator}`", str(len(part)), *(number(rank, 2, sign=True) for rank in ranks)])


KINDS: Mapping[str, Table] = MappingProxyType(
    {"told": told, "over": differences, "made": made, "ranks": correlations, "suites": suites}
)
CAPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "told": "what the motions tell",
        "over": "paired differences of the mean of J [nats]",
        "made": "what the estimators make of it",
        "ranks": "rank correlations over the motions, of medians",
        "suites": "J at the end [nats], medians, in every suite",
    }
)


def _columns(results: Sequence[Result], columns: Sequence[Column], robots: int) -> Iterator[str]:
    """A row for each agent and estimator, the most informative first."""
    several = len({result.job.estimator for result in results}) > 1
    heads = [c.alone[0] if robots == 1 and c.alone is not None else c.head for c in columns]
    units = [f"{head} [{column.unit}]" for head, column in zip(heads, columns, strict=True)]
    yield from _head(["agent", *(["estimator"] if several else []), *units])
    for result in sorted(results, key=_worth):
        cells = []
        for column in columns:
            figure = column.of(result.scores[column.score])
            value, *ends = (
                number(column.scale * part, column.digits, error=column.error)
                for part in (figure.value, figure.low, figure.high)
            )
            note = f" [{', '.join(ends)}]" if np.isfinite(figure.low) and column in (J_END, J_10) else ""
            cells.append(value + note + ("" if np.isnan(figure.share) else f" ({100.0 * figure.share:.0f} %)"))
        yield _row([f"`{result.job.agent}`", *([f"`{result.job.estimator}`"] if several else []), *cells])


def _alike(results: Sequence[Result]) -> list[Result]:
    """Each motion once: with the first estimator that it was played with."""
    kept: dict[str, Result] = {}
    for result in results:
        kept.setdefault(result.job.agent, result)
    return list(kept.values())


def _named(columns: Sequence[Column], keys: Sequence[str]) -> list[Column]:
    return [column for column in columns if column.key in keys]


def _worth(result: Result) -> float:
    """Its median J at the end, less of it being later."""
    return -float(np.median(result.scores[J_END.score]))


def _head(cells: Sequence[str]) -> list[str]:
    return [_row(cells), "|" + "---|" * len(cells)]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
