"""Runs one component: its thread, its exclusion and its life cycle.

The thread compares the goal with the state and takes the next step, so the container
only ever says where the component should be. Timers and messages run on this thread;
calls from others run on theirs, under the component's exclusion.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, nullcontext
from typing import Any

from poise.clock import Clock, ComponentClock
from poise.errors import RunError, Timeout
from poise.priority import ahead
from poise.runtime._calls import ComponentCounters
from poise.runtime.component.component import Component, Context, create
from poise.runtime.component.error_report import Errors
from poise.runtime.component.ports import ports_of, timers_of
from poise.runtime.connectors.endpoints import Endpoints
from poise.runtime.connectors.interface import methods
from poise.runtime.execution.exclusion import Exclusion, Redirected, new_chain
from poise.runtime.execution.histogram import Histogram
from poise.runtime.execution.mailbox import Inbox
from poise.runtime.execution.timers import Timers
from poise.wire.codec import codec
from poise.wire.records.deployment import Aim, ComponentSpec, ComponentStatus, State

log = logging.getLogger(__name__)

_PATIENCE = 1.0
"""How long a timer or message waits to enter before it looks at the goal [s]."""


class Runner:
    """An incarnation of a component with the thread that runs it.

    Parameters
    ----------
    spec
        Name, epoch, parameters and devices.
    implementation
        Its class.
    on_change
        Called on the component's thread after every change of state; must not block.
    """

    def __init__(
        self,
        spec: ComponentSpec,
        implementation: type[Component],
        clock: ComponentClock,
        on_change: Callable[[], None],
    ) -> None:
        self.spec = spec
        self.exclusion = Exclusion(spec.name)
        self.ports = ports_of(implementation)
        self._handler: tuple[str, float] | None = None
        self._deactivated_at: float | None = None
        self.component = create(
            implementation,
            Context(
                name=spec.name,
                parameters=spec.parameters,
                devices=spec.devices,
                clock=clock,
                measure=self._measure,
            ),
        )
        self.counters = ComponentCounters()
        self.endpoints = Endpoints(
            spec.name, self.component, self.ports, self.exclusion, self.counters
        )
        self.schedules: dict[str, Timers] = {}
        self._phases: Mapping[str, float] = {}
        # whoever runs its code while it is at rest holds the first; it is born at rest
        self._lending = threading.Lock()
        self._resting = threading.RLock()
        self._is_resting = True
        self._is_lent = self._goes_on = False
        self._stays: object = None
        self._awaits_lull = False
        self._lull = threading.Event()
        self._clock = clock
        self._on_change = on_change
        self._timers = timers_of(implementation)
        self._measures: dict[str, Histogram] = {}
        self._state: State = "unconfigured"
        self._state_changed = threading.Condition()
        self._goal: Aim = "inactive"
        self._goal_changed = threading.Event()
        self._errors = Errors(spec.name)
        self._thread = threading.Thread(
            target=self._main, name=spec.name[:15], daemon=True
        )
        self.asked_at = clock.now()
        self._start = 0.0
        self._snapshot = 0

    @property
    def state(self) -> State:
        """Where it is in its life cycle."""
        return self._state

    def wait_state(self, states: AbstractSet[State], limit: float) -> State:
        """Wait up to `limit` [s] for one of `states`; return the state then."""
        with self._state_changed:
            self._state_changed.wait_for(lambda: self._state in states, limit)
            return self._state

    @property
    def clock(self) -> Clock:
        """Its clock."""
        return self._clock

    def start(self) -> None:
        """Start its thread; it goes to the goal by itself."""
        self._thread.start()

    def aim(self, goal: Aim) -> None:
        """Say where it should be; harmless when repeated, and in vain after the end.

        Once it is `active`, it goes on after a rest.
        """
        with self._state_changed:
            self._stays = None
            if self._goal != "finalized":
                self._goal = goal
        # in a hook it goes on by itself when that ends, which nobody should wait for
        if goal == "active" and self._state == "active":
            self.go_on()
        self._goal_changed.set()
        self.endpoints.mailbox.wake()

    def stay(self) -> None:
        """Stay as it is: it is about to move, and may be told to rest.

        The move before is over, and what that left at rest goes on.
        """
        self._stays = object()  # one for each move: an order from before is late
        self.go_on()

    def wait_ended(self, limit: float) -> bool:
        """Wait up to `limit` [s] for its thread to end; whether it did."""
        self._thread.join(limit)
        return not self._thread.is_alive()

    def has_ended(self) -> bool:
        """Return at once whether its code runs no more."""
        return self._state in {"finalized", "failed"} or not self._thread.is_alive()

    @contextmanager
    def at_rest(self) -> Iterator[None]:
        """Run its code on this thread, while it is at rest; it does not go on before.

        If it was told to go on meanwhile, it does then.

        Raises
        ------
        RunError
            It is at work.
        """
        try:
            with self._lent():
                yield
        finally:
            if self._goes_on:
                self.go_on()

    @contextmanager
    def _lent(self) -> Iterator[None]:
        with self._lending:
            with self._resting:
                if not self._is_resting:
                    raise RunError(f"component '{self.spec.name}' is not at rest")
                self._is_lent = True
            self.exclusion.lend(new_chain())
            try:
                yield
            finally:
                self.exclusion.lend(0)
                with self._resting:
                    self._is_lent = False

    def wait_lull(self, limit: float) -> bool:
        """Wait until it has just worked on a timer or message, and none waits.

        Parameters
        ----------
        limit
            Wait no longer than this [s]: some never rest, some have nothing to do.

        Returns
        -------
        Whether that was so.
        """
        self._lull.clear()
        self._awaits_lull = True
        try:
            return self._lull.wait(limit)
        finally:
            self._awaits_lull = False

    def rest(self, limit: float) -> None:
        """Come to rest for a move: no code of it runs, and what comes waits.

        Raises
        ------
        Timeout
            It was busy for `limit` [s]; it goes on as before.
        RunError
            It does not move: the order is late, and it goes on as before.
        """
        stays = self._stays
        self._shut(limit)
        with self._resting:
            if stays is None or self._stays is not stays:
                self.go_on()
                raise RunError(f"component '{self.spec.name}' does not move")
            self._goes_on = False

    def _shut(self, limit: float) -> None:
        if not self._is_resting:
            self.exclusion.pause(limit)
            with self._resting:
                self._is_resting = True
                self.endpoints.set_unbounded(unbounded=True)

    def go_on(self) -> None:
        """Go on after a rest, if it is active; harmless when repeated.

        While a thread runs its code at rest nobody waits: it goes on after that.
        """
        with self._resting:
            self._goes_on = self._is_lent
            is_at_work = (self._state, self._goal) == ("active", "active")
            if self._is_resting and not self._is_lent and is_at_work:
                self._is_resting = False
                self.endpoints.set_unbounded(unbounded=False)
                self.endpoints.send_buffered()
                self.exclusion.resume()

    def keep_phases(self, due: Mapping[str, float]) -> None:
        """Let timers be due first at these moments [s], by name."""
        self._phases = due

    def status(self, cpu: float | None = None) -> ComponentStatus:
        """Return what is known of it now.

        Parameters
        ----------
        cpu
            Its CPU time, calls included [s]; None: that of its thread.
        """
        now = self._clock.now()
        handler, since = self._handler or ("", now)
        # releases of timers count while it is active
        until = now if self._deactivated_at is None else self._deactivated_at
        return ComponentStatus(
            name=self.spec.name,
            epoch=self.spec.epoch,
            state=self._state,
            error=self._errors.last,
            errors=self._errors.count,
            error_counts=self._errors.counts(),
            handler=handler,
            handler_seconds=now - since,
            cpu=self.counters.cpu() if cpu is None else cpu,
            start=self._start,
            snapshot=self._snapshot,
            has_state=type(self.component).snapshot is not Component.snapshot,
            requires=self._ports_that("requires"),
            subscribes=self._ports_that("subscribes"),
            timers=tuple(s.status(until) for s in list(self.schedules.values())),
            measures={n: h.summary() for n, h in list(self._measures.items())},
        )

    def _ports_that(self, kind: str) -> tuple[str, ...]:
        return tuple(port.name for port in self.ports.values() if port.kind == kind)

    def _measure(self, name: str, value: float) -> None:
        self._measures.setdefault(name, Histogram()).add(value)

    def _main(self) -> None:
        self.counters.begin()
        try:
            while self._state not in {"finalized", "failed"}:
                self._go_to_goal()
        finally:
            # nobody waits for what has ended: calls go where the component is now
            self.exclusion.redirect()
            self.counters.end()

    def _go_to_goal(self) -> None:
        step = self._next_step()
        if step is not None:
            self._take(*step)
        elif self._goal == "active":
            self._work()
        else:
            self.counters.note_idle()
            self._goal_changed.wait()
            self.counters.note_busy()
            self._goal_changed.clear()

    def _next_step(self) -> tuple[str, State] | None:
        """Return the hook to call and the state it leads to; None at the goal."""
        match self._state, self._goal:
            case "unconfigured", "inactive" | "ready" | "active":
                return "configure", "inactive"
            case "inactive", "ready" | "active":
                return "activate", "active"
            case "active", "inactive" | "finalized":
                return "deactivate", "inactive"
            case "inactive" | "unconfigured", "finalized":
                return "cleanup", "finalized"
        return None

    def _take(self, hook: str, state: State) -> None:
        if hook == "deactivate":
            self.counters.plan([])
            self._come_to_rest()
            self._deactivated_at = self._clock.now()
        elif hook == "activate":
            # the incarnation before it may still be at work, and goes first
            self.endpoints.buffer_until_active()
        # callers wait for one that takes over
        hurry = ahead() if self._goal == "ready" else nullcontext()
        try:
            with hurry, self._lent():
                getattr(self.component, hook)()
                if hook == "deactivate" and self.spec.weigh:
                    self._snapshot = _weight(self.component.snapshot())
        # a user's hook may raise anything
        except (Exception, SystemExit) as error:  # noqa: BLE001
            self._errors.note(hook, error, self._clock.now())
            self._clean_up_after(hook)
            state = "failed"
        if state == "active":
            self._plan_timers()
        elif hook == "configure":
            self._start = self._clock.now() - self.asked_at
        with self._state_changed:
            self._state = state
            self._state_changed.notify_all()
        self.go_on()
        self._on_change()

    def _plan_timers(self) -> None:
        now = self._clock.now()
        self._deactivated_at = None
        for name, timer in self._timers.items():
            first = self._phases.get(name, now + timer.period)
            self.schedules[name] = Timers(timer, first - timer.period)
        self.counters.plan([s.releases for s in self.schedules.values()])

    def _come_to_rest(self) -> None:
        try:
            self._shut(_PATIENCE)
        except Timeout as error:
            # the thread inside belongs to a caller; the process is about to end or
            # the component to go, so waiting longer helps nobody
            log.warning("%s", error)
            self.exclusion.redirect()
            self._is_resting = True

    def _clean_up_after(self, hook: str) -> None:
        if hook == "cleanup":
            return
        try:
            self.component.cleanup()
        except (Exception, SystemExit):
            log.exception("component '%s': cleanup after an error", self.spec.name)

    def _work(self) -> None:
        """Run the timers that are due, then at most one message."""
        schedules = self.schedules.values()
        for schedule in schedules:
            if schedule.due <= self._clock.now():
                self._run_timer(schedule)
        due = min((s.due for s in schedules), default=None)
        limit = None if due is None else max(0.0, due - self._clock.now())
        self.counters.note_idle()
        inbox = self.endpoints.mailbox.next(limit)
        self.counters.note_busy()
        if inbox is not None and self._enter():
            self._deliver(inbox)

    def _run_timer(self, schedule: Timers) -> None:
        if not self._enter():
            return
        began = self._clock.now()
        release = schedule.begin(began)
        self._run(getattr(self.component, schedule.timer.name), schedule.timer.name)
        schedule.end(release, began, self._clock.now())

    def _deliver(self, inbox: Inbox) -> None:
        entry = inbox.take()
        if entry is None:  # it was dropped for a newer one
            self.exclusion.leave()
            return
        port = self.ports[inbox.port]
        tag, value = entry
        if port.kind == "subscribes":
            handler = getattr(self.component, port.name)
            self._run(handler, port.name, value)
        else:
            method = getattr(self.component, methods(port.type)[tag].name)
            self._run(method, port.name, *value)

    def _enter(self) -> bool:
        """Begin a chain and wait to enter; False when the goal has changed."""
        chain = new_chain()
        while self._goal == "active":
            try:
                self.exclusion.enter(chain, _PATIENCE)
            except Timeout:
                continue
            except Redirected:
                # the incarnation that took over does the work; the container ends us
                self._goal_changed.clear()
                if self._goal == "active":
                    self._goal_changed.wait(_PATIENCE)
                continue
            return True
        return False

    def _run(self, method: Callable[..., Any], what: str, *args: object) -> None:
        """Run user code in the exclusion that was entered, and leave it."""
        self._handler = what, self._clock.now()
        try:
            method(*args)
        # a user's method may raise anything
        except (Exception, SystemExit) as error:  # noqa: BLE001
            self._errors.note(what, error, self._clock.now())
        finally:
            self._handler = None
            self.counters.note_done()
            self.exclusion.leave()
            if self._awaits_lull and self.endpoints.is_empty():
                self._lull.set()


def _weight(state: object) -> int:
    """Return the size of a snapshot when encoded [bytes]; 0 when there is none."""
    if state is None:
        return 0
    body, buffers = codec(Any).encode(state)
    return len(body) + sum(buffer.nbytes for buffer in buffers)
