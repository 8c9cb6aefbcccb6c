"""Runs tasks one at a time in virtual time; the seed says which of them is next.

A task is a greenlet: the code under test blocks as on a thread, and gives way only
where it waits. Time passes only while nothing can run.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from hashlib import blake2b
from heapq import heappop, heappush
from itertools import count
from math import inf
from threading import get_ident
from typing import TYPE_CHECKING, Any

from greenlet import getcurrent, greenlet

from poise.errors import PoiseError
from poise.simulation._engine import Engine
from poise.simulation.choices import Choices

if TYPE_CHECKING:
    from poise.simulation.robot.simulated_process import Process

SLACK = 60e-6
"""The kernel ends a wait this much late, as Linux does [s]."""
YIELDS = 0.02
"""How often a task gives way to others where it takes a lock that is free."""
ENGINE = "engine"
"""The stream of what the engine draws."""
_STEP = struct.Struct("<dI")
_MOST_AT_ONCE = 200_000
"""So many steps without any time passing are a loop that never ends."""


class SimulationError(PoiseError):
    """The code under test, or the simulator, did what no simulation can go on with."""


class Killed(BaseException):
    """The process of a task was killed: nothing of it goes on."""


class SimulatedTask:
    """What runs like a thread.

    `waits_for`: what it waits for, in words; empty while it runs.
    """

    greenlet: greenlet

    def __init__(self, number: int, name: str, host: Process) -> None:
        self.number = number
        self.name = name
        self.host = host
        self.waits_for = ""
        self.timer: SimulatedTimer | None = None
        self.is_woken = False
        self.has_ended = False

    def __str__(self) -> str:
        return f"{self.host.name}/{self.name}"


class SimulatedTimer(list[Any]):
    """Something that happens at its moment, unless it is cancelled.

    A list of the moment, a number and the action: the heap compares such without a call
    of Python, and there are several for each message.
    """

    __slots__ = ()

    def cancel(self) -> None:
        """Let it not happen; harmless when repeated."""
        self[2] = None


class Scheduler:
    """The virtual time of one run, and its tasks.

    `engine`: what happens often: it has its own events, and gets the time until the
    next one here.
    `now`: the present moment [s]; the run begins at 0.
    `current`: the task that runs; None: the simulated world does.
    `thread`: on which it runs: on another one, no task does.
    `number`: returns a number that nothing else of this run has.
    `steps`: how often a task ran until it waited.
    `on_step`: called after each step.
    `locks_left`: so many free locks are taken until the task that takes one gives way.
    """

    def __init__(self, choices: Choices) -> None:
        self.choices = choices
        seed = choices.random(ENGINE).getrandbits(64)
        self.engine = Engine(seed, choices.recorded(ENGINE))
        self.now = 0.0
        self.current: SimulatedTask | None = None
        self.thread = get_ident()
        self.steps = 0
        self.on_step: Callable[[], object] = lambda: None
        self.number: Callable[[], int] = count(1).__next__
        self._ready: list[SimulatedTask] = []
        self._timers: list[SimulatedTimer] = []
        self._waiting: dict[int, SimulatedTask] = {}
        self._world = getcurrent()
        self._trace = blake2b(digest_size=16)
        self._at_once = 0
        self.locks_left = choices.pause(YIELDS)

    def digest(self) -> str:
        """Return a hash of all steps so far: equal runs have equal ones."""
        return self._trace.hexdigest()

    def spawn(
        self, host: Process, name: str, work: Callable[[], object]
    ) -> SimulatedTask:
        """Let a process have a new task."""
        task = SimulatedTask(self.number(), name, host)
        task.greenlet = greenlet(lambda: self._main(task, work), self._world)
        self._ready.append(task)
        return task

    def at(self, moment: float, action: Callable[[], object]) -> SimulatedTimer:
        """Let something happen in the simulated world at a moment [s]."""
        timer = SimulatedTimer((max(moment, self.now), self.number(), action))
        heappush(self._timers, timer)
        return timer

    def wait(self, seconds: float = inf, why: str = "time") -> bool:
        """Let the current task wait; return whether it was woken within `seconds` [s].

        Raises SimulationError: no task runs: the simulated world never waits.
        """
        task = self.current
        if task is None:
            raise SimulationError(f"the simulated world waits for {why}: a task should")
        if task.host.is_dead:
            raise Killed
        task.waits_for, task.is_woken = why, False
        if seconds <= 0:
            self._ready.append(task)
        else:
            self._waiting[task.number] = task
            if seconds < inf:
                at = self.now + seconds + SLACK
                task.timer = self.at(at, partial(self._make_ready, task))
        self._world.switch()
        task.waits_for = ""
        if task.host.is_dead:
            raise Killed
        return task.is_woken

    def wake(self, task: SimulatedTask) -> bool:
        """End a task's wait; return whether it waited."""
        is_waiting = task.number in self._waiting
        if is_waiting:
            task.is_woken = True
            self._make_ready(task)
        return is_waiting

    def resume(self, task: SimulatedTask) -> None:
        """Let a task of a process that was paused go on."""
        self._ready.append(task)

    def end(self, task: SimulatedTask) -> None:
        """End a task whose process is dead; for the simulated world."""
        self._waiting.pop(task.number, None)
        if task.timer is not None:
            task.timer.cancel()
        if not task.has_ended:
            self._switch_to(task)

    def run(self, until: float) -> None:
        """Let time pass until a moment [s].

        SimulationError: nothing can ever run again, or time does not pass.
        """
        self.thread = get_ident()
        timers, ready, engine = self._timers, self._ready, self.engine
        while True:
            while timers and timers[0][0] <= self.now:
                action = heappop(timers)[2]
                if action is not None:
                    action()
            if ready:
                self._step()
                continue
            while timers and timers[0][2] is None:
                heappop(timers)
            if not timers and self._waiting and engine.next() == inf:
                waiting = ", ".join(f"{t} ({t.waits_for})" for t in self.waiting())
                raise SimulationError(
                    f"at {self.now:.3f} s nothing can run and nothing will happen: "
                    f"{waiting} waits for ever"
                )
            moment = min(timers[0][0], until) if timers else until
            before, self.now = self.now, engine.run(moment)
            if self.now > before:
                self._at_once = 0
            if not engine.notify() and (not timers or timers[0][0] > until):
                return

    def waiting(self) -> list[SimulatedTask]:
        """Return the tasks that wait, oldest first."""
        return [self._waiting[number] for number in sorted(self._waiting)]

    def _make_ready(self, task: SimulatedTask) -> None:
        if task.timer is not None:
            task.timer.cancel()
            task.timer = None
        del self._waiting[task.number]
        self._ready.append(task)

    def _step(self) -> None:
        """Let one of the ready tasks run until it waits."""
        ready, index = self._ready, 0
        if len(ready) > 1:
            index = self.choices.among("schedule", len(ready))
        task = ready.pop(index)
        host = task.host
        if host.is_dead or task.has_ended:
            return
        if host.is_paused:
            host.held.append(task)
            return
        self.steps += 1
        self._at_once += 1
        if self._at_once > _MOST_AT_ONCE:
            raise SimulationError(
                f"at {self.now:.3f} s {_MOST_AT_ONCE} steps passed without any time: "
                f"{task} ({task.waits_for or 'begins'}) is one of those that loop"
            )
        self._trace.update(_STEP.pack(self.now, task.number))
        self._switch_to(task)
        self.on_step()

    def _switch_to(self, task: SimulatedTask) -> None:
        before, self.current = self.current, task
        try:
            task.greenlet.switch()
        finally:
            self.current = before

    def _main(self, task: SimulatedTask, work: Callable[[], object]) -> None:
        try:
            if not task.host.is_dead:
                work()
        except Killed:
            pass
        except BaseException as error:  # noqa: BLE001, its process says what it means
            if not task.host.is_dead:
                task.host.note_failure(task, error)
        finally:
            task.has_ended = True
