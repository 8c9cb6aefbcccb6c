"""A run's report as one HTML page, which needs no other file and no network."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, NamedTuple

from poise.manage.journal import JournalEntry
from poise.session.render.picture import Point, line, svg, text
from poise.session.run_records import Moment
from poise.units import counted, format_seconds

if TYPE_CHECKING:
    from poise.session.run_report import RunReport

_WIDTH, _LEFT, _HEIGHT, _GAP = 960, 130, 56, 14
"""Of the picture, of the names on its left, of a strip, and between strips [pixels]."""
_MOST_NUMBERS = 40
"""Entries that are numbered; of more, there are lines without numbers."""
_DIGIT = 6
"""What a digit of a number takes [pixels]; numbers that would overlap are joined."""
_STEPS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 86400)
_MISSED = "worst missed"
_DASHED = 'stroke-dasharray="3 2"'
_BAR = 18
"""The height of a row of bars [pixels]."""


class Mark(NamedTuple):
    """Something that happened at a moment [s]."""

    at: float
    says: str


def time_line(report: RunReport, entries: Mapping[int, JournalEntry]) -> str:
    """Return CPU and missed deadlines over time, with numbered journal entries."""
    began, moments = report.began, report.history
    end = max(report.seconds, 1.0)
    names = [n for each in moments for n in each.cpu_share]
    names += [*report.cpu_share, *(each.computer for each in report.components)]
    strips: dict[str, list[Point]] = {
        f"CPU {name}": [
            (m.at - began, m.cpu_share[name]) for m in moments if name in m.cpu_share
        ]
        or [(report.seconds, s) for n, s in report.cpu_share.items() if n == name]
        for name in dict.fromkeys(names)
    }
    strips[_MISSED] = [
        (m.at - began, max(m.missed.values(), default=0.0)) for m in moments
    ]
    marks = {
        number: Mark(entry.at - began, str(entry))
        for number, entry in entries.items()
        if entry.at >= began
    }
    return over_time(strips, marks, end, "CPU and missed deadlines over time")


def over_time(
    strips: Mapping[str, Sequence[Point]],
    marks: Mapping[int, Mark],
    end: float,
    label: str,
    bars: Mapping[str, Sequence[tuple[float, float]]] | None = None,
    *,
    every: float = 1.0,
) -> str:
    """Return shares over time [s], rows of bars [s] below, and marks through all."""
    rows = bars or {}
    below = _GAP + len(strips) * (_HEIGHT + _GAP)
    height = below + len(rows) * _BAR + _GAP + 10
    parts = [*_axis(end, height), *_marks(marks, end, height)]
    for row, (name, points) in enumerate(strips.items()):
        parts += _strip(name, points, _GAP + row * (_HEIGHT + _GAP), end, every)
    for row, (name, spans) in enumerate(rows.items()):
        parts += _bars(name, spans, below + row * _BAR, end)
    return svg(_WIDTH, height, label, parts)


def _x(seconds: float, end: float) -> float:
    share = min(1.0, max(0.0, seconds / end))
    return _LEFT + share * (_WIDTH - _LEFT - 20)


def _axis(end: float, height: int) -> Iterator[str]:
    step = next((s for s in _STEPS if end / s <= 10), _STEPS[-1])  # noqa: PLR2004
    for second in range(0, int(end) + 1, step):
        x = _x(second, end)
        yield line([(x, _GAP), (x, height - 22)], "#8884")
        yield text(x, height - 6, f"{second} s", text_anchor="middle")


def _marks(marks: Mapping[int, Mark], end: float, height: int) -> Iterator[str]:
    for at, what in marks.values():
        x = _x(at, end)
        says = f"<title>{escape(what)}</title>"
        mark = line([(x, 0), (x, height - 22)], "#d98c00", 1.5, _DASHED)
        yield f"<g>{says}{mark}</g>"
    if len(marks) > _MOST_NUMBERS:
        return
    numbers: list[tuple[float, str]] = []
    for number, (at, _) in marks.items():
        x, says = _x(at, end), str(number)
        if numbers and x < numbers[-1][0] + _DIGIT * len(numbers[-1][1]):
            x, before = numbers.pop()
            says = f"{before.partition('-')[0]}-{number}"
        numbers.append((x, says))
    for x, says in numbers:
        left = min(x + 2, _WIDTH - _DIGIT * len(says))
        yield text(left, 11, says, font_size=10)


def _bars(
    name: str, spans: Sequence[tuple[float, float]], top: float, end: float
) -> Iterator[str]:
    """Yield a row of bars; the shortest is still seen."""
    yield text(_LEFT - 8, top + 12, name, text_anchor="end")
    for begin, over in spans:
        x, y = _x(begin, end), top + _BAR / 2
        says = f"<title>{escape(f'{name}: {begin:.1f} s to {over:.1f} s')}</title>"
        bar = line([(x, y), (max(x + 2, _x(over, end)), y)], "#c0392b", _BAR - 6)
        yield f"<g>{says}{bar}</g>"


def _strip(
    name: str, points: Sequence[Point], top: float, end: float, every: float
) -> Iterator[str]:
    """Yield shares over time; the top is 1, or the most if that is more."""
    most = max([1.0, *(share for _, share in points)])
    bottom = top + _HEIGHT
    colour = "#c0392b" if name == _MISSED else "#3b7dd8"
    left, scale = _LEFT - 8, f"0 to {most:.0%}"
    yield text(left, top + 12, name, text_anchor="end")
    yield text(left, bottom, scale, text_anchor="end", font_size=10)
    yield line([(_LEFT, bottom), (_WIDTH - 20, bottom)], "#888")
    if not points:
        return
    began = max(0.0, points[0][0] - every)
    steps = [f"M{_x(began, end):.1f} {bottom}"]
    for at, share in points:  # which is of the time before it
        steps.append(f"V{bottom - share / most * _HEIGHT:.1f}H{_x(at, end):.1f}")
    path = "".join(steps)
    closed = f"{path}V{bottom}H{_x(began, end):.1f}Z"
    yield (
        f'<path d="{closed}" fill="{colour}33"/>'
        f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.5"/>'
    )


_AROUND = 1.0
"""What happened so long before and after a second is shown [s]."""
_FULL = 0.95
"""A computer that used more of its CPU was overloaded, or almost."""
_MOST_DEADLINES = 8
_ABOUT_TIME = (
    "<p>CPU as a share of each computer's; the share of deadlines that the worst timer "
    "or chain missed. Dashed lines are what happened, by number.</p>"
)

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width">
<style>
:root {{ color-scheme: light dark }}
body {{ font: 15px/1.45 system-ui, sans-serif; max-width: 66em; margin: 1.5em auto;
  padding: 0 1em }}
h2 {{ margin-top: 1.6em; border-bottom: 1px solid #8888 }}
table {{ border-collapse: collapse; display: block; overflow-x: auto }}
th, td {{ text-align: left; vertical-align: top; padding: .25em 1em .25em 0;
  border-bottom: 1px solid #8884 }}
td:first-child, td:nth-child(2) {{ white-space: nowrap }}
svg {{ width: 100%; height: auto; fill: currentColor }}
pre {{ overflow-x: auto }}
.verdict {{ font-weight: bold }}
</style></head><body>
{body}
</body></html>
"""


