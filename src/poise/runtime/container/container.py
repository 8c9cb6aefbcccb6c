"""A container: the process in which components run.

The control thread brings it to what its agent says should run (`ContainerSpec`), and
waits for no import and no component.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import signal
import socket
import sys
from collections.abc import Collection
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import FrameType

from msgspec import structs

from poise import threads
from poise.errors import (
    PoiseError,
    RunError,
    Sparing,
    Timeout,
    Unavailable,
    UsageError,
    did_you_mean,
    encodable,
    listed,
)
from poise.priority import as_usual, go_first
from poise.runtime.component.error_report import sendable, traceback_of
from poise.runtime.component.implementation import search_also
from poise.runtime.connectors.tap import ObservedPort, Taps
from poise.runtime.container.agent_link import AgentLink
from poise.runtime.container.component_import import folder_of_version, prepare
from poise.runtime.execution.container_lease import LeaseEnd
from poise.runtime.execution.counters import ComponentKey, StatsPage
from poise.runtime.execution.data_age import ComputerClock
from poise.runtime.hosting.checkpoints import Checkpoints
from poise.runtime.hosting.command_line import freeze_fenced
from poise.runtime.hosting.descendants import Orphans
from poise.runtime.hosting.output import output_trouble
from poise.runtime.hosting.outside_requests import OutsideRequests
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Wiring
from poise.runtime.migration.executor import MigrationExecutor
from poise.waker import Waker, wait_readable
from poise.wire.codec import WireError
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.records.deployment_records import ComponentSpec, ContainerSpec
from poise.wire.records.heartbeat_records import Clocks
from poise.wire.records.migration_records import MigrationSteps
from poise.wire.records.request_records import PortRequest, Tap
from poise.wire.records.status_records import (
    ENDING_LIMIT,
    ComponentStatus,
    ContainerAnswer,
    ContainerFailure,
    ContainerStatus,
    ToContainer,
)

log = logging.getLogger(__name__)

REPORT_EVERY = 1.0
"""A status goes out at least this often [s]."""
BEAT_EVERY = 0.2
"""The heartbeat that the agent watches is incremented at least this often [s]."""
_WHILE_PAUSED, _WHILE_RESUMED = 0.15, 0.02
"""News waits this long after steps of a migration came [s]: callers wait meanwhile, and
a status takes longer to make and to pass on than they do."""
_JOINING_EVERY = 0.02
"""While a connector is not joined, it is looked for this often [s]."""
_STOP_LIMIT = 1.0
"""The handlers that run when a container is to end are waited for so long [s]."""
_LOOK_EVERY = 0.05
_STEP_THREADS = 4
_LONG_PAUSE = 3.0
"""No move pauses a component for so long while there is a manager [s]."""
_SWITCH_EVERY = 0.001
"""How long a thread may keep the others of its container waiting [s] (Python: 5 ms)."""


_PAUSED = (
    "component '%s' has been paused for %g s amid a move that nobody finishes: its "
    "callers get Timeout until a manager (`poise up FILE`) resumes it"
)


class Container:
    """The components of one process and their connectors."""

    def __init__(
        self,
        name: str,
        computer: str,
        folder: Path,
        agent: socket.socket,
        stats_page: int,
    ) -> None:
        self._name = name
        self._clock = ComputerClock(computer)
        self._link = AgentLink(name, agent, stats_page, folder, self._clock)
        self._server = self._listening(folder)
        self._wiring = Wiring(self._server, self._clock.offset)
        self._taps = Taps(self._sender)
        self._folder = folder
        self._wanted: ContainerSpec | None = None
        self._preparing: dict[ComponentKey, tuple[ComponentSpec, Future[Runner]]] = {}
        self._runners: dict[ComponentKey, Runner] = {}
        self._ending: dict[ComponentKey, tuple[Runner, float]] = {}
        # with what could not be started; None: no thread was free, and may be later
        self._broken: dict[
            ComponentKey, tuple[ComponentSpec | None, ComponentStatus]
        ] = {}
        self._not_wired: dict[ComponentKey, ComponentStatus] = {}
        self._steps = MigrationExecutor(self._runners, self._wiring, self._server)
        # steps wait for components and for other computers; the control thread must not
        self._step_threads = ThreadPoolExecutor(_STEP_THREADS, "step", go_first)
        self._outside = OutsideRequests(self._active, self._tell)
        self._paused: dict[Runner, float] = {}
        self._sparing = Sparing(log)
        self._news_waits_until = 0.0
        self._stopping = False
        self._thread_failures = threads.Failures(f"container '{name}'")
        self._stop_limit = _STOP_LIMIT
        self._silent: frozenset[str] = frozenset()
        self._waker = Waker()
        self._server.on_change = self._waker.wake
        self._stats_page = StatsPage(stats_page)
        self._lease = LeaseEnd(stats_page)

    def _listening(self, folder: Path) -> ConnectionServer:
        try:
            return ConnectionServer(folder, self._name)
        except OSError as error:
            why = RunError(f"cannot listen in {folder}: {error.strerror}")
            self._tell_failure(why)
            raise why from error

    def run(self) -> None:
        """Work until the agent says to end, or is gone for too long."""
        sys.setswitchinterval(_SWITCH_EVERY)
        threads.hear_failures(self._thread_failures.note)
        signal.signal(signal.SIGTERM, self._on_signal)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        os.register_at_fork(after_in_child=_end_by_signals)
        try:
            go_first()
            self._serve()
        except Unavailable as error:
            log.warning("container '%s' ends: %s", self._name, error)
        except (RunError, Timeout, WireError) as error:
            self._tell_failure(error)
            raise
        finally:
            self._stop()

    def _tell_failure(self, what: PoiseError | str, *, goes_on: bool = False) -> None:
        self._tell(ContainerFailure(encodable(str(what)), goes_on))

    def _on_signal(self, _signal: int, _frame: FrameType | None) -> None:
        self._stopping = True
        self._waker.wake()

    def _serve(self) -> None:
        report_at, unanswered, missed = 0.0, self._wiring.connect(), 0
        has_news = False
        orphans = Orphans()
        while not self._stopping:
            self._stats_page.beat()
            self._link.ask_when_due()
            freeze_fenced(self._runners.values())
            beat_at = self._clock.now() + BEAT_EVERY
            news_at = self._news_waits_until if has_news else report_at
            due = min(report_at, news_at, beat_at, self._link.due)
            if self._watch_inputs() or unanswered:
                due = min(due, self._clock.now() + _JOINING_EVERY)
            has_news |= self._listen(max(0.0, due - self._clock.now()))
            has_news |= self._settle()
            self._raise_on_hang()
            self._note_pauses()
            self._taps.end_unread()
            before = unanswered, missed
            unanswered, missed = self._wiring.connect(), self._missed()
            has_news |= (unanswered, missed) != before
            now = self._clock.now()
            if now >= report_at or (has_news and now >= self._news_waits_until):
                self._report(self._status())
                has_news = False
                report_at = self._clock.now() + REPORT_EVERY
                orphans.reap()
                self._start_again()

    def _watch_inputs(self) -> bool:
        """Tell components who has lost a source; return whether to look again soon."""
        looks_soon = [
            runner.note_inputs(self._wiring.joined_inputs(*key, self._silent))
            for key, runner in self._runners.items()
            if runner.watches_inputs
        ]
        return any(looks_soon)

    def _missed(self) -> int:
        now = self._clock.now()
        return sum(runner.timers.missed(now) for runner in self._runners.values())

    def _listen(self, limit: float) -> bool:
        """Wait up to `limit` [s] for news, take it in, return whether to report it."""
        waker = self._waker.fileno()
        ready = wait_readable([waker, *self._link.files()], limit)
        if waker in ready:
            self._waker.clear()
            for runner in self._runners.values():
                if runner.reason_to_end:
                    raise RunError(runner.reason_to_end)
        if ready - {waker}:
            record = self._link.receive()
            if record is not None:
                self._hear(record)
            elif self._wanted is None and not self._link.files():
                raise Unavailable("the agent ended while it started")
            return isinstance(record, ContainerSpec) or waker in ready
        return bool(ready)

    def _raise_on_hang(self) -> None:
        for (name, _), runner in self._runners.items():
            if limit := runner.spec.restart_when_hung:
                what, seconds = runner.hang()
                if seconds > limit:
                    self._stop_limit = 0.0  # it would not end in time
                    raise RunError(
                        f"component '{name}' hangs: {what} for {seconds:.1f} s, over "
                        f"its limit of {limit:g} s"
                    )

    def _note_pauses(self) -> None:
        """Say which components wait amid a move that its manager has left, once."""
        now = self._clock.now()
        paused = [runner for runner in self._runners.values() if runner.is_paused]
        self._paused = {runner: self._paused.get(runner, now) for runner in paused}
        for runner, since in self._paused.items():
            if now - since > _LONG_PAUSE:
                self._paused[runner] = math.inf  # it is said once
                log.warning(_PAUSED, runner.spec.name, _LONG_PAUSE)

    def _report(self, status: ContainerStatus) -> None:
        # an agent that is slow to listen gets the next status, not all of them; before
        # it has said what should run there is nothing to report
        if self._wanted is None or not self._link.has_room():
            return
        with contextlib.suppress(Timeout):  # the rest of it goes before the next
            try:
                self._link.send(status)
            except WireError as error:
                self._sparing.warn("status", "the status lacks texts: %s", error)
                self._link.send(sendable(status))

    def _hear(self, what: ToContainer) -> None:
        if isinstance(what, Clocks):
            self._clock.others, self._silent = what.known, what.silent
        elif isinstance(what, Tap):
            self._tell(self._taps.read(what))
        elif isinstance(what, PortRequest):
            self._outside.take(what)
        elif isinstance(what, MigrationSteps) and what.steps[0].name == "halt":
            # at once: all threads for steps may be waiting
            self._tell(self._steps.halt(what))
        elif isinstance(what, MigrationSteps):
            is_paused = what.steps[-1].phase in {"quiesce", "transfer"}
            wait = _WHILE_PAUSED if is_paused else _WHILE_RESUMED
            self._news_waits_until = self._clock.now() + wait
            take = self._steps.receive(what)
            self._step_threads.submit(lambda: self._tell(take()))
        else:
            self._steps.note_deployment(what)
            self._wanted, self._news_waits_until = what, 0.0
            with as_usual():
                self._apply(what)

    def _active(self, component: str) -> Runner | None:
        """Return the incarnation of a component that works here, or the latest."""
        known = [
            r for (name, _), r in self._runners.copy().items() if name == component
        ]
        known.sort(key=lambda r: (r.life_cycle.state == "active", r.spec.epoch))
        return known[-1] if known else None

    def _sender(self, asked: str) -> ObservedPort:
        """Return the sender of a connector, or a published port that has none."""
        component, _, name = asked.rpartition(".")
        runner = self._active(component)
        if runner is None:
            return self._wiring.sender(asked)
        ports = {n: p for n, p in runner.ports.items() if p.kind == "publishes"}
        if name not in ports:
            raise UsageError(
                f"no connector begins or ends at '{asked}', and '{component}' "
                f"publishes no '{name}'{did_you_mean(name, ports)}; it publishes "
                f"{listed(ports)}"
            )
        return runner.endpoints.observed(ports[name])

    def _tell(self, record: ContainerAnswer | ContainerFailure) -> None:
        with contextlib.suppress(Timeout):  # the agent gave up on us
            self._link.send(record)

    def _apply(
        self, spec: ContainerSpec, new: Collection[ComponentKey] | None = None
    ) -> None:
        """Let run what should; of what runs already tell `new` its goal, or all.

        A goal that is told again would undo what steps of a migration did meanwhile.
        """
        folder = folder_of_version(spec.code) if spec.code else spec.folder
        search_also(spec.repository)
        wanted = {c.key: c for c in spec.components}
        for key, (tried, _) in list(self._broken.items()):
            now = wanted.get(key)
            if now is None or (tried and structs.replace(tried, goal=now.goal) != now):
                del self._broken[key]
        known = {*self._runners, *self._preparing, *self._ending, *self._broken}
        for key, component in wanted.items():
            if key not in known:
                self._add(key, component, folder)
        self._connect(spec, [key for key in self._runners if key in wanted])
        for key, runner in list(self._runners.items()):
            if key not in wanted:
                self._remove(key)
            elif new is not None and key not in new:
                continue
            elif (goal := wanted[key].goal) == "stay":
                runner.gate.allow_pause()
            else:
                runner.note_spec(wanted[key])
                runner.aim(goal)
        for key in self._preparing.keys() - wanted:
            del self._preparing[key]
        self._stats_page.show(self._runners, self._wiring.open_connectors())

    def _add(self, key: ComponentKey, component: ComponentSpec, folder: str) -> None:
        # While others work here they would wait for the interpreter, which a thread
        # that hardly gets a CPU may hold.
        is_idle = all(
            runner.life_cycle.state != "active" for runner in self._runners.values()
        )
        preparation = prepare(
            component,
            folder,
            self._clock,
            self._waker.wake,
            gives_way=component.gently and is_idle,
        )
        self._preparing[key] = component, preparation

    def _settle(self) -> bool:
        """Go on with components that are prepared or have ended; whether any are."""
        if not self._preparing and not self._ending:
            return False
        with as_usual():
            prepared = self._start_prepared()
            has_changed = self._end_removed() or bool(prepared)
            if has_changed and self._wanted is not None:
                self._apply(self._wanted, new=prepared)
        return has_changed

    def _start_prepared(self) -> list[ComponentKey]:
        """Start the components whose preparation is done; return which these are."""
        done = [key for key, (_, future) in self._preparing.items() if future.done()]
        for key in done:
            spec, prepared = self._preparing.pop(key)
            try:
                self._start(spec, prepared.result())
            # it is the user's: it may have raised anything
            except BaseException as error:  # noqa: BLE001
                is_lack = threads.is_lack_of_threads(error)
                why = traceback_of(error) or repr(error)
                why = threads.NO_THREAD if is_lack else why
                tried = None if is_lack else spec
                self._broken[key] = tried, _failed(key, "start", why)
        return done

    def _start_again(self) -> None:
        """Start what there was no thread for."""
        again = [key for key, (tried, _) in self._broken.items() if tried is None]
        if again and self._wanted is not None:
            for key in again:
                del self._broken[key]
            self._apply(self._wanted, new=())

    def _start(self, spec: ComponentSpec, runner: Runner) -> None:
        """Start a component; RuntimeError: no thread is free."""
        key = spec.key
        runner.lease = self._lease if spec.leased else None
        if spec.checkpoint:
            runner.checkpoints = Checkpoints(
                self._folder, *key, spec.checkpoint, self._clock, runner.lease
            )
        runner.start()
        self._runners[key] = runner

    def _connect(self, spec: ContainerSpec, staying: list[ComponentKey]) -> None:
        """Join what is to be joined; what could not be is tried again every time."""
        runners = {key: self._runners[key] for key in staying}
        troubles = self._wiring.apply(spec.connectors, runners)
        self._not_wired = {
            key: _failed(key, "be joined", text) for key, text in troubles.items()
        }

    def _remove(self, key: ComponentKey) -> None:
        runner = self._runners.pop(key)
        runner.aim("finalized")
        self._ending[key] = runner, self._clock.now() + ENDING_LIMIT
        self._steps.forget(runner)
        self._outside.forget(runner)

    def _end_removed(self) -> bool:
        """Forget removed components that have ended; whether there were any."""
        ended = [key for key, (runner, _) in self._ending.items() if runner.has_ended()]
        for key in ended:
            self._tell_bad_end(self._ending.pop(key)[0])
        for key, (runner, limit) in self._ending.items():
            if self._clock.now() > limit:
                log.warning("component '%s' did not end in %g s", key[0], ENDING_LIMIT)
                self._ending[key] = runner, math.inf
        return bool(ended)

    def _tell_bad_end(self, runner: Runner) -> None:
        if runner.bad_end:
            self._tell_failure(f"says that {runner.bad_end}", goes_on=True)

    def _status(self) -> ContainerStatus:
        used, used_by = self._stats_page.cpu()
        broken = {key: status for key, (_, status) in self._broken.items()}
        components = {key: runner.status() for key, (runner, _) in self._ending.items()}
        components |= {
            key: ComponentStatus(name=key[0], epoch=key[1], state="unconfigured")
            for key in self._preparing
        }
        components |= {
            key: runner.status(used_by.get(key))
            for key, runner in self._runners.items()
        }
        return ContainerStatus(
            name=self._name,
            pid=os.getpid(),
            at=self._clock.now(),
            trouble=self._server.warning.trouble()
            or self._thread_failures.trouble()
            or output_trouble(),
            cpu=used,
            components=tuple((components | broken | self._not_wired).values()),
            connectors=self._wiring.status(),
        )

    def _stop(self) -> None:
        running = [*self._runners.values(), *(r for r, _ in self._ending.values())]
        for runner in running:
            runner.aim("finalized")
        if late := self._wait_ended(running):
            log.warning("%s", late)
            if self._stopping:
                self._tell_failure(late)
        for runner in running:
            self._tell_bad_end(runner)
        with contextlib.suppress(Timeout):  # nobody may be left to tell
            self._report(self._status())
        self._step_threads.shutdown(wait=False, cancel_futures=True)
        self._outside.close()
        self._wiring.close()
        self._server.close()

    def _wait_ended(self, running: list[Runner]) -> str:
        """Wait until components have ended; return which had not in time, in words."""
        now = self._clock.now()  # hooks by which they end may take longer than handlers
        until = now + self._stop_limit
        hooks_until = now + (ENDING_LIMIT if self._stop_limit else 0.0)
        while running := [each for each in running if not each.wait_ended(0.0)]:
            now = self._clock.now()
            limits = [
                until if since is None else min(hooks_until, since + ENDING_LIMIT)
                for since in (each.ends_since() for each in running)
            ]
            if now >= max(limits):
                break
            self._stats_page.beat()
            running[0].wait_ended(_LOOK_EVERY)
        return "; ".join(each.why_not_ended() for each in running)


def _failed(key: ComponentKey, what: str, why: str) -> ComponentStatus:
    name, epoch = key
    log.error("component '%s' cannot %s: %s", name, what, why)
    return ComponentStatus(name=name, epoch=epoch, state="failed", error=why, errors=1)


def _end_by_signals() -> None:
    """Let signals end what a component forks: they are not the container's there."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
