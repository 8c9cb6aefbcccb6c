"""A simulation as one HTML page, which needs no other file and no network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape

from poise.session.render.picture import bar_row
from poise.session.render.report_page import Mark, document, html_table, over_time
from poise.session.render.simulation_tables import late, share, took, verdict
from poise.simulation.simulation_report import SimulatedEvent, SimulationReport

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
        f"<h1>{escape(title)}</h1>",
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
        parts.append(f"<h1>{escape(method)}</h1>")
        parts += _pictures(simulation)
    return document(title, "\n".join(parts))


def _pictures(report: SimulationReport) -> Iterator[str]:
    """Yield a simulation in words and pictures."""
    yield f'<p class="verdict">{escape(verdict(report))}</p>'
    yield f"<p>{escape(took(report))}</p>"
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
            at=each.at,
            who="manager",
            kind=each.kind,
            what=f"{each.component}: {each.before} → {each.after}"
            + (f", {each.why}" if each.why else ""),
        )
        for each in report.moves
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
        yield "<p>None was missed.</p>"
    for each in timers[:_MOST_LATE]:
        part = share(each.missed, each.due)
        value = f"{each.missed} of {each.due} ({part:.2%})"
        yield bar_row(f"{each.component}.{each.timer}", value, part)
    if more := timers[_MOST_LATE:]:
        yield f"<p>{len(more)} more missed some.</p>"


def _placed(report: SimulationReport) -> Iterator[tuple[str, ...]]:
    for load in report.loads:
        here = (c for c, at in report.placement.items() if at == load.computer)
        cpu = f"{load.cpu:.1%} ({load.peak:.1%})"
        yield escape(load.computer), cpu, escape(", ".join(sorted(here)))


def _happened(report: SimulationReport) -> Iterator[str]:
    """Yield faults and moves with their numbers, and what managers journalled."""
    journal = [("", each) for each in report.events if each.who != _FAULT]
    marked = [(str(number), each) for number, each in _marked(report).items()]
    every = [*marked, *journal]
    every.sort(key=lambda each: each[1].at)
    rows = (
        (number, f"{each.at:.1f} s", *map(escape, (each.who, each.kind, each.what)))
        for number, each in every[:_MOST_EVENTS]
    )
    yield html_table(("#", "at", "who", "kind", "what"), rows)
    if more := every[_MOST_EVENTS:]:
        yield f"<p>{len(more)} more; <code>--json</code> has all.</p>"
