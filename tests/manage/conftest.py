"""A small robot, and a fleet of agents that does what a test says."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import pytest
from msgspec.structs import replace

from poise.errors import RunError
from poise.manage.agent_connections.reports import CheckpointCopies
from poise.manage.agent_connections.requests import PendingAnswer
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Device,
    Robot,
)
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import MigrationSteps, StepsDone, StepsOutcome
from poise.wire.records.request_records import (
    Accepted,
    CheckpointCopy,
    Claimed,
    Election,
    ManagerId,
    Refused,
)
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Fault,
)


@pytest.fixture
def robot() -> Robot:
    """Return a robot whose architecture ``eye`` sends pictures to ``mind``."""
    return Robot(
        name="tiny",
        folder="/robot",
        computers=(
            Computer(name="left", capacity={"cpu": 2.0, "memory": 1e9}, speed=0.5),
            Computer(name="right", capacity={"cpu": 1.0, "memory": 1e9}),
        ),
        devices=(Device(name="camera", computer="left", path="camera.sock"),),
        architectures=(
            Architecture(
                name="eye",
                function="seeing",
                components=(
                    ComponentEntry(
                        name="grabber",
                        implementation="eye:Grabber",
                        devices=("camera",),
                        parameters={"rate": 5},
                    ),
                    ComponentEntry(name="filter", implementation="eye:Filter"),
                    ComponentEntry(
                        name="heavy", implementation="eye:Heavy", demand={"cpu": 0.6}
                    ),
                    ComponentEntry(
                        name="alone", implementation="eye:Alone", isolated=True
                    ),
                    ComponentEntry(name="driver", command=("./driver", "-v")),
                ),
                connectors=(
                    _joined("grabber.raw", "filter.raw"),
                    _joined("filter.clean", "heavy.clean"),
                    _joined("driver.out", "filter.out"),
                ),
            ),
            Architecture(
                name="mind",
                function="thinking",
                components=(
                    ComponentEntry(name="thinker", implementation="mind:Thinker"),
                ),
            ),
        ),
        connectors=(_joined("filter.clean", "thinker.seen", limit=0.3),),
    )


def _joined(source: str, target: str, limit: float = 1.0) -> Connector:
    ends = tuple(ConnectorEnd(*end.split(".")) for end in (source, target))
    return Connector(between=(ends[0], ends[1]), limit=limit)


class FakeAgents:
    """Agents that are at once what they are told to be, but for what a test spoils."""

    def __init__(self, *computers: str, generation: int = 0) -> None:
        self.manager = ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0)
        self.election: Election | None = None
        self.stored: Deployment | None = None
        self.checkpoints = CheckpointCopies()
        self.own_keys = None
        self.heartbeats = self
        self.is_leased = True
        self.gone: set[str] = set()
        self.others: dict[str, str] = {}
        self.lasting: set[str] = set()
        self.lasting_leases: set[str] = set()
        self.heard: set[str] = set()
        self.hearers: dict[str, str] = {}
        self.revoked: list[str] = []
        self.returns = False
        self.back = ""
        self.claimed: list[str] = []
        self.is_forced = False
        self.later: ManagerId | None = None
        self.strangers: set[str] = set()
        self.left_with: dict[str, Deployment] = {}
        self.refusing: set[str] = set()
        self.deaf: set[str] = set()
        self.unclaimed: set[str] = set()
        self.halted: dict[str, StepsOutcome] = {}
        self.kept: list[tuple[str, CheckpointCopy]] = []
        self.full: set[str] = set()
        self.refused: list[str] = []
        self.lose_when_told = ""
        self.deployed: list[tuple[str, Deployment]] = []
        self.states: dict[str, ComponentStatus] = {}
        self.faults: tuple[Fault, ...] = ()
        self.unjoined: tuple[ConnectorStatus, ...] = ()
        self._statuses = {
            name: AgentStatus(
                computer=name,
                generation=generation,
                uptime=0,
                cpu=0,
                gateway=f"{name}:7000",
            )
            for name in computers
        }

    def vote(self, stored: Deployment) -> None:
        """Vote for who asks from now on, and say what all of them have stored."""
        self.election = Election(votes=dict.fromkeys(self._statuses, 1))
        self.stored = stored

    def elect(self, *, take_over: bool) -> dict[str, Claimed]:
        """Let all agents that answer obey, with what they have stored."""
        self.is_forced = take_over
        there = self._statuses.keys() - self.gone
        return {name: Claimed(self.stored) for name in there}

    def has_stored(self, _generation: int) -> bool:
        """Need no votes."""
        return True

    def why_not_leading(self) -> str:
        """Need no votes."""
        return ""

    def note_faults(self, *faults: Fault) -> None:
        """Let all agents have reported these before."""
        self._statuses = {
            name: replace(status, faults=faults)
            for name, status in self._statuses.items()
        }

    def report_component(self, computer: str, component: ComponentStatus) -> None:
        """Let one report a component anew, in the container that is there."""
        status = self._statuses[computer]
        containers = tuple(
            replace(
                container,
                components=tuple(
                    component if each.name == component.name else each
                    for each in container.components
                ),
            )
            for container in status.containers
        )
        self._statuses[computer] = replace(status, containers=containers)

    def forget(self, computer: str) -> None:
        """Let one have come back that has not reported yet."""
        del self._statuses[computer]

    def report(self, status: AgentStatus) -> None:
        """Let an agent have reported something else."""
        self._statuses[status.computer] = status

    def forget_status(self, computer: str) -> None:
        del self._statuses[computer]

    def statuses(self) -> dict[str, AgentStatus]:
        return dict(self._statuses)

    def ages(self) -> dict[str, float]:
        return dict.fromkeys(self.statuses(), 0.0)

    def out_of_reach(self) -> dict[str, float]:
        return dict.fromkeys(self.gone, 0.0)

    def other_agent(self, computer: str) -> str:
        return self.others.get(computer, "")

    def claim(
        self, computers: Collection[str], *, take_over: bool = False
    ) -> dict[str, Deployment]:
        self.claimed += sorted(computers)
        self.is_forced = take_over
        assert self.gone.isdisjoint(computers)
        if not self.unclaimed.isdisjoint(computers):
            raise RunError("its agent is out of reach")
        return {c: d for c, d in self.deployed if c in computers}

    def successor(self) -> ManagerId | None:
        return self.later

    def pop_refused(self) -> list[str]:
        refused, self.refused = self.refused, []
        return refused

    def ends_soon(self, computer: str) -> bool:
        return computer not in self.lasting

    def obey(self, computer: str) -> bool:
        return computer not in self.strangers | self.gone

    def have_leases_ended(self, computers: Collection[str]) -> bool:
        return self.lasting_leases.isdisjoint(computers)

    def heard_by(self, computer: str) -> str:
        return self.hearers.get(computer, "")

    def is_heard(self, computer: str) -> bool:
        return computer in self.heard

    def is_sure(self, computer: str) -> bool:  # noqa: ARG002, always
        return True

    def is_cut_off(self, computer: str) -> bool:  # noqa: ARG002, none ever is
        return False

    def revoke(self, computers: Iterable[str]) -> bool:
        if not self.lasting_leases.isdisjoint(computers):
            return False
        self.revoked += sorted(computers)
        return True

    def notify(self) -> None:
        pass

    def wait_news(self, is_enough: Callable[[], bool], limit: float) -> bool:  # noqa: ARG002, it does not wait
        if self.returns:
            self.gone.clear()
        self.gone.discard(self.back)
        return is_enough()

    def begin_claim(self, computer: str) -> PendingAnswer:
        self.claimed.append(computer)
        reply = PendingAnswer()
        if computer in self.refusing:
            reply.set(Refused("not today"))
        else:
            self.strangers.discard(computer)
            reply.set(Claimed(self.left_with.get(computer)))
        return reply

    def end_claim(self, computer: str, reply: PendingAnswer) -> None:
        pass

    def begin_keeping(self, computer: str, copy: CheckpointCopy) -> PendingAnswer:
        self.kept.append((computer, copy))
        reply = PendingAnswer()
        reply.set(Refused("no space") if computer in self.full else Accepted())
        return reply

    def keep_checkpoint(self, computer: str, copy: CheckpointCopy) -> str:
        self.kept.append((computer, copy))
        return "no space" if computer in self.full else ""

    def begin_steps(self, computer: str, steps: MigrationSteps) -> PendingAnswer:
        reply = PendingAnswer()
        reply.set(self.halted.get(computer, StepsDone(steps.number)))
        return reply

    def send_steps(
        self, batches: Iterable[tuple[str, MigrationSteps]]
    ) -> Iterator[StepsOutcome]:
        for computer, steps in batches:
            done = self.halted.get(computer, StepsDone(steps.number))
            yield replace(done, number=steps.number)

    def begin_deploy(self, computer: str, deployment: Deployment) -> PendingAnswer:
        reply = PendingAnswer()
        if self.lose_when_told:
            self.gone.add(self.lose_when_told)
        if computer in self.refusing:
            reply.set(Refused("not today"))
            return reply
        self.deployed.append((computer, deployment))
        if computer not in self.deaf:
            self._statuses[computer] = self._obeyed(computer, deployment)
        reply.set(Accepted())
        return reply

    def _obeyed(self, computer: str, deployment: Deployment) -> AgentStatus:
        before = self._statuses.get(computer)
        states = {c.key: c.state for c in before.components} if before else {}
        containers = tuple(
            ContainerStatus(
                name=container.name,
                pid=1,
                components=tuple(
                    self.states.get(
                        c.name,
                        ComponentStatus(
                            name=c.name,
                            epoch=c.epoch,
                            state=states.get((c.name, c.epoch), "inactive")
                            if c.goal == "stay"
                            else c.goal,
                        ),
                    )
                    for c in container.components
                ),
                connectors=self.unjoined,
            )
            for container in deployment.containers
        )
        return AgentStatus(
            computer=computer,
            pid=before.pid if before else 0,
            key=before.key if before else "",
            took_over=before.took_over if before else (),
            generation=deployment.generation,
            uptime=0,
            cpu=0,
            gateway=f"{computer}:7000",
            containers=containers,
            faults=self.faults,
        )


def connector_names(deployment: Deployment) -> dict[str, Any]:
    """Return container -> the kinds of its connectors, by name."""
    return {
        container.name: {c.name: c.kind for c in container.connectors}
        for container in deployment.containers
    }
