"""The paper, reproduced: its scenarios, its claims beside what was measured, its figures redrawn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from relloc_env.folders import open_folder
from relloc_env.paper.claim import Claim, Verdict, claims_markdown, claims_table, tally, write_claims

if TYPE_CHECKING:
    from relloc_env.paper.studies import Studies

__all__ = ["Claim", "Verdict", "claims_markdown", "claims_table", "reproduce", "tally", "write_claims"]


def reproduce(out: Path, report: Callable[[str], None] = lambda _: None, studies: Studies | None = None) -> list[Claim]:
    """Run everything, write `claims.json`, `claims.md` and the figures to `out`, and return the claims.

    Args:
        out: a folder, made where it is missing.
        report: told what is about to run.
        studies: the runs, where they are done already (`relloc_env.paper.studies.run_studies`).
    """
    from relloc_env.paper.claims_depth_filter import depth_filter_claims
    from relloc_env.paper.claims_experiment import experiment_claims
    from relloc_env.paper.claims_pose_filter import pose_filter_claims
    from relloc_env.paper.claims_relative_pose import relative_pose_claims
    from relloc_env.paper.claims_simulation import simulation_claims
    from relloc_env.paper.figures import draw_figures
    from relloc_env.paper.studies import run_studies

    out = open_folder(out)
    if studies is None:
        studies = run_studies(report)
    report("claims")
    claims = [
        *depth_filter_claims(studies),
        *relative_pose_claims(studies),
        *pose_filter_claims(studies),
        *simulation_claims(studies),
        *experiment_claims(studies),
    ]
    write_claims(claims, out)
    report("figures")
    draw_figures(studies, out)
    return claims
