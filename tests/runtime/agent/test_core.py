"""An agent's decisions, in a modelled world: no process, socket or real time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from math import inf
from random import Random
from signal import SIGKILL, SIGTERM, Signals
from typing import Any

import pytest
from msgspec import structs

from poise.errors import Unavailable
from poise.runtime.agent.core import AgentCore
from poise.runtime.agent.surroundings import AgentSetup, AgentState, Reply, Surroundings
from poise.runtime.supervision.container_processes import ProcessEnd
from poise.runtime.supervision.supervisor import FENCE_GRACE
from poise.testing import VirtualClock
from poise.threads import SHOWN_FOR
from poise.wire.heartbeats import UNCUT_LEASE, Address, Hear, NextBeat
from poise.wire.records.code_records import CodePart, InstallCode
from poise.wire.records.deployment_records import (
    ComponentSpec,
    ContainerSpec,
    Deployment,
)
from poise.wire.records.migration_records import MigrationSteps, StepsFailed
from poise.wire.records.request_records import (
    Accepted,
    Claim,
    Claimed,
    ManagerId,
    ManagerRequest,
    Refused,
)
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerFailure,
    ContainerStatus,
    ToContainer,
)

MANAGER = ManagerId(key="first", user="ann", host="desk", pid=7, since=0.0)
EXIT_1 = ProcessEnd(1 << 8)


class Process:
    """A modelled container process; `fault` is raised by what is sent to it."""

    def __init__(self) -> None:
        self.sent: list[ToContainer] = []
        self.signals: list[Signals] = []
        self.fault: Exception | None = None
        self.lease_end = 0.0
        self.is_lapsed = False
        self.beats = 1

    def note_born(self, pid: int) -> None:
        pass

    def extend_lease(self, until: float) -> None:
        self.lease_end = until

    def is_lease_past(self) -> bool:
        return self.is_lapsed

    def send(self, record: ToContainer) -> None:
        if self.fault:
            raise self.fault
        self.sent.append(record)

    def signal(self, number: Signals) -> None:
        self.signals.append(number)

    def heartbeat(self) -> int | None:
        return self.beats

    def close(self) -> None:
        pass


class Host:
    """A modelled computer."""

    cpu_weights = ""

    def __init__(self) -> None:
        self.started: list[str] = []
        self.processes: dict[str, Process] = {}
        self.weights: dict[int, int] = {}
        self.faults: dict[str, Exception] = {}

    def start(self, spec: ContainerSpec) -> Process:
        if fault := self.faults.get(spec.name):
            raise fault
        self.started.append(spec.name)
        process = self.processes[spec.name] = Process()
        return process

    def settle(self, spec: ContainerSpec, pid: int) -> None:
        self.weights[pid] = spec.weight

    def release(self, container: str) -> None:
        pass

    def count_kills(self, _now: float) -> None:
        if fault := self.faults.get("kills"):
            raise fault

    def explain_kill(self, _now: float) -> str:
        return ""


class Adopted:
    """Nothing to adopt."""

    def __init__(self) -> None:
        self.adopted: list[str] = []
        self.watched: list[int] = []
        self.is_closed = False
        self.is_waiting = False

    def awaits(self, _container: str) -> bool:
        return False

    def is_settled(self) -> bool:
        return not self.is_waiting

    def watch(self, pid: int) -> bool:
        self.watched.append(pid)
        return True

    def moment(self) -> float:
        return float("inf")

    def give_up(self) -> None:
        pass

    def close(self) -> None:
        self.is_closed = True


class Disk:
    """A folder in memory."""

    def __init__(self) -> None:
        self.kept: AgentState | None = None
        self.removed: set[tuple[str, int]] = set()

    def keep(self, state: AgentState) -> None:
        self.kept = state

    def forget(self) -> None:
        self.kept = None

    def serve(self, _request: object, reply: Reply) -> None:
        reply(Accepted())

    def keep_only(self, wanted: Deployment) -> None:
        pass

    def remove_checkpoints(self, of: Collection[tuple[str, int]]) -> None:
        self.removed.update(of)

    def resend(self) -> None:
        pass

    def checkpoint_age(self, _component: str, _epoch: int) -> float | None:
        return None

    def trouble(self) -> str:
        return ""


class Waiting:
    """A standby that does nothing."""

    def keep(self, claim: Claim | None) -> None:
        pass

    def lead(self) -> None:
        pass


class World:
    """An agent and what it is in."""

    def __init__(
        self,
        left: AgentState | None = None,
        transport: type[Transport] | None = None,
        code: Versions | None = None,
    ) -> None:
        self.code = code
        self.clock = VirtualClock()
        self.asleep = 0.0
        self.transports: list[Transport] = []
        self.host, self.adoption, self.disk = Host(), Adopted(), Disk()
        self.adoption.is_waiting = transport is not None  # something was left
        self.statuses: list[AgentStatus] = []
        self.while_publishing: Callable[[], object] = lambda: None
        self.said: list[str] = []
        self.appeared_at: list[float] = []
        surroundings = Surroundings(
            clock=self.clock,
            wall=lambda: 1e9 + self.clock.now(),
            asleep=lambda: self.asleep,
            random=Random(1),
            say=self.said.append,
            publish=self._publish,
            appear=self._appear,
            wake=lambda: None,
            host=self.host,
            adoption=self.adoption,
            code=code,
            disk=self.disk,
            standby=Waiting(),
            heartbeats=partial(self._open, transport),
            usage=dict,
            cpu=lambda: 0.0,
            gateway="10.0.0.1:7000",
            trouble=str,
            pid=1,
            key="start",
        )
        setup = AgentSetup(robot="test", computer="main", address="10.0.0.1", folder="")
        self.core = AgentCore(setup, surroundings, left or AgentState())
        self._generation = 0

    def _open(
        self, transport: type[Transport] | None, hear: Hear, next_beat: NextBeat
    ) -> Transport | None:
        if transport is None:
            return None
        self.transports.append(transport(hear, next_beat))
        return self.transports[0]

    def _publish(self, status: AgentStatus) -> None:
        self.statuses.append(status)
        self.while_publishing()

    def _appear(self) -> None:
        self.appeared_at.append(self.clock.now())

    def ask(self, request: Any, token: int = 1) -> Any:
        """Return the one answer to a request; None: it was not answered yet."""
        answers: list[Any] = []
        self.core.on_request(
            ManagerRequest(token=token, request=request), answers.append
        )
        assert len(answers) <= 1
        return answers[0] if answers else None

    def deploy(self, *names: str) -> None:
        """Claim the agent, and let containers run; they report at once."""
        if not self._generation:
            assert isinstance(self.ask(Claim(MANAGER)), Claimed)
        self._generation += 1
        wanted = Deployment(generation=self._generation, containers=specs(*names))
        assert self.ask(wanted) == Accepted()
        self.core.tick()
        for pid, name in enumerate(self.host.processes, 100):
            self.core.on_born(name, pid)
            self.core.on_record(name, ContainerStatus(name=name, pid=pid))
        self.core.tick()

    def run(self, seconds: float) -> None:
        """Let time pass, and tick whenever the core wants to."""
        until = self.clock.now() + seconds
        for _ in range(1000):  # a core that wants to tick without end fails
            self.core.tick()
            moment = min(self.core.moment(), until)
            if moment >= until:
                break
            self.clock.sleep(max(0.0, moment - self.clock.now()))
        else:
            pytest.fail("the core ticks without end")
        self.clock.sleep(max(0.0, until - self.clock.now()))
        self.core.tick()

    @property
    def status(self) -> AgentStatus:
        return self.statuses[-1]

    def errors(self) -> Mapping[str, int]:
        return {error.where: error.count for error in self.status.errors}


def specs(*names: str) -> tuple[ContainerSpec, ...]:
    return tuple(
        ContainerSpec(name=name, folder="", components=(), connectors=())
        for name in names
    )


def raising(error: Exception) -> Callable[..., Any]:
    def fail(*_: object, **__: object) -> Any:
        raise error

    return fail


def test_a_container_that_ends_is_started_again_with_a_delay_that_grows() -> None:
    world = World()
    world.deploy("see")
    for num_starts in (2, 3):
        world.core.on_ended(100, EXIT_1)
        world.run(0.11)  # at once the first time, after 0.05 to 0.1 s the second time
        assert world.host.started == ["see"] * num_starts
        world.core.on_born("see", 100)
    assert [fault.container for fault in world.status.faults] == ["see", "see"]


def test_a_container_whose_priority_changed_has_another_weight_at_once() -> None:
    """The next manager may read another one in the robot file."""
    world = World()
    world.deploy("see")
    heavier = structs.replace(specs("see")[0], weight=1000)
    assert world.ask(Deployment(generation=2, containers=(heavier,)))
    world.core.tick()
    assert world.host.weights == {100: 1000}


def test_a_robot_that_starts_has_no_faults_of_the_one_that_was_stopped() -> None:
    world = World()
    world.deploy("see")
    world.core.on_ended(100, EXIT_1)
    world.run(1.0)
    world.core.on_born("see", 101)
    assert world.ask(Deployment(generation=2, containers=(), is_last=True))
    world.run(1.0)
    world.core.on_ended(101, EXIT_1)
    world.run(1.0)
    assert [each.state for each in world.status.health] == ["stopped"]
    assert world.ask(Deployment(generation=3, containers=specs("go")))
    world.run(1.0)
    assert [each.name for each in world.status.health] == ["go"]


def test_a_report_that_only_counts_on_waits_for_the_next_status() -> None:
    world = World()
    world.deploy("see")
    world.disk.kept = None  # each tick that looks at all keeps it again
    world.core.on_record("see", ContainerStatus(name="see", pid=100, cpu=1.5))
    assert world.core.moment() > world.clock.now()
    world.core.tick()
    assert world.disk.kept is None
    eye = ComponentStatus(name="eye", state="active")
    world.core.on_record("see", ContainerStatus(name="see", pid=100, components=(eye,)))
    assert world.core.moment() <= world.clock.now()
    world.core.tick()
    assert world.disk.kept is not None


def test_what_a_container_kept_while_it_ended_goes_with_it() -> None:
    world = World()
    world.deploy()
    eye = ComponentSpec(name="eye", epoch=3, goal="active")
    see = ContainerSpec(name="see", folder="", components=(eye,), connectors=())
    world.ask(Deployment(generation=2, containers=(see,)))
    world.core.tick()
    world.core.on_born("see", 100)
    world.core.on_ended(100, EXIT_1)  # it starts again, and goes on from there
    world.run(1.0)
    world.core.on_born("see", 101)
    world.ask(Deployment(generation=3, containers=()))
    world.core.tick()
    assert not world.disk.removed
    world.core.on_ended(101, EXIT_1)
    assert world.disk.removed == {("eye", 3)}


def test_what_a_container_said_before_it_ended_is_in_its_fault() -> None:
    world = World()
    world.deploy("see")
    world.core.on_record("see", ContainerFailure("its command ended"))
    world.core.on_record("see", ContainerStatus(name="see", pid=100, cpu=1.5))
    world.core.on_ended(100, EXIT_1)
    world.core.tick()
    (fault,) = world.status.faults
    assert fault.message == "ended with exit code 1; its command ended"
    assert world.status.cpu == 1.5


def test_an_error_in_what_concerns_one_container_stops_no_other() -> None:
    world = World()
    world.host.faults["bad"] = KeyError("bad")
    world.deploy("bad", "good")
    assert world.host.started == ["good"]
    assert "container 'bad'" in world.errors()
    assert "KeyError: 'bad'" in world.status.errors[0].text
    world.run(30.0)
    # 0, 0.1, 0.3, 0.7, 1.5, 3.1, 6.3, 11.3, 16.3, 21.3, 26.3 s: not at each tick
    assert world.errors()["container 'bad'"] <= 12
    world.host.faults.clear()
    world.run(5.0)
    assert world.host.started == ["good", "bad"]
    world.run(SHOWN_FOR)
    assert not world.errors()


@pytest.mark.parametrize(
    ("where", "owner", "name"),
    [
        ("lease", "fence", "update"),
        ("steps", "_pending", "give_up"),
        ("containers", "supervisor", "reconcile"),
        ("clocks", "supervisor", "send_clocks"),
    ],
)
def test_an_error_in_one_part_of_the_tick_stops_no_other(
    monkeypatch: pytest.MonkeyPatch, where: str, owner: str, name: str
) -> None:
    world = World()
    world.deploy("see")
    part = getattr(world.core, owner)
    monkeypatch.setattr(part, name, raising(ValueError("a bug")))
    # the table has the methods of some parts already
    world.core._parts = tuple(
        each._replace(act=getattr(part, name)) if each.name == where else each
        for each in world.core._parts
    )
    world.run(2.0)
    assert world.errors().keys() == {where}
    assert not world.host.processes["see"].signals
    assert world.disk.kept is not None
    assert world.disk.kept.wanted is not None
    num = len(world.statuses)
    world.run(2.0)
    assert len(world.statuses) > num


@pytest.mark.parametrize("name", ["keep", "trouble"])
def test_an_error_of_the_disks_code_is_shown(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    world = World()
    world.deploy("see")
    monkeypatch.setattr(world.disk, name, raising(ValueError("a bug")))
    world.run(2.0)
    assert "ValueError: a bug" in world.status.errors[0].text
    assert world.status.containers  # a status that cannot be made is the last one's


def test_a_request_that_fails_is_answered_and_the_next_one_is_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World()
    world.deploy("see")
    monkeypatch.setattr(world.disk, "keep_only", raising(ValueError("a bug")))
    refused = world.ask(Deployment(generation=5, containers=()))
    assert isinstance(refused, Refused)
    assert "a bug in Poise: ValueError('a bug')" in refused.reason
    world.core.tick()
    assert world.errors() == {"requests": 1}
    monkeypatch.undo()
    assert world.ask(Deployment(generation=6, containers=())) == Accepted()


def test_steps_for_a_container_that_does_not_run_are_answered_at_once() -> None:
    world = World()
    world.deploy()
    steps = MigrationSteps(number=3, migration=1, container="see", steps=(), limit=1.0)
    answer = world.ask(steps)
    assert isinstance(answer, StepsFailed)
    assert "does not run" in answer.reason


def test_without_starts_what_runs_goes_on_and_the_status_says_so() -> None:
    world = World()
    world.deploy("see", "act")
    world.core.on_no_more_starts("the zygote is gone")
    assert world.adoption.watched == [100, 101]
    world.host.faults["see"] = Unavailable("the zygote is gone")
    world.core.on_ended(100, "ended")
    world.run(20.0)
    assert "the zygote is gone" in world.status.trouble
    assert [each.name for each in world.status.containers] == ["act"]
    assert not world.host.processes["act"].signals
    world.deploy("see", "act", "new")  # the policy `cannot-start` goes by the reason
    reasons = {each.name: each.reason for each in world.status.health}
    why = "cannot be started: the zygote is gone"
    assert reasons == {"see": why, "act": "", "new": why}


def test_the_end_asks_first_and_kills_what_does_not_end() -> None:
    world = World()
    world.deploy("see", "act")
    world.core.end()
    world.core.tick()
    assert world.disk.kept is None
    assert world.adoption.is_closed
    world.core.on_ended(100, ProcessEnd(0))
    assert not world.core.has_ended()
    assert world.host.processes["act"].signals == [SIGTERM]
    world.run(2.1)  # it may take 2 s to end
    assert world.host.processes["act"].signals == [SIGTERM, SIGKILL]
    world.core.on_ended(101, ProcessEnd(9))
    assert world.core.has_ended()
    assert not world.status.faults


def test_a_container_that_ends_may_take_as_long_as_its_heart_beats() -> None:
    world = World()
    world.deploy("see")
    process = world.host.processes["see"]
    world.deploy()
    for _ in range(5):
        process.beats += 1
        world.run(1.5)
    assert process.signals == [SIGTERM]
    world.run(4.1)
    assert process.signals == [SIGTERM, SIGKILL]
    world.core.on_ended(100, ProcessEnd(9))
    world.run(0.6)
    (fault,) = world.status.faults
    assert fault.message == "was ended: it did not respond for 2 s"


def test_what_an_earlier_agent_wanted_is_started_without_a_manager() -> None:
    wanted = Deployment(generation=4, containers=specs("see"))
    world = World(AgentState(claim=Claim(MANAGER), token=2, wanted=wanted))
    world.run(0.1)
    assert world.host.started == ["see"]
    assert not world.appeared_at  # before its containers are known, up to 5 s
    world.run(5.0)
    assert world.appeared_at == [5.0]
    assert world.status.generation == 4
    assert world.status.token == 2


def leased_by(world: World, *, lapsed: bool) -> Process:
    """Let a container of an earlier agent be adopted, and return it."""
    process = Process()
    process.is_lapsed = lapsed
    assert world.core.on_orphan("see", 100, process)
    world.adoption.is_waiting = False
    return process


def other_agents() -> AgentState:
    agents = {"main": "tcp/10.0.0.1:7", "far": "tcp/10.0.0.2:7"}
    wanted = Deployment(generation=4, containers=specs("see"))
    return AgentState(claim=Claim(MANAGER, agents=agents), token=2, wanted=wanted)


class Transport:
    """A network on which nobody answers; a test says when a heartbeat is due."""

    def __init__(self, _hear: Hear, next_beat: NextBeat) -> None:
        self.beat = next_beat

    def start(self) -> None:
        pass

    def send_to(self, targets: Mapping[str, Address]) -> None:
        pass

    def close(self) -> None:
        pass


def test_containers_may_act_for_ever_where_no_other_computer_is() -> None:
    world = World()
    world.deploy("see")
    assert world.host.processes["see"].lease_end == inf


def test_each_heartbeat_extends_what_containers_may_do() -> None:
    world = World(other_agents(), Transport)
    process = leased_by(world, lapsed=False)
    for moment in (0.1, 5.0):
        world.clock.sleep(moment)
        world.transports[0].beat()
        assert process.lease_end == world.clock.now() + UNCUT_LEASE
    assert not world.core.fence.is_cut_off


def test_what_had_no_lease_any_more_when_it_was_adopted_gets_none() -> None:
    world = World(other_agents(), Transport)
    process = leased_by(world, lapsed=True)
    world.transports[0].beat()
    assert process.lease_end == -inf
    world.run(0.1)
    assert world.core.fence.cut_off == 1e9
    assert world.core.fence.token == 2  # its manager need not claim it again


@pytest.mark.parametrize("ended", [True, False])
def test_a_manager_that_may_be_only_cut_off_is_not_succeeded_without_a_pause(
    *, ended: bool
) -> None:
    """It may start elsewhere what runs here, until the next one says what runs."""
    world = World()
    world.ask(Claim(MANAGER), 1)
    world.core.fence.note_liveliness(MANAGER.key, is_there=False, has_ended=ended)
    answer = world.ask(Claim(structs.replace(MANAGER, key="later")), 2)
    assert world.core.fence.is_cut_off is not ended
    assert answer == Claimed(is_cut_off=not ended)


def test_a_manager_that_arrives_while_a_status_goes_out_gets_another_one() -> None:
    """Of the one that is under way it may hear nothing."""
    world = World()
    world.run(0.1)
    told = len(world.statuses)

    arrive = partial(
        world.core.fence.note_liveliness, "k", is_there=True, has_ended=False
    )
    world.while_publishing = arrive
    arrive()
    world.core.tick()
    world.while_publishing = lambda: None
    world.core.tick()
    assert len(world.statuses) == told + 2


def test_where_no_container_was_left_nothing_leased_runs_before_it_is_told() -> None:
    """What the agent kept may run elsewhere by now."""
    world = World(other_agents())
    world.run(0.1)
    assert world.core.fence.is_cut_off
    assert world.core.supervisor.is_cut_off


@pytest.mark.parametrize("containers", [(), ("see",)])
def test_a_container_that_goes_on_is_told_nothing_that_is_on_the_disk(
    containers: tuple[str, ...],
) -> None:
    """The disk may be late: its component may have moved away, or just come."""
    eye = ComponentSpec(name="eye", epoch=3, goal="active", leased=True)
    see = [structs.replace(spec, components=(eye,)) for spec in specs("see")]
    left = tuple(spec for spec in see if spec.name in containers)
    wanted = Deployment(generation=4, containers=left)
    world = World(structs.replace(other_agents(), wanted=wanted), Transport)
    process = leased_by(world, lapsed=False)
    seen = ComponentStatus(name="eye", epoch=3, state="active")
    world.core.on_record(
        "see", ContainerStatus(name="see", pid=100, components=(seen,))
    )
    world.run(0.1)
    assert not process.sent
    assert world.core.supervisor.processes["see"].is_stopping is False
    deployment = Deployment(generation=5, containers=tuple(see))
    assert world.ask(deployment, 2) == Accepted()
    world.run(0.1)
    (told,) = process.sent
    assert isinstance(told, ContainerSpec)


def test_a_computer_that_was_suspended_has_no_lease() -> None:
    world = World(other_agents(), Transport)
    process = leased_by(world, lapsed=False)
    world.asleep = 60.0
    world.transports[0].beat()
    assert process.lease_end == -inf


def test_a_container_whose_code_goes_on_without_lease_is_killed() -> None:
    world = World(other_agents(), Transport)
    arm = ComponentSpec(name="arm", goal="active", leased=True)
    wanted = ContainerSpec(name="see", folder="", components=(arm,), connectors=())
    world.core.supervisor.deploy(Deployment(generation=5, containers=(wanted,)))
    process = leased_by(world, lapsed=True)
    world.run(0.1)
    at_work = ComponentStatus(name="arm", state="active")
    status = ContainerStatus(
        name="see", pid=100, at=world.clock.now(), components=(at_work,)
    )
    world.core.on_record("see", status)
    world.run(FENCE_GRACE - 0.2)
    assert process.signals == []
    world.run(0.2)
    assert process.signals == [SIGKILL]
    world.core.on_ended(100, ProcessEnd(9))
    world.core.tick()
    (fault,) = world.status.faults
    assert "'arm' still ran 0.5 s after the computer's lease ended" in fault.message


class Versions:
    """The code on a computer, in memory."""

    def __init__(self) -> None:
        self.there: tuple[str, ...] = ()
        self.kept: tuple[str, ...] = ()

    def versions(self) -> tuple[str, ...]:
        return self.there

    def keep(self, in_use: Collection[str]) -> None:
        self.kept = tuple(in_use)

    def serve(self, request: CodePart | InstallCode, reply: Reply) -> None:
        assert isinstance(request, InstallCode)
        self.there = (request.version, *self.there)
        reply(Accepted())


def test_code_comes_without_a_token_and_only_then_its_containers_run() -> None:
    world = World(code=Versions())
    assert isinstance(world.ask(Claim(MANAGER)), Claimed)
    container = structs.replace(specs("see")[0], code="a" * 64)
    wanted = Deployment(generation=1, containers=(container,), code=("a" * 64,))
    refused = world.ask(wanted)
    assert isinstance(refused, Refused)
    assert "does not have version aaaaaaaaaaaa" in refused.reason
    assert world.ask(InstallCode("a" * 64), token=0) == Accepted()
    world.core.tick()
    assert world.status.code == ("a" * 64,)
    assert world.ask(wanted) == Accepted()
    assert world.code is not None
    assert world.code.kept == ("a" * 64,)


def test_an_agent_without_a_place_for_code_takes_none() -> None:
    answer = World().ask(InstallCode("a" * 64))
    assert answer == Refused("it runs no components, and takes no code")
