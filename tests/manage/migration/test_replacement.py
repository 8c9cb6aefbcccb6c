"""A whole architecture is replaced by its alternative, or goes on, by real agents."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.move import plan_alternative, plan_replacement
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Layer,
    Robot,
)
from tests.manage.agents import TELLING, Told, TwoAgents, two_agents

pytestmark = pytest.mark.slow

LIMIT = 20.0
CODE = (
    TELLING
    + '''
class Sink(Telling):
    """Counts the sums that are not those of all numbers so far."""

    def configure(self):
        super().configure()
        self.last = self.wrong = 0

    @subscribed(block=100)
    def sums(self, message: Number):
        self.last += 1
        self.wrong += message.value != self.last * (self.last + 1) // 2
        self.tell(self.last, self.wrong)

class Count(Message):
    count: int

class Sum(Message):
    sum: int

class Counter(Component):
    """The first half of one alternative: counts, and passes on."""

    passed: Published[Number]
    doubles: Provided[Doubles]
    helps: Required[Doubles]
    state = Count(0)

    def double(self, value: int) -> int:
        return self.helps.double(value)

    @subscribed(block=100)
    def numbers(self, message: Number):
        self.state = Count(self.state.count + 1)
        self.passed.publish(message)

    def snapshot(self) -> Count:
        return self.state

class Remembering(Counter):
    def restore(self, state: Count) -> None:
        self.state = state

class Total(Message):
    total: int

class Renamed(Counter):
    """Its state has one number, too, and means another thing."""

    def restore(self, state: Total) -> None:
        self.state = Count(state.total)

def renamed(state: Count) -> Total:
    return Total(state.count)

class Adder(Component):
    """The second half: adds up."""

    doubles: Provided[Doubles]
    sums: Published[Number]
    state = Sum(0)

    def double(self, value: int) -> int:
        return 2 * value

    @subscribed(block=100)
    def passed(self, message: Number):
        self.state = Sum(self.state.sum + message.value)
        self.sums.publish(Number(self.state.sum))

    def snapshot(self) -> Sum:
        return self.state

class Both(Message):
    count: int
    sum: int

class Whole(Component):
    """The alternative: does both."""

    sums: Published[Number]
    doubles: Provided[Doubles]

    def double(self, value: int) -> int:
        return value + value

    @subscribed(block=100)
    def numbers(self, message: Number):
        count, total = self.state.count + 1, self.state.sum + message.value
        self.state = Both(count, total)
        self.sums.publish(Number(total))

    def restore(self, state: Both) -> None:
        self.state = state

class Broken(Whole):
    def restore(self, state: Both) -> None:
        raise LookupError("no such sum")

class Idle(Component):
    """Is there to be part of an alternative that fails."""

class Before(Message):
    counter: Count
    adder: Sum

class After(Message):
    whole: Both

def adapt(before: Before) -> After:
    return After(Both(before.counter.count, before.adder.sum))

class Strange(Message):
    stranger: Count

def elsewhere(before: Strange) -> After:
    return After(Both(before.stranger.count, 0))

class Broke(Message):
    broken: Both

def misadapt(before: Before) -> Broke:
    return Broke(Both(before.counter.count, before.adder.sum))
'''
)


class RobotWithAlternatives(Told):
    """Two agents, and a robot with alternatives for what is between its ends."""

    def __init__(self, folder: Path, agents: Agents, place: Path) -> None:
        super().__init__(place)
        self.journal = Journal(":memory:")
        placement = dict.fromkeys(("source", "sink", "counter"), "left")
        placement["adder"] = "right"
        robot = _robot(folder, place)
        self.run = LiveRobot(robot, placement, agents, self.journal, str(folder))

    def active(self) -> set[str]:
        """Return what is active, by what was said last."""
        return {
            component.name
            for component in components_of(self.run.current())
            if component.state == "active"
        }


def _robot(folder: Path, place: Path) -> Robot:
    def architecture(
        name: str, function: str, *components: str, layer: Layer = "sequencing"
    ) -> Architecture:
        return Architecture(
            name=name,
            function=function,
            layer=layer,
            home="left",
            components=tuple(
                ComponentEntry(
                    name=each,
                    implementation=f"replaced:{each.title()}",
                    parameters={"folder": str(place)},
                )
                for each in components
            ),
        )

    joints = ["source.numbers counter.numbers", "source.doubles counter.doubles"]
    joints += ["counter.passed adder.passed", "counter.helps adder.doubles"]
    joints += ["adder.sums sink.sums"]
    for name in ("whole", "broken"):
        joints += [f"source.numbers {name}.numbers", f"source.doubles {name}.doubles"]
        joints += [f"{name}.sums sink.sums"]
    connectors = []
    for joint in joints:
        first, second = (ConnectorEnd(*end.split(".")) for end in joint.split())
        connectors.append(Connector(between=(first, second), limit=3.0))
    capacity = {"cpu": 1.0, "memory": 1e9}
    return Robot(
        name="replaces",
        folder=str(folder),
        computers=tuple(Computer(name=n, capacity=capacity) for n in ("left", "right")),
        architectures=(
            architecture("ends", "ends", "source", "sink", layer="reactive"),
            architecture("halves", "adding", "counter", "adder"),
            architecture("one", "adding", "whole"),
            architecture("bad", "adding", "broken", "idle"),
            architecture("deaf", "adding", "silent"),
            architecture("reflex", "ends", "reacting", layer="reactive"),
        ),
        connectors=tuple(connectors),
    )


@pytest.fixture(scope="module")
def pair() -> Iterator[TwoAgents]:
    """Start both agents."""
    with two_agents(f"replaces{os.getpid()}", "replaced", CODE) as found:
        yield found


@pytest.fixture
def world(pair: TwoAgents, tmp_path: Path) -> Iterator[RobotWithAlternatives]:
    """Start the robot."""
    world = RobotWithAlternatives(pair.folder, pair.agents, tmp_path)
    world.run.start()
    world.works()
    yield world
    stop(world.run)
    world.journal.close()


def test_the_alternative_goes_on_where_the_architecture_stopped(
    world: RobotWithAlternatives,
) -> None:
    report = plan_alternative(world.run, "halves", "one", "replaced:adapt").run()
    assert (report.committed, report.reason) == (True, "")
    assert set(world.run.placement()) == {"source", "sink", "whole"}
    world.works()
    assert world.wrong() == 0
    world.run.agents.wait_news(
        lambda: world.active() == {"source", "sink", "whole"}, LIMIT
    )
    assert world.active() == {"source", "sink", "whole"}


def test_all_goes_on_as_before_when_one_component_cannot_restore(
    world: RobotWithAlternatives,
) -> None:
    report = plan_alternative(world.run, "halves", "bad", "replaced:misadapt").run()
    assert not report.committed
    assert "LookupError: no such sum" in report.reason
    assert set(world.run.placement()) == {"source", "sink", "counter", "adder"}
    world.works()
    assert world.wrong() == 0
    before = {"source", "sink", "counter", "adder"}
    world.run.agents.wait_news(lambda: world.active() == before, LIMIT)
    assert world.active() == before


def test_a_state_is_matched_by_the_names_of_its_fields(
    world: RobotWithAlternatives,
) -> None:
    for by, adapt, words in (
        ("Counter", "", "Counter has no `restore`, so the state would be lost"),
        ("Renamed", "", "is (count: int), but Renamed.restore takes"),
        ("Renamed", "replaced:adapt", "but Renamed.restore takes (total: int)"),
    ):
        report = plan_replacement(world.run, "counter", f"replaced:{by}", adapt).run()
        assert not report.committed
        assert words in report.reason
        world.works()
    for by, adapt, fresh in (
        ("Remembering", "", False),
        ("Renamed", "replaced:renamed", False),
        ("Counter", "", True),
    ):
        report = plan_replacement(
            world.run, "counter", f"replaced:{by}", adapt, fresh=fresh
        ).run()
        assert report.committed, report.reason
        world.works()
    assert world.wrong() == 0


def test_no_state_of_an_architecture_is_lost_unsaid(
    world: RobotWithAlternatives,
) -> None:
    words = r"'adder' and 'counter' would be lost: .*--fresh"
    with pytest.raises(UsageError, match=words):
        plan_alternative(world.run, "halves", "one").run()
    report = plan_alternative(world.run, "halves", "one", "replaced:misadapt").run()
    assert "--adapt makes no state for 'whole', only for broken" in report.reason
    report = plan_alternative(world.run, "halves", "one", "replaced:elsewhere").run()
    assert "--adapt takes the state of 'stranger', which is not" in report.reason
    assert world.run.placement().keys() >= {"counter", "adder"}
    assert plan_alternative(world.run, "halves", "bad", fresh=True).run().committed


def test_refuses_before_anything_is_touched(world: RobotWithAlternatives) -> None:
    for name, by, words in (
        ("none", "one", "has no architecture 'none'"),
        ("one", "halves", "architecture 'one' does not run"),
        ("halves", "halves", "runs already"),
        ("halves", "ends", "provides 'ends', not 'adding'"),
        ("ends", "reflex", "'ends' is in the reactive layer, which stays as it is"),
        ("halves", "deaf", "'source.doubles' calls 'counter.doubles', and is joined"),
    ):
        with pytest.raises(UsageError, match=words):
            plan_alternative(world.run, name, by).run()
    report = plan_alternative(world.run, "halves", "one", "replaced:nothing").run()
    assert "has no" in report.reason
    assert report.downtime == 0.0
    world.works()