def page(report: RunReport, picture: str, figures: str) -> str:
    """Return the page: the verdict, where and when what happened, then all figures."""
    entries = dict(enumerate(_events(report), 1))
    title = f"{report.robot}: {report.task}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{escape(report.method)} placement, active for {report.seconds:.1f} s</p>",
        f'<p class="verdict">{escape(_verdict(report))}</p>',
        "<h2>What ran where</h2>",
        picture,
        "<h2>Over time</h2>",
        _ABOUT_TIME,
        time_line(report, entries),
        "<h2>Worst deadlines</h2>",
        *_worst(report, entries),
        "<h2>What happened</h2>",
        _journal(entries, report.began),
        "<h2>All figures</h2>",
        figures,
    ]
    return document(title, "\n".join(parts))


def document(title: str, body: str) -> str:
    """Return an HTML page with our style."""
    return _PAGE.format(title=escape(title), body=body)


def _events(report: RunReport) -> list[JournalEntry]:
    """Return what the manager saw and did, and the containers that ended, in turn."""
    faults = [
        JournalEntry(each.at, "wrong", each.message, {}) for each in report.faults
    ]
    return sorted([*report.journal, *faults], key=lambda each: each.at)


def _verdict(report: RunReport) -> str:
    if report.invalid:
        return f"✗ invalid run: {report.invalid}"
    if report.failed:
        return "✗ failed: errors, faults or suspended architectures are at the end"
    early = ", and was ended early" if report.interrupted else ""
    deadlines = [*_deadlines(report)]
    missed = "nothing has a deadline"
    if deadlines:
        missed = f"{counted(sum(d.missed for d in deadlines), 'deadline')} missed"
    return f"✓ ran without a fault{early}; {missed}"


