"""Notes what goes out over a connector, while somebody looks.

A sender that nobody looks at has no observer, and does not ask whether it has. What is
noted is bounded; what finds no room is counted.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from collections.abc import Set as AbstractSet
from functools import partial
from itertools import islice
from typing import Any

import msgspec

from poise.clock import wall_time
from poise.wire.records.tap_records import SHOWN_ITEMS, Passed, TapReading

MOST_TIMES = 10_000
MOST_PASSED = 100
"""So much waits for the viewer."""
_MOST_LETTERS, _DEEPEST = 200, 5
_LARGEST = 1 << 63


class Observer:
    """What one viewer gets of a connector. Any thread may use it."""

    def __init__(
        self, connector: str, type_: object, rate: float, items: int = SHOWN_ITEMS
    ) -> None:
        self.connector = connector
        self.carries = getattr(type_, "__qualname__", str(type_))
        self.read_at = time.monotonic()
        self._items = items
        self._every = 1 / rate if rate > 0 else float("inf")
        self._due = 0.0 if rate > 0 else float("inf")
        self._times: list[float] = []
        self._passed: list[Passed] = []
        self._missing = 0
        self._lock = threading.Lock()

    def note(self, value: Callable[[], object]) -> None:
        """Note that something went out; its content is asked for when it is due."""
        at, now = wall_time(), time.monotonic()
        with self._lock:
            if len(self._times) >= MOST_TIMES:
                self._missing += 1
                return
            self._times.append(at)
            if now < self._due or len(self._passed) >= MOST_PASSED:
                return
            # half a gap early is in time, or a jitter would leave every second out
            self._due = max(self._due, now - self._every / 2) + self._every
        plain = Plain(self._items)
        passed = Passed(at, plain.of(value()), plain.is_whole)
        with self._lock:
            self._passed.append(passed)

    def take(self, number: int) -> TapReading:
        """Return what was noted since the last time."""
        self.read_at = time.monotonic()
        with self._lock:
            times, self._times = self._times, []
            passed, self._passed = self._passed, []
            missing, self._missing = self._missing, 0
        return TapReading(
            number=number,
            connector=self.connector,
            carries=self.carries,
            times=tuple(times),
            passed=tuple(passed),
            missing=missing,
        )


Observers = tuple[Observer, ...]


def observed_send(
    send: Callable[..., None], observers: Observers
) -> Callable[..., None]:
    """Return a function that sends a message or one-way call, and lets it be noted."""

    def go(value: object, method: Any = None) -> None:  # noqa: ANN401, as the sender's
        for each in observers:
            each.note(lambda: value if method is None else {method.name: value})
        send(value, method)

    return go


def observed_call(
    call: Callable[..., Any], name: str, observers: Observers
) -> Callable[..., Any]:
    """Return a function that makes a call, and lets it be noted with its outcome."""

    def run(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401, the call's own
        began = time.monotonic()
        outcome: dict[str, object] = {}
        try:
            result = call(*args, **kwargs)
        except Exception as error:
            outcome = {"raised": repr(error)}
            raise
        else:
            outcome = {"returned": result}
            return result
        finally:
            took = time.monotonic() - began
            said = {name: [*args, *kwargs.values()], **outcome, "seconds": took}
            for each in observers:
                each.note(lambda: said)

    return run


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
            names = [each.name for each in dataclasses.fields(value)]
            return partial(self._fields, value, names)
        if isinstance(value, Mapping):
            return partial(self._entries, value)
        if isinstance(value, list | tuple | AbstractSet):
            return partial(self._list, value)
        return None

    def _entries(self, value: Mapping[Any, object], depth: int) -> dict[str, Any]:
        first = islice(value.items(), self._items)
        named = {self._cut(str(key)): self.of(each, depth) for key, each in first}
        return named | dict.fromkeys(self._more(value), "")

    def _list(self, value: Collection[object], depth: int) -> list[Any]:
        first = [self.of(each, depth) for each in islice(value, self._items)]
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
        if len(text) <= _MOST_LETTERS:
            return text
        return self._instead(f"{text[:_MOST_LETTERS]}...")

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
