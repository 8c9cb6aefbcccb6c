"""The outcome of a move, a replacement or a new balance, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rich.markup import escape

from poise.manage.adaptation.proposals import Proposal, WhatIf
from poise.manage.control_socket.commands import Rebalanced
from poise.manage.migration.migration_report import MigrationReport, TransitionReport
from poise.units import format_bytes, format_seconds

Outcome = MigrationReport | Rebalanced


def outcome_lines(outcome: Outcome) -> Iterator[str]:
    """Yield what was done, or why it was not."""
    if isinstance(outcome, Rebalanced):
        yield from _proposal_lines(outcome.proposal)
        if outcome.report is not None:
            yield _transition_line(outcome.report)
    else:
        yield escape(outcome_sentence(outcome))


def outcome_sentence(report: MigrationReport) -> str:
    """Return what was done, or why it was not, in a sentence."""
    if not report.committed:
        return f"{_places(report.before, 'stays')}: {report.reason}"
    runs, downtime = _places(report.after, "runs"), format_seconds(report.downtime)
    if report.cold:
        return f"{runs} now; it was stopped and started, downtime {downtime}"
    prepared = format_seconds(report.prepared)
    return f"{runs} now; prepared in {prepared}, downtime {downtime}"


def _places(placement: Mapping[str, str], verb: str) -> str:
    return " and ".join(f"{name} {verb} on {at}" for name, at in placement.items())


def what_if_lines(what_if: WhatIf) -> Iterator[str]:
    """Yield what a move would change."""
    if what_if.trouble:
        yield f"as it is: {what_if.trouble}"
    now, then = what_if.now.total, what_if.then.total
    yield f"F = {now:.4g} would become {then:.4g}"
    for computer, (before, after) in what_if.loads.items():
        yield (
            f"components on {computer} need {before:.1%} of a core, and would need "
            f"{after:.1%}, of {what_if.usable[computer]:.1%}"
        )
    state = f" with a state of {format_bytes(what_if.state)}" if what_if.state else ""
    yield (
        f"the move{state} costs {what_if.cost:.2f} core-seconds; {what_if.component} "
        f"is paused for about {format_seconds(what_if.downtime)}"
    )
    for limit in what_if.breaks:
        yield f"it would be refused: {limit}"


def _proposal_lines(proposal: Proposal) -> Iterator[str]:
    for name, need in proposal.shifted.items():
        yield f"{name} needs {need}"
    if proposal.trouble:
        yield f"[red]as it is: {escape(proposal.trouble)}[/]"
    known = " (proven the best)" if proposal.proven else ""
    if not proposal.steps:
        yield f"best as it is{known}: F = {proposal.now.total:.4g}"
        return
    now, then = proposal.now.total, proposal.then.total
    yield f"F = {now:.4g} becomes {then:.4g}{known}, by:"
    for step in proposal.steps:
        yield f"  {step}"


def _transition_line(report: TransitionReport) -> str:
    if not report.committed:
        return f"[red]rolled back:[/] {escape(report.reason)}"
    longest = max((move.downtime for move in report.moves), default=0.0)
    downtime = f"; the longest downtime was {format_seconds(longest)}"
    return f"done{downtime if report.moves else ''}"
