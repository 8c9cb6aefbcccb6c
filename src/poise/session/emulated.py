"""Keeps the emulated computers of a robot up, for runs and rehearsed faults."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

from poise.emulate import EmulatedSet, find_set
from poise.emulate.registry import locked
from poise.errors import PoiseError, UsageError
from poise.model.robot import Robot
from poise.session.launch.emulated_agents import EmulatedAgents, emulated_agents
from poise.session.launch.temporary_folders import scratch_folder
from poise.session.say import Say, log

_LOOK_EVERY = 0.1
_MOST_DELAY = 5.0
"""An agent that keeps ending is started again after this time at most [s]."""
_STEADY = 10.0
"""An agent that ran for this time [s] is started at once when it ends."""


@contextlib.contextmanager
def emulated(robot: Robot, *, say: Say = log.info) -> Iterator[EmulatedSet]:
    """Emulate a robot's computers inside the ``with`` block, with an agent on each.

    Meanwhile `run` and `up` of this robot use them, from any process of this user, and
    leave them up. An agent that ends is started again, as systemd would on a real
    computer, unless its computer was crashed.

    Parameters
    ----------
    say
        Takes sentences, also on a thread of its own.

    Raises
    ------
    UsageError
        The robot's computers have addresses, or are kept by another process.
    RobotError, RunError
        They cannot be emulated; nothing is left.
    """
    real = [computer.name for computer in robot.computers if computer.address]
    if real:
        raise UsageError(
            f"robot '{robot.name}' has real computers ({', '.join(real)}): only "
            "computers without `address` are emulated"
        )
    with (
        scratch_folder("poise-run-") as folder,
        emulated_agents(robot, folder / "computers", say, keep=True) as agents,
    ):
        kept = find_set(robot.name)
        ending = threading.Event()
        keeper = _Keeper(agents, kept, say)
        thread = threading.Thread(
            target=keeper.keep, args=[ending], name="keeper", daemon=True
        )
        thread.start()
        try:
            yield kept
        finally:
            ending.set()
            thread.join()


class _Keeper:
    """Starts agents again that have ended."""

    def __init__(self, agents: EmulatedAgents, kept: EmulatedSet, say: Say) -> None:
        self._agents = agents
        self._kept = kept
        self._say = say
        self._delays = dict.fromkeys(agents.processes, 0.0)
        self._starts = dict.fromkeys(agents.processes, time.monotonic())

    def keep(self, ending: threading.Event) -> None:
        """Look after all agents until the set ends."""
        while not ending.wait(_LOOK_EVERY):
            for name, process in list(self._agents.processes.items()):
                if process.poll() is not None:
                    self._look_after(name, process.returncode)

    def _look_after(self, name: str, code: int) -> None:
        lasted = time.monotonic() - self._starts[name]
        if lasted > _STEADY:
            self._delays[name] = 0.0
        if lasted < self._delays[name]:
            return
        try:
            with locked():  # or it might start while its computer is being crashed
                if self._kept.is_crashed(name):
                    self._delays[name] = 0.0
                    return
                self._starts[name] = time.monotonic()
                delay = 2 * self._delays[name] + _LOOK_EVERY
                self._delays[name] = min(_MOST_DELAY, delay)
                self._agents.start(name)
        except (PoiseError, OSError) as error:
            self._say(f"the agent of '{name}' cannot be started again: {error}")
        else:
            self._say(f"the agent of '{name}' ended ({code}) and is started again")
