"""What the code under test gets of the standard library while a simulation runs.

Clock, chance and transport are passed in where the code has a seam for them. This is
the net below: what reads the time, draws, locks or sleeps by the library does so in
virtual time, and what would leave the simulation is an error. Code outside of the
simulation's tasks, such as a test, gets the real library meanwhile. The library's
conditions, events and queues are written in Python over the locks replaced here.
"""

from __future__ import annotations

import getpass
import os
import queue
import random
import secrets
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from functools import partial
from math import inf
from threading import get_ident
from types import FunctionType, SimpleNamespace
from typing import Any

import zenoh

from poise.manage.agent_connections import reachability
from poise.manage.tasks import saved_tasks, task_manager
from poise.simulation.robot.simulated_process import Process
from poise.simulation.scheduler import (
    SLACK,
    YIELDS,
    Scheduler,
    SimulatedTask,
    SimulationError,
)
from poise.simulation.zenoh_sessions import ZenohNetwork

_FORBIDDEN = (
    (os, "fork"),
    (subprocess, "Popen"),
    (socket, "socket"),
    (socket, "socketpair"),
)


Replaced = tuple[Any, str, Callable[..., Any]]
"""A module, the name of what is replaced in it, and what tasks get instead."""


class SimulatedLibrary:
    """Replaces what the code under test uses of the library, while it is entered.

    It may be entered again and again. It is made while no other one is entered.
    """

    def __init__(self, scheduler: Scheduler, sessions: ZenohNetwork) -> None:
        replaced = [
            *_clocks(scheduler),
            *_threads(scheduler),
            *_process(scheduler),
            *_chance(scheduler),
            *_connections(scheduler, sessions),
            *((m, name, _refusal(f"{m.__name__}.{name}")) for m, name in _FORBIDDEN),
        ]
        self._real = [
            (module, name, getattr(module, name)) for module, name, _ in replaced
        ]
        self._instead = {
            real: _in_tasks(scheduler, function, real)
            for (_, _, function), (_, _, real) in zip(replaced, self._real, strict=True)
        }
        self._instead[time.monotonic] = _monotonic(scheduler, time.monotonic)
        self._num_modules = 0
        self._bound: list[_Bound] = []

    def __enter__(self) -> None:
        if len(sys.modules) != self._num_modules:  # some were imported meanwhile
            self._num_modules = len(sys.modules)
            self._bound = [
                _Bound(function, self._instead)
                for function in _with_defaults(self._instead)
            ]
        for module, name, real in self._real:
            setattr(module, name, self._instead[real])
        for bound in self._bound:
            bound.swap()

    def __exit__(self, *_: object) -> None:
        for module, name, real in self._real:
            setattr(module, name, real)
        for bound in self._bound:
            bound.restore()


class _Bound:
    """A function whose default arguments were bound to the library."""

    def __init__(
        self, function: FunctionType, instead: Mapping[Any, Callable[..., Any]]
    ) -> None:
        self._function = function
        self._real = function.__defaults__, function.__kwdefaults__
        self._defaults = tuple(
            _swapped(default, instead) for default in function.__defaults__ or ()
        )
        self._named = {
            name: _swapped(default, instead)
            for name, default in (function.__kwdefaults__ or {}).items()
        }

    def swap(self) -> None:
        """Let it get what is simulated."""
        self._function.__defaults__ = self._defaults
        self._function.__kwdefaults__ = self._named

    def restore(self) -> None:
        """Let it get the library again."""
        self._function.__defaults__, self._function.__kwdefaults__ = self._real


def _host(scheduler: Scheduler) -> Process:
    """Return the process of the task that runs."""
    assert scheduler.current is not None  # noqa: S101, only tasks get here
    return scheduler.current.host


def _clocks(scheduler: Scheduler) -> list[Replaced]:
    def clock_gettime(number: int) -> float:
        computer = _host(scheduler).computer
        if number == time.CLOCK_REALTIME:
            return computer.wall()
        is_boot = number == time.CLOCK_BOOTTIME
        return computer.boottime() if is_boot else computer.monotonic()

    def wall() -> float:
        return _host(scheduler).computer.wall()

    def monotonic() -> float:
        return _host(scheduler).computer.monotonic()

    def asleep() -> float:
        return _host(scheduler).computer.asleep()

    def sleep(seconds: float) -> None:
        scheduler.wait(max(seconds, SLACK), "sleep")

    def boot_id() -> str:  # as long as a real one: it is sent in messages
        return f"{_host(scheduler).computer.name:-<36}"

    return [
        (saved_tasks, "boot_id", boot_id),
        (task_manager, "boot_id", boot_id),
        (reachability, "time_asleep", asleep),
        (time, "time", wall),
        (time, "localtime", time.gmtime),
        (time, "monotonic", monotonic),
        (time, "perf_counter", monotonic),
        (time, "process_time", lambda: 0.0),
        (time, "clock_gettime", clock_gettime),
        (time, "sleep", sleep),
        (threading, "_time", monotonic),
        (queue, "time", monotonic),
    ]


