"""What a viewer gets of a connector: bounded, short, and nothing is changed by it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from poise import Message
from poise.errors import UsageError
from poise.runtime.component.ports import Port
from poise.runtime.connectors import tap
from poise.runtime.connectors.interface import Proxy
from poise.runtime.connectors.sender import Sender
from poise.runtime.connectors.tap import (
    MOST_PASSED,
    MOST_TIMES,
    MOST_VIEWERS,
    Observer,
    Plain,
    Taps,
)
from poise.wire import frame
from poise.wire.records.migration_records import StepsFailed
from poise.wire.records.request_records import Tap, TapReading
from tests.runtime.connectors.test_sender import FakeRoute, Note, Sums

NOTES = Port("notes", "publishes", Note)
SUMS = Port("sums", "requires", Sums)


def observer_of(type_: type, rate: float) -> Observer:
    tap = Tap(number=0, container="", connector="a-b", viewer="", rate=rate)
    return Observer(tap, type_)


def publisher() -> tuple[Sender, FakeRoute]:
    sender, route = Sender("a-b", NOTES, None, 1.0), FakeRoute()
    sender.add("here", route)
    return sender, route


def test_a_message_is_noted_and_goes_out_as_ever() -> None:
    sender, route = publisher()
    observer = observer_of(Note, 1e6)
    sender.observe((observer,))
    note = Note(7)
    sender.sending()(note)
    assert route.went == [note]
    reading = observer.read(1)
    assert (reading.connector, reading.carries) == ("a-b", "Note")
    assert [each.value for each in reading.passed] == [{"number": 7}]
    assert [each.at for each in reading.passed] == list(reading.times)
    assert observer.read(2).times == ()


def test_messages_are_shown_at_their_rate_though_the_time_of_day_steps_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    observer = observer_of(Note, 1e9)
    observer.note(lambda: Note(1))
    monkeypatch.setattr("time.time", lambda: 1e9)  # in 2001
    observer.note(lambda: Note(2))
    passed = observer.read(1).passed
    assert [each.value for each in passed] == [{"number": 1}, {"number": 2}]
    first, second = (each.at for each in passed)
    assert first <= second


def test_a_burst_below_the_rate_is_shown_whole() -> None:
    observer = observer_of(Note, 400)
    for number in range(4):  # at once, as the calls of one timer
        observer.note(lambda number=number: Note(number))  # type: ignore[misc]
    assert len(observer.read(1).passed) == 4


def test_without_viewers_messages_take_the_way_that_they_always_took() -> None:
    sender, _ = publisher()
    assert sender.sending() == sender.send
    sender.observe((observer_of(Note, 1.0),))
    assert sender.sending() != sender.send
    sender.observe(())
    assert sender.sending() == sender.send


def test_calls_are_noted_with_their_results_and_errors() -> None:
    proxy: Any = Proxy("a.sums")
    sender, route = Sender("a-b", SUMS, proxy, 1.0), FakeRoute()
    sender.add("here", route)
    before = proxy.add
    observer = observer_of(Sums, 1e6)
    sender.observe((observer,))
    assert proxy.add(4) == (route, 4)
    sender.remove("here")
    sender.observe(())
    assert proxy.add is not before  # it refuses
    (passed,) = observer.read(1).passed
    assert passed.value["add"] == [4]
    assert passed.value["seconds"] >= 0


def test_a_call_that_raises_is_noted_and_raises() -> None:
    proxy: Any = Proxy("a.sums")
    sender = Sender("a-b", SUMS, proxy, 1.0)

    class Raises(FakeRoute):
        def function(self, *_: object) -> Any:
            def call(_: int) -> int:
                raise ValueError("no")

            return call

    sender.add("here", Raises())
    observer = observer_of(Sums, 1e6)
    sender.observe((observer,))
    with pytest.raises(ValueError, match="no"):
        proxy.add(4)
    assert observer.read(1).passed[0].value["raised"] == "ValueError('no')"


class Unsaid(Exception):
    def __str__(self) -> str:
        raise RuntimeError("it says nothing")

    __repr__ = __str__


def test_what_cannot_be_shown_goes_out_as_ever() -> None:
    sender, route = publisher()
    observer = observer_of(Note, 1e6)
    sender.observe((observer,))
    sender.sending()(Unsaid())
    assert len(route.went) == 1
    (passed,) = observer.read(1).passed
    assert (passed.value, passed.is_whole) == ("it says nothing", False)


def test_a_caller_gets_an_error_that_cannot_be_shown() -> None:
    proxy: Any = Proxy("a.sums")
    sender = Sender("a-b", SUMS, proxy, 1.0)

    class Raises(FakeRoute):
        def function(self, *_: object) -> Any:
            def call(_: int) -> int:
                raise Unsaid

            return call

    sender.add("here", Raises())
    observer = observer_of(Sums, 1e6)
    sender.observe((observer,))
    with pytest.raises(Unsaid):
        proxy.add(4)
    assert observer.read(1).passed[0].value == "it says nothing"


def test_a_text_that_cannot_be_sent_is_shown_escaped() -> None:
    observer = observer_of(Note, 1e6)
    name = os.fsdecode(b"map-\xff.png")
    observer.note(lambda: {name: [name, 100 * name]})
    reading = frame.unpack_record(frame.pack_record(observer.read(1)), TapReading)
    (shown,) = reading.passed
    assert list(shown.value) == ["map-\\udcff.png"]
    assert shown.value["map-\\udcff.png"][0] == "map-\\udcff.png"


def test_what_finds_no_room_is_counted() -> None:
    observer = observer_of(Note, 1e9)
    for number in range(MOST_TIMES + 3):
        observer.note(lambda number=number: number)  # type: ignore[misc]
    reading = observer.read(1)
    assert len(reading.times) == MOST_TIMES
    assert len(reading.passed) == MOST_PASSED
    assert reading.missing == 3


def test_no_content_is_looked_at_more_often_than_asked() -> None:
    def content() -> object:
        raise AssertionError("nobody asked for it")

    observer = observer_of(Note, 0.0)
    observer.note(content)
    assert len(observer.read(1).times) == 1
    slow = observer_of(Note, 0.001)
    slow.note(lambda: 1)
    slow.note(content)
    reading = slow.read(1)
    assert (len(reading.times), len(reading.passed)) == (2, 1)


@dataclass
class Place:
    x: float
    name: str


class Deep(Message):
    inside: Any


def deep(levels: int) -> object:
    return Deep(deep(levels - 1)) if levels else 0


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, None),
        (1 << 70, str(1 << 70)),
        (b"12345", "<5 bytes>"),
        ("a" * 300, "a" * 200 + "..."),
        (Place(1.5, "hall"), {"x": 1.5, "name": "hall"}),
        ({1: Note(2)}, {"1": {"number": 2}}),
        (list(range(18)), [*range(16), "... and 2 more"]),
        (
            dict.fromkeys(range(17), 0),
            dict.fromkeys(map(str, range(16)), 0) | {"... and 1 more": ""},
        ),
        (np.zeros((480, 640), np.uint8), "<uint8 array of 480 x 640>"),
        (np.array([1.0, 2.0]), [1.0, 2.0]),
        (deep(9), {"inside": {"inside": {"inside": {"inside": {"inside": "..."}}}}}),
    ],
)
def test_values_are_shown_short(value: object, shown: object) -> None:
    assert Plain().of(value) == shown


class OneSender:
    """A container in which one connector begins."""

    def __init__(self) -> None:
        self.only, _ = publisher()

    def sender(self, connector: str) -> Sender:
        if connector != "a-b":
            raise UsageError(f"no connector '{connector}' begins in this container")
        return self.only


def asked(viewer: str = "me", connector: str = "a-b") -> Tap:
    return Tap(number=5, container="c", connector=connector, viewer=viewer)


def test_each_viewer_gets_everything_and_is_forgotten_when_it_asks_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wiring: Any = OneSender()
    watched = Taps(wiring.sender)
    for viewer in ("me", "you"):
        reading = watched.read(asked(viewer))
        assert isinstance(reading, TapReading)
        assert reading.times == ()
    wiring.only.sending()(Note(1))
    for viewer in ("me", "you"):
        reading = watched.read(asked(viewer))
        assert isinstance(reading, TapReading)
        assert len(reading.times) == 1
    watched.end_unread()
    assert wiring.only.sending() != wiring.only.send
    monkeypatch.setattr(tap, "KEPT_FOR", -1.0)
    watched.end_unread()
    assert wiring.only.sending() == wiring.only.send


def test_too_many_viewers_and_unknown_connectors_are_refused() -> None:
    wiring: Any = OneSender()
    watched = Taps(wiring.sender)
    for number in range(MOST_VIEWERS):
        watched.read(asked(str(number)))
    refused = watched.read(asked("one more"))
    assert isinstance(refused, StepsFailed)
    assert "16 viewers" in refused.reason
    unknown = watched.read(asked(connector="x-y"))
    assert isinstance(unknown, StepsFailed)
    assert unknown.number == 5


def test_a_viewer_may_watch_more_connectors_than_there_may_be_viewers() -> None:
    senders: dict[str, Any] = {f"a-{n}": publisher()[0] for n in range(20)}
    watched = Taps(senders.__getitem__)
    for connector in senders:
        assert isinstance(watched.read(asked(connector=connector)), TapReading)


def test_a_reading_amid_a_message_has_its_time_and_its_content_or_neither() -> None:
    observer = observer_of(Note, 1e9)
    amid = []

    def value() -> Note:
        amid.append(observer.read(1))
        return Note(1)

    observer.note(value)
    after = observer.read(2)
    assert [(len(r.times), len(r.passed)) for r in (*amid, after)] == [(0, 0), (1, 1)]
