"""A component's state and goal, its news of tasks, and the gate that pauses it."""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Set as AbstractSet
from contextlib import contextmanager

from poise.errors import RunError, Timeout
from poise.runtime.component.component import Verb
from poise.runtime.component.started_calls import StartedCalls
from poise.runtime.connectors.endpoints import ComponentEndpoints
from poise.runtime.execution.exclusion import Exclusion, new_chain
from poise.wire.records.deployment_records import LifeCycleGoal
from poise.wire.records.status_records import ActionEnd, State, TaskRequest

ENDED: AbstractSet[State] = {"finalized", "failed"}

_MOST_REQUESTS = 16
"""As many requests are reported again and again, in case that a status is lost."""
_BITS = 62
_TURN = 0.01
"""A component that waits for answers looks for them this often [s]."""
BORROW_LIMIT = 5.0
"""Whoever wants the component's code waits this long for another who has it [s]."""


class LifeCycle:
    """Where a component is, and where it should be; any thread may ask."""

    def __init__(self) -> None:
        self.state: State = "unconfigured"
        self.goal: LifeCycleGoal = "inactive"
        self._changed = threading.Condition()

    @property
    def is_at_work(self) -> bool:
        """Whether it is active, and should be."""
        return (self.state, self.goal) == ("active", "active")

    def aim(self, goal: LifeCycleGoal) -> None:
        """Set the goal; in vain after `finalized`."""
        with self._changed:
            if self.goal != "finalized":
                self.goal = goal
            self._changed.notify_all()

    def enter(self, state: State) -> None:
        """Set the state."""
        with self._changed:
            self.state = state
            self._changed.notify_all()

    def next_step(self) -> tuple[str, State] | None:
        """Return the hook to call and the state it leads to; None at the goal."""
        match self.state, self.goal:
            case "unconfigured", "inactive" | "ready" | "active":
                return "configure", "inactive"
            case "inactive", "ready" | "active":
                return "activate", "active"
            case "active", "inactive" | "finalized":
                return "deactivate", "inactive"
            case "inactive" | "unconfigured", "finalized":
                return "cleanup", "finalized"
        return None

    def wait_for_step(self) -> None:
        """Wait until there is something to do: this is how a component idles."""
        with self._changed:
            self._changed.wait_for(lambda: self.next_step() or self.goal == "active")

    def wait_while_active(self, limit: float) -> None:
        """Wait up to `limit` [s] for another goal than ``active``."""
        with self._changed:
            self._changed.wait_for(lambda: self.goal != "active", limit)

    def wait_state(self, states: AbstractSet[State], limit: float) -> State:
        """Wait up to `limit` [s] for one of `states`; return the state then."""
        with self._changed:
            self._changed.wait_for(lambda: self.state in states, limit)
            return self.state


class TaskNews:
    """What one component requests of tasks, and which of its actions have ended."""

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._requests: deque[TaskRequest] = deque(maxlen=_MOST_REQUESTS)
        # one that is started again after a crash repeats no number
        self._number = secrets.randbits(_BITS)
        self._ends: dict[str, ActionEnd] = {}
        self._ended: set[str] = set()

    def begin(self) -> None:
        """Heed ends again: an action begins, or the component was deactivated."""
        self._ended.clear()

    def ended(self) -> tuple[ActionEnd, ...]:
        """Return what it said since then, of which the manager may not know yet."""
        return tuple(self._ends[port] for port in sorted(self._ended))

    def take_over(
        self, ended: Iterable[ActionEnd], requests: Iterable[TaskRequest]
    ) -> None:
        """Say what the incarnation before said, too."""
        self._ends |= {end.port: end for end in ended}
        self._ended.update(self._ends)
        self._requests.extend(requests)

    def request(self, verb: Verb, task: str) -> None:
        """Request that something is done with a task."""
        self._requests.append(TaskRequest(number=self._next(), verb=verb, task=task))
        self._on_change()

    def note_end(self, port: str, done: object) -> None:
        """Note that the action of a port is done, or failed; the first counts."""
        if port in self._ended:
            return
        self._ended.add(port)
        self._ends[port] = ActionEnd(port=port, count=self._next(), done=bool(done))
        self._on_change()

    def requests(self) -> tuple[TaskRequest, ...]:
        """Return the latest, oldest first; any thread may ask."""
        return tuple(self._requests.copy())

    def ends(self) -> tuple[ActionEnd, ...]:
        """Return the last end at each port; any thread may ask."""
        return tuple(self._ends.copy().values())

    def _next(self) -> int:
        self._number += 1
        return self._number


