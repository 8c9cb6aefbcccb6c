"""The manager of a robot that is up: carries out commands, and reports deviations.

Any thread may submit a command. Status and stop overtake: a status is the last known
state, and a stop rolls back what is under way. Everything else is carried out by the
one thread that calls `work`, which also looks after the robot in between. Nothing here
runs on a transport's thread.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future

from poise.errors import PoiseError, RunError
from poise.manage.adaptation.admission import check_move
from poise.manage.adaptation.replan import propose, with_present_needs
from poise.manage.control_socket.records import (
    Command,
    MoveCommand,
    Moved,
    RebalanceCommand,
    Rebalanced,
    Refusal,
    ReplaceArchitectureCommand,
    ReplaceCommand,
    Replaced,
    Result,
    RobotStatus,
    StatusCommand,
    StopCommand,
    StopReport,
)
from poise.manage.deployment import Incarnation
from poise.manage.migration.move import move, replace
from poise.manage.migration.replacement import replace_architecture
from poise.manage.migration.transition_run import transit
from poise.manage.observe.deviations import (
    Deviation,
    find_deviations,
    find_unjoined,
)
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.faults import FaultFilter
from poise.manage.run import Run
from poise.wire.records.deployment import AgentStatus
from poise.wire.records.samples import AgentSample

MOST_COMMANDS = 64
"""At most this many commands queue; further ones are refused."""
MOST_SAMPLES = 10_000
"""At most this many samples wait for the manager; then the oldest are dropped."""
_JOIN_WITHIN = 2.0
"""A connector that is not joined for so long is a deviation [s]."""
_RETRY_AFTER = 1.0
"""A computer that came back, but refuses, is asked again after this time [s]."""

Results = Future[Result | Refusal]


class SampleQueue:
    """The samples that wait for the manager; any thread may add one, at once."""

    def __init__(self) -> None:
        self._samples: deque[AgentSample] = deque(maxlen=MOST_SAMPLES)
        self.add = self._samples.append

    def take(self) -> list[AgentSample]:
        """Return the samples that wait, oldest first, and forget them."""
        return [self._samples.popleft() for _ in range(len(self._samples))]


class Manager:
    """Looks after a robot that is up.

    Parameters
    ----------
    run
        The running robot.
    estimates
        What its components need.
    take
        Called with each sample, on the thread that calls `work`.
    samples
        Where samples wait until then.
    """

    def __init__(
        self,
        run: Run,
        task: str,
        estimates: Estimates,
        samples: SampleQueue,
        take: Callable[[AgentSample], object],
    ) -> None:
        self._run = run
        self._task = task
        self._estimates = estimates
        self._samples = samples
        self._take = take
        self._commands: queue.Queue[tuple[Command, Results]] = queue.Queue(
            MOST_COMMANDS
        )
        self._stops: list[Results] = []
        self._stopping = threading.Event()
        self._deviations: tuple[Deviation, ...] = ()
        self._unjoined: dict[str, Deviation] = {}
        self._retry_at: dict[str, float] = {}
        self._refusals: dict[str, Deviation] = {}
        self._faults = FaultFilter(run.faults_before)
        self._reached = set(run.computers())
        run.check = self._look  # moves wait long: what breaks meanwhile is said at once

    @property
    def is_stopping(self) -> bool:
        """Whether somebody asked for the robot's stop."""
        return self._stopping.is_set()

    def submit(self, command: Command) -> Results:
        """Take a command, from any thread, at once."""
        future: Results = Future()
        if isinstance(command, StatusCommand):
            future.set_result(self.status())
        elif isinstance(command, StopCommand):
            self._stops.append(future)  # before the flag, or nobody answers it
            self._stopping.set()
            self._run.cancel()
        elif self.is_stopping:
            future.set_result(Refusal("the robot is being stopped", "RunError"))
        else:
            try:
                self._commands.put_nowait((command, future))
            except queue.Full:
                text = f"{MOST_COMMANDS} commands wait already: try again later"
                future.set_result(Refusal(text, "RunError"))
        return future

    def status(self) -> RobotStatus:
        """Return the last known state; from any thread, at once."""
        run = self._run
        return RobotStatus(
            robot=run.robot.name,
            task=self._task,
            manager=run.agents.manager,
            placement=run.placement(),
            computers=run.agents.statuses(),
            out_of_reach=run.agents.out_of_reach(),
            deviations=(*self._unreached(), *self._deviations),
            faults=self._faults.count,
            demand_estimates=tuple(self._estimates.demand_estimates()),
        )

    def work(self, limit: float) -> None:
        """Carry out a command if one comes within `limit` [s]; look at the robot."""
        try:
            command, future = self._commands.get(timeout=limit)
        except queue.Empty:
            pass
        else:
            if not self.is_stopping and future.set_running_or_notify_cancel():
                future.set_result(self._carry_out(command))
        for sample in self._samples.take():
            self._take(sample)
        self._look()
        self._synchronise()

    def stop(self) -> None:
        """Stop the robot, and answer whoever still waits.

        Raises
        ------
        RunError
            Something still runs.
        """
        remaining: tuple[str, ...] = ()
        self._stopping.set()
        try:
            self._run.stop()
        except RunError as error:
            remaining = (str(error),)
            raise
        finally:
            for future in self._stops:
                _answer(future, StopReport(remaining))
            text = f"robot '{self._run.robot.name}' has stopped"
            while not self._commands.empty():
                _answer(self._commands.get_nowait()[1], Refusal(text, "RunError"))

    def _carry_out(self, command: Command) -> Result | Refusal:
        try:
            return self._done(command)
        except PoiseError as error:
            return Refusal.from_error(error)

    def _done(self, command: Command) -> Result:
        run = self._run
        match command:
            case MoveCommand(component, computer, force):
                if not force:
                    robot = with_present_needs(
                        run.robot, self._estimates.demand_estimates()
                    )
                    check_move(robot, run.placement(), component, computer)
                return Moved(move(run, component, computer))
            case ReplaceCommand(component, by, adapt, fresh):
                return Moved(replace(run, component, by, adapt, fresh=fresh))
            case ReplaceArchitectureCommand(architecture, by, adapt, fresh):
                return Replaced(
                    replace_architecture(run, architecture, by, adapt, fresh=fresh)
                )
            case RebalanceCommand(cost, dry):
                return self._rebalance(cost, dry=dry)
        raise AssertionError(command)

    def _rebalance(self, move: float, *, dry: bool) -> Rebalanced:
        run, estimates = self._run, self._estimates.demand_estimates()
        proposal = propose(run.robot, self._task, run.placement(), estimates, move)
        if dry or not proposal.steps:
            return Rebalanced(proposal)
        return Rebalanced(proposal, transit(run, proposal.steps))

    def _synchronise(self) -> None:
        """Bring computers back that return."""
        run, now = self._run, time.monotonic()
        for computer in run.computers() - self._reached:
            is_there = computer in run.agents.statuses()
            if is_there and self._retry_at.get(computer, 0.0) <= now:
                self._bring_back(computer, now)

    def _bring_back(self, computer: str, now: float) -> None:
        run = self._run
        is_same = run.agents.obey(computer)
        try:
            run.synchronise(computer)
        except RunError as error:
            self._retry_at[computer] = now + _RETRY_AFTER
            what = f"computer '{computer}' is reached again, but: {error}"
            before = self._refusals.get(computer)
            if before is None or before.what != what:
                self._refusals[computer] = Deviation(
                    what=what, computer=computer, since=time.time()
                )
                run.journal.note("failed", what)
            return
        self._refusals.pop(computer, None)
        self._reached.add(computer)
        run.excused.discard(computer)
        how = "" if is_same else "; its agent is another one: components begin anew"
        run.journal.note("right", f"computer '{computer}' is reached again{how}")

    def _excuse_lost(self) -> None:
        """Journal which computers were lost, and go on without them."""
        run = self._run
        obeying = {c for c in run.computers() if run.agents.obey(c)}
        for computer in self._reached - obeying:
            self._reached.discard(computer)
            run.excused.add(computer)
            back = f"computer '{computer}' was cut off, or its agent was restarted"
            run.journal.note("wrong", run.unreached().get(computer, back))

    def _look(self) -> None:
        """Journal each deviation and fault when it begins, and when it ends.

        A deviation that a container's fault caused is told by that fault; what is just
        being moved is for the move to judge.
        """
        run = self._run
        run.note_refused()
        self._excuse_lost()
        self._note_faults()
        reached = run.computers()
        statuses = {c: status for c, status in run.current().items() if c in reached}
        wanted = set(run.wanted)
        settled = {n: each for n, each in run.placed.items() if each in wanted}
        deviations = find_deviations(
            settled.values(), wanted, run.layout, statuses, time.time()
        )
        before = {each.key: each for each in self._deviations}
        moving = run.placed.keys() - settled.keys()
        found = {key: before[key] for key in before.keys() & moving}
        found |= {each.key: each for each in deviations}
        found |= self._long_unjoined(
            [each for name, each in settled.items() if name not in found], statuses
        )
        for key, each in found.items():
            if key in before and before[key].what == each.what:
                found[key] = before[key]
            elif not each.container:
                run.journal.note("wrong", each.what)
        for key in before.keys() - found.keys():
            if not before[key].container:
                run.journal.note("right", before[key].end())
        self._deviations = tuple(found.values())
        self._note_recoveries(statuses)

    def _long_unjoined(
        self, settled: list[Incarnation], statuses: Mapping[str, AgentStatus]
    ) -> dict[str, Deviation]:
        """Return the connectors that have not been joined for some time."""
        now = time.time()
        there = [each for each in settled if each.computer in statuses]
        unjoined = find_unjoined(there, self._run.layout, statuses, now)
        self._unjoined = {e.key: self._unjoined.get(e.key, e) for e in unjoined}
        return {
            key: each
            for key, each in self._unjoined.items()
            if now - each.since >= _JOIN_WITHIN
        }

    def _note_recoveries(self, statuses: Mapping[str, AgentStatus]) -> None:
        """Journal which containers run as they should again after a fault."""
        run = self._run
        deviating = {
            run.layout.container_of(each.component)
            for each in self._deviations
            if each.component
        }
        for computer, status in statuses.items():
            for each in status.health:
                is_well = each.state == "running" and each.name not in deviating
                if is_well and self._faults.close(computer, each.name):
                    what = f"container '{each.name}' on '{computer}'"
                    run.journal.note("right", f"{what} runs as it should again")

    def _unreached(self) -> list[Deviation]:
        since = self._run.agents.out_of_reach()
        refusals = [r for c, r in list(self._refusals.items()) if c not in since]
        return refusals + [
            Deviation(what=what, computer=computer, since=since[computer])
            for computer, what in self._run.unreached().items()
            if computer in since
        ]

    def _note_faults(self) -> None:
        """Journal what broke on computers since the last time."""
        statuses = self._run.agents.statuses()
        for new in self._faults.new(statuses, time.monotonic()):
            note = self._run.journal.note
            note(
                "right" if new.fault.is_over else "wrong",
                new.sentence,
                fault=new.fault,
            )


def _answer(future: Results, result: Result | Refusal) -> None:
    """Answer a client that still waits."""
    if future.set_running_or_notify_cancel():
        future.set_result(result)
