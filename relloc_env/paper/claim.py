"""What the paper says, beside what was measured."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Self

import numpy as np
from rich.table import Table
from rich.text import Text

from relloc_env.files import write_json, write_whole


class Verdict(StrEnum):
    """Whether the measured values agree with a sentence as it is printed."""

    HOLDS = "holds"
    FAILS = "does not hold"
    CONSISTENT = "consistent with"
    """Can come out so: what the paper leaves open was chosen so that it does, which is no test of the sentence."""
    UNDETERMINED = "undetermined"
    """Depends on what the paper leaves open."""

    @classmethod
    def of(cls, *cases: bool) -> Self:
        """The verdict over all cases that the paper leaves open: where they differ, it is undetermined."""
        return cls(cls.HOLDS if all(cases) else cls.UNDETERMINED if any(cases) else cls.FAILS)


@dataclass(frozen=True)
class Claim:
    """One printed sentence of the paper, with the equations in it."""

    id: str
    quote: str
    """The sentence; "…" where words are left out, formulas in Unicode."""
    source: str
    """Where in the paper."""
    measured: dict[str, float | None]
    """What running it gave, by a name with its unit; None for not within the run."""
    verdict: Verdict
    """By the tolerance that the code states."""
    note: str
    """Why it does not hold, or what was chosen where the paper leaves it open."""


def claim(name: str, quote: str, source: str, measured: Mapping[str, float], verdict: Verdict, note: str = "") -> Claim:
    """Return a claim with its measured values rounded to four digits, and infinity (not within the run) as None."""
    return Claim(name, quote, source, {key: _rounded(float(value)) for key, value in measured.items()}, verdict, note)


def _rounded(value: float) -> float | None:
    return float(np.format_float_scientific(value, precision=3)) if math.isfinite(value) else None


def tally(claims: Iterable[Claim]) -> str:
    """How many sentences there are, and how many of each verdict."""
    count = Counter(one.verdict for one in claims)
    return f"{count.total()} printed sentences: " + ", ".join(f"{verdict} {count[verdict]}" for verdict in Verdict)


def write_claims(claims: Iterable[Claim], out: Path) -> None:
    """Write the claims as a JSON list, claims.json, and as a table in Markdown, claims.md, into the folder `out`."""
    claims = list(claims)
    write_json(out / "claims.json", [asdict(one) for one in claims], indent=2, ensure_ascii=False)
    write_whole(out / "claims.md", claims_markdown(claims))


def claims_markdown(claims: Iterable[Claim]) -> str:
    """The verdicts counted, and a table in Markdown: each sentence, its verdict, what was measured, and why."""
    claims = list(claims)
    rows = [["printed sentence", "verdict", "measured", "why, and what was chosen"], ["---"] * 4]
    for one in claims:
        measured = "<br>".join(f"{key}: {_shown(value)}" for key, value in one.measured.items())
        rows.append([f"`{one.id}` ({one.source})<br>“{one.quote}”", str(one.verdict), measured, one.note])
    lines = ("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)
    return f"{tally(claims)}.\n\n" + "\n".join(lines) + "\n"


_COLOURS = {
    Verdict.HOLDS: "green",
    Verdict.FAILS: "bold red",
    Verdict.CONSISTENT: "yellow",
    Verdict.UNDETERMINED: "yellow",
}


def claims_table(claims: Iterable[Claim]) -> Table:
    """The same as a table for the terminal."""
    table = Table(title="What the paper prints, sections III and IV", show_lines=True)
    table.add_column("sentence and note", ratio=6)
    table.add_column("measured", ratio=5)
    table.add_column("verdict", justify="center", min_width=max(map(len, Verdict)))
    for one in claims:
        left = Text.assemble((one.id, "bold"), f"  {one.source}\n“{one.quote}”")
        if one.note:
            left.append(f"\n{one.note}", "dim")
        right = Text("\n").join(
            Text.assemble((f"{key}: ", "dim"), (_shown(value), "bold")) for key, value in one.measured.items()
        )
        table.add_row(left, right, Text(one.verdict, _COLOURS[one.verdict]))
    return table


SMALLEST = 1e-6
"""Values below count as rounding, and are shown as that."""


def _shown(value: float | None) -> str:
    if value is None:
        return "not in 40 s"
    return "< 1e-6" if 0.0 < abs(value) < SMALLEST else f"{value:.3g}"
