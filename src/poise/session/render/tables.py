"""Tables for people: how they look, and those that several commands print."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.markup import escape
from rich.segment import Segment
from rich.table import Table

from poise.clock import time_of_day
from poise.manage.control_socket.commands import Rebalanced
from poise.manage.migration.migration_report import MigrationReport, Proposal, WhatIf
from poise.manage.observe.chains import ChainReport
from poise.manage.tasks.task_reports import OVER, ActionReport, TaskReport
from poise.units import format_bytes, format_seconds
from poise.wire.records.heartbeat_records import ClockStatus
from poise.wire.records.status_records import ConnectorStatus, Summary


def table(*columns: str, folds: int = 0) -> Table:
    """Return an empty table, whose cells break over lines in a narrow terminal.

    Names, and the column number `folds`, break anywhere; others break between words,
    and a word that is cut ends in an ellipsis.
    """
    made = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for place, title in enumerate(columns):
        # rich takes room from columns that may break first: from one alone, all of it
        made.add_column(title, overflow="fold" if place in {0, folds} else "ellipsis")
    return made


class NamedRows:
    """A table whose long names have a line of their own, above their rows."""

    def __init__(self, title: str, *columns: str) -> None:
        self._rows = table(title, *columns)
        for column in self._rows.columns:
            column.no_wrap = True  # so that each row is one line
        self._names: list[str] = []

    @property
    def row_count(self) -> int:
        """How many rows there are, names aside."""
        return len(self._names)

    def add_row(self, name: str, *cells: str) -> None:
        """Add a row; that of the same name as the one before stands under it."""
        self._names.append(name)
        self._rows.add_row("", *cells)

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """Give the lines, for rich."""
        title, rule, *rows = console.render_lines(self._rows, options, pad=False)
        yield from (*title, Segment.line(), *rule, Segment.line())
        before = None
        for name, row in zip(self._names, rows, strict=True):
            if name != before:
                yield name
            before = name
            yield from (*row, Segment.line())


def filled(*tables: Table) -> Iterator[Table]:
    """Yield the tables that have rows."""
    return (each for each in tables if each.row_count)


def chain_tables(chains: Iterable[ChainReport]) -> Iterator[Table]:
    """Yield a row for each chain, if there is one: the age of its data when used."""
    names = "chain,\ndata age", "deadline", "used", "late", "median", "p99", "longest"
    rows = table(*names, "most time to", folds=len(names))
    for chain in chains:
        age, head = chain.age, (chain.name, format_seconds(chain.deadline))
        if not age.count:
            rows.add_row(*head, "0")
            continue
        share = f"{chain.missed / age.count:.1%}"
        ages = list(map(format_seconds, (age.median, age.p99, age.maximum)))
        if chain.error > _NOTABLE * age.median:
            ages[0] += f" ± {format_seconds(chain.error)}"
        rows.add_row(*head, str(age.count), share, *ages, _slowest(chain))
    return filled(rows)


_NOTABLE = 0.1
"""An error of the clocks is shown when it is more than this share of the age."""


def _slowest(chain: ChainReport) -> str:
    """Return the component at which the data is most older than at the one before."""
    steps = [
        (next_.age.median - before.age.median, next_.component)
        for before, next_ in pairwise(chain.hops)
    ]
    return max(steps)[1] if steps else ""


def clock_tables(clocks: Mapping[str, Mapping[str, ClockStatus]]) -> Iterator[Table]:
    """Yield a row for each two computers: how far the second is ahead, +- error."""
    rows = table("clock of", "seen from", "ahead by", "quickest round trip", folds=1)
    for here, known in clocks.items():
        for there, clock in known.items():
            if there < here and here in clocks.get(there, {}):
                continue  # the same from the other side
            error = format_seconds(clock.error)
            offset = f"{_signed(clock.offset, clock.error)} ± {error}"
            rows.add_row(there, here, offset, format_seconds(clock.trip))
    return filled(rows)


def _signed(offset: float, error: float) -> str:
    """Return an offset, as exactly as it is known."""
    sign = "-" if offset < 0 else ""
    return "0 s" if abs(offset) <= error else f"{sign}{format_seconds(abs(offset))}"


_OF = "connector"
_Ends = list[ConnectorStatus]


def connector_tables(ends: Iterable[ConnectorStatus]) -> list[NamedRows]:
    """Return what went over connectors, how long it took, and how large it was."""
    grouped: dict[tuple[str, str], _Ends] = {}
    for end in ends:
        grouped.setdefault((end.name, end.end), []).append(end)
    counts = NamedRows(_OF, "kind", "end", "count", "out", "in", "errors", "drops")
    times = NamedRows(_OF, "end", "took", "p99", "one way", "p99")
    sizes = NamedRows(_OF, "end", "size", "p99", "largest")
    for (name, _), same in sorted(grouped.items()):
        # a source that has a path more reports the same numbers twice
        each = same if same[0].end == "target" else same[:1]
        for rows, cells in ((counts, _counts), (times, _times), (sizes, _sizes)):
            if found := cells(each):
                rows.add_row(name, *found)
    return [rows for rows in (counts, times, sizes) if rows.row_count]


def failed_calls(ends: Iterable[ConnectorStatus]) -> Iterator[str]:
    """Say over which connectors calls failed: their callers alone know why."""
    for end in sorted(ends, key=lambda end: end.name):
        if end.end != "target" and end.calls and end.errors:
            yield f"{end.name}: {end.errors:,} of {end.calls:,} calls failed"


def _counts(same: _Ends) -> tuple[str, ...]:
    kind = same[0].kind if all(end.ready for end in same) else "not joined"
    sizes = [sum(e.bytes_out for e in same), sum(e.bytes_in for e in same)]
    return (
        kind,
        same[0].end,
        str(sum(e.count for e in same) or ""),
        *(format_bytes(size) if size else "" for size in sizes),
        str(sum(e.errors for e in same) or ""),
        str(sum(e.drops for e in same) or ""),
    )


def _times(same: _Ends) -> tuple[str, ...]:
    """Return how long calls took, or messages waited, whichever there are more of."""
    took = _most(s for e in same for s in (e.delay, e.wait))
    busiest = max(same, key=lambda end: end.latency.count)
    way, error = busiest.latency, busiest.latency_error
    if not took.count and not way.count:
        return ()
    median, p99 = _pair(way)
    if error:
        median += f" ± {format_seconds(error)}"
    return (same[0].end, *_pair(took), median, p99)


def _sizes(same: _Ends) -> tuple[str, ...]:
    size = _most(end.size for end in same)
    if not size.count:
        return ()
    return (same[0].end, *map(format_bytes, (size.median, size.p99, size.maximum)))


def _pair(times: Summary) -> tuple[str, str]:
    if not times.count:
        return "", ""
    return format_seconds(times.median), format_seconds(times.p99)


def _most(summaries: Iterable[Summary]) -> Summary:
    return max(summaries, key=lambda summary: summary.count)


_COLOURS = {"failed": "red", "waiting": "yellow", "paused": "yellow"}


def task_table(tasks: Iterable[TaskReport]) -> Table:
    """Return tasks with their states and actions, and why under them."""
    rows = table("task", "state", "since", "priority", "actions", folds=4)
    for task in tasks:
        colour = _COLOURS.get(task.state, "")
        actions = ", ".join(map(_action, task.actions))
        rows.add_row(
            task.name,
            f"[{colour}]{task.state}[/]" if colour else task.state,
            time_of_day(task.since),
            str(task.priority),
            escape("\n".join(filter(None, [actions, task.why]))),
        )
    return rows


def task_lines(tasks: Iterable[TaskReport], *, is_over: bool = False) -> Iterator[str]:
    """Yield a line for each task; `is_over`: of a robot that runs no more."""
    for task in tasks:
        was_cut = is_over and task.state not in OVER
        colour = _COLOURS.get(task.state, "")
        at = f" with {', '.join(map(_action, task.actions))}" if task.actions else ""
        why = f": {task.why}" if task.why else ""
        state = f"was {task.state}" if was_cut else f"is {task.state}"
        end = " when the run ended" if was_cut else ""
        line = escape(f"task '{task.name}' {state}{at}{end}{why}")
        yield f"[{colour}]{line}[/]" if colour else line


def action_lines(task: TaskReport) -> Iterator[str]:
    """Yield a line for each action of a task whose turn it is."""
    for action in task.actions:
        by = ", ".join(action.architectures) or "nothing yet"
        needs = ", ".join(action.functions) or "no function"
        yield escape(f"{_action(action)}: uses {needs}, provided by {by}")


def _action(action: ActionReport) -> str:
    worked = f" ({action.worked:.1f} s)" if action.is_at_work else ""
    return f"'{action.name}'{worked}"


Outcome = MigrationReport | Rebalanced


def outcome_lines(outcome: Outcome) -> Iterator[str]:
    """Yield what was done, or why it was not."""
    if isinstance(outcome, Rebalanced):
        yield from _proposal_lines(outcome.proposal)
        report = outcome.report
        if report is not None and not report.committed:
            yield f"[red]rolled back:[/] {escape(report.reason)}"
        elif report is not None:
            longest = max((move.downtime for move in report.moves), default=0.0)
            downtime = f"; the longest downtime was {format_seconds(longest)}"
            yield f"done{downtime if report.moves else ''}"
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
    times = f"prepared in {prepared}, downtime {downtime}"
    return f"{runs} now; {times}{report.without_state}"


def _places(placement: Mapping[str, str], verb: str) -> str:
    return " and ".join(f"{name} {verb} on {at}" for name, at in placement.items())


def what_if_lines(what_if: WhatIf) -> Iterator[str]:
    """Yield what a move would change."""
    if what_if.trouble:
        yield f"as it is: {what_if.trouble}"
    now, then = what_if.now.total, what_if.then.total
    yield f"F = {now:.4g} would become {then:.4g}, without the cost of the move"
    for computer, (before, after) in what_if.loads.items():
        yield (
            f"components on {computer} need {before:.1%} of a core, and would need "
            f"{after:.1%}, of {what_if.usable[computer]:.1%}"
        )
    state = f" with a state of {format_bytes(what_if.state)}" if what_if.state else ""
    if what_if.downtime is None:
        pause = "was not moved yet, so nobody knows for how long it is paused"
    else:
        lasts = format_seconds(what_if.downtime)
        pause = f"is paused for about {lasts}, as in its last move"
    yield (
        f"the move{state} costs {what_if.cost:.2f} core-seconds; {what_if.component} "
        f"{pause}"
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
    now, then = proposal.now, proposal.then
    moves = f", {then.move - now.move:.4g} of it for the moves"
    yield f"F = {now.total:.4g} becomes {then.total:.4g}{moves}{known}, by:"
    for step in proposal.steps:
        yield f"  {step}"
