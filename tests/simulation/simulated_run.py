"""One run of a simulated robot: faults by a seed, then it must converge."""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from msgspec import Struct, structs

from poise.errors import TakenOver
from poise.manage.control_socket.commands import RobotStatus
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot
from poise.simulation.choices import Choices
from poise.simulation.faults import (
    KINDS,
    LINK_KINDS,
    SimulatedFault,
    SimulatedFaultKind,
    inject,
    plan_faults,
)
from poise.simulation.rehearsal import unsettled
from poise.simulation.robot.simulated_robot import (
    ManagedRobot,
    SimulatedManager,
    SimulatedRobot,
)
from poise.simulation.scheduler import ENGINE, SimulationError
from poise.simulation.workload import SimulatedWork
from poise.threads import LONGEST_DELAY
from poise.wire.records.request_records import Claim, Election, ManagerId
from tests.simulation.aimed_faults import AimedFaults
from tests.simulation.clients import Clients
from tests.simulation.served_tasks import unserved
from tests.simulation.status_watch import StatusWatch, ask_status

INVARIANTS: Mapping[str, str] = {
    "nothing-active-twice": "No two incarnations of a component work at one time.",
    "each-message-once-in-order": "No message is processed twice, or out of order.",
    "committed-stays": "A committed move is never undone.",
    "nothing-is-lost": "While nothing is broken, no message is lost.",
    "moves-succeed": "While nothing is broken, a move that has begun is committed.",
    "commands-end": "An accepted command ends within its limit.",
    "desired-is-reached": "What is desired runs soon after the last fault ended.",
    "failures-are-shown": "A failure is in `status` within a second.",
    "status-tells-all": "`status` leaves out nothing that does not work.",
    "what-is-lost-runs": "What a lost computer ran runs elsewhere soon.",
    "one-manager-is-obeyed": "An agent does nothing for a manager that was replaced.",
    "a-manager-stays": "Without a take-over no agent leaves a manager that is well.",
    "no-bug-stops-the-robot": "No error ends a manager, an agent or a thread of them.",
}
"""Id -> what it says; `docs/design/simulation.md` cites the ids."""


class Violation(SimulationError):
    """An invariant does not hold.

    `invariant`: its id.
    """

    def __init__(self, invariant: str, what: str) -> None:
        assert invariant in INVARIANTS, invariant
        super().__init__(f"{invariant}: {what}")
        self.invariant = invariant


_ANSWERED = 0.01
"""A manager answers within this time [s]."""
UP_LIMIT = 30.0
"""A robot without faults is up within this time [s]."""
CONVERGE_LIMIT = 5.0
"""What is desired runs this long [s] after the last fault ended, at most."""
SHOWN_WITHIN = 1.0
"""A lost computer or agent is in `status` within this time [s]."""
FAILED_OVER_WITHIN = 4.0
"""What a computer that is cut off ran works elsewhere within this time [s]."""
_LOSSES = {
    "kill agent",
    "pause agent",
    "pause computer",
    "isolate computer",
    "restart computer",
}
_BAD_LINKS = {*LINK_KINDS, "isolate computer", "lose datagrams", "restart computer"}
EARLIER_KINDS = tuple(kind for kind in KINDS if kind != "restart computer")
"""Those of the seeds in tests: another one would give them other faults."""
_SILENCING = {*_BAD_LINKS, *(kind for kind in KINDS if "pause" in kind)} | {
    "suspend computer"
}
_POLL_EVERY = 0.05
_QUIET = 0.15
"""In this share of runs nothing breaks in the first half."""
_LINES = 400


class Scenario(Struct, frozen=True, kw_only=True):
    """What is simulated, but for the seed.

    `placement`: component -> computer, at first.
    `seconds`: of faults; to come up and to converge take their own time.
    `faults`: what breaks; None: the seed decides.
    `kinds`: what of it may break.
    `moves`: whether clients move components meanwhile.
    `converges`: how long it may take after the last fault [s].
    `election`: how managers follow each other; None: somebody starts the next one.
    `is_wild`: whether clients ask for all that there is, and what components need is
    more than there is at times.
    `is_watched`: whether the status is asked for all the time.
    """

    robot: Robot
    placement: Mapping[str, str]
    tasks: Sequence[str]
    workload: SimulatedWork = SimulatedWork()
    seconds: float = 60.0
    faults: tuple[SimulatedFault, ...] | None = None
    kinds: tuple[SimulatedFaultKind, ...] = EARLIER_KINDS
    moves: bool = True
    converges: float = CONVERGE_LIMIT
    election: Election | None = None
    is_wild: bool = False
    is_watched: bool = False