class _Deadline(NamedTuple):
    """How a timer or chain kept its deadline [s] in the whole run."""

    name: str
    deadline: float
    times: int
    missed: int
    p99: float
    where: str

    @property
    def share(self) -> float:
        return self.missed / self.times if self.times else 0.0


def _deadlines(report: RunReport) -> Iterator[_Deadline]:
    for component in report.components:
        for timer in component.timers:
            if timer.deadline is not None:
                p99 = timer.lateness.p99 + timer.duration.p99
                counts = timer.releases, timer.missed, p99, component.computer
                yield _Deadline(
                    f"{component.name}.{timer.name}", timer.deadline, *counts
                )
    for chain in report.chains:
        where = " → ".join(hop.computer for hop in chain.hops)
        counts = chain.age.count, chain.missed, chain.age.p99, where
        yield _Deadline(chain.name, chain.deadline, *counts)


def _worst(report: RunReport, entries: Mapping[int, JournalEntry]) -> Iterator[str]:
    """Yield the deadlines that were missed most, and what happened around them."""
    missed = sorted(
        (each for each in _deadlines(report) if each.missed),
        key=lambda each: -each.share,
    )
    if never := ", ".join(d.name for d in _deadlines(report) if not d.times):
        yield f"<p>Nothing is known of {escape(never)}: never due, or never used.</p>"
    if not missed:
        yield "<p>None was missed.</p>"
        return
    rows = []
    for late in missed[:_MOST_DEADLINES]:
        moments = [m for m in report.history if late.name in m.missed]
        worst = max(moments, key=lambda m: m.missed[late.name], default=None)
        around = _around(late.name, worst, entries, report.began) if worst else ""
        where = escape(f"{late.name}, {late.where}")
        share = f"{late.missed} of {late.times} ({late.share:.1%})"
        p99 = f"{format_seconds(late.p99)} of {format_seconds(late.deadline)}"
        rows.append((where, share, p99, around))
    head = "timer or chain, computer", "missed", "p99, deadline", "at its worst"
    yield html_table(head, rows)
    if more := missed[_MOST_DEADLINES:]:
        names = ", ".join(each.name for each in more)
        yield f"<p>{len(more)} more missed some: {escape(names)}</p>"


def _around(
    name: str, moment: Moment, entries: Mapping[int, JournalEntry], began: float
) -> str:
    """Return what else there was in the second when a timer or chain missed most."""
    cpu = ", ".join(
        f"{c} {share:.0%}{' (overloaded)' if share > _FULL else ''}"
        for c, share in moment.cpu_share.items()
    )
    others = [each for each in moment.missed if each != name]
    lines = [
        f"{moment.at - began:.0f} s: {moment.missed[name]:.0%} in a second",
        f"CPU: {cpu}" if cpu else "",
        f"late as well: {', '.join(others[:5])}" if others else "",
        *(
            f"#{number} {entry.what}"
            for number, entry in entries.items()
            if -1 - _AROUND <= entry.at - moment.at <= _AROUND
        ),
    ]
    return "<br>".join(escape(line) for line in lines if line)


def _journal(entries: Mapping[int, JournalEntry], began: float) -> str:
    rows = [
        (str(n), f"{entry.at - began:z.1f} s", entry.kind, escape(entry.what))
        for n, entry in entries.items()
    ]
    return html_table(("#", "at", "kind", "what"), rows)


def html_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table of cells that are HTML."""
    heads = "".join(f"<th scope=col>{name}</th>" for name in head)
    lines = ("".join(f"<td>{cell}</td>" for cell in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><tr>{heads}</tr>{body}</table>"
