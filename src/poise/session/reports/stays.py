"""Adds up what a component counted in each place where it ran. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import TypeVar

from msgspec.structs import replace

from poise.wire.records.status import (
    ChainStatus,
    ComponentStatus,
    ErrorCount,
    Summary,
    TimerStatus,
)

T = TypeVar("T", TimerStatus, ChainStatus)


def whole(stays: Sequence[ComponentStatus]) -> ComponentStatus:
    """Return the last status, with the counts of all stays, first to last.

    Medians and 99th percentiles are those of the stay with most values.
    """
    return reduce(_after, stays)


def _after(before: ComponentStatus, last: ComponentStatus) -> ComponentStatus:
    measures = dict(before.measures)
    for name, values in last.measures.items():
        measures[name] = together(measures.get(name, Summary()), values)
    return replace(
        last,
        errors=before.errors + last.errors,
        error_counts=_errors(before.error_counts + last.error_counts),
        cpu=before.cpu + last.cpu,
        timers=tuple(_timer(_same(before.timers, each), each) for each in last.timers),
        chains=tuple(_chain(_same(before.chains, each), each) for each in last.chains),
        measures=measures,
    )


def together(one: Summary, other: Summary) -> Summary:
    """Return the summary of the values of both.

    It is exact but for median and 99th percentile: these are of the larger one.
    """
    count = one.count + other.count
    if not count:
        return one
    larger = one if one.count > other.count else other
    return replace(
        larger,
        count=count,
        mean=(one.count * one.mean + other.count * other.mean) / count,
        maximum=max(each.maximum for each in (one, other) if each.count),
    )


def _same(before: Iterable[T], now: T) -> T | None:
    return next((each for each in before if each.name == now.name), None)


def _timer(before: TimerStatus | None, last: TimerStatus) -> TimerStatus:
    if before is None:
        return last
    return replace(
        last,
        releases=before.releases + last.releases,
        missed=before.missed + last.missed,
        lateness=together(before.lateness, last.lateness),
        duration=together(before.duration, last.duration),
    )


def _chain(before: ChainStatus | None, last: ChainStatus) -> ChainStatus:
    if before is None:
        return last
    missed, age = before.missed + last.missed, together(before.age, last.age)
    return replace(last, missed=missed, age=age)


def _errors(errors: Iterable[ErrorCount]) -> tuple[ErrorCount, ...]:
    found: dict[tuple[str, str], ErrorCount] = {}
    for each in errors:
        key = each.where, each.text
        known = found.get(key)
        count = each.count + (known.count if known else 0)
        found[key] = replace(known or each, count=count)
    return tuple(found.values())
