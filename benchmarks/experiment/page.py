"""The experiment as one HTML page, which needs no other file and no network.

It imports internal modules: its page looks as reports do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape

import msgspec

from benchmarks.experiment.analysis import Comparison
from benchmarks.experiment.results import BASE, LOADS, Extent, TrialResult
from benchmarks.experiment.summary import ArmSummary, ExperimentReport, Share
from poise.session.render.picture import line, svg, text
from poise.session.render.report_page import document, html_table
from poise.units import format_seconds

_COLOURS = (
    "#c0392b",
    "#e08214",
    "#8e44ad",
    "#7f8c8d",
    "#8c6d31",
    "#17becf",
    "#1f77b4",
    "#2e8b57",
    "#d6649a",
    "#444444",
)
_LEFT, _WIDTH, _ROW = 170.0, 960.0, 22.0


def intervals(shares: Mapping[str, Mapping[str, Share]]) -> str:
    """Return a dot with its interval for each function and arm.

    Parameters
    ----------
    shares
        Function -> arm -> how often it worked.
    """
    parts: list[str] = []
    y = _ROW
    for function, arms in shares.items():
        parts.append(text(0, y, function, font_weight="bold"))
        for number, (arm, share) in enumerate(arms.items()):
            parts += _dot(arm, share, y, _COLOURS[number % len(_COLOURS)])
            y += _ROW
        y += _ROW / 2
    for tenth in (0, 0.25, 0.5, 0.75, 1):
        x = _x(tenth)
        parts.insert(0, line([(x, 8), (x, y - _ROW)], "#8884"))
        parts.append(text(x, y + 4, f"{tenth:.0%}", text_anchor="middle"))
    return svg(_WIDTH, y + 16, "how often each function worked", parts)


def _dot(arm: str, share: Share, y: float, colour: str) -> Iterator[str]:
    yield text(_LEFT + 140, y, arm, text_anchor="end")
    if share.share is None:
        yield text(_x(0) + 6, y, "no valid run")
        return
    yield line([(_x(share.low), y - 4), (_x(share.high), y - 4)], colour, 3)
    yield (
        f'<circle cx="{_x(share.share):.1f}" cy="{y - 4:.1f}" r="5" fill="{colour}">'
        f"<title>{escape(f'{arm}: {share}')}</title></circle>"
    )


def _x(share: float) -> float:
    left = _LEFT + 150
    return left + share * (_WIDTH - left - 40)


def curves(
    lines: Mapping[str, Sequence[tuple[float, float]]], label: str, unit: str
) -> str:
    """Return a line for each arm over the load; both axes are shares.

    Parameters
    ----------
    lines
        Arm -> points (load, share).
    label, unit
        What the shares are of, and what the axis below is.
    """
    points = [point for each in lines.values() for point in each]
    if not points:
        return "<p>No valid run.</p>"
    low, high = min(x for x, _ in points), max(x for x, _ in points)
    height, bottom, top = 330.0, 290.0, 20.0

    def at(load: float, share: float) -> tuple[float, float]:
        along = (load - low) / (high - low) if high > low else 0.5
        return 60 + along * (_WIDTH - 280), bottom - share * (bottom - top)

    parts = []
    for share in (0, 0.25, 0.5, 0.75, 1):
        _, y = at(low, share)
        parts.append(line([(60, y), (_WIDTH - 220, y)], "#8884"))
        parts.append(text(52, y + 4, f"{share:.0%}", text_anchor="end"))
    for load in sorted({x for x, _ in points}):
        x, _ = at(load, 0)
        parts.append(text(x, bottom + 18, f"{load:.0%}", text_anchor="middle"))
    parts.append(text(60, height - 4, unit))
    for number, (arm, shares) in enumerate(lines.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        parts.append(line([at(*point) for point in shares], colour, 2.5))
        y = top + 12 + number * _ROW
        parts.append(line([(_WIDTH - 200, y - 4), (_WIDTH - 170, y - 4)], colour, 3))
        parts.append(text(_WIDTH - 162, y, arm))
    return svg(_WIDTH, height, label, parts)


_HOW = """<p>Each run is of real processes on emulated computers, in a simulated world,
which alone says what worked. Of each seed all arms run, in an order of its own: what
else this machine does hits all alike. Intervals are Wilson's, of 95 %. Timers begin in
each run with phases of their own; ages are medians over the runs. A run whose simulated
world or measurement broke, or in which this machine was too busy, is invalid: it counts
nowhere else, and is made again when the experiment goes on.</p>"""
_LOAD = """<p>Under a load of 120 % all computers are slower by a factor of 1.2; 100 %
is the robot file. The planner knows the load, but neither the overrun, where a
component has half as much to do more than when its demand was measured, nor the other
program.</p>"""
_RAW = """<h2>Raw data</h2><p>A line of JSON for each run, as in
<code>results.jsonl</code> beside this page.</p>"""


def experiment_page(
    report: ExperimentReport, extent: Extent, results: Sequence[TrialResult]
) -> str:
    """Return the page: what works, where each arm breaks, all tables, the raw data."""
    base = [each for each in report.arms if each.condition == BASE]
    arms = [(escape(arm.name), escape(arm.what)) for arm in extent.arms]
    parts = [
        f"<h1>{escape(report.robot)}: what placement is worth</h1>",
        f"<p><b>{escape(report.headline)}</b></p>",
        _counted(report),
        _HOW,
        html_table(("arm", "placement"), arms),
        *_comparisons(report.comparisons, report.criteria),
        "<h2>Which functions work</h2>",
        intervals(
            {
                name: {each.placement: each.success[name] for each in base}
                for name in (base[0].success if base else ())
            }
        ),
        *_load_curves(report.arms),
        *_tables(report.arms),
        *_invalid(results),
        _RAW,
        '<script type="application/jsonl" id="results">',
        *(_line(each) for each in results),
        "</script>",
    ]
    return document(f"{report.robot}: experiment", "\n".join(parts))


_CRITERIA = """<p>Measures, exclusions and analysis were written down before the data
(<code>benchmarks/experiment/criteria.md</code>{commit}). Of each run the chain
counts that missed its declared deadline most; a chain whose data never came missed all.
An effect is Poise's share minus the other's, of runs with the same seed: the
Hodges-Lehmann estimate and its bootstrap interval of 95 %; p is of Wilcoxon's
signed-rank test, adjusted by Holm.</p>"""


def _comparisons(comparisons: Sequence[Comparison], criteria: str) -> Iterator[str]:
    """Yield a table for each condition: how Poise did against each other way."""
    yield "<h2>Poise against the others</h2>"
    yield _CRITERIA.format(commit=f", commit {escape(criteria)}" if criteria else "")
    for condition in dict.fromkeys(each.condition for each in comparisons):
        rows = [
            (
                escape(each.other),
                each.verdict,
                _effect(each),
                _p(each.p),
                f"{each.pairs}",
            )
            for each in comparisons
            if each.condition == condition
        ]
        yield f"<h3>{escape(condition)}</h3>"
        yield html_table(("against", "Poise is", "points missed", "p", "pairs"), rows)


def _effect(found: Comparison) -> str:
    if found.effect is None or found.low is None or found.high is None:
        return ""
    low, high = 100 * found.low, 100 * found.high
    return f"{100 * found.effect:+.1f} ({low:+.1f} to {high:+.1f})"


def _p(value: float | None) -> str:
    return "" if value is None else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _counted(report: ExperimentReport) -> str:
    invalid = sum(each.invalid for each in report.arms)
    valid = sum(each.runs for each in report.arms) - invalid
    runs = f"{valid} valid runs of {report.planned}, {report.seconds:g} s each"
    return f"<p>{runs}; {invalid} invalid ones.</p>"


def _invalid(results: Sequence[TrialResult]) -> Iterator[str]:
    rows = [
        (
            escape(each.trial.arm),
            escape(each.trial.condition),
            str(each.trial.seed),
            escape(each.invalid),
        )
        for each in results
        if each.invalid
    ]
    if rows:
        yield "<h2>Invalid runs</h2>"
        yield html_table(("way", "condition", "seed", "why"), rows)


def _line(result: TrialResult) -> str:
    """Return a result as JSON that cannot end the element around it."""
    return msgspec.json.encode(result).decode().replace("<", "\\u003c")


def _load_curves(arms: Sequence[ArmSummary]) -> Iterator[str]:
    """Yield where each arm breaks; nothing when only one load was tried."""
    loads = {BASE: 1.0} | {each.name: each.load for each in LOADS}
    tried = sorted(
        (each for each in arms if each.condition in loads),
        key=lambda each: loads[each.condition],
    )
    if len({each.condition for each in tried}) == 1:
        return
    works: dict[str, list[tuple[float, float]]] = {}
    misses: dict[str, list[tuple[float, float]]] = {}
    for each in tried:
        load = loads[each.condition]
        shares = [s.share for s in each.success.values() if s.share is not None]
        # each arm has its place, and with that its colour, in both
        works_here = works.setdefault(each.placement, [])
        misses_here = misses.setdefault(each.placement, [])
        missed = [m for m in each.deadline_miss_share.values() if m is not None]
        if shares:
            works_here.append((load, sum(shares) / len(shares)))
        if missed:
            misses_here.append((load, max(missed)))
    yield "<h2>Where each arm breaks</h2>"
    yield _LOAD
    yield "<h3>Functions that worked</h3>"
    yield curves(works, "functions that worked, by load", "load")
    yield "<h3>Deadlines missed by the worst chain</h3>"
    yield curves(misses, "deadlines missed by the worst chain, by load", "load")


def _tables(arms: Sequence[ArmSummary]) -> Iterator[str]:
    """Yield all figures, condition by condition."""
    for condition in dict.fromkeys(each.condition for each in arms):
        here = [each for each in arms if each.condition == condition]
        names = [escape(each.placement) for each in here]
        yield f"<h2>All figures: {escape(condition)}</h2>"
        yield html_table(("", *names), _rows(here))


def _rows(arms: Sequence[ArmSummary]) -> Iterator[tuple[str, ...]]:
    yield "runs (invalid)", *(f"{each.runs} ({each.invalid})" for each in arms)
    yield "all functions worked", *(str(each.all_worked) for each in arms)
    for name in arms[0].success:
        yield f"{escape(name)} worked", *(str(each.success[name]) for each in arms)
    yield from _named(
        "chain {}: missed", [each.deadline_miss_share for each in arms], _percent
    )
    yield from _named("chain {}: age, median", [each.ages for each in arms], _time)
    yield from _named("chain {}: age, p99", [each.ages_p99 for each in arms], _time)
    yield from _named(
        "timer {}: missed", [each.timer_miss_share for each in arms], _percent
    )
    yield from _named("CPU of {}", [each.cpu_share for each in arms], _percent)
    yield (
        "path error",
        *(
            "" if each.path_error is None else f"{100 * each.path_error:.1f} cm"
            for each in arms
        ),
    )
    yield "placement decided in", *(_time(each.decision_seconds) for each in arms)
    yield "moves", *("" if each.moves is None else f"{each.moves:g}" for each in arms)
    yield (
        "suspended",
        *(
            escape(", ".join(f"{name} in {n}" for name, n in each.suspended.items()))
            for each in arms
        ),
    )


def _named(
    label: str,
    columns: Sequence[Mapping[str, float | None]],
    shown: Callable[[float | None], str],
) -> Iterator[tuple[str, ...]]:
    """Yield a row for each name in any column."""
    for name in dict.fromkeys(name for column in columns for name in column):
        head = escape(label.format(name))
        yield head, *(shown(column.get(name)) for column in columns)


def _percent(share: float | None) -> str:
    return "" if share is None else f"{share:.1%}"


def _time(seconds: float | None) -> str:
    return "" if seconds is None else format_seconds(seconds)
