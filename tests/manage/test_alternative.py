"""A whole architecture is replaced by its alternative, or goes on, by real agents."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.clock import SystemClock
from poise.errors import UsageError
from poise.manage.alternative import replace_architecture
from poise.manage.fleet import Fleet
from poise.manage.journal import Journal
from poise.manage.run import Run, components_of
from poise.model.robot import (
    Architecture,
    Component,
    Computer,
    Connector,
    End,
    Robot,
)
from tests.manage.agents import agent
from tests.runtime.conftest import free_port, wait_until

pytestmark = pytest.mark.slow

LIMIT = 20.0
CODE = '''
import os
from typing import Protocol
from poise import Component, Message, Provided, Published, Required, every, subscribed
from poise.errors import CallError

class Number(Message):
    value: int

class Doubles(Protocol):
    def double(self, value: int) -> int: ...

class Telling(Component):
    """Writes numbers where the test reads them at once."""

    def configure(self):
        path = os.path.join(self.parameters["folder"], self.name)
        self.file = os.open(path, os.O_CREAT | os.O_WRONLY)

    def tell(self, *numbers):
        os.pwrite(self.file, b"".join(b"%10d" % n for n in numbers), 0)

class Source(Telling):
    numbers: Published[Number]
    doubles: Required[Doubles]

    def configure(self):
        super().configure()
        self.sent = self.answered = self.refused = 0

    @every(0.005)
    def produce(self):
        self.sent += 1
        self.numbers.publish(Number(self.sent))
        try:
            self.answered += self.doubles.double(self.sent) == 2 * self.sent
        except CallError:
            self.refused += 1
        self.tell(self.answered, self.refused)

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

class Broke(Message):
    broken: Both

def misadapt(before: Before) -> Broke:
    return Broke(Both(before.counter.count, before.adder.sum))
'''


class World:
    """Two agents, and a robot with alternatives for what is between its ends."""

    def __init__(self, folder: Path, fleet: Fleet) -> None:
        self.folder = folder
        self.journal = Journal(":memory:")
        placement = dict.fromkeys(("source", "sink", "counter"), "left")
        placement["adder"] = "right"
        robot = _robot(folder)
        self.run = Run(robot, placement, fleet, self.journal, str(folder))

    def told(self, component: str) -> tuple[int, int]:
        """Return what a component tells: progress, and what went wrong."""
        with contextlib.suppress(FileNotFoundError):
            said = (self.folder / component).read_bytes()
            if said:
                return int(said[:10]), int(said[10:])
        return 0, 0

    def works(self) -> None:
        """Wait until sums come, and calls are answered."""
        for component in ("sink", "source"):
            before = self.told(component)[0]
            wait_until(lambda b=before, c=component: self.told(c)[0] not in {0, b})  # type: ignore[misc]

    def active(self) -> set[str]:
        """Return what is active, by what was said last."""
        return {
            component.name
            for component in components_of(self.run.current())
            if component.state == "active"
        }


def _robot(folder: Path) -> Robot:
    def architecture(name: str, function: str, *components: str) -> Architecture:
        return Architecture(
            name=name,
            function=function,
            components=tuple(
                Component(
                    name=each,
                    implementation=f"replaced:{each.title()}",
                    parameters={"folder": str(folder)},
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
        first, second = (End(*end.split(".")) for end in joint.split())
        connectors.append(Connector(between=(first, second), limit=3.0))
    capacity = {"cpu": 1.0, "memory": 1e9}
    return Robot(
        name="replaces",
        folder=str(folder),
        computers=tuple(Computer(name=n, capacity=capacity) for n in ("left", "right")),
        architectures=(
            architecture("ends", "ends", "source", "sink"),
            architecture("halves", "adding", "counter", "adder"),
            architecture("one", "adding", "whole"),
            architecture("bad", "adding", "broken", "idle"),
            architecture("deaf", "adding", "silent"),
        ),
        connectors=tuple(connectors),
    )


@pytest.fixture
def world() -> Iterator[World]:
    """Start both agents and the robot."""
    robot = f"replaces{os.getpid()}"
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / "replaced.py").write_text(CODE)
        ports = {"left": free_port(), "right": free_port()}
        lifeline, held = os.pipe()
        for name in ports:
            stack.enter_context(agent(robot, name, ports, folder, lifeline))
        stack.callback(os.close, held)
        stack.callback(os.close, lifeline)
        ends = {name: f"tcp/127.0.0.1:{port}" for name, port in ports.items()}
        fleet = stack.enter_context(Fleet(robot, ends, SystemClock()))
        fleet.wait_alive(ports, LIMIT)
        world = World(folder, fleet)
        stack.callback(world.journal.close)
        world.run.start()
        world.works()
        yield world
        world.run.stop()


def test_the_alternative_goes_on_where_the_architecture_stopped(world: World) -> None:
    report = replace_architecture(world.run, "halves", "one", "replaced:adapt")
    assert (report.committed, report.reason) == (True, "")
    assert set(world.run.placement()) == {"source", "sink", "whole"}
    world.works()
    assert (world.told("sink")[1], world.told("source")[1]) == (0, 0)
    world.run.fleet.wait_news(
        lambda: world.active() == {"source", "sink", "whole"}, LIMIT
    )
    assert world.active() == {"source", "sink", "whole"}


def test_all_goes_on_as_before_when_one_component_cannot_restore(world: World) -> None:
    report = replace_architecture(world.run, "halves", "bad", "replaced:misadapt")
    assert not report.committed
    assert "LookupError: no such sum" in report.reason
    assert set(world.run.placement()) == {"source", "sink", "counter", "adder"}
    world.works()
    assert (world.told("sink")[1], world.told("source")[1]) == (0, 0)
    before = {"source", "sink", "counter", "adder"}
    world.run.fleet.wait_news(lambda: world.active() == before, LIMIT)
    assert world.active() == before


def test_refuses_before_anything_is_touched(world: World) -> None:
    for name, by, words in (
        ("none", "one", "has no architecture 'none'"),
        ("one", "halves", "architecture 'one' does not run"),
        ("halves", "halves", "runs already"),
        ("halves", "ends", "provides 'ends', not 'adding'"),
        ("halves", "deaf", "'source.doubles' calls 'counter.doubles', and is joined"),
    ):
        with pytest.raises(UsageError, match=words):
            replace_architecture(world.run, name, by)
    report = replace_architecture(world.run, "halves", "one", "replaced:nothing")
    assert "has no" in report.reason
    assert report.gate_shut == 0.0
    world.works()