class RunOutcome(Struct, frozen=True, kw_only=True):
    """What came of a run.

    `failure`, `message`: the id of the violated invariant, or the type of an error; and
    what it says. Empty: all held.
    `virtual`, `took`: virtual and real time [s]; `took` is the CPU time of this
    process.
    `digest`: equal for equal runs.
    `choices`: stream -> all draws, for a replay.
    `trace`: the last lines: who did what when.
    """

    seed: int
    failure: str
    message: str
    virtual: float
    took: float
    steps: int
    digest: str
    faults: tuple[SimulatedFault, ...]
    choices: Mapping[str, Sequence[float]]
    trace: tuple[str, ...]
    handled: int
    processed: int

    @property
    def signature(self) -> tuple[str, str]:
        """What makes two failures the same: type and message, but for what is named."""
        return self.failure, re.sub(r"'[^']*'|\d[\d.]*", "#", self.message)


def simulate(
    scenario: Scenario,
    seed: int,
    recorded: Mapping[str, Sequence[float]] | None = None,
) -> RunOutcome:
    """Run a robot once; never raises for what goes wrong with it.

    Parameters
    ----------
    recorded
        Draws to begin with, instead of the seed's.
    """
    began = time.process_time()
    choices, trace = Choices(seed, recorded), deque[str](maxlen=_LINES)

    def note(at: float, who: str, what: str) -> None:
        trace.append(f"{at:9.4f} {who:12} {what}")

    robot = SimulatedRobot(
        ManagedRobot(
            robot=scenario.robot,
            placement=scenario.placement,
            tasks=scenario.tasks,
            election=scenario.election,
        ),
        choices,
        scenario.workload,
        note=note,
    )
    run = _Run(robot, scenario)
    failure = message = ""
    with robot.library:
        try:
            run.go()
        except SimulationError as error:
            failure = getattr(error, "invariant", type(error).__name__)
            message = str(error)
            note(robot.scheduler.now, "FAILURE", message)
        virtual = robot.scheduler.now
        robot.end()
    return RunOutcome(
        seed=seed,
        failure=failure,
        message=message,
        virtual=virtual,
        took=time.process_time() - began,
        steps=robot.scheduler.steps,
        digest=robot.scheduler.digest(),
        faults=run.all_faults(),
        choices={**choices.made, ENGINE: robot.scheduler.engine.draws()},
        trace=tuple(trace),
        handled=robot.ledger.handled,
        processed=robot.ledger.processed,
    )


