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

from poise.wire.records.taps import SHOWN_ITEMS, Passed, TapReading

MOST_TIMES = 10_000
MOST_PASSED = 100
"""So much waits for the viewer."""
_MOST_LETTERS, _DEEPEST = 200, 5
_LARGEST = 1 << 63


class Observer:
    """What one viewer gets of a connector. Any thread may use it.

    Parameters
    ----------
    connector
        Its name.
    type_
        The declared type of its messages, or its interface.
    rate
        So many messages a second are noted with their content.
    items
        Of longer lists, arrays and mappings the rest is left out.
    """

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
        now = time.time()
        with self._lock:
            if len(self._times) >= MOST_TIMES:
                self._missing += 1
                return
            self._times.append(now)
            if now < self._due or len(self._passed) >= MOST_PASSED:
                return
            # half a gap early is in time, or a jitter would leave every second out
            self._due = max(self._due, now - self._every / 2) + self._every
        passed = Passed(now, plain(value(), self._items))
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


def plain(value: object, items: int = SHOWN_ITEMS, depth: int = _DEEPEST) -> Any:  # noqa: ANN401, JSON's values
    """Return a value as JSON has them: short, whatever it is."""
    if value is None or isinstance(value, bool | float):
        return value
    if isinstance(value, int):
        return value if -_LARGEST <= value < _LARGEST else str(value)
    if isinstance(value, bytes | bytearray | memoryview):
        return f"<{len(value)} bytes>"
    if hasattr(value, "dtype") and hasattr(value, "tolist"):  # an array of NumPy
        is_short = getattr(value, "size", 0) <= items
        return plain(value.tolist(), items, depth) if is_short else _array(value)
    if isinstance(value, str) or not (parts := _parts(value)):
        return _cut(str(value))
    return parts(items, depth - 1) if depth else "..."


def _parts(value: object) -> Callable[[int, int], Any] | None:
    """Return a function that makes the parts of a value plain; None: it has none."""
    if isinstance(value, msgspec.Struct):
        return partial(_fields, value, value.__struct_fields__)
    if dataclasses.is_dataclass(value):
        return partial(_fields, value, [f.name for f in dataclasses.fields(value)])
    if isinstance(value, Mapping):
        return partial(_entries, value)
    if isinstance(value, list | tuple | AbstractSet):
        return partial(_items, value)
    return None


def _array(value: Any) -> str:  # noqa: ANN401, NumPy need not be there
    return f"<{value.dtype} array of {' x '.join(map(str, value.shape))}>"


def _entries(value: Mapping[Any, object], items: int, depth: int) -> dict[str, Any]:
    first = islice(value.items(), items)
    named = {_cut(str(key)): plain(each, items, depth) for key, each in first}
    return named | dict.fromkeys(_more(len(value) - items), "")


def _items(value: Collection[object], items: int, depth: int) -> list[Any]:
    first = [plain(each, items, depth) for each in islice(value, items)]
    return [*first, *_more(len(value) - items)]


def _fields(
    value: object, names: Iterable[str], items: int, depth: int
) -> dict[str, Any]:
    return {name: plain(getattr(value, name), items, depth) for name in names}


def _more(more: int) -> list[str]:
    return [f"... and {more} more"] if more > 0 else []


def _cut(text: str) -> str:
    return text if len(text) <= _MOST_LETTERS else f"{text[:_MOST_LETTERS]}..."
