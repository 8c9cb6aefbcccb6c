"""What users may use in tests of their own components: a bench and a clock.

On a bench, the ports of one component lead to lists and functions, its time is virtual.

::

    bench = Bench(Counter)
    bench.advance(0.3)
    assert bench.published["count"] == [Count(1), Count(2), Count(3)]
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any, Generic, Self, TypeVar

from poise.clock import Elapsed, Stamp
from poise.errors import UsageError
from poise.runtime.component.component import Component, Context, create
from poise.runtime.component.ports import (
    InputEvent,
    Published,
    ports_of,
    timers_of,
    watchers_of,
)
from poise.runtime.execution.timers import Releases

__all__ = ["Bench", "VirtualClock"]

C = TypeVar("C", bound=Component)


class Bench(Generic[C]):
    """Runs a component without a robot, in the calling thread.

    The component is configured and active when the bench is made. Whatever its code
    raises comes out of the method of the bench that ran it.

    Parameters
    ----------
    implementation
        Its class.
    parameters
        As in the robot file.
    devices
        Device -> path.
    required
        Required port -> any object that has the methods the component calls.

    Attributes
    ----------
    component
        The component itself: call the methods that it provides on it.
    published
        Published port -> the messages so far, oldest first.
    measured
        Name -> the values that it measured, oldest first.
    clock
        Its clock, which begins at 0 s.
    """

    def __init__(
        self,
        implementation: type[C],
        parameters: Mapping[str, Any] | None = None,
        devices: Mapping[str, str] | None = None,
        **required: object,
    ) -> None:
        self.clock = VirtualClock()
        self.measured: dict[str, list[float]] = {}
        self.published: dict[str, list[Any]] = {}
        self._ports = ports_of(implementation)
        self._watchers = watchers_of(implementation)
        self._came: dict[str, float] = {}
        context = Context(
            age=self._age,
            name=implementation.__name__,
            parameters=parameters or {},
            devices=devices or {},
            clock=self.clock,
            measure=self._measure,
        )
        self.component = create(implementation, context)
        self.component.configure()
        self._connect(required)
        self.component.activate()
        timers = timers_of(implementation).values()
        self._schedules = [Releases(timer, self.clock.now()) for timer in timers]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, port: str, message: object) -> None:
        """Deliver a message to a subscribed port.

        Raises
        ------
        UsageError
            It has no such port.
        """
        self._check_is_one(port, "subscribes")
        self._came[port] = self.clock.now()
        getattr(self.component, self._ports[port].handler)(message)

    def lose(self, port: str) -> None:
        """Let nobody publish to a subscribed port any more: ``@lost`` is called."""
        self._happen("lost", port)

    def find(self, port: str) -> None:
        """Let somebody publish to a subscribed port again: ``@found`` is called."""
        self._happen("found", port)

    def advance(self, seconds: float) -> None:
        """Let `seconds` [s] pass and run every timer that comes due, in time's order.

        A method takes no time unless it sleeps on the component's clock.
        """
        end = self.clock.now() + seconds
        while self._schedules:
            schedule = min(self._schedules, key=lambda schedule: schedule.due)
            if schedule.due > end + _ROUNDING:
                break
            self.clock.sleep(max(0.0, schedule.due - self.clock.now()))
            schedule.begin(self.clock.now())
            getattr(self.component, schedule.timer.name)()
        self.clock.sleep(max(0.0, end - self.clock.now()))

    def close(self) -> None:
        """Deactivate the component and clean it up."""
        self.component.deactivate()
        self.component.cleanup()

    def _happen(self, event: InputEvent, port: str) -> None:
        self._check_is_one(port, "subscribes")
        for name in self._watchers.get((event, port), ()):
            getattr(self.component, name)()

    def _connect(self, required: Mapping[str, object]) -> None:
        for name in self._named("publishes"):
            kept: list[Any] = []
            self.published[name] = kept
            setattr(
                self.component, name, Published(kept.append, self._ports[name].type)
            )
        for name, other in required.items():
            self._check_is_one(name, "requires")
            setattr(self.component, name, other)
        missing = [name for name in self._named("requires") if name not in required]
        if missing:
            raise UsageError(
                f"{self.component.name} requires {', '.join(missing)}: give the bench "
                f"an object for each, as in Bench(..., {missing[0]}=...)"
            )

    def _named(self, kind: str) -> list[str]:
        return [name for name, port in self._ports.items() if port.kind == kind]

    def _check_is_one(self, name: str, kind: str) -> None:
        """Raise UsageError when the component has no such port of a kind."""
        ports = self._named(kind)
        if name not in ports:
            known = ", ".join(ports) or "nothing"
            raise UsageError(f"{self.component.name} {kind} no '{name}', but {known}")

    def _age(self, port: str) -> float:
        self._check_is_one(port, "subscribes")
        return self.clock.now() - self._came.get(port, -inf)

    def _measure(self, name: str, value: float) -> None:
        self.measured.setdefault(name, []).append(value)


_ROUNDING = 1e-9
"""Three steps of 0.1 s reach a release at 0.3 s, whatever floating point says [s]."""


class VirtualClock:
    """Time for tests; a `poise.clock.ComponentClock`.

    Parameters
    ----------
    start
        The first moment [s].
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def now(self) -> float:
        """Return the present moment [s]."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Let `seconds` [s] pass, at once."""
        self._now += seconds

    def stamp(self, at: float | None = None) -> Stamp:
        """Return the present moment, or `at` [s]."""
        return Stamp(self._now if at is None else at)

    def since(self, stamp: Stamp) -> Elapsed:
        """Return how long ago a stamp was; there is one computer, whatever it says."""
        return Elapsed(self._now - stamp.at)
