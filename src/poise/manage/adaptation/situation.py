"""What the manager knows of a running robot at one moment, and what answers to it."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from poise.estimate.profiles import ConnectorProfile
from poise.manage.adaptation.policies import Symptom
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.lost_computers import LostComputers
from poise.manage.observe.chains import ChainAge, ChainAges, ChainReader, DeadlineMisses
from poise.manage.observe.estimates import (
    DemandEstimate,
    Estimates,
    Load,
    PresentDemand,
    present_demands,
)
from poise.model.policy import Do, TimerValues
from poise.model.robot import Computer, Robot, Task
from poise.wire.records.status_records import AgentStatus

Homes = Mapping[str, tuple[str, ...]]
"""Component -> the computers where it may be; one: it stays there."""
WANTS_MORE = 1.2
"""What other programs want on a full computer, as a multiple of what they get there."""
_CAUTIOUS = 1.5
"""What they may want later, likewise."""


class Situation(Struct, frozen=True, kw_only=True, dict=True):
    """One moment of a running robot."""

    robot: Robot  # with what runs of its tasks, and the demands that it was placed by
    placement: Mapping[str, str]  # component -> computer
    lost: frozenset[str] = frozenset()  # the computers that nobody hears
    # those out of reach of the manager, also where components go on
    away: frozenset[str] = frozenset()
    loads: Mapping[str, Load] = {}  # computer -> its CPU use lately, where it is known
    misses: tuple[TimerValues, ...] = ()
    chains: tuple[ChainAge, ...] = ()
    # what the components need, also those that ran before and may run again
    demand_estimates: tuple[DemandEstimate, ...] = ()
    # component -> how many times its CPU counts, as it is late; else once
    urgency: Mapping[str, float] = {}
    statuses: Mapping[str, AgentStatus] = {}  # computer -> what its agent reported last
    traffic: Mapping[str, ConnectorProfile] = {}  # connector -> what goes over it now
    # component -> the downtime of its last move [s]
    downtimes: Mapping[str, float] = {}
    # the links that are cut or slow, of which a placement is wanted without them
    bad_links: frozenset[str] = frozenset()
    now: float = 0.0  # the moment, by a clock that never goes back [s]
    symptoms: tuple[Symptom, ...] = ()  # what policies have seen for long enough
    missing: frozenset[str] = frozenset()  # what a task needs, and nothing provides
    suspends: frozenset[str] = frozenset()  # what policies' functions want suspended
    # how much the planner searches; None: as its time allows
    solve_steps: int | None = None

    def about(self, do: Do) -> tuple[Symptom, ...]:
        """Return the symptoms about which something is to be done."""
        return tuple(symptom for symptom in self.symptoms if symptom.policy.do == do)

    def estimates_at_work(self) -> list[DemandEstimate]:
        """Return what the components need that run."""
        estimates = self.demand_estimates
        return [each for each in estimates if each.component in self.placement]

    def without_estimates(self, components: Collection[str]) -> Situation:
        """Return the same with what some components need by the robot file."""
        if not components:
            return self
        known = self.demand_estimates
        kept = tuple(each for each in known if each.component not in components)
        return replace(self, demand_estimates=kept)

    @property
    def unreached(self) -> frozenset[str]:
        """The computers of which it is not known how they are now."""
        return self.lost | self.away

    def within_reach(self) -> Situation:
        """Return the same without what is lost."""
        return self._without(self.lost) if self.lost else self

    def of_running_components(self) -> Situation:
        """Return the same without what is out of reach: nothing moves there."""
        gone = self.unreached
        if not gone:
            return self
        here = self._without(gone)
        runs = here.placement.keys()
        robot = here.robot.with_components(lambda c: c if c.name in runs else None)
        return replace(here, robot=robot)

    def _without(self, gone: Collection[str]) -> Situation:
        return replace(
            self,
            robot=self.robot.on(c for c in self.robot.computers if c.name not in gone),
            placement={n: at for n, at in self.placement.items() if at not in gone},
        )

    def left(self) -> Situation:
        """Return the same with what other programs leave of the computers' CPU."""
        robot = replace(self.robot, computers=self.computers_left())
        return replace(self, robot=robot, loads={})

    @cached_property
    def shifted(self) -> Mapping[str, PresentDemand]:
        """Component -> its demand now, where that is not what was counted with."""
        return present_demands(self.robot, self.demand_estimates, self.urgency)

    @cached_property
    def robot_now(self) -> Robot:
        """The robot with the CPU demands that its components have now."""
        shifted = self.shifted
        if not shifted:
            return self.robot
        return self.robot.with_components(
            lambda c: (
                replace(c, demand={**c.demand, "cpu": shifted[c.name].counted})
                if c.name in shifted
                else c
            )
        )

    def functions(self) -> tuple[str, ...]:
        """Return the functions of its tasks, without those that nothing provides."""
        provided = {each.function for each in self.robot.architectures}
        return tuple(f for f in self.robot.functions_of() if f in provided)

    def stopped(self, missing: Collection[str]) -> tuple[list[Task], set[str]]:
        """Return the tasks that need missing functions, and what only they use."""
        tasks = [t for t in self.robot.tasks if not {*t.needs}.isdisjoint(missing)]
        others = replace(
            self.robot, tasks=tuple(t for t in self.robot.tasks if t not in tasks)
        )
        robot = replace(self.robot, tasks=tuple(tasks))
        functions = {*robot.functions_of()} - {*others.functions_of()}
        return tasks, functions

    def computers_left(self, *, is_cautious: bool = False) -> tuple[Computer, ...]:
        """Return the computers with what other programs leave of their CPU."""
        return tuple(
            _less_background(
                computer, self.loads.get(computer.name), is_cautious=is_cautious
            )
            for computer in self.robot.computers
        )

    def amounts(self) -> dict[str, float]:
        """Return what decides on a placement: CPU [cores], and bad links."""
        left = {
            f"on {computer.name}": computer.capacity.get("cpu", 0.0)
            for computer in self.computers_left()
            if computer.name not in self.lost
        }
        needed = {e.component: e.estimate.mean for e in self.demand_estimates}
        return left | needed | {f"link {name}": 0.0 for name in self.bad_links}


