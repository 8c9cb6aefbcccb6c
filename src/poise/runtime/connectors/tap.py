"""Observes a connector: what goes out, for viewers, and what comes in, for a file.

What is noted is bounded; what finds no room is counted.
"""

from __future__ import annotations

import dataclasses
import logging
import os
import secrets
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from collections.abc import Set as AbstractSet
from functools import partial
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any

import msgspec

from poise.clock import steady_wall_time
from poise.errors import RunError, UsageError, encodable, said
from poise.runtime.component.ports import Port
from poise.runtime.connectors.latest import (
    NONE,
    LatestMessage,
    Number,
    Numbered,
    numbered_tag,
    without_number,
)
from poise.wire.codec import MALFORMED, Packed, pack
from poise.wire.connections.connection_server import Handler
from poise.wire.frame import Frame, FrameKind, Pieces
from poise.wire.recording_file import Input, McapFile
from poise.wire.records.migration_records import StepsFailed
from poise.wire.records.request_records import (
    MOST_PACKED,
    SHOWN_ITEMS,
    Passed,
    Tap,
    TapReading,
)

log = logging.getLogger(__name__)

MOST_TIMES = 10_000
MOST_PASSED = 100
"""So much waits for the viewer."""
_MOST_LETTERS, _DEEPEST = 200, 5
_LARGEST = 1 << 63

_BURST = 0.1
"""What comes at once is shown, up to what may come in this time [s]."""
KEPT_FOR = 3.0
"""A viewer that has not asked for so long does not look any more [s]."""
MOST_VIEWERS = 16
MOST_RECORDED = 1 << 28
"""Of one connector at most so much is recorded [bytes]; later entries are left out."""
_RECORDED = {FrameKind.MESSAGE, FrameKind.CALL, FrameKind.ONEWAY}
_RESULT_BODY = 1


class Observer:
    """What one viewer gets of a connector. Any thread may use it."""

    def __init__(self, tap: Tap, type_: object) -> None:
        self._tap = tap
        self._carries = getattr(type_, "__qualname__", str(type_))
        self.read_at = time.monotonic()
        self._size = 0
        self._every = 1 / tap.rate if tap.rate > 0 else inf
        self._due = 0.0 if tap.rate > 0 else inf
        self._times: list[float] = []
        self._passed: list[Passed] = []
        self._missing = 0
        self._latest = tap.latest or NONE
        self._lock = threading.Lock()
        self._time = steady_wall_time()

    def note(self, value: Callable[[], object], number: Number = NONE) -> None:
        """Note that something went out; its content is asked for when it is due."""
        at, now = self._time(), time.monotonic()
        with self._lock:
            if number == self._latest != NONE:
                return
            self._latest = max(self._latest, number)
            if len(self._times) >= MOST_TIMES:
                self._missing += 1
                return
            if now < self._due or len(self._passed) >= MOST_PASSED:
                self._times.append(at)
                return
            # half a gap early is in time, or a jitter would leave every second out;
            # and so is a burst, where fewer came before
            early = max(self._every / 2, _BURST)
            self._due = max(self._due, now - early) + self._every
        passed = self._shown(at, value)
        size = passed.value.size if isinstance(passed.value, Packed) else 0
        with self._lock:  # a reading has both, or neither
            self._times.append(at)
            if self._size + size <= MOST_PACKED:  # else it has no room
                self._size += size
                self._passed.append(passed)

    def _shown(self, at: float, value: Callable[[], object]) -> Passed:
        """Return a value as the viewer gets it, or why it gets none."""
        try:
            if self._tap.is_whole:
                return Passed(at, pack(value()))
            plain = Plain(self._tap.items)
            return Passed(at, plain.of(value()), plain.is_whole)
        # a user's class may raise anything when its texts and parts are asked for
        except Exception as error:  # noqa: BLE001
            return Passed(at, said(error), is_whole=False)

    def note_last(self, last: Numbered) -> None:
        """Note a message that had gone out before, if contents are wanted."""
        if self._every < inf and last.number > self._latest:
            self.note(lambda: last.value, last.number)

    def read(self, number: int) -> TapReading:
        """Return what was noted since the last time."""
        self.read_at = time.monotonic()
        with self._lock:
            times, self._times = self._times, []
            passed, self._passed, self._size = self._passed, [], 0
            missing, self._missing = self._missing, 0
            latest, at = self._latest, self._time()
        return TapReading(
            number=number,
            connector=self._tap.connector,
            carries=self._carries,
            times=tuple(times),
            passed=tuple(passed),
            missing=missing,
            latest=latest,
            at=at,
        )


