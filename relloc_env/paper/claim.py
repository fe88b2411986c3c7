"""What the paper says, beside what was measured."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from relloc_env.files import write_json


@dataclass(frozen=True)
class Claim:
    """One sentence or equation of the paper."""

    id: str
    claim: str
    """In few words."""
    source: str
    """Where in the paper."""
    paper: str
    """What the paper states or shows."""
    measured: dict[str, float | None]
    """What running it gave, by a name with its unit; None for not within the run."""
    holds: bool
    """Whether the measured values agree with the claim as printed, within the tolerance that the code states."""
    note: str
    """Why it does not hold, or what was chosen where the paper leaves it open."""


def claim(
    name: str, text: str, source: str, paper: str, measured: Mapping[str, float], *, holds: bool, note: str = ""
) -> Claim:
    """Return a claim with its measured values rounded to four digits, and infinity (not within the run) as None."""
    values = {key: _rounded(float(value)) for key, value in measured.items()}
    return Claim(name, text, source, paper, values, bool(holds), note)


def _rounded(value: float) -> float | None:
    return float(np.format_float_scientific(value, precision=3)) if math.isfinite(value) else None


def write_claims(claims: Iterable[Claim], path: Path) -> None:
    """Write the claims as a JSON list."""
    write_json(path, [asdict(one) for one in claims], indent=2, ensure_ascii=False)


def claims_table(claims: Iterable[Claim]) -> Table:
    """The same as a table for the terminal."""
    table = Table(title="Claims of the paper, sections III and IV", show_lines=True)
    table.add_column("claim and note", ratio=6)
    table.add_column("paper, measured", ratio=5)
    table.add_column("holds", justify="center", no_wrap=True)
    for one in claims:
        left = Text.assemble((one.id, "bold"), f"  {one.source}\n{one.claim}")
        if one.note:
            left.append(f"\n{one.note}", "dim")
        right = Text(f"paper: {one.paper}")
        for key, value in one.measured.items():
            right.append(f"\n{key}: ", "dim").append(_shown(value), "bold")
        table.add_row(left, right, Text("yes", "green") if one.holds else Text("no", "bold red"))
    return table


def _shown(value: float | None) -> str:
    return "not in 40 s" if value is None else f"{value:.4g}"
