"""Starts agents of emulated computers again that have ended, as systemd would."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator

from poise.emulate.registry import locked
from poise.errors import PoiseError
from poise.runtime.waker import Waker, wait_readable
from poise.session.callbacks import Say
from poise.session.launch.emulated_agents import EmulatedAgents

_LOOK_EVERY = 0.02
"""While an agent has ended, it is looked whether it may start so often [s]."""
_FIRST_DELAY = 0.1
_MOST_DELAY = 5.0
"""An agent that keeps ending is started again after this time at most [s]."""
_STEADY = 10.0
"""An agent that ran for this time [s] is started at once when it ends."""


@contextlib.contextmanager
def keeping_agents(
    agents: EmulatedAgents, may_start: Callable[[str, int], bool], say: Say
) -> Iterator[None]:
    """Start agents again that end inside the ``with`` block.

    Parameters
    ----------
    may_start
        Returns whether the agent of a computer, which ended with some return code, is
        started again.
    say
        Takes sentences, on a thread of its own.
    """
    ending = Waker()
    keeper = _Keeper(agents, may_start, say)
    thread = threading.Thread(
        target=keeper.keep, args=[ending], name="keeper", daemon=True
    )
    thread.start()
    try:
        yield
    finally:
        ending.wake()
        thread.join()
        ending.close()


class _Keeper:
    """Starts agents again that have ended."""

    def __init__(
        self, agents: EmulatedAgents, may_start: Callable[[str, int], bool], say: Say
    ) -> None:
        self._agents = agents
        self._may_start = may_start
        self._say = say
        self._delays = dict.fromkeys(agents.processes, 0.0)
        self._starts = dict.fromkeys(agents.processes, time.monotonic())

    def keep(self, ending: Waker) -> None:
        """Look after all agents until the set ends."""
        while not self._wait(ending):
            for name, process in list(self._agents.processes.items()):
                if process.poll() is not None:
                    self._look_after(name, process.returncode)

    def _wait(self, ending: Waker) -> bool:
        """Wait until an agent has ended or may start; return whether the set ends."""
        with contextlib.ExitStack() as stack:
            fds = []
            processes = list(self._agents.processes.values())
            for process in processes:
                if process.poll() is None:
                    fds.append(os.pidfd_open(process.pid))
                    stack.callback(os.close, fds[-1])
            limit = _LOOK_EVERY if len(fds) < len(processes) else None
            return ending.fileno() in wait_readable([ending.fileno(), *fds], limit)

    def _look_after(self, name: str, code: int) -> None:
        lasted = time.monotonic() - self._starts[name]
        if lasted > _STEADY:
            self._delays[name] = 0.0
        if lasted < self._delays[name]:
            return
        try:
            with locked():  # or it might start while its computer is being crashed
                if not self._may_start(name, code):
                    self._delays[name] = 0.0
                    return
                self._starts[name] = time.monotonic()
                delay = 2 * self._delays[name] + _FIRST_DELAY
                self._delays[name] = min(_MOST_DELAY, delay)
                self._agents.start(name)
        except (PoiseError, OSError) as error:
            self._say(f"the agent of '{name}' cannot be started again: {error}")
        else:
            self._say(f"the agent of '{name}' ended ({code}) and is started again")
