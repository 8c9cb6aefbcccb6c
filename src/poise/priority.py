"""Which threads go first: control threads, then transfers of state, then components.

Threads differ by their nice values, which the threads that they start inherit. With
`REAL_TIME` set, those that call `go_first` are real-time threads where they may be.
"""

from __future__ import annotations

import contextlib
import os
import resource
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

_usual = os.getpriority(os.PRIO_PROCESS, 0)
_AHEAD, _LAST = -10, 19
_NICE_RANGE = 20
"""The limit for a nice value is this less the value (getrlimit(2))."""
_LOWEST = 1
"""The lowest real-time priority: a robot's own real-time threads go before."""
REAL_TIME = "POISE_REALTIME"
"""Environment variable: ``1`` makes the control threads real-time threads."""


def be_nice(steps: int) -> None:
    """Let all threads of this process, which has one yet, share the CPU with others."""
    global _usual  # noqa: PLW0603, it is that of the process
    _usual = min(_usual + steps, _LAST)
    if steps:
        _set_nice(_usual)


def go_first() -> None:
    """Let this thread go before all that work, so far as the system allows it.

    For what others wait for and takes next to no CPU time. Users' code is never run
    so: nothing could stop it.
    """
    if os.environ.get(REAL_TIME) == "1":
        with contextlib.suppress(PermissionError):
            policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(_LOWEST))
            return
    _set_nice(_usual + _AHEAD)


def let_go_first() -> None:
    """Let this process go first, too, when it is not root any more, if it may."""
    with contextlib.suppress(ValueError):
        resource.setrlimit(resource.RLIMIT_NICE, (_NICE_RANGE - _AHEAD,) * 2)
        if os.environ.get(REAL_TIME) == "1":
            resource.setrlimit(resource.RLIMIT_RTPRIO, (_LOWEST, _LOWEST))


def goes_first() -> bool:
    """Return whether the system let this thread go before all that work."""
    nice = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    return nice <= _usual + _AHEAD or os.sched_getscheduler(0) != os.SCHED_OTHER


def going_first() -> AbstractContextManager[None]:
    """Let this thread go first for a while."""
    return _for_a_while(go_first)


def before_components() -> AbstractContextManager[None]:
    """Let this thread go before components for a while; for users' code, too."""
    return _for_a_while(lambda: _set_nice(_usual + _AHEAD))


def as_usual() -> AbstractContextManager[None]:
    """Let a thread that goes first, and those that it starts, be as all others."""
    return _for_a_while(lambda: _set_nice(_usual))


def give_way() -> None:
    """Let this thread leave the CPU to all others, for good.

    Only the privileged may take that back, so use a thread that does nothing else.
    """
    _set_nice(_LAST)


@contextmanager
def _for_a_while(change: Callable[[], object]) -> Iterator[None]:
    """Change the priority of this thread, and put it back at the end."""
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    nice = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    try:
        change()
        yield
    finally:
        _set_nice(nice)
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, policy, param)


def _set_nice(value: int) -> None:
    """Share the CPU with this nice value, if the system allows it."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), value)
