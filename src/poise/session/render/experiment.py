"""What an experiment found, in short, for terminals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType

from poise.session.render.shared_tables.columns import table
from poise.units import counted

if TYPE_CHECKING:
    from poise.session.experiment.summary import ExperimentReport


def experiment_parts(report: ExperimentReport) -> Iterator[RenderableType]:
    """Yield how often each function worked, a table for each condition."""
    for condition in dict.fromkeys(each.condition for each in report.arms):
        here = [each for each in report.arms if each.condition == condition]
        names = list(here[0].success)
        rows = table(condition, *names, "worst chain missed", "runs")
        for arm in here:
            missed = [m for m in arm.deadline_miss_share.values() if m is not None]
            rows.add_row(
                arm.placement,
                *(_share(arm.success[name].share) for name in names),
                f"{max(missed):.1%}" if missed else "",
                f"{arm.runs}" + (f", {arm.invalid} invalid" if arm.invalid else ""),
            )
        yield rows
    invalid = sum(each.invalid for each in report.arms)
    if invalid:
        yield (
            f"[yellow]{counted(invalid, 'invalid run')}: the same command makes them "
            "again[/]"
        )


def _share(share: float | None) -> str:
    return "" if share is None else f"{share:.0%}"