Observers = tuple[Observer, ...]


class ObservedPort:
    """What is sent at a port, for those who look; by itself it sends to nobody."""

    def __init__(self, port: Port, latest: LatestMessage | None) -> None:
        self.port = port
        self.on_observed: Callable[[], object] = lambda: None
        """Called when there are others who look."""
        self._latest = latest
        self._observers: Observers = ()

    @property
    def last(self) -> Numbered | None:
        """The last message, where late subscribers get it; None: there is none."""
        return self._latest.last if self._latest else None

    def sending(self) -> Callable[..., None]:
        """Return a function that lets a message be noted, and sends it."""
        return observed_send(lambda *_: None, self._observers)

    def observe(self, observers: Observers) -> None:
        """Let observers note what goes out from now on, instead of those before."""
        self._observers = observers
        self.on_observed()


def observed_send(
    send: Callable[..., None], observers: Observers
) -> Callable[..., None]:
    """Return a function that sends a message or one-way call, and lets it be noted."""

    def go(value: object, method: Any = None) -> None:  # noqa: ANN401, as the sender's
        number, message = NONE, value
        if type(value) is Numbered:
            number, message = value.number, value.value
        for observer in observers:
            observer.note(
                lambda: message if method is None else {method.name: message}, number
            )
        send(value, method)

    return go


