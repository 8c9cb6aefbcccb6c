"""What a simulation showed, for people: tables, and a page without other files."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite

from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table

from poise.manage.tasks.task_reports import OVER
from poise.session.render.picture import bar_row
from poise.session.render.report_page import Mark, document, html_table, over_time
from poise.session.render.tables import filled, table
from poise.simulation.simulation_report import (
    SimulatedEvent,
    SimulatedLoad,
    SimulationReport,
    TimerMisses,
)
from poise.units import counted, format_bytes, format_seconds

MOST_ROWS = 12
"""More timers, faults, moves, outages or guesses are counted; `--json` has all."""
_EARLY = 1e-3
"""What the time may be short by because of rounding [s]."""
_MINUTE = 60.0


def simulation_parts(report: SimulationReport) -> Iterator[RenderableType]:
    """Yield the verdict, then computers, deadlines, chains, faults, moves, outages."""
    colour = "red" if report.violations else "bold"
    yield f"[{colour}]{escape(verdict(report))}[/]"
    for sentence in report.violations[1:]:
        yield f"[red]a promise of Poise did not hold: {escape(sentence)}[/]"
    yield from _ended_tasks(report)
    yield _computers(report)
    yield from _timers(report)
    yield from _chains(report)
    yield from _faults(report)
    yield from _moves(report)
    yield from _outages(report)
    yield _messages(report)
    for guess in report.guesses[:MOST_ROWS]:
        yield f"[yellow]assumed: {escape(guess)}[/]"
    yield from _more(len(report.guesses), "assumption")
    yield _took(report)


def verdict(report: SimulationReport) -> str:
    """Return what came of it, in one sentence."""
    if report.violations:
        broken = counted(len(report.violations), "promise")
        return (
            f"a defect of Poise: {broken} did not hold in {span(report.seconds)} of "
            f"virtual time: {report.violations[0]}"
        )
    early = ", then it was ended early" if ended_early(report) else ""
    asked = f" of {span(report.asked)}" if early else ""
    facts = [_missed(report), _stopped(report)]
    if report.moves:
        facts.append(counted(len(report.moves), "move"))
    return f"{span(report.seconds)}{asked} of virtual time{early}: {', '.join(facts)}"


def _ended_tasks(report: SimulationReport) -> Iterator[str]:
    """Yield what became of tasks that ended: nothing of them was simulated then."""
    for task in report.tasks:
        if task.state in OVER:
            ended = "failed" if task.state == "failed" else f"was {task.state}"
            why = f": {task.why}" if task.why else ""
            after = span(task.since - task.began)
            line = escape(f"task '{task.name}' {ended} after {after}{why}")
            yield f"[yellow]{line}[/]" if task.state == "failed" else line


def ended_early(report: SimulationReport) -> bool:
    """Return whether it was ended before the time that was asked for."""
    return report.seconds < report.asked - _EARLY


def _took(report: SimulationReport) -> str:
    """Return how much quicker than real time it was, and with which seed."""
    times = f", {report.ratio:.3g} times real time" if report.took else ""
    return (
        f"{span(report.seconds)} of virtual time took {span(report.took)} of CPU time"
        f"{times}; {report.method} placement, seed {report.seed}"
    )


def span(seconds: float) -> str:
    """Return a time [s] for people, in hours and minutes where it is long."""
    if seconds < _MINUTE:
        return format_seconds(seconds)
    whole = round(seconds)
    hours, minutes, rest = whole // 3600, whole % 3600 // 60, whole % 60
    parts = {"h": hours, "min": minutes, "s": 0 if hours else rest}
    return " ".join(f"{number} {unit}" for unit, number in parts.items() if number)


def late(timers: Sequence[TimerMisses]) -> list[TimerMisses]:
    """Return the timers with a deadline, the worst first."""
    timed = [each for each in timers if each.deadline is not None]
    return sorted(timed, key=lambda t: (-share(t.missed, t.due), t.component, t.timer))


def share(part: int, whole: int) -> float:
    """Return a share; 0 of nothing."""
    return part / whole if whole else 0.0


def comparison_parts(
    results: Mapping[str, SimulationReport], without: Mapping[str, str]
) -> Iterator[RenderableType]:
    """Yield a row for each placement, then what was violated."""
    rows = table(*COMPARED, folds=2)
    for method, report in results.items():
        rows.add_row(*map(escape, compared(method, report)))
    yield rows
    for method, why in without.items():
        yield f"[red]{escape(method)}: {escape(why)}[/]"
    for method, report in results.items():
        for sentence in report.violations:
            where = escape(f"{method}: {sentence}")
            yield f"[red]a promise of Poise did not hold: {where}[/]"
        if ended_early(report):
            after = f"{span(report.seconds)} of {span(report.asked)}"
            yield f"[yellow]{escape(method)} was ended after {after}[/]"


COMPARED = (
    "placement",
    "deadlines missed",
    "CPU mean (peak)",
    "data too old",
    "moves",
    "outages",
    "longest",
    "dropped",
)


def compared(method: str, report: SimulationReport) -> tuple[str, ...]:
    """Return a row of the comparison, under `COMPARED`."""
    uses = sum(each.uses for each in report.chains if each.deadline is not None)
    old = sum(each.missed for each in report.chains)
    longest = max((each.lasts for each in report.outages), default=None)
    return (
        method,
        f"{share(report.missed, report.due):.2%}" if report.due else "",
        ", ".join(f"{c.computer} {c.cpu:.0%} ({c.peak:.0%})" for c in report.loads),
        f"{share(old, uses):.2%}" if uses else "",
        str(len(report.moves)),
        str(len(report.outages)),
        "" if longest is None else format_seconds(longest),
        str(report.dropped),
    )


def _missed(report: SimulationReport) -> str:
    if not report.due:
        return "no timer has a deadline"
    if not report.missed:
        return f"none of {counted(report.due, 'deadline')} missed"
    part = share(report.missed, report.due)
    return f"{report.missed} of {counted(report.due, 'deadline')} missed ({part:.2%})"


def _stopped(report: SimulationReport) -> str:
    names = list(dict.fromkeys(each.function for each in report.outages))
    if not names:
        return "no function stopped"
    longest = max(each.lasts for each in report.outages)
    what = f"{len(names)} functions" if len(names) > 1 else names[0]
    return f"{what} stopped, for up to {format_seconds(longest)}"


def _computers(report: SimulationReport) -> Table:
    rows = table(
        "computer", "CPU mean", "peak", "memory", "components at first", folds=4
    )
    for load in report.loads:
        shares = f"{load.cpu:.1%}", f"{load.peak:.1%}"
        here = escape(_components_on(report, load.computer))
        rows.add_row(escape(load.computer), *shares, _memory(load), here)
    return rows


def _components_on(report: SimulationReport, computer: str) -> str:
    here = (name for name, at in report.placement.items() if at == computer)
    return ", ".join(sorted(here))


def _memory(load: SimulatedLoad) -> str:
    """Return the most memory that a computer needed, and what it has if known."""
    has = load.memory_capacity
    known = f" of {format_bytes(has)}" if has is not None and isfinite(has) else ""
    return f"{format_bytes(load.memory)}{known}"


def _timers(report: SimulationReport) -> Iterator[RenderableType]:
    rows = table("timer", "period", "deadline", "missed", "share")
    timers = [each for each in late(report.timers) if each.missed]
    for timer in timers[:MOST_ROWS]:
        rows.add_row(
            escape(f"{timer.component}.{timer.timer}"),
            format_seconds(timer.period),
            format_seconds(timer.deadline or 0.0),
            f"{timer.missed} of {timer.due}",
            f"{share(timer.missed, timer.due):.2%}",
        )
    yield from _rows(rows, len(timers), "late timer")


def _chains(report: SimulationReport) -> Iterator[Table]:
    rows = table(
        "chain,\ndata age", "deadline", "used", "missed", "median", "p99", "maximum"
    )
    for chain in report.chains:
        until = "" if chain.deadline is None else format_seconds(chain.deadline)
        head = escape(chain.name), until, str(chain.uses)
        if not chain.uses:
            rows.add_row(*head)
            continue
        part = f"{share(chain.missed, chain.uses):.1%}" if until else ""
        ages = map(format_seconds, (chain.median, chain.p99, chain.maximum))
        rows.add_row(*head, part, *ages)
    return filled(rows)


def _faults(report: SimulationReport) -> Iterator[str]:
    faults = [each for each in report.events if each.who == _FAULT]
    for each in faults[:MOST_ROWS]:
        yield escape(f"fault at {each.what}")
    yield from _more(len(faults), "fault")


def _moves(report: SimulationReport) -> Iterator[RenderableType]:
    rows = table("at", "component", "from", "to", "how", "downtime", "why", folds=6)
    for move in report.moves[:MOST_ROWS]:
        where = move.component, move.before, move.after, move.kind
        cells = span(move.at), *where, format_seconds(move.downtime), move.why
        rows.add_row(*map(escape, cells))
    yield from _rows(rows, len(report.moves), "move")


def _outages(report: SimulationReport) -> Iterator[RenderableType]:
    rows = table("at", "function that stopped", "for", "components", folds=3)
    for outage in report.outages[:MOST_ROWS]:
        lasts = format_seconds(outage.lasts) + ("" if outage.over else ", to the end")
        components = ", ".join(outage.components)
        cells = span(outage.at), outage.function, lasts, components
        rows.add_row(*map(escape, cells))
    yield from _rows(rows, len(report.outages), "outage")


def _messages(report: SimulationReport) -> str:
    sentences = [f"{counted(report.messages, 'message')} processed"]
    if report.dropped:
        sentences.append(f"{report.dropped} dropped because newer ones came")
    if report.calls:
        sentences.append(f"{counted(report.calls, 'call')} answered")
    if report.failed_calls:
        sentences.append(f"{report.failed_calls} not answered")
    return ", ".join(sentences)


def _rows(rows: Table, count: int, noun: str) -> Iterator[RenderableType]:
    yield from filled(rows)
    yield from _more(count, noun)


def _more(count: int, noun: str) -> Iterator[str]:
    if count > MOST_ROWS:
        yield f"{counted(count - MOST_ROWS, f'more {noun}')}; `--json` has all"


_MOST_LATE, _MOST_EVENTS = 20, 1000
_FAULT = "fault"
"""Who injected an event, instead of a manager."""
_ABOUT_TIME = (
    "<p>CPU as a share of each computer's. Dashed lines are faults and moves, by "
    "number. Red bars are functions that did not work.</p>"
)


def simulation_page(simulation: SimulationReport, figures: str) -> str:
    """Return the page: the verdict, what happened when, what was late, all figures."""
    title = f"{simulation.robot}: {simulation.task}, simulated"
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        *_pictures(simulation),
        "<h2>All figures</h2>",
        figures,
    ]
    return document(title, "\n".join(parts))


def comparison_page(results: Mapping[str, SimulationReport], figures: str) -> str:
    """Return the page: all placements side by side, then each by itself."""
    title = "Placements, simulated"
    parts = [f"<h1>{title}</h1>", figures]
    for method, simulation in results.items():
        parts.append(f"<h1>{html.escape(method)}</h1>")
        parts += _pictures(simulation)
    return document(title, "\n".join(parts))


def _pictures(report: SimulationReport) -> Iterator[str]:
    yield f'<p class="verdict">{html.escape(verdict(report))}</p>'
    yield f"<p>{html.escape(_took(report))}</p>"
    yield "<h2>Over time</h2>"
    yield _ABOUT_TIME
    yield simulation_picture(report)
    yield "<h2>Deadlines missed</h2>"
    yield from _late(report)
    yield "<h2>What ran where at first</h2>"
    heads = "computer", "CPU mean (peak)", "components"
    yield html_table(heads, _placed(report))
    yield "<h2>What happened</h2>"
    yield from _happened(report)


def _marked(report: SimulationReport) -> dict[int, SimulatedEvent]:
    """Return faults and moves by number, in turn."""
    faults = [each for each in report.events if each.who == _FAULT]
    moves = [
        SimulatedEvent(
            at=move.at,
            who="manager",
            kind=move.kind,
            what=f"{move.component}: {move.before} → {move.after}"
            + (f", {move.why}" if move.why else ""),
        )
        for move in report.moves
    ]
    return dict(enumerate(sorted([*faults, *moves], key=lambda each: each.at), 1))


def simulation_picture(report: SimulationReport) -> str:
    """Return CPU, faults, moves and outages over time, as SVG."""
    marks = {n: Mark(each.at, each.what) for n, each in _marked(report).items()}
    strips = {f"CPU {load.computer}": load.over_time for load in report.loads}
    bars: dict[str, list[tuple[float, float]]] = {}
    for each in report.outages:
        bars.setdefault(each.function, []).append((each.at, each.at + each.lasts))
    end = max(report.seconds, 1.0)
    label = "CPU, faults, moves and outages over time"
    return over_time(strips, marks, end, label, bars, every=end)


def _late(report: SimulationReport) -> Iterator[str]:
    """Yield a bar for each timer that was late, the worst first."""
    timers = [each for each in late(report.timers) if each.missed]
    if not timers:
        none = "None was missed" if report.due else "No timer has a deadline"
        yield f"<p>{none}.</p>"
    for timer in timers[:_MOST_LATE]:
        part = share(timer.missed, timer.due)
        value = f"{timer.missed} of {timer.due} ({part:.2%})"
        yield bar_row(f"{timer.component}.{timer.timer}", value, part)
    if more := timers[_MOST_LATE:]:
        yield f"<p>{len(more)} more missed some.</p>"


def _placed(report: SimulationReport) -> Iterator[tuple[str, ...]]:
    for load in report.loads:
        cpu, here = f"{load.cpu:.1%} ({load.peak:.1%})", load.computer
        yield html.escape(here), cpu, html.escape(_components_on(report, here))


def _happened(report: SimulationReport) -> Iterator[str]:
    """Yield faults and moves with their numbers, and what managers journalled."""
    journal = [("", each) for each in report.events if each.who != _FAULT]
    marked = [(str(number), each) for number, each in _marked(report).items()]
    every = [*marked, *journal]
    every.sort(key=lambda each: each[1].at)
    rows = (
        (n, f"{e.at:.1f} s", *map(html.escape, (e.who, e.kind, e.what)))
        for n, e in every[:_MOST_EVENTS]
    )
    yield html_table(("#", "at", "who", "kind", "what"), rows)
    if more := every[_MOST_EVENTS:]:
        yield f"<p>{len(more)} more; <code>--json</code> has all.</p>"
