"""The native code of `poise.runtime` in readable Python: its specification."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NoReturn

from poise.errors import Timeout
from poise.runtime._calls import time_left
from poise.runtime.component.component import within
from poise.runtime.execution.exclusion import Redirected, current_chain
from poise.wire.records.status_records import Summary


class Exclusion:
    """Mutual exclusion of call chains; paused until it is first resumed."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._changed = threading.Condition()
        self._waiting: deque[tuple[int, object]] = deque()
        self._held = True
        self._owner = 0
        self._depth = 0
        self._outside = 0
        self._is_lent = False
        self.is_redirected = False

    def enter(self, chain: int, limit: float) -> None:
        with self._changed:
            if chain and chain == self._owner:
                self._depth += 1
                return
            self._acquire(chain, limit, "was busy for")

    def leave(self) -> None:
        with self._changed:
            if self._depth:
                self._depth -= 1
            else:
                self._release()

    def step_out(self, chain: int) -> int:
        with self._changed:
            if not chain or chain != self._owner or self._is_lent:
                return -1
            depth, self._depth = self._depth, 0
            self._outside += 1
            self._release()
            return depth

    @property
    def num_outside(self) -> int:
        return self._outside

    def step_in(self, chain: int, depth: int, limit: float) -> None:
        with self._changed:
            self._wait(chain, limit, "was busy for", steps_in=True)
            self._depth = depth
            self._outside -= 1

    def lend(self, chain: int) -> None:
        self._owner = chain
        self._is_lent = bool(chain)

    def resume(self) -> None:
        with self._changed:
            self._release()

    def pause(self, limit: float) -> None:
        with self._changed:
            self._acquire(0, limit, "did not pause within")

    def redirect(self) -> None:
        with self._changed:
            self.is_redirected = True
            self._changed.notify_all()

    def _acquire(self, chain: int, limit: float, what: str) -> None:
        self._wait(chain, limit, what, steps_in=False)

    def _wait(self, chain: int, limit: float, what: str, *, steps_in: bool) -> None:
        ticket = (chain, object())
        self._waiting.append(ticket)

        def is_away() -> bool:
            return self.is_redirected and not steps_in

        def is_next() -> bool:
            # whoever shuts (0) waits for those that stepped out, and lets others pass
            able = [each for each in self._waiting if each[0] or not self._outside]
            return not self._held and able[:1] == [ticket]

        try:
            came = self._changed.wait_for(lambda: is_away() or is_next(), limit)
            if is_away():
                raise Redirected(f"component '{self._what}' has moved away")
            if not came:
                raise Timeout(f"component '{self._what}' {what} {limit:g} s")
            self._held, self._owner = True, chain
        finally:
            self._waiting.remove(ticket)
            self._changed.notify_all()

    def _release(self) -> None:
        if not self._held:
            raise RuntimeError("nobody is inside")
        self._held, self._owner = False, 0
        self._changed.notify_all()


class Counts:
    """What a direct call counts."""

    def __init__(self) -> None:
        self.calls = 0
        self.errors = 0
        self.delay = Histogram()


def direct_call(
    method: Callable[..., Any],
    exclusion: Any,
    limit: float,
    counts: Any,
    translate: Callable[[Exception], NoReturn],
    resend: Callable[..., Any] | None = None,
) -> Callable[..., Any]:
    """Return a function that calls `method` under `exclusion`."""

    def call(*args: Any, **kwargs: Any) -> Any:
        began = time.monotonic()
        left = time_left(limit)
        if left <= 0.0:
            count(began)
            counts.errors += 1
            raise Timeout("no time is left")
        try:
            exclusion.enter(current_chain(), left)
        except Redirected:
            if resend is None:
                raise
            return resend(*args, **kwargs)
        except Timeout:
            count(began)
            counts.errors += 1
            raise
        try:
            with within(left):
                result = method(*args, **kwargs)
        except Exception as error:  # noqa: BLE001, translate raises
            counts.errors += 1
            translate(error)
        finally:
            exclusion.leave()
            elapsed = count(began)
        if elapsed > left:
            counts.errors += 1
            raise Timeout(
                f"{method.__qualname__} took {elapsed:.3f} s, limit {left:.3g} s"
            )
        return result

    def count(began: float) -> float:
        elapsed = time.monotonic() - began
        counts.calls += 1
        counts.delay.add(elapsed)
        return elapsed

    return call


class Histogram:
    """Counts values in buckets that grow by an eighth of an octave."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._num = 0
        self._sum = 0.0
        self._minimum, self._maximum = math.inf, 0.0

    def add(self, value: float) -> None:
        value = value if value > 0 else 0.0
        inside = min(max(value, 2.0**-30), 2.0**64)
        bucket = math.ceil(math.log2(inside) * 8)
        self._counts[bucket] = self._counts.get(bucket, 0) + 1
        self._num += 1
        self._sum += value
        self._minimum = min(self._minimum, value)
        self._maximum = max(self._maximum, value)

    def summary(self) -> Summary:
        return Summary(
            count=self._num,
            mean=self._sum / self._num if self._num else 0.0,
            median=self._quantile(0.5),
            p99=self._quantile(0.99),
            maximum=self._maximum,
        )

    def _quantile(self, share: float) -> float:
        seen = 0
        for bucket in sorted(self._counts):
            seen += self._counts[bucket]
            if seen >= share * self._num:
                middle = float(2 ** ((bucket - 0.5) / 8))
                return min(max(middle, self._minimum), self._maximum)
        return self._maximum
