"""What an experiment found, in short, for terminals.

It imports internal modules: it prints as commands do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from rich.console import RenderableType

from poise.session.render.tables import table
from poise.units import counted

if TYPE_CHECKING:
    from benchmarks.experiment.summary import ExperimentReport, Share


def experiment_parts(report: ExperimentReport) -> Iterator[RenderableType]:
    """Yield how often all functions worked, and which did not, for each condition."""
    if report.headline:
        yield report.headline
    for condition in dict.fromkeys(each.condition for each in report.arms):
        rows = table(
            condition, "all worked", "worst chain missed", "runs", "failed", folds=4
        )
        for arm in (each for each in report.arms if each.condition == condition):
            # data that never came, as of what is suspended, is missed
            shares = arm.deadline_miss_share.values()
            missed = [1.0 if share is None else share for share in shares]
            rows.add_row(
                arm.placement,
                str(arm.all_worked),
                f"{max(missed):.1%}" if missed else "",
                f"{arm.runs}" + (f", {arm.invalid} invalid" if arm.invalid else ""),
                _failures(arm.success),
            )
        yield rows
    invalid = sum(each.invalid for each in report.arms)
    if invalid:
        yield (
            f"[yellow]{counted(invalid, 'invalid run')}: the same command makes them "
            "again[/]"
        )


def _failures(success: Mapping[str, Share]) -> str:
    """Return in how many valid runs each function failed, of those that did."""
    failed = {
        name: round((1 - each.share) * each.of)
        for name, each in success.items()
        if each.share is not None
    }
    return ", ".join(f"{name} {count}" for name, count in failed.items() if count)
