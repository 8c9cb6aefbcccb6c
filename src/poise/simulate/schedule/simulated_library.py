"""What the code under test gets of the standard library while a simulation runs.

Clock, chance and transport are passed in where the code has a seam for them. This is
the net below: what reads the time, draws, locks or sleeps by the library does so in
virtual time, and what would leave the simulation is an error. Code outside of the
simulation's tasks, such as a test, gets the real library meanwhile.
"""

from __future__ import annotations

import os
import queue
import random
import secrets
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Container, Hashable, Iterator, Mapping
from contextlib import contextmanager
from types import FunctionType, SimpleNamespace
from typing import Any

import zenoh

from poise.simulate.computers.process import Process
from poise.simulate.network.datagrams import SimulatedSocket
from poise.simulate.network.zenoh_sessions import ZenohNetwork
from poise.simulate.schedule.locks import SimulatedLock, SimulatedThread
from poise.simulate.schedule.scheduler import Scheduler, SimulationError

_FORBIDDEN = ((os, "fork"), (subprocess, "Popen"), (socket, "socketpair"))


@contextmanager
def simulated_library(
    scheduler: Scheduler, sessions: ZenohNetwork
) -> Iterator[None]:
    """Replace what the code under test uses of the library, until the block ends."""
    network, addresses = sessions.network, sessions.addresses

    def process() -> Process:
        assert scheduler.current is not None  # noqa: S101, only tasks get here
        assert isinstance(scheduler.current.host, Process)  # noqa: S101
        return scheduler.current.host

    def clock_gettime(number: int) -> float:
        computer = process().computer
        if number == time.CLOCK_REALTIME:
            return computer.wall()
        is_boot = number == time.CLOCK_BOOTTIME
        return computer.boottime() if is_boot else computer.monotonic()

    def lock() -> SimulatedLock:
        return SimulatedLock(scheduler)

    def sleep(seconds: float) -> None:
        scheduler.wait(max(seconds, 1e-9), "sleep")

    def nothing(*_: object) -> None:
        """Priorities of tasks are the scheduler's affair."""

    thread = type("Thread", (SimulatedThread,), {"scheduler": scheduler})
    monotonic = _Seconds(lambda: process().computer.monotonic())
    replaced: list[tuple[Any, str, Callable[..., Any]]] = [
        (time, "time", lambda: process().computer.wall()),
        (time, "monotonic", monotonic),
        (time, "perf_counter", monotonic),
        (time, "process_time", lambda: 0.0),
        (time, "clock_gettime", clock_gettime),
        (time, "sleep", sleep),
        (threading, "_time", monotonic),
        (queue, "time", monotonic),
        (threading, "Lock", lock),
        (threading, "_allocate_lock", lock),
        (threading, "RLock", threading._PyRLock),  # type: ignore[attr-defined]  # noqa: SLF001
        (threading, "get_ident", lambda: scheduler.current.number),  # type: ignore[union-attr]
        (threading, "get_native_id", lambda: scheduler.current.number),  # type: ignore[union-attr]
        (threading, "Thread", thread),
        (threading, "current_thread", lambda: SimpleNamespace(name=str(scheduler.current))),
        (queue, "SimpleQueue", queue._PySimpleQueue),  # type: ignore[attr-defined]  # noqa: SLF001
        (os, "getpid", lambda: process().pid),
        (os, "urandom", lambda size: process().random.randbytes(size)),
        (os, "setpriority", nothing),
        (os, "sched_setscheduler", nothing),
        (os, "getpriority", lambda *_: 0),
        (secrets, "randbits", lambda bits: process().random.getrandbits(bits)),
        (socket, "gethostname", lambda: process().computer.name),
        (socket, "socket", lambda *kind: SimulatedSocket(addresses, network, process(), *kind)),
        (socket, "create_connection", lambda *a: sessions.probe(process(), *a)),
        (zenoh, "open", lambda config: sessions.open(process(), config)),
    ]
    for name in ("random", "uniform", "randint", "choice", "gauss", "expovariate"):
        replaced.append((random, name, _drawn(process, name)))
    for module, name in _FORBIDDEN:
        replaced.append((module, name, _refusal(f"{module.__name__}.{name}")))
    before = [(module, name, getattr(module, name)) for module, name, _ in replaced]
    instead = {
        real: _in_tasks(scheduler, function, real)
        for (_, _, function), (_, _, real) in zip(replaced, before, strict=True)
    }
    bound = [(each, each.__defaults__) for each in _with_defaults(instead)]
    try:
        for module, name, real in before:
            setattr(module, name, instead[real])
        for function, defaults in bound:
            function.__defaults__ = tuple(_swapped(each, instead) for each in defaults)
        yield
    finally:
        for module, name, real in before:
            setattr(module, name, real)
        for function, defaults in bound:
            function.__defaults__ = defaults


def _with_defaults(real: Container[object]) -> list[FunctionType]:
    """Return functions of Poise whose default arguments were bound to the library."""
    modules = [m for n, m in sorted(sys.modules.items()) if n.startswith("poise.")]
    classes = [c for m in modules for c in vars(m).values() if isinstance(c, type)]
    methods = [f for c in classes for f in vars(c).values()]
    return [
        function
        for function in methods
        if isinstance(function, FunctionType)
        and any(_is_hashable(d) and d in real for d in function.__defaults__ or ())
    ]


def _swapped(default: object, instead: Mapping[Any, object]) -> object:
    return instead.get(default, default) if _is_hashable(default) else default


def _is_hashable(value: object) -> bool:
    return isinstance(value, Hashable)


class _Seconds:
    """A clock; a class, so that no default argument takes it for a method."""

    def __init__(self, read: Callable[[], float]) -> None:
        self._read = read

    def __call__(self) -> float:
        return self._read()


def _drawn(process: Callable[[], Process], name: str) -> Callable[..., Any]:
    return lambda *limits: getattr(process().random, name)(*limits)


def _refusal(what: str) -> Callable[..., Any]:
    def refuse(*_: object, **__: object) -> None:
        raise SimulationError(f"{what} would leave the simulation: pass in what it is for")

    return refuse


def _in_tasks(
    scheduler: Scheduler, simulated: Callable[..., Any], real: Callable[..., Any]
) -> Callable[..., Any]:
    """Return what is simulated for tasks, and real for all others."""

    def either(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401, as the library's
        use = real if scheduler.current is None else simulated
        return use(*args, **kwargs)

    return either