class ExecutionGate:
    """Whether a component's code may run. It starts paused."""

    def __init__(
        self,
        name: str,
        exclusion: Exclusion,
        endpoints: ComponentEndpoints,
        calls: StartedCalls,
        may_resume: Callable[[], bool],
        hang: Callable[[], tuple[str, float]] = lambda: ("", 0.0),
    ) -> None:
        self._name = name
        self._hang = hang
        self._exclusion = exclusion
        self._endpoints = endpoints
        self._calls = calls
        self._may_resume = may_resume
        self._changed = threading.Condition()
        self.is_paused = True
        self._is_borrowed = self._resumes_later = False
        self._migration: object = None
        self._awaited_idle: threading.Event | None = None

    def allow_pause(self) -> None:
        """Allow a pause for a migration; what the one before paused resumes."""
        self._migration = object()  # one for each: a pause for the last one is late
        self.resume()

    def refuse_pause(self) -> None:
        """Refuse a pause for a migration."""
        self._migration = None

    def pause_for_migration(self, limit: float) -> None:
        """Pause within `limit` [s]; on Timeout or RunError it goes on as before."""
        migration = self._migration
        self.pause(limit)
        with self._changed:
            if migration is None or self._migration is not migration:
                self.resume()
                raise RunError(f"component '{self._name}' does not move")
            self._resumes_later = False

    def pause(self, limit: float) -> None:
        """Pause; raise Timeout when it was busy for `limit` [s]."""
        if not self.is_paused:
            until = time.monotonic() + limit
            self._keep_out(limit)
            while self._calls.num_open:  # their answers are still to be taken
                self._exclusion.resume()
                if not self._calls.wait(until):
                    raise Timeout(f"component '{self._name}' waits for {self._calls}")
                self._exclusion.pause(max(0.0, until - time.monotonic()))
            self._note_paused()

    def pause_oneself(self, limit: float, take_answers: Callable[[], bool]) -> None:
        """Pause, on the component's own thread; Timeout when others stay inside.

        Answers of calls that it started are taken within half of `limit` [s], the
        others when it is active again. `take_answers` takes those that have come;
        False: none may be taken now.
        """
        until = time.monotonic() + limit / 2
        while take_answers() and self._calls.num_open and time.monotonic() < until:
            self._calls.wait(min(until, time.monotonic() + _TURN))
        self._keep_out(limit / 2)
        self._note_paused()

    def pause_for_good(self) -> None:
        """Pause although others are inside: their process ends."""
        self._exclusion.redirect()
        self.is_paused = True

    def _keep_out(self, limit: float) -> None:
        try:
            self._exclusion.pause(limit)
        except Timeout as error:
            what, seconds = self._hang()
            runs = f": {what}, for {seconds:.1f} s by now" if what else ""
            raise Timeout(f"{error}{runs}") from None

    def _note_paused(self) -> None:
        with self._changed:
            self.is_paused = True
            self._endpoints.mailbox.set_unbounded(unbounded=True)

    def resume(self) -> None:
        """Go on after a pause, if it is active; harmless when repeated."""
        with self._changed:
            self._resumes_later = self._is_borrowed
            if self.is_paused and not self._is_borrowed and self._may_resume():
                self.is_paused = False
                self._endpoints.mailbox.set_unbounded(unbounded=False)
                try:
                    self._endpoints.send_buffered()
                except BaseException:  # no thread is free, say: the next time
                    self.is_paused = True
                    raise
                self._exclusion.resume()

    @contextmanager
    def borrowed(self, *, by_hook: bool = False) -> Iterator[None]:
        """Run its code here while it is paused; resume at the end if asked to."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._is_borrowed, BORROW_LIMIT):
                raise Timeout(
                    f"component '{self._name}': its `snapshot`, `restore` or another "
                    f"hook still runs after {BORROW_LIMIT:g} s"
                )
            if not self.is_paused:
                raise RunError(f"component '{self._name}' is not paused")
            self._is_borrowed = True
        self._exclusion.lend(new_chain())
        try:
            yield
        finally:
            self._exclusion.lend(0)
            with self._changed:
                self._is_borrowed = False
                self._changed.notify_all()
            if self._resumes_later and not by_hook:
                self.resume()

    def wait_idle(self, limit: float) -> bool:
        """Wait up to `limit` [s] until it ends its work; return whether it has."""
        idle = self._awaited_idle = threading.Event()
        try:
            return idle.wait(limit)
        finally:
            self._awaited_idle = None

    def note_done(self) -> None:
        """Note that it has finished a timer or message."""
        idle = self._awaited_idle
        if idle is not None and self._endpoints.mailbox.is_empty():
            idle.set()