class _Run:
    """The phases of one run."""

    def __init__(self, robot: SimulatedRobot, scenario: Scenario) -> None:
        self.robot = robot
        self.faults: tuple[SimulatedFault, ...] = ()
        self._scenario = scenario
        self._scheduler = robot.scheduler
        self._aimed: AimedFaults | None = None
        self._scheduler.on_step = self._check
        robot.on_claim = self._check_claim

    def go(self) -> None:
        """Come up, break, heal, converge."""
        robot = self.robot
        for computer in robot.computers:
            robot.start_agent(computer)
        robot.start_manager(next(iter(robot.computers)))
        self._until(UP_LIMIT, "the robot is not up")
        stops = {"restart", "replace", "suspend"}
        policies = self._scenario.robot.policies
        robot.ledger.is_whole = stops.isdisjoint(policy.do for policy in policies)
        if self._scenario.is_watched:
            StatusWatch(robot)
        begin = self._scheduler.now
        end = begin + self._scenario.seconds
        self.faults = self._scenario.faults or ()
        if self._scenario.faults is None:
            names = tuple(robot.computers)
            kinds = self._scenario.kinds
            is_quiet = robot.choices.happens("faults", _QUIET)
            first = (begin + end) / 2 if is_quiet else begin
            self.faults = tuple(plan_faults(robot.choices, names, first, end, kinds))
            self._aimed = AimedFaults(robot, first, end, self._inject, kinds)
        for fault in self.faults:
            self._scheduler.at(fault.at, partial(self._inject_planned, fault))
        clients = self._clients(end)
        if self._scenario.moves:
            clients.begin(begin + 1.0)
        robot.run(max([end, *(f.at + f.lasts for f in self.faults)]) + 0.01)
        self._heal()
        limit = self._scenario.converges
        if self._scenario.workload.flaws:  # what has crashed waits before it begins
            limit += LONGEST_DELAY
        troubles = not_well
        if self._scenario.is_wild:
            keeps = self._scenario.election is not None
            troubles = partial(
                not_served, undone=clients.undone if keeps else lambda _: []
            )
        self._until(limit, f"{limit:g} s after the last fault", troubles)

    def _clients(self, end: float) -> Clients:
        robot, is_wild = self.robot, self._scenario.is_wild
        names = sorted(self._scenario.placement)
        if is_wild:
            names = sorted(component.name for component in robot.robot.components())
        return Clients(robot, names, end, does_all=is_wild)

    def _heal(self) -> None:
        """Start what was killed and never came back, and mend code that crashes."""
        robot = self.robot
        robot.workload = structs.replace(robot.workload, flaws={})
        for computer in robot.computers:
            robot.start_agent(computer)
        self._keep_managed()
        robot.note("run", "all faults are over")

    def _keep_managed(self) -> None:
        """Let somebody start a manager where none runs, from now on.

        One that stood still ends as it sees that it was replaced, and who replaced it
        may be gone by then. Standbys see to that themselves.
        """
        self.robot.keep_managed(next(iter(self.robot.computers)))
        if self._scenario.election is None:
            soon = self._scheduler.now + _POLL_EVERY
            self._scheduler.at(soon, self._keep_managed)

    def all_faults(self) -> tuple[SimulatedFault, ...]:
        """Return what was to break, in the order of time."""
        aimed = self._aimed.faults if self._aimed else ()
        return tuple(sorted((*self.faults, *aimed), key=lambda fault: fault.at))

    def _until(
        self,
        limit: float,
        what: str,
        troubles: Callable[[SimulatedRobot], list[str]] = unsettled,
    ) -> None:
        deadline = self._scheduler.now + limit
        while found := troubles(self.robot):
            if self._scheduler.now >= deadline:
                raise Violation("desired-is-reached", f"{what}: {'; '.join(found)}")
            self.robot.run(self._scheduler.now + _POLL_EVERY)

    def _inject_planned(self, fault: SimulatedFault) -> None:
        """Let it begin, unless nobody would know what had moved to that computer."""
        manager = self.robot.manager
        is_there = manager and manager.process.computer.name == fault.target
        is_alone = bool(is_there) and self._scenario.election is None
        if not (is_alone and fault.kind == "restart computer"):
            self._inject(fault)

    def _inject(self, fault: SimulatedFault) -> None:
        """Let a fault begin; in a second `status` has to say what is lost."""
        self.robot.ledger.is_whole = False
        manager, agent = self.robot.manager, self.robot.agents.get(fault.target)
        was_heard = self._is_heard(fault.target)
        inject(self.robot, fault)
        if fault.kind == "isolate computer" and fault.lasts > FAILED_OVER_WITHIN:
            at = self._scheduler.now + FAILED_OVER_WITHIN
            self._scheduler.at(at, partial(self._check_failover, fault))
        if fault.kind not in _LOSSES or fault.lasts < SHOWN_WITHIN or not was_heard:
            return
        is_judge = manager is not None and manager.process.computer.name != fault.target
        if manager is None or not is_judge or fault.target in _lost(manager):
            return
        at = self._scheduler.now

        def look() -> None:
            process = manager.process
            if manager is not self.robot.manager:  # it is replaced, or is about to be
                return
            if process.is_dead or process.is_paused or process.awake_since > at:
                return
            if self.robot.agents.get(fault.target) not in {agent, None}:
                return  # the end of another fault has started it again
            ask_status(manager, judge)

        def judge(status: RobotStatus) -> None:
            said = [deviation.what for deviation in status.deviations]
            # one that was superseded says that it does not know any more
            known = f"'{fault.target}'", "may be out of date"
            if not any(part in what for part in known for what in said):
                self.robot.ledger.violate(
                    "failures-are-shown",
                    f"status says {said} {SHOWN_WITHIN:g} s after {fault}",
                )

        self._scheduler.at(at + SHOWN_WITHIN, look)

    def _check_failover(self, fault: SimulatedFault) -> None:
        """See that all works elsewhere, if nothing else was broken meanwhile."""
        manager, begin = self.robot.manager, fault.at - CONVERGE_LIMIT
        is_judge = manager is not None and manager.process.computer.name != fault.target
        others = [
            each
            for each in self.all_faults()
            if each is not fault
            and each.at < self._scheduler.now
            and begin < each.at + each.lasts
        ]
        if manager is None or not is_judge or manager.up_since > begin or others:
            return
        works, live = set(self.robot.working()), manager.live
        if self._scenario.is_wild and live is not None and live.desired.coming:
            return  # a start takes up to 3 s there, and what makes room moves before
        allowed = allowed_computers(self._scenario.robot)
        flaws = self.robot.workload.flaws  # code that crashes breaks by itself
        missing = [
            name
            for name, placed in sorted(live.placed.items() if live is not None else ())
            if placed.implementation not in flaws
            and (elsewhere := allowed[name] - {fault.target})
            and works.isdisjoint((name, at) for at in elsewhere)
        ]
        if missing:
            self.robot.ledger.violate(
                "what-is-lost-runs",
                f"{missing} works nowhere {FAILED_OVER_WITHIN:g} s after {fault}",
            )

    def _check_claim(self, computer: str, claim: Claim, before: ManagerId) -> None:
        """See that the manager before has ended, or may seem so."""
        alive = [
            each.process
            for each in self.robot.managers
            if each.process.pid == before.pid and not each.process.is_dead
        ]
        since = self._scheduler.now - CONVERGE_LIMIT
        is_broken = any(
            fault.kind in _SILENCING
            and fault.at < self._scheduler.now
            and since < fault.at + fault.lasts
            for fault in self.all_faults()
        )
        is_same = claim.manager.key == before.key
        if alive and not (is_same or claim.take_over or is_broken):
            self.robot.ledger.violate(
                "a-manager-stays",
                f"the agent of '{computer}' obeys {claim.manager} while {before}, "
                "which it obeyed, is at work",
            )

    def _is_heard(self, computer: str) -> bool:
        """Return whether the manager has heard heartbeats of an agent for a while.

        Else the lease of its connection tells of its loss, which takes longer.
        """
        manager, agent = self.robot.manager, self.robot.agents.get(computer)
        since = self._scheduler.now - SHOWN_WITHIN
        if manager is None or agent is None or agent.process.is_paused:
            return False
        awake = max(agent.process.awake_since, manager.process.awake_since)
        return max(awake, manager.up_since) < since and not any(
            fault.kind in _BAD_LINKS
            and fault.at < self._scheduler.now
            and since < fault.at + fault.lasts
            for fault in self.all_faults()
        )

    def _check(self) -> None:
        """Raise what was violated in this step."""
        if self.robot.ledger.violations:
            raise Violation(*self.robot.ledger.violations[0])
        for each in self.robot.managers:
            error = None if each.manager is None else each.error
            if error is not None and not isinstance(error, TakenOver):
                raise Violation("no-bug-stops-the-robot", str(error))


