"""The manager of a robot that is up: carries out commands, and reports deviations.

The thread that calls `work` carries out commands, and looks after the robot; any thread
may submit one. A status and a stop overtake what waits.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial
from typing import TypeVar

from msgspec import structs

from poise.clock import wall_time
from poise.errors import PoiseError, TakenOver, UsageError, listed
from poise.manage.adaptation.loop import Adaptation
from poise.manage.adaptation.situation import Situation, SituationReader
from poise.manage.agent_connections.statuses import located
from poise.manage.control_socket.commands import (
    Command,
    MoveCommand,
    ParametersCommand,
    RebalanceCommand,
    Rebalanced,
    RecordCommand,
    Refusal,
    ReplaceCommand,
    Result,
    RobotStatus,
    StopCommand,
    StopReport,
    TaskCommand,
    TaskDone,
)
from poise.manage.control_socket.immediate_commands import (
    answer,
    set_parameters,
    status_of,
)
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.lost_computers import LostComputers
from poise.manage.migration.canary import Canaries
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.move import (
    check_target,
    plan_alternative,
    plan_move,
    plan_replacement,
)
from poise.manage.migration.pending_migration import PendingMigration
from poise.manage.observe.deviations import Deviation
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.sample_recording import Recording, RecordingFile
from poise.manage.observe.troubles import ManagerTroubles
from poise.manage.observe.watch import Watch
from poise.manage.shortages.suspension import Suspensions
from poise.manage.tasks.prefetch import Prefetcher
from poise.manage.tasks.task_manager import TaskManager
from poise.manage.tasks.task_progress import Saved
from poise.wire.codec import unpack
from poise.wire.records.request_records import PortAnswer

MOST_COMMANDS = 64
"""At most this many commands queue; further ones are refused."""
_STORED_LIMIT = 5.0
"""A majority of agents stores a commit within this time [s]."""
TICK = 0.2
"""A manager looks at its robot so often [s]."""
PendingResult = Future[Result | Refusal]
T = TypeVar("T")


class Manager:
    """Looks after a robot; `recording`: keeps samples, and what policies see."""

    def __init__(
        self,
        live: LiveRobot,
        tasks: Saved,
        estimates: Estimates,
        samples: Recording,
        *,
        adapts: bool = False,
        suspended: str = "",  # why not all that the task needs runs; empty: it does
        recording: RecordingFile | None = None,
    ) -> None:
        self._live = live
        live.goes_on_without_lost = True
        self._parts = live.parts
        self._estimates = estimates
        self._samples = samples
        self._recording = recording
        self._estimates_end = False
        self._commands: queue.Queue[tuple[Command, PendingResult]] = queue.Queue(
            MOST_COMMANDS
        )
        self._pending: list[tuple[Command, PendingMigration, PendingResult]] = []
        self._unstored: list[tuple[int, float, PendingResult, Result | Refusal]] = []
        self._stops: list[PendingResult] = []
        self._ended: StopReport | Refusal | None = None
        self._stopping = threading.Event()
        self._why_over, self._over_since = "", 0.0
        self._watch = Watch(live)
        others = samples, recording, live.agents.own_keys
        self.troubles = ManagerTroubles(
            live.journal, others=[each for each in others if each is not None]
        )
        self.lost = LostComputers(live)
        self._reader = SituationReader(live, estimates, self.lost)
        self.tasks = TaskManager(live, tasks, self._situation)
        self._suspensions = Suspensions(live, self.tasks.now, suspended)
        if suspended:
            self._suspensions.record()
        self._prefetch = Prefetcher(live)
        self._canaries = Canaries(live)
        keep = recording.add if recording else None
        self._adaptation = Adaptation(
            live,
            self._situation,
            self._suspensions,
            acts=adapts,
            keep=keep,
            is_well=lambda: not self._deviations(),
        )
        live.check = (
            self._observe
        )  # also while it waits for a move, which may take long

    @property
    def is_stopping(self) -> bool:
        """Whether a client asked for the robot's stop."""
        return self._stopping.is_set()

    def submit(self, command: Command) -> PendingResult:
        """Take a command, from any thread; what only looks is answered there."""
        future: PendingResult = Future()
        if isinstance(command, StopCommand) and self._ended is not None:
            future.set_result(self._ended)
        elif isinstance(command, StopCommand):
            if not self.is_stopping:
                self._live.journal.note("seen", "asked to stop the robot")
            self._stops.append(future)  # before the flag, or nobody answers it
            self._stopping.set()
            self._live.cancel()
        elif self.is_stopping and not isinstance(command, RecordCommand):
            future.set_result(Refusal("the robot is being stopped", "RunError"))
        elif (seen := answer(self._live, self.status, command)) is not None:
            future.set_result(seen)
        elif isinstance(command, ParametersCommand):
            self._set_parameters(command, future)
        else:
            self._enqueue(command, future)
        return future

    def _set_parameters(
        self, command: ParametersCommand, future: PendingResult
    ) -> None:
        """Let a component take parameters; what it took is kept by this command."""
        if self._commands.full():
            self._refuse_more(future)
            return
        try:
            taken = set_parameters(self._live, command)
        except PoiseError as error:
            future.set_result(Refusal.from_error(error))
            return
        if taken.outcome == "done":
            kept: PendingResult = Future()  # also if its client has left meanwhile
            kept.add_done_callback(lambda done: _answer(future, done.result()))
            self._enqueue(structs.replace(command, changes=taken.value), kept)
        else:
            future.set_result(taken)

    def _enqueue(self, command: Command, future: PendingResult) -> None:
        try:
            self._commands.put_nowait((command, future))
            self._live.agents.notify()
        except queue.Full:
            self._refuse_more(future)

    def _refuse_more(self, future: PendingResult) -> None:
        text = f"{MOST_COMMANDS} commands wait already: try again later"
        future.set_result(Refusal(text, "RunError"))

    def status(self) -> RobotStatus:
        """Return the last known state; from any thread, at once."""
        known = status_of(self._live, self.tasks.reports, self._estimates)
        lost_states = tuple(self._live.lost_states.copy().values())
        return structs.replace(
            known,
            deviations=(*self._superseded(), *known.deviations, *self._deviations()),
            under_way=(
                *self._watch.change(),
                *(p.under_way() for _, p, _ in self._pending.copy()),
                *self._canaries.under_way(),
                *(self._stop_waits() if self.is_stopping else ()),
            ),
            faults=self._watch.faults.count + len(lost_states),
            lost_states=lost_states,
            hanging=self._adaptation.hanging,
            prefetch=self._prefetch.report(),
        )

    def _stop_waits(self) -> Iterator[str]:
        """Yield what a stop waits for, in words; from any thread."""
        known = [each for _, each in located(self._live.agents.statuses())]
        ending = [c for c in known if c.handler in {"deactivate", "cleanup"}]
        if names := sorted({component.name for component in ending or known}):
            yield f"the stop waits for `deactivate` and `cleanup` of {listed(names)}"

    def work(self, limit: float) -> None:
        """Carry out a command if one comes within `limit` [s]; look at the robot."""
        wait = partial(self._live.agents.wait_news, self._has_news, limit)
        if self._parts.run("wait for news", wait) is None:
            self._live.clock.sleep(limit)
        try:
            command, future = self._commands.get_nowait()
        except queue.Empty:
            pass
        else:
            if not self.is_stopping and future.set_running_or_notify_cancel():
                self._begin(command, future)
        self._parts.run("migrate", self._run_configured)
        self._parts.run("answer what is stored", self._answer_stored)
        self._parts.run("take samples", self._estimate_from_samples)
        self._observe()
        if not self.is_stopping:
            self._parts.run("look after tasks", self._look_after_tasks, changes=True)
            self._parts.run("prepare the next action", self._prepare_next, changes=True)
            if not self._parts.run(
                "watch new code", self._canaries.check, changes=True
            ):
                self._parts.run("adapt the placement", self._adaptation.adapt)

    def stop(self) -> None:
        """Stop the robot, and answer the clients that still wait."""
        self._stopping.set()
        try:
            stop(self._live)
        finally:
            self.end()

    def end(self) -> None:
        """Answer the clients that still wait: the robot has stopped."""
        self._stopping.set()
        self._adaptation.close()
        text = f"robot '{self._live.robot.name}' has stopped"
        if self._why_over:
            text = "another manager has taken the robot over: ask that one"
        refusal, remaining = Refusal(text, "RunError"), self._live.remaining
        report = StopReport((remaining,) if remaining else ())
        self._ended = refusal if self._why_over else report
        for future in self._stops:
            _answer(future, self._ended)
        for _, _, future in self._pending:
            future.set_result(refusal)
        self._pending.clear()
        while not self._commands.empty():
            _answer(self._commands.get_nowait()[1], refusal)
        for _, _, future, result in self._unstored:
            done = Refusal(f"{text}; the command may have taken effect", "RunError")
            future.set_result(result if isinstance(result, Refusal) else done)
        self._unstored.clear()

    def end_estimates(self) -> None:
        """Take no more samples: without a simulated world sensors are silent."""
        if not self._estimates_end:
            self._estimates_end = True
            what = "the simulated world has ended: estimates are frozen"
            self._live.journal.note("seen", what)

    def _estimate_from_samples(self) -> None:
        """Estimate from samples, keep them, and say which demands have shifted."""
        desired = self._live.desired
        prepared = (*desired.prefetched.values(), *desired.coming)
        self._estimates.idle = {idle.key for idle in prepared}
        for sample in self._samples.drain():
            if self._estimates_end:
                return
            if self._recording is not None:
                self._recording.add(sample)
            for name, drift in self._estimates.add(sample):
                needs = f"'{name}' needs {drift.after:.1%} of a core now"
                what = f"{needs}, {drift.before:.1%} before"
                self._live.journal.note("seen", what)

    def _look_after_tasks(self) -> None:
        self.tasks.advance(self._suspensions.functions())

    def _prepare_next(self) -> None:
        self._prefetch.update(self.tasks.likely_next(), self._estimates.loads.loads)

    def _deviations(self) -> tuple[Deviation, ...]:
        return (
            *self._parts.deviations(),
            *self.troubles.deviations(),
            *self.lost.deviations(),
            *self._watch.deviations,
            *self._watch.code_errors.deviations(),
            *self._adaptation.deviations,
            *self._suspensions.deviations(),
            *self._canaries.deviations(),
        )

    def _has_news(self) -> bool:
        """Return whether something is to be done at once."""
        return (
            self.is_stopping
            or not self._commands.empty()
            or (not self._parts.backs_off("look after tasks") and self.tasks.has_news())
            or any(pending.is_decided() for _, pending, _ in self._pending)
            or any(self._live.agents.has_stored(each[0]) for each in self._unstored)
        )

    def _begin(self, command: Command, future: PendingResult) -> None:
        """Carry out a command; of a migration the targets are configured first."""
        result = self._carry_out(command, partial(self._do_or_plan, command))
        if isinstance(result, PendingMigration):
            self._pending.append((command, result, future))
        else:
            self._answer_when_stored(future, result)

    def _answer_when_stored(
        self, future: PendingResult, result: Result | Refusal
    ) -> None:
        """Answer once what it changed outlives this manager."""
        generation, now = self._live.desired.generation, self._live.clock.now()
        self._unstored.append((generation, now + _STORED_LIMIT, future, result))
        self._answer_stored()

    def _answer_stored(self) -> None:
        for waiting in list(self._unstored):
            generation, until, future, result = waiting
            if not self._live.agents.has_stored(generation):
                if self._live.clock.now() < until:
                    continue
                if not isinstance(result, Refusal):
                    why = "it was done, but no majority of agents has stored it: the "
                    result = Refusal(f"{why}next manager may undo it", "RunError")
            self._unstored.remove(waiting)
            future.set_result(result)

    def _run_configured(self) -> None:
        """Make the migrations whose targets are configured, or will not be."""
        for waiting in list(self._pending):
            command, pending, future = waiting
            if not self.is_stopping and pending.is_decided():
                migrate: Callable[[], MigrationReport] = pending.run
                if isinstance(command, ReplaceCommand) and command.watch:
                    begin = self._canaries.begin
                    migrate = partial(begin, command.what, command.watch, migrate)
                result = self._carry_out(command, migrate)
                self._pending.remove(waiting)
                self._answer_when_stored(future, result)

    def _carry_out(self, command: Command, do: Callable[[], T]) -> T | Refusal:
        try:
            return do()
        except PoiseError as error:
            return Refusal.from_error(error)
        except Exception as error:  # noqa: BLE001, a bug of Poise must not end the robot
            asked = type(command).__name__.removesuffix("Command").lower()
            what = (
                f"command '{asked}' failed because of a bug in Poise: "
                f"{type(error).__name__}: {error}"
            )
            trace = traceback.format_exc()
            self._live.journal.note("failed", what, command=command, traceback=trace)
            self._live.release(what)  # what was placed goes on
            return Refusal(f"{what}. The robot keeps its placement", "RunError")

    def _do_or_plan(self, command: Command) -> Result | PendingMigration:
        """Do what a command asks for, but for a migration: that is returned."""
        live = self._live
        self.lost.settle()
        match command:
            case TaskCommand(verb, task, priority):
                self.tasks.command(verb, task, priority)
                return TaskDone(self.tasks.report(task))
            case ParametersCommand(component=component, changes=changes):
                desired = live.desired.with_parameters(component, unpack(changes))
                live.commit(desired, f"parameters of '{component}' are set")
                return PortAnswer(number=0, outcome="done", value=changes)
            case RebalanceCommand(cost, dry):
                return Rebalanced(*self._adaptation.balance(cost, dry=dry))
            case MoveCommand(component, computer, force, dry=True):
                check_target(live, component, computer, force=force)
                return self._adaptation.what_if(component, computer)
            case MoveCommand(component, computer, force):
                pending = plan_move(live, component, computer, force=force)
                self._adaptation.check_asked(component, computer, force=force)
            case ReplaceCommand(adapt=adapt, fresh=True) if adapt:
                raise UsageError(
                    "--adapt maps the old state, and --fresh drops it: give one of them"
                )
            case ReplaceCommand(by=by, adapt=adapt, watch=watch) if watch and (
                adapt or ":" not in by
            ):
                raise UsageError(
                    "--watch is for a component's new code, and not with --adapt: a "
                    "state that was mapped cannot be mapped back"
                )
            case ReplaceCommand(component, by, adapt, fresh) if ":" in by:
                pending = plan_replacement(live, component, by, adapt, fresh=fresh)
            case ReplaceCommand(what, by, adapt, fresh):
                pending = plan_alternative(live, what, by, adapt, fresh=fresh)
            case _:
                raise AssertionError(command)
        return pending.configure_ahead()

    def _situation(self) -> Situation:
        return self._reader.read(self.tasks.now())

    def _end_of_lead(self) -> tuple[str, float]:
        """Return why it leads no more, and since when [s since 1970]; or nothing."""
        if self._why_over:  # it has left, also when it could lead again
            return self._why_over, self._over_since
        agents = self._live.agents
        if (successor := agents.successor()) is not None:
            text = f"{successor} has taken over the robot, which keeps running"
            return text, successor.since
        if not (why := agents.why_not_leading()):
            return "", 0.0
        text = f"{why}: this manager leaves the robot to another one"
        return text, wall_time() - agents.heartbeats.unconfirmed()

    def _superseded(self) -> Iterator[Deviation]:
        """Yield what to know of a status while this manager ends what it had begun."""
        text, since = "", 0.0
        with contextlib.suppress(Exception):  # the loop reports a bug in it
            text, since = self._end_of_lead()
        if text:
            what = f"{text}; what this manager says may be out of date"
            host = self._live.agents.manager.host
            yield Deviation(what=what, computer=host, since=since)

    def _raise_on_successor(self) -> None:
        text, since = self._end_of_lead()
        if text and not self._why_over:
            self._live.journal.note("seen", text)
            self._live.leave()
            self._why_over, self._over_since = text, since
        if text:  # again, when something that waited has caught it
            raise TakenOver(text)

    def _observe(self) -> None:
        self._parts.run("see who manages the robot", self._raise_on_successor)
        self._parts.run("look at itself", self.troubles.check)
        self._live.reconcile()
        self._parts.run("see which computers are lost", self.lost.note)
        self._parts.run("watch components", self._watch.record)


def _answer(future: PendingResult, result: Result | Refusal) -> None:
    """Answer a client that still waits."""
    if future.set_running_or_notify_cancel():
        future.set_result(result)
