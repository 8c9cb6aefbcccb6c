"""A container: the process in which components run.

It is told by its agent what should be (`ContainerSpec`), makes it so step by step, and
tells what is (`ContainerStatus`) whenever that changes, and now and then.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import FrameType

from poise.errors import RunError, Timeout, Unavailable
from poise.priority import as_usual, gently, go_first
from poise.runtime.clock_table import ComputerClock
from poise.runtime.component.component import Component
from poise.runtime.component.error_report import told
from poise.runtime.component.implementation import find, specialised
from poise.runtime.hosting.command_line import Command
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.stats_page import Incarnation, StatsPage
from poise.runtime.hosting.wiring import Place, Transports, Wiring
from poise.runtime.migration.executor import MigrationExecutor
from poise.runtime.waker import Waker, is_writable, wait_readable
from poise.wire import record_channel
from poise.wire.records.deployment import (
    ComponentSpec,
    ComponentStatus,
    ContainerSpec,
    ContainerStatus,
    FromContainer,
    Goal,
    ToContainer,
)
from poise.wire.records.migration import Done, Failed, Order, Outcome

log = logging.getLogger(__name__)

REPORT_EVERY = 1.0
"""A status goes out at least this often [s]."""
_JOINING_EVERY = 0.02
"""While a connector is not joined, it is looked for this often [s]."""
_STOP_LIMIT = 1.0
_STEP_THREADS = 4
_SWITCH_EVERY = 0.001
"""How long a thread may keep the others of its container waiting [s] (Python: 5 ms)."""


class Container:
    """The components of one process and their connectors.

    Parameters
    ----------
    agent
        The control socket.
    ledger
        The descriptor of the memory in which it counts.
    """

    def __init__(
        self, name: str, agent: socket.socket, stats_page: int, place: Place
    ) -> None:
        self._name = name
        self._agent = agent
        self._clock = ComputerClock(place.computer, Path(place.folder))
        self._transports = Transports(place)
        self._wiring = Wiring(self._transports, self._clock.ahead)
        self._runners: dict[Incarnation, Runner] = {}
        self._commands: dict[Incarnation, Command] = {}
        self._hanging: list[Runner] = []
        self._broken: dict[Incarnation, ComponentStatus] = {}
        self._steps = MigrationExecutor(self._runners, self._wiring, self._transports)
        # steps wait for components and for other computers; the control thread must not
        self._step_threads = ThreadPoolExecutor(_STEP_THREADS, "step", go_first)
        self._telling = threading.Lock()
        self._stopping = False
        self._waker = Waker()
        self._stats_page = StatsPage(stats_page)

    def run(self) -> None:
        """Work until told to end, or until the agent is gone.

        Raises
        ------
        RunError
            The process of a command-line component ended by itself.
        """
        sys.setswitchinterval(_SWITCH_EVERY)
        signal.signal(signal.SIGTERM, self._on_signal)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            go_first()
            self._serve()
        except Unavailable:
            log.warning("container '%s': the agent is gone", self._name)
        finally:
            self._stop()

    def _on_signal(self, _signal: int, _frame: FrameType | None) -> None:
        self._stopping = True
        self._waker.wake()

    def _serve(self) -> None:
        report_at, unjoined = 0.0, self._wiring.unjoined()
        while not self._stopping:
            look_at = report_at
            if unjoined:
                look_at = min(report_at, self._clock.now() + _JOINING_EVERY)
            has_news = self._listen(max(0.0, look_at - self._clock.now()))
            before, unjoined = unjoined, self._wiring.unjoined()
            if has_news or unjoined != before or self._clock.now() >= report_at:
                self._report(self._status())
                report_at = self._clock.now() + REPORT_EVERY

    def _listen(self, limit: float) -> bool:
        """Wait up to `limit` [s] for news, and attend to it; whether it is to be told.

        An order is not: what it changes will be.
        """
        agent, waker = self._agent.fileno(), self._waker.fileno()
        ended = [fd for each in self._commands.values() for fd in each.watched()]
        ready = wait_readable([agent, waker, *ended], limit)
        if waker in ready:
            self._waker.clear()
        if agent in ready:
            what = record_channel.receive(self._agent, ToContainer).what
            self._hear(what)
            if isinstance(what, Order) and len(ready) == 1:
                return False
        if not ready.isdisjoint(ended):
            self._raise_if_ended()
        return bool(ready)

    def _raise_if_ended(self) -> None:
        """End with a command that ended: the agent starts both anew, after a while."""
        try:
            for command in self._commands.values():
                command.raise_if_ended()
        except ChildProcessError as error:
            raise RunError(str(error)) from None

    def _report(self, status: ContainerStatus) -> None:
        # an agent that is slow to listen gets the next status, not all of them
        if is_writable(self._agent.fileno()):
            self._tell(status)

    def _hear(self, what: ContainerSpec | Order) -> None:
        if isinstance(what, Order):
            self._step_threads.submit(self._take_steps, self._steps.hear(what))
        else:
            self._steps.note_deployment()
            with as_usual():
                self._apply(what)

    def _take_steps(self, take: Callable[[], Outcome]) -> None:
        outcome = take()
        with contextlib.suppress(Timeout, Unavailable):  # the agent gave up on us
            self._tell(outcome)

    def _tell(self, what: ContainerStatus | Done | Failed) -> None:
        with self._telling:
            record_channel.send(self._agent, FromContainer(what))

    def _apply(self, spec: ContainerSpec) -> None:
        wanted = {(c.name, c.epoch): c for c in spec.components}
        for key, component in wanted.items():
            if key not in {*self._running(), *self._broken}:
                self._add(component, spec.folder)
        self._connect(spec, [key for key in self._runners if key in wanted])
        for key, running in self._running().items():
            if key in wanted:
                self._aim(running, wanted[key].goal)
            else:
                self._remove(key)
        for key in set(self._broken) - set(wanted):
            del self._broken[key]
        self._stats_page.show(self._running(), self._wiring.endpoints())

    def _running(self) -> dict[Incarnation, Runner | Command]:
        return {**self._runners, **self._commands}

    @staticmethod
    def _aim(running: Runner | Command, goal: Goal) -> None:
        if goal != "stay":
            running.aim(goal)
        elif isinstance(running, Runner):
            running.stay()

    def _add(self, component: ComponentSpec, folder: str) -> None:
        asked_at = self._clock.now()
        if component.command:
            self._commands[component.name, component.epoch] = Command(component, folder)
            return
        try:
            implementation = specialised(
                self._found(component, folder), component.parameters, folder
            )
            runner = Runner(component, implementation, self._clock, self._waker.wake)
            runner.asked_at = asked_at
        # it is the user's: it may raise anything
        except (Exception, SystemExit) as error:  # noqa: BLE001
            text = told(error)
            log.error("component '%s' cannot start: %s", component.name, text)  # noqa: TRY400, told
            self._note_broken(component, text)
            return
        self._runners[component.name, component.epoch] = runner
        runner.start()

    def _found(self, component: ComponentSpec, folder: str) -> type[Component]:
        """Import the class of a component, with what CPU time is left if it says so.

        Not while others work here: they would wait for the interpreter, which a thread
        that hardly gets a CPU may hold.
        """
        is_idle = all(each.state != "active" for each in self._runners.values())
        if component.gently and is_idle:
            return gently(lambda: find(component.implementation, folder))
        return find(component.implementation, folder)

    def _note_broken(self, component: ComponentSpec, error: str) -> None:
        self._broken[component.name, component.epoch] = ComponentStatus(
            name=component.name,
            epoch=component.epoch,
            state="failed",
            error=error,
            errors=1,
        )

    def _connect(self, spec: ContainerSpec, staying: list[Incarnation]) -> None:
        runners = {key: self._runners[key] for key in staying}
        for key, text in self._wiring.apply(spec.connectors, runners).items():
            log.error("component '%s' cannot be joined: %s", key[0], text)
            self._note_broken(runners[key].spec, text)

    def _remove(self, key: Incarnation) -> None:
        running = self._running()[key]
        runner = self._runners.pop(key, None)
        running.aim("finalized")
        ended = running.wait_ended(_STOP_LIMIT)
        self._commands.pop(key, None)
        if not ended:
            log.warning("component '%s' did not end in %g s", key[0], _STOP_LIMIT)
        if runner is not None:
            self._steps.forget(runner)
            self._hanging += () if ended else (runner,)

    def _status(self) -> ContainerStatus:
        used = self._stats_page.cpu()
        self._hanging = [each for each in self._hanging if not each.wait_ended(0)]
        hanging = {(r.spec.name, r.spec.epoch): r.status() for r in self._hanging}
        components = hanging | {
            key: each.status(used.get(key)) for key, each in self._running().items()
        }
        return ContainerStatus(
            name=self._name,
            pid=os.getpid(),
            cpu=time.process_time()
            + sum(each.account.cpu() for each in self._commands.values()),
            components=tuple((components | self._broken).values()),
            connectors=self._wiring.status(),
        )

    def _stop(self) -> None:
        deadline = self._clock.now() + _STOP_LIMIT
        for running in self._running().values():
            running.aim("finalized")
        for (name, _), running in self._running().items():
            if not running.wait_ended(max(0.0, deadline - self._clock.now())):
                log.warning("component '%s' did not end in time", name)
        with contextlib.suppress(Timeout, Unavailable):  # nobody may be left to tell
            self._report(self._status())
        self._step_threads.shutdown(wait=False, cancel_futures=True)
        self._wiring.close()
        self._transports.close()