def not_well(robot: SimulatedRobot) -> list[str]:
    """Return what is not as it is desired, or is said not to be."""
    return unsettled(robot) or _told(robot, _wrong)


def not_served(
    robot: SimulatedRobot, undone: Callable[[RobotStatus], list[str]]
) -> list[str]:
    """Return what is not as it is desired, or not as tasks or clients want it.

    Here `status` may say for good that something is late, or uses too much.
    """
    return unsettled(robot) or _told(
        robot, lambda status: [*unserved(robot.robot, status), *undone(status)]
    )


def _wrong(status: RobotStatus) -> list[str]:
    return [
        f"status says: {deviation.what}"
        for deviation in status.deviations
        # a clock that jumped is said for a while, and so are many restarts
        if deviation.computer and not deviation.what.startswith("container '")
    ]


def _told(
    robot: SimulatedRobot, judge: Callable[[RobotStatus], list[str]]
) -> list[str]:
    """Return what is wrong by what the manager says of itself, if it is up."""
    if robot.manager is None:
        return []
    told: list[RobotStatus] = []
    ask_status(robot.manager, told.append)
    robot.run(robot.scheduler.now + _ANSWERED)
    return judge(told[0]) if told else ["the manager does not say how it is"]


def _lost(manager: SimulatedManager) -> frozenset[str]:
    return manager.manager.lost.computers() if manager.manager else frozenset()