def _monotonic(scheduler: Scheduler, real: Callable[[], float]) -> Callable[[], float]:
    """Return what `_in_tasks` would, without its detours: most calls are of this."""

    def monotonic() -> float:
        task = scheduler.current
        if task is None or get_ident() != scheduler.thread:
            return real()
        return task.host.computer.monotonic()

    return monotonic


def _threads(scheduler: Scheduler) -> list[Replaced]:
    lock = partial(SimulatedLock, scheduler)

    def ident() -> int:
        return 0 if scheduler.current is None else scheduler.current.number

    def current() -> SimpleNamespace:
        return SimpleNamespace(name=str(scheduler.current), ident=ident(), daemon=True)

    def raise_(failed: threading.ExceptHookArgs) -> None:
        """Raise in the simulated world what ended a thread."""
        task = scheduler.current
        assert task is not None  # noqa: S101, only tasks get here
        error = failed.exc_value or failed.exc_type()
        scheduler.at(scheduler.now, partial(task.host.note_failure, task, error))

    thread = type("Thread", (SimulatedThread,), {"scheduler": scheduler})
    return [
        (threading, "Lock", lock),
        (threading, "_allocate_lock", lock),
        (threading, "RLock", partial(SimulatedRLock, scheduler)),
        (threading, "get_ident", ident),
        (threading, "get_native_id", ident),
        (threading, "current_thread", current),
        (threading, "Thread", thread),
        (threading, "excepthook", raise_),
        (queue, "SimpleQueue", queue._PySimpleQueue),  # type: ignore[attr-defined]  # noqa: SLF001, the same
    ]


def _process(scheduler: Scheduler) -> list[Replaced]:
    def nothing(*_: object) -> int:
        """Return the usual priority: who runs first is the scheduler's affair."""
        return 0

    return [
        (os, "getpid", lambda: _host(scheduler).pid),
        (os, "getpriority", nothing),
        (os, "setpriority", nothing),
        (os, "sched_setscheduler", nothing),
        (socket, "gethostname", lambda: _host(scheduler).computer.name),
        # a longer name would make longer messages
        (getpass, "getuser", lambda: "user"),
    ]


def _chance(scheduler: Scheduler) -> list[Replaced]:
    def drawn(name: str) -> Callable[..., Any]:
        def draw(*limits: float) -> Any:  # noqa: ANN401, as the library's
            return getattr(_host(scheduler).random, name)(*limits)

        return draw

    names = ("random", "uniform", "randint", "choice", "gauss", "expovariate")
    return [
        *((random, name, drawn(name)) for name in names),
        (os, "urandom", drawn("randbytes")),
        (secrets, "randbits", drawn("getrandbits")),
    ]


def _connections(scheduler: Scheduler, sessions: ZenohNetwork) -> list[Replaced]:
    return [
        (
            socket,
            "create_connection",
            lambda *to: sessions.probe(_host(scheduler), *to),
        ),
        (zenoh, "open", lambda config: sessions.open(_host(scheduler), config)),
    ]


def _with_defaults(real: Container[object]) -> list[FunctionType]:
    """Return functions of Poise whose default arguments were bound to the library."""
    known = sys.modules.copy()  # another thread may import
    modules = [m for n, m in sorted(known.items()) if n.startswith("poise.")]
    classes = [c for m in modules for c in vars(m).values() if isinstance(c, type)]
    methods = [f for c in classes for f in vars(c).values()]
    return [
        function
        for function in methods
        if isinstance(function, FunctionType)
        and any(_is_hashable(d) and d in real for d in _defaults(function))
    ]


def _defaults(function: FunctionType) -> Iterator[object]:
    yield from function.__defaults__ or ()
    yield from (function.__kwdefaults__ or {}).values()


def _swapped(default: object, instead: Mapping[Any, object]) -> object:
    return instead.get(default, default) if _is_hashable(default) else default


def _is_hashable(value: object) -> bool:
    """Return whether it can be looked up: its type may depend on what it holds."""
    try:
        hash(value)
    except TypeError:
        return False
    return True


def _refusal(what: str) -> Callable[..., Any]:
    def refuse(*_: object, **__: object) -> None:
        raise SimulationError(
            f"{what} would leave the simulation: pass in what it is for"
        )

    return refuse


def _in_tasks(
    scheduler: Scheduler, simulated: Callable[..., Any], real: Callable[..., Any]
) -> Callable[..., Any]:
    """Return what is simulated for tasks, and real for all others."""

    def either(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401, as the library's
        if scheduler.current is None or get_ident() != scheduler.thread:
            return real(*args, **kwargs)
        return simulated(*args, **kwargs)

    return either


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

    def release(self, *_: object) -> None:
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
    __exit__ = release

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

    def release(self, *_: object) -> None:
        """Give it back, when that was done as often as it was taken."""
        if not self._count or not self._is_owned():
            raise RuntimeError("cannot release un-acquired lock")
        self._count -= 1
        if not self._count:
            self._owner = None
            super().release()

    __enter__ = acquire
    __exit__ = release

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
