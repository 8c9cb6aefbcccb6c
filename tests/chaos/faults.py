"""What breaks a robot: each fault happens at once, or lasts for a while."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

from msgspec import Struct

from poise.emulate import EmulatedSet
from poise.errors import RunError, UsageError
from poise.session.running_robots.running import Status
from poise.wire.records.status_records import ContainerStatus
from tests.chaos.managers import Managers

COMPONENTS = ("caller", "counter", "relay", "sensor", "sink", "source", "worker")
COMPUTERS = ("a", "b", "c")
AT_ONCE = 2
"""At most so many faults that last are in force."""
LASTS = (0.5, 8.0)
"""How long a fault lasts [s]."""
_CRASH = "crash"
SPLIT_LASTS = (8.0, 16.0)
"""How long a computer with a second manager is cut off [s]: that takes 3 s to start."""


class Fault(Struct, kw_only=True):
    """What was done to the robot.

    Parameters
    ----------
    on
        The computers, the container or the component.
    since, until
        When it was in force [s, by the clock of the machine].
    stops_agent
        Whether an agent could not do its work meanwhile.
    forced
        Whether a person let a second manager take over what another may run.
    """

    kind: str
    on: str = ""
    since: float
    until: float
    stops_agent: bool = False
    forced: bool = False

    def __str__(self) -> str:
        return f"{self.kind}: {self.on}" if self.on else self.kind


class Faults:
    """Breaks a robot at random.

    Parameters
    ----------
    status
        Returns what the manager says, or None.
    say
        Takes a sentence at every event.

    Attributes
    ----------
    history
        All faults, oldest first.
    trouble
        What could not be injected or mended, and what hung.
    """

    def __init__(
        self,
        robot: str,
        computers: EmulatedSet,
        managers: Managers,
        status: Callable[[], Status | None],
        chance: random.Random,
        say: Callable[[str], object],
    ) -> None:
        self._robot = robot
        self._computers = computers
        self._managers = managers
        self._status = status
        self._chance = chance
        self._say = say
        self._lasting: list[tuple[Fault, Callable[[], object]]] = []
        self._momentary = (
            self._kill_container,
            self._kill_agent,
            self._kill_all,
            self._kill_manager,
            self._move,
            self._move,
        )
        self._deck: list[Callable[[], Fault]] = []
        self._manager_due = 0.0
        self._moves: list[subprocess.Popen[bytes]] = []
        self.history: list[Fault] = []
        self.trouble: list[str] = []

    def inject(self) -> None:
        """Break something; nothing happens when what is chosen is not possible."""
        event = self._draw()
        if event is None:
            return
        with self._noted():
            fault = event()
            self.history.append(fault)
            self._say(str(fault))

    def _draw(self) -> Callable[[], Fault] | None:
        """Return what to do next: each kind comes once before any comes again.

        None: all that is left lasts, and enough is in force.
        """
        if not self._deck:
            self._deck = [
                *self._momentary,
                self._cut,
                self._cut_off,
                self._slow,
                self._crash,
                self._freeze,
                self._freeze_agent,
                self._freeze_container,
                self._load,
                self._split,
            ]
            self._chance.shuffle(self._deck)
        is_free = len(self._lasting) < AT_ONCE
        for event in self._deck:
            if is_free or event in self._momentary:
                self._deck.remove(event)
                return event
        return None

    def end_due(self) -> None:
        """End the faults whose time has come."""
        now = time.monotonic()
        if self._manager_due and now >= self._manager_due:
            self._manager_due = 0.0
            self._managers.restart()
        if self._managers.was_taken_over():
            self._say("the first manager was taken over, and starts again")
            self._managers.restart()
        for fault, end in [each for each in self._lasting if each[0].until <= now]:
            if self._may_end(fault):
                self._lasting.remove((fault, end))
                with self._noted():
                    end()
                fault.until = time.monotonic()
                self._say(f"  no more: {fault}")

    def in_force(self) -> bool:
        """Return whether anything is broken, or still to be started again."""
        return bool(self._lasting or self._manager_due)

    def end_moves(self, limit: float) -> None:
        """Wait until no command to move is under way [at most so many s]."""
        for process in self._moves:
            try:
                process.wait(limit)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(limit)
                self.trouble.append(f"`poise move` gave no answer for {limit:g} s")

    @contextlib.contextmanager
    def _noted(self) -> Iterator[None]:
        """Note what fails; what is refused is not possible now.

        Such as a second fault of a link, or to heal a cut that a crash has ended.
        """
        try:
            yield
        except UsageError:
            pass
        except RunError as error:
            self.trouble.append(str(error))

    def _may_end(self, fault: Fault) -> bool:
        """Cables are mended only where no computer is crashed."""
        kinds = {each.kind for each, _ in self._lasting}
        return fault.kind == _CRASH or _CRASH not in kinds

    def _happened(self, kind: str, on: str = "", *, stops_agent: bool = False) -> Fault:
        now = time.monotonic()
        return Fault(kind=kind, on=on, since=now, until=now, stops_agent=stops_agent)

    def _lasts(
        self,
        kind: str,
        on: str,
        end: Callable[[], object],
        lasts: tuple[float, float] = LASTS,
        *,
        stops_agent: bool = False,
        forced: bool = False,
    ) -> Fault:
        now = time.monotonic()
        until = now + self._chance.uniform(*lasts)
        fault = Fault(
            kind=kind,
            on=on,
            since=now,
            until=until,
            stops_agent=stops_agent,
            forced=forced,
        )
        self._lasting.append((fault, end))
        return fault

    def _kill_container(self) -> Fault:
        container = self._any_container()
        _send(signal.SIGKILL, container.pid)
        return self._happened("container killed", container.name)

    def _freeze_container(self) -> Fault:
        container = self._any_container()
        _send(signal.SIGSTOP, container.pid)
        return self._lasts(
            "container stopped",
            container.name,
            lambda: _send(signal.SIGCONT, container.pid),
        )

    def _kill_agent(self) -> Fault:
        computer, status = self._any_computer(), self._status()
        if status is None or computer not in status.computers:
            raise UsageError("its process is not known")
        _send(signal.SIGKILL, status.computers[computer].pid)
        return self._happened("agent killed", computer, stops_agent=True)

    def _kill_all(self) -> Fault:
        computer = self._any_computer()
        _send(signal.SIGKILL, *self._computers.computers[computer].running())
        return self._happened("all processes killed", computer, stops_agent=True)

    def _kill_manager(self) -> Fault:
        if self._manager_due:
            raise UsageError("it is killed already")
        self._managers.kill()
        self._manager_due = time.monotonic() + self._chance.uniform(0, 2)
        return self._happened("manager killed")

    def _move(self) -> Fault:
        component, computer = self._chance.choice(COMPONENTS), self._any_computer()
        argv = [sys.executable, "-m", "poise", "move", component, computer]
        self._moves = [each for each in self._moves if each.poll() is None]
        null = subprocess.DEVNULL
        self._moves.append(
            subprocess.Popen([*argv, "--robot", self._robot], stdout=null, stderr=null)
        )
        return self._happened("move", f"{component} to {computer}")

    def _cut(self) -> Fault:
        one, two = self._chance.sample(COMPUTERS, 2)
        self._computers.cut(one, two)
        return self._lasts(
            "link cut", f"{one} {two}", lambda: self._computers.heal(one, two)
        )

    def _cut_off(self) -> Fault:
        computer = self._any_computer()
        self._computers.cut(computer)
        return self._lasts("cut off", computer, lambda: self._computers.heal(computer))

    def _split(self) -> Fault:
        """Cut a computer off, and start a second manager there.

        The first one may be killed at the same time.
        """
        if self._manager_due or any("manager" in f.kind for f, _ in self._lasting):
            raise UsageError("there is no first manager, or a second one already")
        computer = self._any_computer()
        forced, is_killed = self._chance.choice([(0, 0), (0, 1), (1, 0), (1, 1)])
        self._computers.cut(computer)
        if is_killed:
            self._managers.kill()
        self._managers.start_second(self._computers, computer, forced=bool(forced))
        kind = "cut off with a second manager"
        kind += " and --take-over" * forced + ", the first one killed" * is_killed
        beside = self._chance.uniform(0, 2)
        return self._lasts(
            kind,
            computer,
            lambda: self._join(computer, beside),
            SPLIT_LASTS,
            forced=bool(forced),
        )

    def _join(self, computer: str, beside: float) -> None:
        """Heal the cut, and keep the first manager, or start it again."""
        with contextlib.suppress(UsageError):  # a crash has ended the cut
            self._computers.heal(computer)
        if self._managers.first.poll() is None:
            time.sleep(beside)  # both see all computers
        self._managers.kill_second()
        if self._managers.first.poll() == -signal.SIGKILL:
            self._managers.restart()

    def _slow(self) -> Fault:
        one, two = self._chance.sample(COMPUTERS, 2)
        self._computers.slow(one, two, bandwidth=self._chance.choice([2e4, 1e6]))
        return self._lasts(
            "link slow", f"{one} {two}", lambda: self._computers.heal(one, two)
        )

    def _crash(self) -> Fault:
        computer = self._any_computer()
        self._computers.crash(computer)
        end = self._booting(computer)
        return self._lasts(_CRASH, computer, end, stops_agent=True)

    def _freeze(self) -> Fault:
        computer = self._any_computer()
        self._computers.freeze(computer)
        end = self._booting(computer)
        return self._lasts("all processes stopped", computer, end, stops_agent=True)

    def _freeze_agent(self) -> Fault:
        computer = self._any_computer()
        self._computers.freeze(computer, agent=True)
        end = self._booting(computer)
        # the gateway is a thread of it
        return self._lasts("agent and gateway stopped", computer, end, stops_agent=True)

    def _load(self) -> Fault:
        computer = self._any_computer()
        self._computers.load(computer, 0.3)
        return self._lasts("load", computer, lambda: self._computers.load(computer, 0))

    def _booting(self, computer: str) -> Callable[[], object]:
        return lambda: self._computers.boot(computer)

    def _any_computer(self) -> str:
        return self._chance.choice(COMPUTERS)

    def _any_container(self) -> ContainerStatus:
        found = list(containers(self._status()))
        if not found:
            raise UsageError("there is no container")
        return self._chance.choice(found)


def containers(status: Status | None) -> Iterator[ContainerStatus]:
    """Yield all containers that a manager knows."""
    for computer in status.computers.values() if status else ():
        yield from computer.containers


def _send(sent: signal.Signals, *pids: int) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, sent)
