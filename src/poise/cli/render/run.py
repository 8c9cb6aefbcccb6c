"""A run's report, for people."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from poise.cli.render.clocks import clock_table
from poise.cli.render.connectors import connector_tables
from poise.cli.render.tables import table
from poise.manage.observe.report import ComponentReport, RunReport
from poise.units import format_seconds


def show_run(report: RunReport, console: Console) -> None:
    """Print where the components ran, what they used, and how timers kept up."""
    rows = table(
        "component", "CPU", "timer, period", "missed", "median", "p99", folds=2
    )
    for computer in report.cpu_share:
        rows.add_row(f"[bold]on {computer}[/]")
        here = (c for c in report.components if c.computer == computer)
        for component in sorted(here, key=lambda c: c.name):
            _add_component(rows, component)
    console.print(rows)
    _show_measures(report, console)
    for connectors in connector_tables(report.connectors):
        console.print(connectors)
    clocks = clock_table(report.clocks)
    if clocks.row_count:
        console.print(clocks)
    shares = ", ".join(
        f"{name} {share:.0%}" for name, share in report.cpu_share.items()
    )
    console.print(f"ran for {report.seconds:.1f} s; CPU used: {shares}")
    for component in report.components:
        if component.errors:
            many = "1 error" if component.errors == 1 else f"{component.errors} errors"
            console.print(f"[red]{component.name}: {many}, the last:[/]")
            # as it is: it may hold anything, and lines of code are not wrapped
            console.print(component.last_error, markup=False, soft_wrap=True)
    for fault in report.faults:
        console.print(f"[red]container {fault.container}[/] {escape(fault.message)}")
    if report.simulation:
        facts = ", ".join(f"{key} {value}" for key, value in report.simulation.items())
        console.print(f"the simulated world says: {escape(facts)}")
    if report.void:
        console.print(f"[bold yellow]void:[/] {report.void}")


def _add_component(rows: Table, component: ComponentReport) -> None:
    head = (component.name, f"{component.cpu:.1%}")
    if not component.timers:
        rows.add_row(*head)
    for timer in component.timers:
        share = timer.missed / timer.releases if timer.releases else 0.0
        rows.add_row(
            *head,
            f"{timer.name} {format_seconds(timer.period)}",
            f"{share:.1%}" if timer.deadline else "",
            format_seconds(timer.duration.median),
            format_seconds(timer.duration.p99),
        )
        head = ("", "")


def _show_measures(report: RunReport, console: Console) -> None:
    rows = table("measure", "count", "mean", "median", "p99", "maximum")
    for component in report.components:
        for name, summary in component.measures.items():
            values = summary.mean, summary.median, summary.p99, summary.maximum
            numbers = (f"{value:.4g}" for value in values)
            rows.add_row(f"{component.name} {name}", str(summary.count), *numbers)
    if rows.row_count:
        console.print(rows)
