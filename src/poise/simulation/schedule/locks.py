"""Locks and threads of the code under test, as tasks in virtual time.

The conditions, events and queues of the standard library are written in Python over
these locks, so the locks and the thread are all that is replaced.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Any

from poise.simulation.schedule.scheduler import YIELDS, Scheduler, SimulatedTask


class SimulatedLock:
    """As `threading.Lock`."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._is_locked = False
        self._granted: SimulatedTask | None = None
        self._waiting: deque[SimulatedTask] = deque()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:  # noqa: FBT001, FBT002, as the library's
        """Take it; return whether that was done within `timeout` [s]."""
        scheduler, task = self._scheduler, self._scheduler.current
        if task is not None and task.host.is_dead:  # it only unwinds
            self._is_locked = True
            return True
        if not self._is_locked:
            self._is_locked = True
            if task is not None and blocking:
                scheduler.locks_left -= 1
                if scheduler.locks_left < 0:
                    self._give_way()
            return True
        if not blocking or task is None:
            return False
        self._waiting.append(task)
        until = scheduler.now + timeout if timeout >= 0 else inf
        while scheduler.wait(until - scheduler.now, "a lock"):
            if self._granted is task:
                self._granted = None
                return True
        if task in self._waiting:
            self._waiting.remove(task)
        return False

    def release(self) -> None:
        """Give it back, to the task that has waited longest."""
        if not self._is_locked:
            raise RuntimeError("release unlocked lock")
        while self._waiting:
            task = self._waiting.popleft()
            if not task.host.is_dead and self._scheduler.wake(task):
                self._granted = task
                return
        self._is_locked = False

    def locked(self) -> bool:
        """Return whether it is taken."""
        return self._is_locked

    __enter__ = acquire

    def __exit__(self, *_: object) -> None:
        self.release()

    def _give_way(self) -> None:
        scheduler = self._scheduler
        scheduler.locks_left = scheduler.choices.pause(YIELDS)
        scheduler.wait(0, "its turn")


class SimulatedRLock(SimulatedLock):
    """As `threading.RLock`, also for conditions; the library's is slow in Python."""

    def __init__(self, scheduler: Scheduler) -> None:
        super().__init__(scheduler)
        self._owner: SimulatedTask | None = None
        self._count = 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:  # noqa: FBT001, FBT002, as the library's
        """Take it, or take it once more; return whether that was done."""
        if self._count and self._is_owned():
            self._count += 1
            return True
        is_taken = super().acquire(blocking, timeout)
        if is_taken:
            self._owner, self._count = self._scheduler.current, 1
        return is_taken

    def release(self) -> None:
        """Give it back, when that was done as often as it was taken."""
        if not self._count or not self._is_owned():
            raise RuntimeError("cannot release un-acquired lock")
        self._count -= 1
        if not self._count:
            self._owner = None
            super().release()

    __enter__ = acquire

    def _is_owned(self) -> bool:
        return self._owner is self._scheduler.current

    def _release_save(self) -> int:
        """Give it back wholly; return what `_acquire_restore` needs."""
        count, self._count, self._owner = self._count, 0, None
        super().release()
        return count

    def _acquire_restore(self, count: int) -> None:
        super().acquire()
        self._owner, self._count = self._scheduler.current, count


class SimulatedThread:
    """As `threading.Thread`: a task of the process that starts it."""

    def __init__(
        self,
        group: None = None,
        target: Callable[..., object] | None = None,
        name: str | None = None,
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
        *,
        daemon: bool | None = None,
    ) -> None:
        del group
        self._target, self._args, self._kwargs = target, args, kwargs or {}
        self.name = name or "thread"
        self.daemon = bool(daemon)
        self._task: SimulatedTask | None = None

    scheduler: Scheduler
    """Of the run; set by `SimulatedLibrary`."""

    @property
    def ident(self) -> int | None:
        """The number of its task."""
        return None if self._task is None else self._task.number

    def start(self) -> None:
        """Begin."""
        starter = self.scheduler.current
        assert starter is not None  # noqa: S101, the world starts tasks
        self._task = starter.host.spawn(self.name, self.run)

    def run(self) -> None:
        """Work."""
        if self._target is not None:
            self._target(*self._args, **self._kwargs)

    def is_alive(self) -> bool:
        """Return whether it works."""
        return self._task is not None and not self._task.has_ended

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended, at most `timeout` [s]."""
        until = inf if timeout is None else self.scheduler.now + timeout
        while self.is_alive() and self.scheduler.now < until:
            self.scheduler.wait(min(0.001, until - self.scheduler.now), self.name)
