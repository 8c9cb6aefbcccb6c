"""What managers obtain from the agents of a simulated robot, over links that break."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from poise.clock import SystemClock
from poise.errors import AlreadyManaged, RunError
from poise.manage.agent_connections.agents import Agents
from poise.simulation.choices import Choices
from poise.simulation.robot.simulated_process import Process
from poise.simulation.robot.simulated_robot import ManagedRobot, SimulatedRobot
from poise.simulation.workload import SimulatedWork
from poise.wire.records.deployment_records import (
    ComponentSpec,
    ContainerSpec,
    Deployment,
)
from poise.wire.records.migration_records import MigrationSteps
from tests.simulation.conftest import small_scenario

EVERYONE = frozenset("abc")
MIND = ComponentSpec(name="mind", goal="inactive", implementation="small:mind")
EYE = ContainerSpec(name="eye", folder="/", components=(MIND,), connectors=())
RUNNING = Deployment(generation=7, containers=(EYE,))
LONGEST = 60.0
now, sleep = SystemClock().now, SystemClock().sleep


class World:
    """The agents of `a`, `b` and `c`, and managers that do what a test says."""

    def __init__(self, *, elects: bool = False) -> None:
        small = small_scenario(elects=elects)
        self.election = small.election
        managed = ManagedRobot(robot=small.robot, placement={}, tasks=())
        self.robot = SimulatedRobot(managed, Choices(1), SimulatedWork())
        for name in EVERYONE:
            self.robot.start_agent(name)

    def start(
        self, work: Callable[[Agents], object], at: str = "a"
    ) -> tuple[Process, list[Any]]:
        """Start a manager; what `work` returns is in the list once it has."""
        process = self.robot.computers[at].start("manager")
        done: list[Any] = []

        def main() -> None:
            with Agents(
                self.robot.robot.name,
                self.robot.endpoints,
                SystemClock(),
                datagrams=self.robot.datagrams_of(process, None),
                election=self.election,
            ) as agents:
                agents.wait_news(lambda: agents.reached() >= EVERYONE, 1.0)
                done.append(work(agents))

        process.spawn("manager", main)
        return process, done

    def run(self, work: Callable[[Agents], object], at: str = "a") -> Any:
        """Return what `work` returns, as a manager on a computer."""
        _, done = self.start(work, at)
        while not done and self.robot.scheduler.now < LONGEST:
            self.pass_time(0.1)
        (result,) = done
        return result

    def pass_time(self, seconds: float) -> None:
        with self.robot.library:
            self.robot.run(self.robot.scheduler.now + seconds)

    def isolate(self, computer: str, seconds: float = LONGEST) -> None:
        network, scheduler = self.robot.network, self.robot.scheduler
        for other in self.robot.others_than(computer):
            for way in ((computer, other), (other, computer)):
                network.cut(*way)
                scheduler.at(scheduler.now + seconds, partial(network.heal, *way))

    def deafen(self, computer: str) -> None:
        """Let an agent answer nothing, though its heartbeats go on."""
        core: Any = self.robot.agents[computer].core
        core.on_request = lambda *_: None

    def managers(self) -> set[str]:
        """Return the keys of the managers that agents obey."""
        fences = [agent.core.fence for agent in self.robot.agents.values()]
        return {fence.manager.key if fence.manager else "" for fence in fences}


@pytest.fixture
def world() -> Iterator[World]:
    yield from ending(World())


@pytest.fixture
def voting() -> Iterator[World]:
    yield from ending(World(elects=True))


def ending(world: World) -> Iterator[World]:
    yield world
    with world.robot.library:
        world.robot.end()


def leading(agents: Agents) -> None:
    """Lead a robot that is at work on `b`, for a minute."""
    if agents.election:
        agents.elect()
    else:
        agents.claim(EVERYONE)
    agents.begin_deploy("b", RUNNING)
    sleep(LONGEST)


def refused(how: Callable[[], object]) -> tuple[type, str, float]:
    """Return what `how` raised, and how long that took [s]."""
    began = now()
    with pytest.raises(RunError) as caught:
        how()
    return caught.type, str(caught.value), now() - began


def test_who_comes_second_gets_no_agent_before_the_first_has_ended(
    world: World,
) -> None:
    """Over a link that is cut agents know of an end once their session timed out."""
    process, _ = world.start(leading)
    world.pass_time(2.0)
    (key,) = world.managers()

    def claim(agents: Agents) -> object:
        agents.wait_news(lambda: agents.reached() >= EVERYONE, 2.0)
        return refused(lambda: agents.claim("c"))

    first = world.run(claim, "b")
    assert world.managers() == {key}
    world.isolate("c", 0.5)
    process.kill()
    world.pass_time(0.5)
    _, then = world.start(claim, "b")
    # on its own computer it is known to have ended, so the agent is waited for
    assert world.run(lambda agents: agents.claim("c") == {} and agents.obey("c"))
    for kind, said, took in (first, *then):
        assert kind is AlreadyManaged
        assert "the agent of 'c' refused: robot 'small' is managed by user" in said
        assert took < 0.1
    assert len(then) == 1


def test_steps_end_with_what_each_agent_said_or_why_it_said_nothing(
    world: World,
) -> None:
    """One that does not answer keeps none waiting for longer than the limit."""

    def move(agents: Agents) -> object:
        agents.claim(EVERYONE)
        world.deafen("b")
        world.robot.agents["c"].process.kill()
        began = now()
        asked = [
            (name, MigrationSteps(number, 1, "eye", steps=(), limit=0.4))
            for number, name in enumerate("abc")
        ]
        said: Any = agents.send_steps(asked)
        return {each.number: (each.reason, now() - began) for each in said}

    said = world.run(move)
    assert said[0] == ("container 'eye' does not run", pytest.approx(0.0, abs=0.1))
    late = pytest.approx(0.5, abs=0.1)
    assert said[1] == ("the agent of 'b' did not answer within 0.5 s", late)
    assert said[2][0] == "the agent of 'c' is out of reach"


def test_what_a_lost_computer_ran_may_start_elsewhere_once_its_lease_has_ended(
    world: World,
) -> None:
    """From then on it has to be claimed again, for it was told nothing of that."""

    def lose(agents: Agents) -> object:
        agents.claim(EVERYONE)
        sleep(1.0)
        world.isolate("c", 1.5)
        agents.wait_news(lambda: "c" in agents.out_of_reach(), 1.0)
        states = [agents.obey("c"), agents.revoke("c")]
        sleep(0.8)
        states.append(agents.revoke("c"))
        sleep(2.0)
        assert "c" in agents.reached()
        states.append(agents.obey("c"))
        reply = agents.begin_claim("c")
        agents.wait_news(lambda: reply.is_done, 2.0)
        agents.end_claim("c", reply)
        agents.wait_news(lambda: agents.obey("c"), 2.0)
        return [*states, agents.obey("c")]

    assert world.run(lose) == [False, False, True, False, True]


def awaited(agents: Agents) -> tuple[bool, set[str], float]:
    """Return whether the robot was at work, who is missing, and how long it took."""
    began = now()
    at_work = agents.wait_at_work(2.0)
    return at_work, set(agents.out_of_reach()), now() - began


def test_who_is_missing_is_lost_only_where_components_run(world: World) -> None:
    """Else it may be about to start for the first time."""
    world.isolate("c", 4.0)
    assert world.run(awaited) == (False, set(), pytest.approx(2.0, abs=0.1))
    world.pass_time(2.0)
    world.start(leading)
    world.pass_time(1.0)
    assert world.run(awaited) == (True, set(), pytest.approx(0.0, abs=0.1))
    world.isolate("c")
    assert world.run(awaited) == (True, {"c"}, pytest.approx(2.0, abs=0.1))


def test_a_majority_makes_a_leader_and_stores_what_it_commits(voting: World) -> None:
    def lead(agents: Agents) -> object:
        voters = agents.elect()
        assert agents.heartbeats.leads()
        stored = []
        for name in "ab":
            agents.begin_deploy(name, RUNNING)
            sleep(0.2)
            stored.append(agents.has_stored(7))
        return voters.keys(), set(filter(agents.obey, EVERYONE)), stored

    voting.isolate("c")
    assert voting.run(lead) == ({"a", "b"}, {"a", "b"}, [False, True])


def test_without_a_majority_nothing_changes_and_the_missing_are_named(
    voting: World,
) -> None:
    voting.isolate("b")
    voting.isolate("c")
    kind, said, took = voting.run(lambda agents: refused(agents.elect))
    assert (kind, said) == (RunError, "no majority of votes: not reached: b, c")
    assert took == pytest.approx(1.0, abs=0.2)
    assert voting.managers() == {""}


def test_voters_that_do_not_answer_are_named_beside_those_out_of_reach(
    voting: World,
) -> None:
    def lead(agents: Agents) -> object:
        voting.deafen("b")
        return refused(agents.elect)[1]

    voting.isolate("c")
    said = "no majority of votes: no answer: b; not reached: c"
    assert voting.run(lead) == said


def test_a_leader_that_is_cut_off_ends_and_follows_the_next_one(voting: World) -> None:
    def first(agents: Agents) -> object:
        agents.elect()
        sleep(1.0)
        well = agents.why_not_leading()
        agents.wait_news(lambda: agents.successor() is not None, LONGEST)
        return well, agents.why_not_leading(), agents.successor()

    def second(agents: Agents) -> object:
        kind, said, _ = refused(agents.elect)
        assert kind is AlreadyManaged
        assert said.startswith("no majority of votes: robot 'small' is managed by")
        voting.isolate("a", 4.0)
        sleep(0.5)
        agents.elect()
        sleep(5.0)
        assert agents.manager.term == 2
        return agents.manager

    _, done = voting.start(first)
    voting.pass_time(3.0)
    later = voting.run(second, "b")
    assert done == [("", "no majority of agents has heard it for 2 s", later)]
