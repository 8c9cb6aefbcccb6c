"""How old data is when a component of a chain uses it: the chain's *data age*.

The term is that of Feiertag, Richter, Nordlander and Jonsson (2008), "A compositional
framework for end-to-end path delay calculation of automotive systems under different
path semantics": from when a datum is made at the beginning of a chain to its use.

- The first component of a chain stamps data when it sends it; the stamp goes along.
- A component that takes several inputs in one run goes on with the oldest; a timer,
  with what was taken last.
- A component within the chain uses data when it sends it on. The last one uses it at
  the end of each run that took some, and at the end of each run of a timer.

Stamps are of the computer's own monotonic clock [s], translated where they come in; no
number while the other clock is not known. Over a wire they stand before the value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from math import isnan, nan
from typing import Any, NamedTuple

from poise.clock import DRIFT, ComponentClock, Elapsed, Stamp, SystemClock
from poise.runtime._calls import Histogram
from poise.wire.codec import Codec, codec
from poise.wire.frame import Frame
from poise.wire.records.deployment_records import ChainPart, ConnectorSpec
from poise.wire.records.heartbeat_records import ClockStatus
from poise.wire.records.status_records import ChainStatus

Stamps = tuple[float, ...]


class ComputerClock(SystemClock):
    """The clock of one computer."""

    def __init__(self, computer: str) -> None:
        super().__init__(computer)
        self.others: Mapping[str, ClockStatus] = {}

    def since(self, stamp: Stamp) -> Elapsed | None:
        """Return how long ago a stamp was, with what is known of its clock."""
        if stamp.computer == self._computer:
            return super().since(stamp)
        offset = self.offset(stamp.computer)
        if offset is None:
            return None
        return Elapsed(self.now() + offset.value - stamp.at, offset.error)

    def offset(self, computer: str) -> Elapsed | None:
        """Return how far another computer's clock is ahead [s]; None: not known."""
        known = self.others.get(computer)
        if known is None:
            return None
        error = known.error + DRIFT * max(0.0, self.now() - known.at)
        return Elapsed(known.offset, error)


class RemoteClock:
    """How far the clock at the other end is ahead, as far as it is known."""

    __slots__ = ("_ask", "error", "most", "offset")

    def __init__(self, ask: Callable[[], Elapsed | None] | None = None) -> None:
        self._ask = ask
        self.offset = self.most = 0.0 if ask is None else nan
        self.error = 0.0
        self.update()

    def update(self) -> None:
        """Update from what is known now; once a second, because clocks drift."""
        known = self._ask() if self._ask else None
        if known is not None:
            self.offset, self.error, self.most = known.value, known.error, known.most


class Stamped(NamedTuple):
    """What goes over a connector of chains, with the stamp of each [s]."""

    chains: Sequence[str]
    stamps: Sequence[float]
    value: Any


class _ChainAge:
    """What one component knows of the data of one chain."""

    def __init__(self, part: ChainPart) -> None:
        self.part = part
        self.held = nan
        self.is_new = False
        self.ages = Histogram()
        self.missed = 0

    def note(self, stamp: float) -> None:
        if not self.is_new:
            self.held = stamp
        elif not isnan(self.held):  # one that is not known makes the run's age unknown
            self.held = nan if isnan(stamp) else min(self.held, stamp)
        self.is_new = True

    def use(self, now: float) -> None:
        if isnan(self.held):
            return
        age = now - self.held
        self.ages.add(age)
        if self.part.deadline is not None and age > self.part.deadline:
            self.missed += 1