def _less_background(
    computer: Computer, load: Load | None, *, is_cautious: bool
) -> Computer:
    if load is None or not load.background:
        return computer
    # on a full computer other programs get less than they want
    times = _CAUTIOUS if is_cautious else WANTS_MORE if load.is_full else 1.0
    wanted = load.background * times
    cores = computer.capacity.get("cpu", 0.0) - wanted / computer.speed
    return replace(computer, capacity={**computer.capacity, "cpu": max(0.0, cores)})


class SituationReader:
    """Reads what the manager knows of its robot, for one moment at a time."""

    def __init__(
        self, live: LiveRobot, estimates: Estimates, lost: LostComputers
    ) -> None:
        self._live = live
        self._estimates = estimates
        self._lost = lost
        self._misses = DeadlineMisses()
        self._chains, self._ages = ChainReader(live.robot), ChainAges()

    def read(self, tasks: tuple[Task, ...]) -> Situation:
        """Return the situation now, while `tasks` run."""
        live, moment = self._live, time.monotonic()
        statuses, away = live.current(), live.agents.out_of_reach()
        loads = self._estimates.loads.loads(without=away)
        held = live.desired.held
        placement = {n: at for n, at in live.placement().items() if n not in held}
        return Situation(
            robot=replace(live.robot, tasks=tasks),
            placement=placement,
            lost=self._lost.computers(),
            away=frozenset(away),
            loads=loads,
            misses=self._misses.measure(statuses, moment),
            chains=self._ages.measure(self._chains.reports(statuses), moment),
            demand_estimates=tuple(self._estimates.demand_estimates()),
            statuses=statuses,
            traffic=self._estimates.traffic(),
            solve_steps=live.solve_steps,
        )


class Change(Struct, frozen=True, kw_only=True):
    """What a responder wants done; nothing of it has happened yet."""

    carry_out: Callable[[], object]
    why: str = ""  # the decision, for the journal; empty: what carries it out says it
    facts: Mapping[str, object] = {}  # what led to it, for the journal


class Responder(Protocol):
    """Reacts to one kind of trouble; never waits.

    It changes nothing that runs: what it wants done it returns. It may journal, and
    remember what it has seen and answered.
    """

    @property
    def purpose(self) -> str:
        """Return what it is there for."""
        ...

    def respond(self, situation: Situation, desired: Desired) -> Change | None:
        """Return what should change; None: nothing, so the next responder is asked."""
        ...