def observed_call(
    call: Callable[..., Any], name: str, observers: Observers
) -> Callable[..., Any]:
    """Return a function that makes a call, and lets it be noted with its outcome."""

    def run(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401, the call's own
        began = time.monotonic()
        outcome: Callable[[], dict[str, object]] = dict
        try:
            result = call(*args, **kwargs)
        except Exception as error:
            outcome = partial(_raised, error)
            raise
        else:
            outcome = partial(dict, returned=result)
            return result
        finally:
            took = time.monotonic() - began

            def summary() -> dict[str, object]:
                return {name: [*args, *kwargs.values()], **outcome(), "seconds": took}

            for observer in observers:
                observer.note(summary)

    return run


def _raised(error: Exception) -> dict[str, object]:
    return {"raised": repr(error)}


class Plain:
    """Makes values plain, as JSON has them, and short, whatever they are."""

    def __init__(self, items: int = SHOWN_ITEMS) -> None:
        self.is_whole = True
        self._items = items

    def of(self, value: Any, depth: int = _DEEPEST) -> Any:  # noqa: ANN401, JSON's
        """Return a value as JSON has them."""
        if value is None or isinstance(value, bool | float):
            return value
        if isinstance(value, int) and -_LARGEST <= value < _LARGEST:
            return value
        if _is_array(value) and value.size <= self._items:
            return self.of(value.tolist(), depth)
        if size := _size(value):
            return self._instead(size)
        if isinstance(value, str) or not (parts := self._parts(value)):
            return self._cut(str(value))
        return parts(depth - 1) if depth else self._instead("...")

    def _parts(self, value: object) -> Callable[[int], Any] | None:
        """Return a function that makes the parts of a value plain; None: no parts."""
        if isinstance(value, msgspec.Struct):
            return partial(self._fields, value, value.__struct_fields__)
        if dataclasses.is_dataclass(value):
            names = [field.name for field in dataclasses.fields(value)]
            return partial(self._fields, value, names)
        if isinstance(value, Mapping):
            return partial(self._entries, value)
        if isinstance(value, list | tuple | AbstractSet):
            return partial(self._list, value)
        return None

    def _entries(self, value: Mapping[Any, object], depth: int) -> dict[str, Any]:
        first = islice(value.items(), self._items)
        named = {self._cut(str(key)): self.of(item, depth) for key, item in first}
        return named | dict.fromkeys(self._more(value), "")

    def _list(self, value: Collection[object], depth: int) -> list[Any]:
        first = [self.of(item, depth) for item in islice(value, self._items)]
        return [*first, *self._more(value)]

    def _fields(self, value: object, names: Iterable[str], depth: int) -> Any:  # noqa: ANN401, JSON's
        return {name: self.of(getattr(value, name), depth) for name in names}

    def _more(self, value: Collection[object]) -> list[str]:
        more = len(value) - self._items
        if more <= 0:
            return []
        mark = self._instead(f"... and {more} more")
        return [mark] if self._items <= SHOWN_ITEMS else []

    def _cut(self, text: str) -> str:
        """Return a text that can be sent, and is not too long."""
        if len(text) <= _MOST_LETTERS:
            return encodable(text)
        return self._instead(f"{encodable(text[:_MOST_LETTERS])}...")

    def _instead(self, text: str) -> str:
        self.is_whole = False
        return text


def _is_array(value: Any) -> bool:  # noqa: ANN401, NumPy need not be there
    return hasattr(value, "dtype") and hasattr(value, "tolist")


def _size(value: Any) -> str:  # noqa: ANN401, the same
    """Return what stands for bytes or an array; empty: it is neither."""
    if _is_array(value):
        return f"<{value.dtype} array of {' x '.join(map(str, value.shape))}>"
    is_bytes = isinstance(value, bytes | bytearray | memoryview)
    return f"<{len(value)} bytes>" if is_bytes else ""


class Taps:
    """The observers of a container's senders; used by its control thread alone."""

    def __init__(self, sender_of: Callable[[str], ObservedPort]) -> None:
        self._sender_of = sender_of
        self._observed: dict[tuple[ObservedPort, str], Observer] = {}

    def read(self, tap: Tap) -> TapReading | StepsFailed:
        """Return what has gone out since a viewer asked last; from now on note it."""
        try:
            sender = self._sender_of(tap.connector)
        except UsageError as error:
            return StepsFailed(tap.number, str(error))
        key = sender, tap.viewer
        if key not in self._observed:
            viewers = {viewer for _, viewer in self._observed}
            if len(viewers | {tap.viewer}) > MOST_VIEWERS:
                text = f"{MOST_VIEWERS} viewers watch this container already"
                return StepsFailed(tap.number, text)
            self._observed[key] = Observer(tap, sender.port.type)
            self._show(sender)
            if sender.last and tap.latest is not None:
                self._observed[key].note_last(sender.last)
        return self._observed[key].read(tap.number)

    def end_unread(self) -> None:
        """Remove the observers of viewers that do not look any more."""
        if not self._observed:
            return
        until = time.monotonic() - KEPT_FOR
        unread = [
            key for key, observer in self._observed.items() if observer.read_at < until
        ]
        for key in unread:
            del self._observed[key]
            self._show(key[0])

    def _show(self, sender: ObservedPort) -> None:
        sender.observe(
            tuple(
                o for (observed, _), o in self._observed.items() if observed is sender
            )
        )


class InputFile:
    """A file for the inputs of one connector's end: whole however its process ends."""

    def __init__(self, folder: Path, source: str, port: Port) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        name = f"{source}-{os.getpid()}-{secrets.token_hex(4)}.mcap"
        self._file = McapFile(folder / name, "", at_once=True)
        self._source = source
        is_topic = port.kind == "subscribes"
        self._numbered = numbered_tag(port.type) if is_topic else None
        self._size = 0
        self._has_ended = False
        self._time = steady_wall_time()

    def handler(self, handle: Handler) -> Handler:
        """Return a handler that also records messages and calls."""

        def handle_and_record(received: Frame) -> Pieces | None:
            at = self._time()
            answer = handle(received)
            if received.kind in _RECORDED and not _is(FrameKind.MOVED, answer):
                self._add(at, received, answer)
            return answer

        return handle_and_record

    def _add(self, at: float, received: Frame, answer: Pieces | None) -> None:
        body, buffers = bytes(received.body), bytes(received.buffers)
        if self._has_ended:
            return
        self._size += len(body) + len(buffers)
        if self._size > MOST_RECORDED:
            self._end(f"the limit of {MOST_RECORDED} B is reached in {self._file.path}")
            return
        tag = None if received.kind is FrameKind.MESSAGE else received.tag
        if tag is None and received.tag == self._numbered:
            try:
                body = without_number(body)
            except MALFORMED:  # it was refused
                return
        entry = Input(self._source, at, body, buffers, tag, _result(answer))
        try:
            self._file.add_record(entry, at)
        except RunError as error:
            self._end(str(error))

    def _end(self, why: str) -> None:
        self._has_ended = True
        log.warning("nothing more is recorded: %s", why)

    def close(self) -> None:
        """Close the file, as far as its disk has room; harmless when repeated."""
        try:
            self._file.close()
        except RunError as error:  # it is read as far as it goes
            log.warning("%s", error)


def _result(answer: Pieces | None) -> bytes:
    """Return the encoded result of an answer; empty when it failed."""
    if answer is None or not _is(FrameKind.RESULT, answer):
        return b""
    return bytes(answer[_RESULT_BODY])


def _is(kind: FrameKind, answer: Pieces | None) -> bool:
    return answer is not None and bytes(answer[0])[1] == kind
