"""A robot's components, running: started, watched, moved, stopped.

It believes only what agents observed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable, Mapping

from msgspec import structs

from poise.errors import RunError
from poise.estimate.profile.code_version import version_of
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import (
    components_of,
    containers_left,
    gateways,
    located,
    missing,
    unreached,
)
from poise.manage.deploy.deployment_plan import DeploymentPlan
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.journal import Journal
from poise.manage.observe.faults import fault_sentence, faults_after, last_numbers
from poise.manage.prefetch.report import Switches
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
    ) -> None:
        self.robot = robot
        self.agents = agents
        self.journal = journal
        self.layout = DeploymentPlan(
            robot, folder, weigh=weigh, code_version=version_of
        )
        self._epochs: dict[str, int] = {}
        self._last_epoch = -1
        self.placed = {
            name: Incarnation(
                component=name, computer=computer, epoch=self.next_epoch(name)
            )
            for name, computer in placement.items()
        }
        self.prepared: dict[str, Incarnation] = {}
        """Components that are configured, inactive and unjoined, to be active soon."""
        self.spare: dict[str, float] = {}
        """Computer -> CPU for what is being prepared there [cores]."""
        self.switches = Switches()
        self.tasks = b""
        """What the next manager needs to go on with the tasks; agents keep it."""
        self.check: Callable[[], object] = lambda: None
        """Called at all news while all is started or watched; may raise to end that."""
        self.faults_before = last_numbers(agents.statuses())
        self._faults_before_tell = self.faults_before
        self.generation = 0
        """The number of what agents were told last: higher than any before."""
        self._gateways: dict[str, str] = {}
        self.wanted: tuple[Incarnation, ...] = ()
        """What the agents should run; during a move also what is prepared."""
        self._told: dict[str, Deployment] = {}
        self._is_cancelled = threading.Event()
        self.is_left = False
        """Whether it was stopped, or is left to another manager."""
        self.excused: set[str] = set()
        """Computers that may be out of reach: `raise_on_lost` ignores them."""

    def start(self) -> None:
        """End what an earlier manager left, and start everything.

        Raises
        ------
        RunError
            Another manager is at work, a component failed, a computer is out of reach,
            or a limit passed; its message names the component and holds its traceback.
        """
        self.agents.claim(self.computers())
        if left := containers_left(self.agents.statuses(), self.computers()):
            text = f"an earlier manager left {', '.join(left)}: it is ended first"
            self.journal.note("seen", text)
            self.end_all(self.computers())
        self.start_all()

    def start_all(self) -> None:
        """Start everything, all inactive first, then active; as `start`."""
        what = f"starting {counted(len(self.placed), 'component')}"
        self.journal.note("decided", what)
        self.reach("inactive", READY_LIMIT)
        self.reach("active", ACTIVE_LIMIT)
        self.journal.note("done", "everything runs", placement=self.placement())

    def adopt(
        self, kept: Mapping[str, Incarnation], last_epochs: Mapping[str, int]
    ) -> None:
        """Go on with what an earlier manager left, in place of what was planned."""
        self.placed = dict(kept)
        self._epochs = dict(last_epochs)
        # that of one on a computer that is out of reach is not known, and lower
        self._last_epoch = max(s.generation for s in self.agents.statuses().values())

    def placement(self) -> dict[str, str]:
        """Return component -> computer, as it is now."""
        return {name: each.computer for name, each in self.placed.items()}

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
        self._is_cancelled.set()
        self.agents.notify()

    def synchronise(self, computer: str) -> None:
        """Bring a computer that came back to what should run there now.

        Raise RunError when its agent obeys another manager, or does not answer.
        """
        self.reclaim({computer})
        self.tell(self.placed.values())

    def reclaim(self, computers: Iterable[str]) -> None:
        """Claim again those whose agents were restarted, and tell all of them again."""
        for computer in computers:
            if not self.agents.obey(computer) or not self.agents.holds_lease(computer):
                self.agents.claim({computer})
            self._told.pop(computer, None)

    def end_all(self, computers: set[str]) -> None:
        """End all containers of computers, also those of another manager.

        Raises
        ------
        RunError
            An agent refused, or something still ran after `STOP_LIMIT`.
        """
        self.prepared.clear()
        self.tell((), computers)
        if not self.agents.wait_news(lambda: not self._running(computers), STOP_LIMIT):
            running = ", ".join(self._running(computers))
            raise RunError(f"{running} still ran {STOP_LIMIT:g} s after the stop")

    def reach(self, goal: Goal, limit: float) -> None:
        """Bring every component to a goal within `limit` [s]; `start` says the rest."""
        self.bring([each.with_goal(goal) for each in self.placed.values()], limit)
        self.journal.note("done", f"all components are {goal}")

    def bring(self, wanted: Collection[Incarnation], limit: float) -> None:
        """Tell agents what should run beside all other components, and wait for it.

        Raises
        ------
        RunError
            As `tell` and `wait` do.
        """
        names = {each.component for each in wanted}
        others = [each for name, each in self.placed.items() if name not in names]
        self.tell([*others, *wanted])
        self.wait(wanted, limit)

    def tell(
        self, wanted: Iterable[Incarnation], computers: Iterable[str] | None = None
    ) -> None:
        """Tell the agents of `computers` what should run, where that has changed.

        What is prepared stays beside it.

        Parameters
        ----------
        computers
            None: all that are reached.

        Raises
        ------
        RunError
            An agent refused or did not answer.
        """
        self.wanted = tuple(wanted)
        names = {each.component for each in self.wanted}
        others = (e for name, e in self.prepared.items() if name not in names)
        self.wanted += tuple(others)
        statuses = self.agents.statuses()
        self._faults_before_tell = last_numbers(statuses)
        # later than any that the agents ever saw, from whatever manager
        seen = [status.generation for status in statuses.values()]
        self.generation = max(self.generation, *seen, 0) + 1
        specs = {
            computer: structs.replace(spec, tasks=self.tasks)
            for computer, spec in self.layout.specs(
                self.wanted, self.generation, self.gateways(), self.spare
            ).items()
        }
        news = {
            computer: specs[computer]
            for computer in sorted(self.computers() if computers is None else computers)
            if computer not in self._told
            or _said(self._told[computer]) != _said(specs[computer])
        }
        refusals = self.agents.deploy(news)
        self._told |= {c: spec for c, spec in news.items() if c not in refusals}
        if refusals:
            self.raise_on_lost()  # which explains a silence
            raise RunError("; ".join(refusals.values()))

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
        """Wait until `wanted` are at their goals and all their connectors are joined.

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
            return not self._missing(wanted)

        if not self.agents.wait_news(is_reached, limit):
            missing = "; ".join(self._missing(wanted))
            raise RunError(f"not there within {limit:g} s: {missing}")

    def current(self) -> dict[str, AgentStatus]:
        """Return the statuses that speak of what the agents were told last."""
        return {
            computer: status
            for computer, status in self.agents.statuses().items()
            if computer in self._told
            and status.generation >= self._told[computer].generation
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

    def _missing(self, wanted: tuple[Incarnation, ...]) -> list[str]:
        """Return what there is still to wait for, in words."""
        statuses = self.current()
        silent = self._told.keys() - statuses.keys() - self.excused
        found = missing(wanted, statuses, silent, self._unreached_connectors())
        found += self.unresponsive(wanted) if found else []
        faults = faults_after(self._faults_before_tell, statuses) if found else ()
        return found + [fault_sentence(computer, fault) for computer, fault in faults]

    def _running(self, computers: set[str]) -> list[str]:
        """Return the containers that still run there, for all that is known."""
        return containers_left(self.current(), computers & self.computers())

    def _unreached_connectors(self) -> set[str]:
        """Return the connectors that have an end on an excused computer."""
        away = {n for n, each in self.placed.items() if each.computer in self.excused}
        return {
            str(connector)
            for connector in self.layout.connectors(self.placed)
            if not away.isdisjoint(end.component for end in connector.between)
        }

    def note_refused(self) -> None:
        """Journal why records of agents were refused."""
        for sentence in self.agents.take_refused():
            self.journal.note("wrong", sentence)

    def look(self) -> None:
        """Look around while agents are waited for; raise RunError to end that."""
        self.note_refused()
        self.check()
        if self._is_cancelled.is_set():
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

    def raise_on_unreached(self, incarnations: Iterable[Incarnation]) -> None:
        """Raise RunError when one is on a computer that is out of reach."""
        unreached = self.unreached()
        for each in incarnations:
            if each.computer in unreached:
                raise RunError(unreached[each.computer])

    def raise_on_lost(self) -> bool:
        """Raise RunError when a computer is out of reach that is not excused."""
        for computer, sentence in self.unreached().items():
            if computer not in self.excused:
                self.journal.note("wrong", sentence)
                raise RunError(sentence)
        return False


def _said(deployment: Deployment) -> Deployment:
    """Return what a deployment says, whenever that is."""
    return structs.replace(deployment, generation=0)
