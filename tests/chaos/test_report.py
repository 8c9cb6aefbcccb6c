"""Which overlaps of incarnations break a promise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from msgspec.structs import replace

from examples.demo.overlaps import Overlap
from tests.chaos.faults import Fault
from tests.chaos.report import ChaosReport


def judged(overlap: Overlap, *faults: Fault) -> ChaosReport:
    """Return the report of a run that began at 100 s."""
    report = ChaosReport(seed=1, events=Counter(), trouble=[], settled=[])
    report.judge([overlap], faults, began=100)
    return report


def overlap(*, begun: int = 0, went_on: float = 0.0) -> Overlap:
    """Return one from 110 s to 112 s, of which the older incarnation is on 'a'."""
    return Overlap(
        component="relay",
        computers=("a", "b"),
        processes=(7, 8),
        since=110,
        until=112,
        begun=begun,
        went_on=went_on,
    )


def counts(report: ChaosReport) -> Iterable[int]:
    return report.overlaps, report.unfinished, report.forced


def test_handlers_that_begin_beside_a_later_incarnation() -> None:
    cut = Fault(kind="cut off", on="a", since=105, until=111)
    over = Fault(kind="link slow", on="a b", since=101, until=107)
    report = judged(overlap(begun=3), cut, over)
    assert counts(report) == (1, 0, 0)
    (trouble,) = report.trouble
    assert trouble.startswith("10.0 s: 'relay' worked twice")
    assert trouble.endswith("in force: cut off: a")
    assert "1 overlaps, 0 unfinished, 0 forced" in str(report)


def test_a_handler_may_be_finished_within_the_grace() -> None:
    cut = Fault(kind="cut off", on="a", since=105, until=111)
    short = judged(overlap(went_on=0.9), cut)
    assert (counts(short), short.trouble) == ((1, 1, 0), [])
    assert judged(overlap(went_on=1.1), cut).trouble


def test_nobody_ends_a_handler_while_its_agent_is_stopped() -> None:
    stopped = Fault(
        kind="agent stopped", on="a", since=105, until=109, stops_agent=True
    )
    assert not judged(overlap(went_on=2.0), stopped).trouble
    assert judged(overlap(begun=1), stopped).trouble
    elsewhere = replace(stopped, on="b")
    assert judged(overlap(went_on=2.0), elsewhere).trouble


def test_what_a_person_forced_breaks_no_promise() -> None:
    split = Fault(kind="second manager", on="a", since=103, until=109, forced=True)
    report = judged(overlap(begun=3), split)
    assert (counts(report), report.trouble) == ((0, 0, 1), [])
    for other in ({"on": "c"}, {"since": 60, "until": 70}):
        assert judged(overlap(begun=3), replace(split, **other)).trouble
