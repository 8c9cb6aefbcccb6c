"""A run from second to second, as SVG that stands alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, NamedTuple

from poise.manage.journal import JournalEntry
from poise.session.render.html.svg import Point, line, svg, text

if TYPE_CHECKING:
    from poise.session.reports.history import Moment

_WIDTH, _LEFT, _HEIGHT, _GAP = 960, 130, 56, 14
"""Of the picture, of the names on its left, of a strip, and between strips [pixels]."""
_MOST_NUMBERS = 40
"""Entries that are numbered; of more, there are lines without numbers."""
_STEPS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 86400)
_MISSED = "worst missed"
_DASHED = 'stroke-dasharray="3 2"'
_BAR = 18
"""The height of a row of bars [pixels]."""


class Mark(NamedTuple):
    """Something that happened at a moment [s]."""

    at: float
    says: str


def time_line(
    moments: Sequence[Moment],
    entries: Mapping[int, JournalEntry],
    began: float,
    seconds: float,
) -> str:
    """Return a strip for each computer's CPU, and one for missed deadlines.

    Entries of the journal are lines through all of them, with their numbers.
    """
    end = max(seconds, 1.0)
    names = list(dict.fromkeys(n for each in moments for n in each.cpu_share))
    strips = {
        f"CPU {name}": [
            (m.at - began, m.cpu_share[name]) for m in moments if name in m.cpu_share
        ]
        for name in names
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
    """Return strips of shares over time, rows of bars below, and marks through all.

    Parameters
    ----------
    strips
        Name -> moments [s], and the share of the time before each.
    end
        Of the time that is shown [s].
    bars
        Name -> when each bar begins and ends [s].
    every
        How much time the first moment of each strip stands for [s].
    """
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
    for number, (at, what) in marks.items():
        x = _x(at, end)
        says = f"<title>{escape(what)}</title>"
        mark = line([(x, 0), (x, height - 22)], "#d98c00", 1.5, _DASHED)
        told = text(x + 2, 11, str(number), font_size=10)
        yield f"<g>{says}{mark}{told if len(marks) <= _MOST_NUMBERS else ''}</g>"


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
