"""A robot's components, running: started, watched, moved, stopped.

What should run is one record (`Desired`), which `commit` replaces; a reconciler brings
the agents there. What does run is what they observed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable, Mapping

from msgspec import structs

from poise.clock import Clock, SystemClock
from poise.errors import RunError
from poise.estimate.profile.code_version import version_of
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import (
    components_of,
    containers_left,
    cut_links,
    gateways,
    located,
    missing,
    unreached,
)
from poise.manage.deploy.adoption import found_in
from poise.manage.deploy.deployment_plan import DeploymentPlan
from poise.manage.deploy.desired import Desired, difference
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.deploy.other_side import joined_by
from poise.manage.deploy.reconciler import Reconciler
from poise.manage.journal import Journal
from poise.manage.observe.faults import fault_sentence, faults_after, last_numbers
from poise.manage.prefetch.report import Switches
from poise.manage.supervised import SupervisedTick
from poise.model.robot import Robot
from poise.units import counted
from poise.wire.records.deployment import Deployment, Goal
from poise.wire.records.status import AgentStatus

READY_LIMIT = 20.0
"""All components are configured and all connectors joined within this time [s]."""
ACTIVE_LIMIT = 10.0
STOP_LIMIT = 5.0


class RunningComponents:
    """The components of a task on the robot's computers.

    Parameters
    ----------
    placement
        Component -> computer.
    folder
        The run's folder, to which devices' paths are relative.
    weigh
        Whether the sizes of snapshots are taken as components are deactivated.
    """

    def __init__(
        self,
        robot: Robot,
        placement: Mapping[str, str],
        agents: Agents,
        journal: Journal,
        folder: str,
        *,
        weigh: bool = False,
        clock: Clock | None = None,
    ) -> None:
        self.robot = robot
        self.agents = agents
        self.journal = journal
        self.layout = DeploymentPlan(
            robot, folder, weigh=weigh, code_version=version_of
        )
        self.clock = clock or SystemClock()
        self._is_over = threading.Event()
        self._epochs: dict[str, int] = {}
        self._last_epoch = -1
        self.desired = Desired(
            placed={
                name: Incarnation(
                    component=name, computer=computer, epoch=self.next_epoch(name)
                )
                for name, computer in placement.items()
            }
        )
        """What should run; any thread may read it, and only `commit` replaces it."""
        self.tick = SupervisedTick(
            journal, self.clock, self.release, self._is_over.is_set
        )
        """What runs the parts of the manager's loop."""
        self.reconciler = Reconciler(agents, self.clock, self._note_claimed)
        self.claimed: set[str] = set()
        """The computers that this manager has claimed, and so knows what runs there."""
        self._found: dict[str, Deployment] = {}
        self.switches = Switches()
        self.check: Callable[[], object] = lambda: None
        """Called at all news while agents are waited for; may raise to end that."""
        self.faults_before = last_numbers(agents.statuses())
        self._faults_before_commit = self.faults_before
        self._gateways: dict[str, str] = {}
        self._deployments: Mapping[str, Deployment] = {}
        self._deployed_for: object = None
        self.is_left = False
        """Whether it is left to another manager, or was stopped."""
        self.goes_on_without_lost = False
        """Whether a lost computer is a deviation; else it ends what waits."""

    @property
    def placed(self) -> Mapping[str, Incarnation]:
        """Component -> its authoritative incarnation."""
        return self.desired.placed

    @property
    def prepared(self) -> Mapping[str, Incarnation]:
        """Component -> its idle incarnation, to be active soon."""
        return self.desired.prepared

    def commit(self, desired: Desired, why: str, *, tell_later: bool = False) -> None:
        """Let something else run from now on; the only place that changes that.

        It is journalled, and agents are told; nothing is waited for. For the manager's
        thread.

        Parameters
        ----------
        desired
            Made from `desired` as it is; its generation is set here.
        why
            For people, in the journal.
        tell_later
            Whether agents are told at the next `reconcile` only.
        """
        before = self.desired
        statuses = self.agents.statuses()
        self._faults_before_commit = last_numbers(statuses)
        if desired != before:
            # later than any that the agents ever saw, from whatever manager
            seen = [status.generation for status in statuses.values()]
            self.desired = structs.replace(
                desired, generation=max(desired.generation, *seen, 0) + 1
            )
            if changes := difference(before, desired):
                self.journal.note("desired", why, changes=changes)
        if not tell_later:
            self.reconcile()

    def reconcile(self) -> None:
        """Bring the agents a step nearer to what should run; never raises."""
        if not self.is_left:
            self.tick.run("bring agents to what should run", self._reconcile)

    def release(self, why: str) -> None:
        """Let what is placed go on, without any change under way: that broke."""
        self.commit(self.desired.released(), why)

    def _reconcile(self) -> None:
        now = self.desired, dict(self.gateways())
        if now != self._deployed_for:
            self._deployed_for = now
            self._deployments = {
                computer: structs.replace(spec, tasks=self.desired.tasks)
                for computer, spec in self.layout.specs(
                    self.desired.incarnations(),
                    self.desired.generation,
                    now[1],
                    self.desired.spare,
                ).items()
            }
        self.reconciler.step(self._deployments)
        if self._found:
            self._join_found()

    def start(self) -> None:
        """End what an earlier manager left, and start everything.

        Raises
        ------
        RunError
            Another manager is at work, a component failed, a computer is out of reach,
            or a limit passed; its message names the component and holds its traceback.
        """
        self.agents.claim(self.computers())
        self.claimed |= self.computers()
        if left := containers_left(self.agents.statuses(), self.computers()):
            text = f"an earlier manager left {', '.join(left)}: it is ended first"
            self.journal.note("seen", text)
            placed = self.desired
            self.end_all("an earlier manager left something")
            self.commit(placed, "what it left has ended")
        self.start_all()

    def start_all(self) -> None:
        """Start everything, all inactive first, then active; as `start`."""
        what = f"starting {counted(len(self.placed), 'component')}"
        self.journal.note("decided", what)
        self.reach("inactive", READY_LIMIT)
        self.reach("active", ACTIVE_LIMIT)
        self.journal.note("done", "everything runs", placement=self.placement())

    def adopt(
        self,
        kept: Mapping[str, Incarnation],
        last_epochs: Mapping[str, int],
        tasks: bytes,
        held: frozenset[str],
    ) -> None:
        """Go on with what an earlier manager left, in place of what was planned."""
        self._epochs = dict(last_epochs)
        # that of one on a computer that is out of reach is not known, and lower
        self._last_epoch = max(s.generation for s in self.agents.statuses().values())
        desired = Desired(placed=dict(kept), tasks=tasks, held=held)
        self.commit(desired, "taking the robot over")

    def placement(self) -> dict[str, str]:
        """Return component -> computer, as it is now; from any thread."""
        return self.desired.placement()

    def watch(self, seconds: float) -> None:
        """Let it run for `seconds` [s]; raise RunError when something fails."""
        self.agents.wait_news(self._raise_on_trouble, seconds)

    def leave(self) -> None:
        """Leave the robot as it is: a stop does nothing from now on."""
        self.is_left = True

    def unreached(self) -> dict[str, str]:
        """Return what is known of each computer that is out of reach, in words."""
        out_of_reach = self.agents.out_of_reach()
        heard_by = {name: self.agents.heard_by(name) for name in out_of_reach}
        return unreached(out_of_reach, self.placement(), heard_by)

    def cancel(self) -> None:
        """End what waits for agents: a change of the placement is rolled back."""
        self._is_over.set()
        self.agents.notify()

    def end_all(self, why: str) -> None:
        """End all containers of the computers that are reached, whoever started them.

        Raises
        ------
        RunError
            An agent refused, or something still ran after `STOP_LIMIT`.
        """
        self.commit(structs.replace(self.desired, is_stopped=True), why)

        def has_ended() -> bool:
            self.reconcile()
            return not self._running()

        if not self.agents.wait_news(has_ended, STOP_LIMIT):
            refusals = map(self.reconciler.refusal, sorted(self.computers()))
            text = "; ".join(filter(None, refusals)) or (
                f"{', '.join(self._running())} still ran {STOP_LIMIT:g} s after "
                "the stop"
            )
            raise RunError(text)

    def reach(self, goal: Goal, limit: float) -> None:
        """Bring every component to a goal within `limit` [s]; `start` says the rest."""
        self.commit(self.desired.aiming(goal, self.placed.keys()), f"start: {goal}")
        self.wait(self.placed.values(), limit)
        self.journal.note("done", f"all components are {goal}")

    def bring(self, coming: Collection[Incarnation], limit: float, why: str) -> None:
        """Let something run beside all else, and wait for it.

        Raises
        ------
        RunError
            As `wait` does.
        """
        self.commit(self.desired.starting(coming), why)
        self.wait(coming, limit)

    def gateways(self) -> dict[str, str]:
        """Return where other computers reach each computer's containers.

        It is known also of a computer that is out of reach, or back without a report.
        """
        self._gateways |= gateways(self.agents.statuses())
        return self._gateways

    def next_epoch(self, component: str) -> int:
        """Return an epoch that no incarnation of the component has had."""
        last = self._epochs.get(component, self._last_epoch)
        self._epochs[component] = last + 1
        return self._epochs[component]

    def wait(
        self,
        wanted: Iterable[Incarnation],
        limit: float,
        trouble: Callable[[], bool] | None = None,
    ) -> None:
        """Wait until `wanted` are at their goals and their connectors are joined.

        Those whose ends do not reach each other are joined later.

        Parameters
        ----------
        trouble
            Called at every news; raises to end the waiting. None: any trouble does.

        Raises
        ------
        RunError
            They were not within `limit` [s], or there was trouble.
        """
        wanted = tuple(wanted)
        look = trouble or self._raise_on_trouble

        def is_reached() -> bool:
            look()
            self.raise_on_unreached(wanted)
            self._raise_on_refusal(wanted)
            return not self.missing(wanted)

        if not self.agents.wait_news(is_reached, limit):
            missing = "; ".join(self.missing(wanted))
            raise RunError(f"not there within {limit:g} s: {missing}")

    def current(self) -> dict[str, AgentStatus]:
        """Return the statuses that speak of what the agents were told last."""
        return {
            computer: status
            for computer, status in self.agents.statuses().items()
            if self.reconciler.is_current(computer, status)
        }

    def computers(self) -> set[str]:
        """Return the names of the robot's computers that are reached."""
        known = {computer.name for computer in self.robot.computers}
        return known - self.agents.out_of_reach().keys()

    def has_ended(self, gone: Incarnation) -> bool:
        """Return whether an incarnation is not there any more, so far as is known."""
        if gone.computer in self.agents.out_of_reach():
            return True
        status = self.current().get(gone.computer)
        return status is not None and all(
            (component.name, component.epoch) != (gone.component, gone.epoch)
            for component in components_of({gone.computer: status})
        )

    def wait_ended(self, gone: Incarnation) -> None:
        """Wait until an incarnation that is not wanted any more has ended.

        Raises
        ------
        RunError
            It still ran after `STOP_LIMIT`.
        """
        if not self.agents.wait_news(lambda: self.has_ended(gone), STOP_LIMIT):
            raise RunError(
                f"component '{gone.component}' still runs on '{gone.computer}' "
                f"{STOP_LIMIT:g} s after it was to end"
            )

    def unresponsive(self, incarnations: Iterable[Incarnation]) -> list[str]:
        """Return which of their containers do not respond, and why, in words."""
        known = {
            (computer, each.name): each
            for computer, status in self.agents.statuses().items()
            for each in status.health
            if each.state == "unresponsive"
        }
        places = dict.fromkeys(
            (each.computer, self.layout.container_of(each.component))
            for each in incarnations
        )
        return [
            f"container '{place[1]}' on '{place[0]}' does not respond: "
            f"{known[place].reason}"
            for place in places
            if place in known
        ]

    def missing(self, wanted: Collection[Incarnation]) -> list[str]:
        """Return what `wait` still waits for, in words."""
        statuses = self.current()
        silent = self._involved(wanted) & (self.computers() - statuses.keys())
        new = {each.component: each for each in wanted if not each.unjoined}
        placed = {**self.placed, **new}
        unreached = self.unreached_connectors(placed)
        joins = {
            self.layout.key_of(connector, placed)
            for connector in self.layout.connectors_at(new, placed)
            if str(connector) not in unreached
        }
        found = missing(wanted, statuses, silent, joins)
        found += self.unresponsive(wanted) if found else []
        faults = faults_after(self._faults_before_commit, statuses) if found else ()
        return found + [fault_sentence(computer, fault) for computer, fault in faults]

    def unreached_connectors(self, placed: Mapping[str, Incarnation]) -> dict[str, str]:
        """Return the connectors whose ends do not reach each other, and why.

        Parameters
        ----------
        placed
            By component.
        """
        cut = cut_links(self.agents.statuses())
        away = set(self.agents.out_of_reach())
        found = {}
        for connector in self.layout.connectors(placed):
            ends = [placed[end.component] for end in connector.between]
            between = sorted({each.computer for each in ends})
            if lost := away.intersection(between):
                found[str(connector)] = f"computer '{min(lost)}' is out of reach"
            elif frozenset(between) in cut:
                found[str(connector)] = f"link '{'-'.join(between)}' is cut"
            elif frozen := self.unresponsive(ends):
                found[str(connector)] = "; ".join(frozen)
        return found

    def _involved(self, wanted: Iterable[Incarnation]) -> set[str]:
        """Return the computers of incarnations, and of what is joined to them."""
        wanted = tuple(wanted)
        names = {each.component for each in wanted}
        where = self.placement()
        peers = {
            where[end.component]
            for connector in self.layout.connectors(where.keys() | names)
            if not names.isdisjoint(end.component for end in connector.between)
            for end in connector.between
            if end.component in where
        }
        return peers | {each.computer for each in wanted}

    def _running(self) -> list[str]:
        """Return the containers that still run, for all that is known."""
        return containers_left(self.current(), self.computers())

    def _note_claimed(self, computer: str, found: Deployment | None) -> None:
        """Take in what an agent works towards that was claimed."""
        found = found or Deployment(generation=0, containers=())
        if computer in self.claimed:  # this manager knows what runs there
            found = structs.replace(found, containers=())
        self.claimed.add(computer)
        self._found[computer] = found

    def _join_found(self) -> None:
        """Adopt what is at work on computers that were claimed for the first time."""
        found, self._found = self._found, {}
        for each in found_in(found):
            self._epochs[each.name] = max(
                self._epochs.get(each.name, self._last_epoch), each.spec.epoch
            )
        names = ", ".join(f"'{name}'" for name in sorted(found))
        desired = joined_by(self.desired, self.robot, found_in(found), self.claimed)
        last = max(each.generation for each in found.values())
        desired = structs.replace(
            desired, generation=max(last, self.desired.generation) + 1
        )
        self.commit(desired, f"what is at work on {names} goes on there")

    def note_refused(self) -> None:
        """Journal why records of agents were refused."""
        for sentence in self.agents.take_refused():
            self.journal.note("wrong", sentence)

    def look(self) -> None:
        """Look around while agents are waited for; raise RunError to end that."""
        self.note_refused()
        self.check()
        self.reconcile()
        if self._is_over.is_set():
            raise RunError("the robot is being stopped")
        self.raise_on_lost()

    def _raise_on_trouble(self) -> bool:
        self.look()
        prepared = {(name, each.epoch) for name, each in self.prepared.items()}
        for computer, component in located(self.agents.statuses()):
            is_prepared = (component.name, component.epoch) in prepared
            if component.state == "failed" and not is_prepared:
                what = f"component '{component.name}' on '{computer}' failed"
                self.journal.note("failed", what)
                raise RunError(f"{what}:\n{component.error}")
        return False

    def raise_on_broken(self, incarnations: Collection[Incarnation]) -> None:
        """Raise RunError when one failed, or its container does not respond."""
        if stuck := self.unresponsive(incarnations):
            raise RunError("; ".join(stuck))
        where = {(each.component, each.epoch): each.computer for each in incarnations}
        for each in components_of(self.current()):
            computer = where.get((each.name, each.epoch))
            if computer is not None and each.state == "failed":
                raise RunError(
                    f"component '{each.name}' cannot be configured on '{computer}':\n"
                    f"{each.error}"
                )

    def raise_on_unreached(self, incarnations: Iterable[Incarnation]) -> None:
        """Raise RunError when one is on a computer that is out of reach."""
        unreached = self.unreached()
        for each in incarnations:
            if each.computer in unreached:
                raise RunError(unreached[each.computer])

    def why_held(self, component: str) -> str:
        """Return why a component stays inactive, for people."""
        missing = {computer.name for computer in self.robot.computers} - self.claimed
        names = " or ".join(f"'{name}'" for name in sorted(missing))
        return (
            f"component '{component}' waits: another manager may run it on {names}, "
            "which this one has not reached. `poise up FILE --take-over` starts it "
            "nevertheless"
        )

    def _raise_on_refusal(self, incarnations: Iterable[Incarnation]) -> None:
        """Raise RunError when an agent refuses what should run there, or it is held."""
        incarnations = tuple(incarnations)
        for each in incarnations:
            if each.goal == "active" and each.component in self.desired.held:
                raise RunError(self.why_held(each.component))
        for computer in sorted({each.computer for each in incarnations}):
            if refusal := self.reconciler.refusal(computer):
                raise RunError(refusal)

    def raise_on_lost(self) -> bool:
        """Raise RunError when a computer is out of reach, unless it goes on without."""
        if not self.goes_on_without_lost:
            for sentence in self.unreached().values():
                self.journal.note("wrong", sentence)
                raise RunError(sentence)
        return False