class DataAges:
    """The chains that one component is part of."""

    def __init__(self, parts: Iterable[ChainPart], clock: ComponentClock) -> None:
        self._clock = clock
        self._chains = {part.name: _ChainAge(part) for part in parts}

    def __bool__(self) -> bool:
        """Whether it is part of any chain."""
        return bool(self._chains)

    def run(
        self,
        method: Callable[..., Any],
        args: Sequence[object],
        *,
        taken: Stamped | None = None,
        is_later: bool = False,
    ) -> Any:  # noqa: ANN401, the method's own
        """Run the component's code on what came with stamps; an error is no use."""
        self.begin()
        if taken is not None:
            self.note(taken.chains, taken.stamps)
        result = method(*args)
        self.end(is_later=is_later)
        return result

    def begin(self) -> None:
        """Let a run begin, which has taken no data yet."""
        for chain in self._chains.values():
            chain.is_new = False

    def end(self, *, is_later: bool) -> None:
        """Let a run end: the last component of a chain has used its data.

        `is_later`: that may have come before, as for a timer or the turn of an answer.
        """
        now = self._clock.now()
        for chain in self._chains.values():
            if chain.part.deadline is not None and (is_later or chain.is_new):
                chain.use(now)
            chain.is_new = False

    def note(self, names: Iterable[str], stamps: Iterable[float]) -> None:
        """Take stamps that came with a message, a call or an answer."""
        for name, stamp in zip(names, stamps, strict=True):
            if name in self._chains:
                self._chains[name].note(stamp)

    def stamps(self, names: Iterable[str]) -> tuple[float, ...]:
        """Return the stamps of data that goes out now (its use, within a chain)."""
        now = self._clock.now()
        return tuple(self._stamp(name, now) for name in names)

    def held(self) -> dict[str, Stamp]:
        """Return the stamps that a successor goes on with, by chain."""
        return {
            name: self._clock.stamp(chain.held)
            for name, chain in self._chains.items()
            if not isnan(chain.held)
        }

    def restore(self, held: Mapping[str, Stamp]) -> None:
        """Go on with the stamps that the incarnation before held."""
        for name, stamp in held.items():
            if name in self._chains:
                self._chains[name].held = self.local(stamp)

    def local(self, stamp: Stamp) -> float:
        """Return a stamp on this computer's clock; no number when nobody knows it."""
        elapsed = self._clock.since(stamp)
        return nan if elapsed is None else self._clock.now() - elapsed.value

    def status(self) -> tuple[ChainStatus, ...]:
        """Return what was counted; a chain's first component makes data of age 0."""
        return tuple(
            ChainStatus(
                name=name,
                deadline=chain.part.deadline,
                missed=chain.missed,
                age=chain.ages.summary(),
            )
            for name, chain in self._chains.items()
            if not chain.part.is_first
        )

    def _stamp(self, name: str, now: float) -> float:
        chain = self._chains.get(name)
        if chain is None:
            return nan
        if chain.part.is_first:
            return now
        chain.use(now)
        return chain.held


def with_stamps(coder: Codec[Any], chains: Sequence[str]) -> Codec[tuple[Stamps, Any]]:
    """Return the codec of values behind the stamps of these chains, one of each."""
    stamps: Any = tuple[(float,) * len(chains)]  # type: ignore[misc]
    return codec(tuple[stamps, coder.type], coder.name)  # type: ignore[name-defined]


class SentChains:
    """The source's end of the chains that pass over a connector."""

    def __init__(
        self, ages: DataAges, carries: Sequence[str], answers: Sequence[str]
    ) -> None:
        self._ages = ages
        self.carries = carries
        self.answers = answers

    def stamping(self, send: Callable[..., None]) -> Callable[..., None]:
        """Return `send` for messages and arguments of calls, with their stamps."""

        def stamp(value: object, method: object = None) -> None:
            send(self.stamped(value), method)

        return stamp

    def stamped(self, value: object) -> Stamped:
        """Return a value with its stamps."""
        return Stamped(self.carries, self._ages.stamps(self.carries), value)

    def binding(
        self, bind: Callable[..., tuple[Any, ...]]
    ) -> Callable[..., tuple[Any, ...]]:
        """Return a function that also puts stamps in front of a call's arguments."""

        def stamp(*args: Any, **kwargs: Any) -> tuple[Any, ...]:  # noqa: ANN401, a call's
            values = bind(*args, **kwargs)
            return self._ages.stamps(self.carries), values

        return stamp

    def taking(
        self, decode: Callable[..., tuple[Stamps, Any]], remote_clock: RemoteClock
    ) -> Callable[..., Any]:
        """Return a function that decodes an answer and takes its stamps."""

        def take(*answer: object) -> Any:  # noqa: ANN401, the call's own
            stamps, result = decode(*answer)
            self._ages.note(self.answers, local(stamps, remote_clock))
            return result

        return take

    def direct(
        self, method: Callable[..., Any], target: DataAges
    ) -> Callable[..., Any]:
        """Return a method of a target in the same process, which takes stamps, too."""

        @wraps(method)
        def run(*args: object, **kwargs: object) -> Any:  # noqa: ANN401, the call's own
            result = target.run(
                lambda *_: method(*args, **kwargs), (), taken=self.stamped(None)
            )
            self._ages.note(self.answers, target.stamps(self.answers))
            return result

        return run


def served(
    method: Callable[..., Any],
    ages: DataAges,
    spec: ConnectorSpec,
    remote_clock: RemoteClock,
) -> Callable[[Stamps, Sequence[object]], tuple[Stamps, Any]]:
    """Return a target's method that takes stamps and answers with some."""

    def serve(stamps: Stamps, args: Sequence[object]) -> tuple[Stamps, Any]:
        taken = Stamped(spec.carries, local(stamps, remote_clock), None)
        result = ages.run(method, args, taken=taken)
        return ages.stamps(spec.answers), result

    return serve


def stamped_value(
    spec: ConnectorSpec, remote_clock: RemoteClock, received: Frame, coder: Codec[Any]
) -> Stamped:
    """Return what a message or one-way call holds, with its stamps."""
    stamps, value = received.value(with_stamps(coder, spec.carries))
    return Stamped(spec.carries, local(stamps, remote_clock), value)


def local(stamps: Stamps, remote_clock: RemoteClock) -> Stamps:
    """Return stamps of the other end's clock on this computer's."""
    return tuple(stamp - remote_clock.offset for stamp in stamps)
