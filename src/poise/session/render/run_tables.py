"""A run's report, for people."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import Struct
from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from poise.clock import time_of_day
from poise.decoding import convert
from poise.manage.observe.deviations import combined
from poise.session.render.tables import (
    chain_tables,
    clock_tables,
    connector_tables,
    failed_calls,
    filled,
    table,
    task_lines,
)
from poise.session.run_records import ComponentReport
from poise.units import counted, format_seconds

if TYPE_CHECKING:
    from poise.session.run_report import RunReport


class Measured(Struct, frozen=True):
    """A value that decided, None when it was not measured; with its unit or ""."""

    value: int | float | str | bool | None
    unit: str = ""

    def __str__(self) -> str:
        """Return it for people."""
        if self.value is None:
            return "not measured"
        return f"{self.value} {self.unit}".rstrip()


class Judgement(Struct, frozen=True, kw_only=True):
    """Whether a task or a function succeeded, and by what."""

    name: str
    success: bool
    values: Mapping[str, Measured] = {}


def judgements(
    simulation: Mapping[str, Any], tasks: Collection[str]
) -> list[Judgement]:
    """Return the world's judgements of the tasks that ran, else of all functions."""
    of_tasks = [each for each in _found(simulation, "tasks") if each.name in tasks]
    return of_tasks or _found(simulation, "criteria")


def _found(simulation: Mapping[str, Any], key: str) -> list[Judgement]:
    try:
        return convert(simulation.get(key, []), list[Judgement])
    except msgspec.ValidationError:
        return []


def report_parts(report: RunReport) -> Iterator[RenderableType]:
    """Yield where the components ran, what they used, and how timers kept up."""
    yield _component_table(report)
    yield from _measure_tables(report)
    yield from chain_tables(report.chains)
    yield from connector_tables(report.connectors)
    yield from clock_tables(report.clocks)
    shares = ", ".join(f"{n} {share:.0%}" for n, share in report.cpu_share.items())
    used = f"; CPU used: {shares}" if shares else ""
    yield f"ran for {report.seconds:.1f} s{used}"
    yield from task_lines(report.tasks, is_over=True)
    for name in report.suspended:
        yield f"[red]architecture '{name}' was suspended: not all fits[/]"
    yield from _failures(report)
    yield from _world(report)
    if report.invalid:
        yield f"[bold yellow]invalid run:[/] {escape(report.invalid)}"


def _world(report: RunReport) -> Iterator[RenderableType]:
    """Yield what the simulated world judges; without judgements, its plain values."""
    rows = table("in the simulated world", "success", "measured", folds=2)
    for judged in judgements(report.simulation, [task.name for task in report.tasks]):
        values = (f"{name} {value}" for name, value in judged.values.items())
        success = "yes" if judged.success else "[red]no[/]"
        rows.add_row(escape(judged.name), success, escape(", ".join(values)))
    if rows.row_count:
        yield rows
    elif report.simulation:
        plain = (
            f"{key} {value}"
            for key, value in report.simulation.items()
            if not isinstance(value, list | dict)
        )
        yield f"the simulated world says: {escape(', '.join(plain))}"


def _failures(report: RunReport) -> Iterator[RenderableType]:
    """Yield what is not as it should be, the worst first."""
    for error in report.errors:
        many = counted(error.count, "error")
        since = time_of_day(error.first)
        where = f"{error.component} on {error.computer}: {many} in '{error.where}'"
        yield f"[red]{where}, the first at {since}:[/]"
        # as it is: it may hold anything, and lines of code are not wrapped
        yield Text(error.text, no_wrap=True, overflow="ignore")
    for hung in report.hung:
        yield (
            f"[red]{hung.component} on {hung.computer}: '{hung.handler}' still ran "
            f"after {hung.seconds:.1f} s[/]"
        )
    for sentence in combined((fault.computer, fault) for fault in report.faults):
        yield f"[red]{escape(sentence)}[/]"
    for name, count in report.refused.items():
        refused = counted(count, "message")
        yield f"[red]{name}: {refused} refused: not of the port's type[/]"
    most = "up to " if report.faults else ""  # its container's last count is old
    for name, count in report.lost.items():
        lost = f"{most}{counted(count, 'message')}"
        yield f"[red]{name}: {lost} sent and not processed[/]"
    dropped = (
        f"{each.name}: {counted(each.drops, 'message')} dropped"
        for each in report.connectors
        if each.drops
    )
    for sentence in (*dropped, *failed_calls(report.connectors)):
        yield f"[yellow]{sentence}[/]"
    for port in report.silent:
        yield f"[yellow]{escape(str(port))}[/]"
    if report.interrupted:
        yield "[yellow]the run was ended early[/]"


def _component_table(report: RunReport) -> Table:
    rows = table(
        "component", "CPU", "timer, period", "missed", "median", "p99", folds=2
    )
    known = [*report.cpu_share, *(each.computer for each in report.components)]
    for computer in dict.fromkeys(known):
        rows.add_row(f"[bold]on {computer}[/]")
        here = (c for c in report.components if c.computer == computer)
        for component in sorted(here, key=lambda c: c.name):
            _add_component(rows, component)
    return rows


def _add_component(rows: Table, component: ComponentReport) -> None:
    head = (component.name, f"{component.cpu:.1%}")
    if not component.timers:
        rows.add_row(*head)
    for timer in component.timers:
        known = timer.deadline and timer.releases
        took = timer.duration
        rows.add_row(
            *head,
            f"{timer.name} {format_seconds(timer.period)}",
            f"{timer.missed / timer.releases:.1%}" if known else "",
            *map(format_seconds, (took.median, took.p99) if took.count else ()),
        )
        head = ("", "")


def _measure_tables(report: RunReport) -> Iterator[Table]:
    rows = table("measure", "count", "mean", "median", "p99", "maximum")
    for component in report.components:
        for name, summary in component.measures.items():
            values = summary.mean, summary.median, summary.p99, summary.maximum
            numbers = (f"{value:.4g}" for value in values)
            measured = escape(f"{component.name} {name}")
            rows.add_row(measured, str(summary.count), *numbers)
    return filled(rows)
