"""A small robot of three computers, whose work can run on each of them."""

from __future__ import annotations

import pytest

from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Link,
    Robot,
    Task,
)
from poise.simulation.choices import Choices
from poise.simulation.scheduler import Scheduler
from poise.wire.records.request_records import Election
from tests.simulation.simulated_run import Scenario


@pytest.fixture
def scheduler() -> Scheduler:
    """Return virtual time that begins at 0."""
    return Scheduler(Choices(1))


@pytest.fixture
def scenario() -> Scenario:
    """Return a robot that sees on a and b, thinks on b and acts on c."""
    return small_scenario()


def small_scenario(seconds: float = 10.0, *, elects: bool = False) -> Scenario:
    """Return the robot of the fixture `scenario`, for other interpreters, too."""
    computers = tuple(
        Computer(name=name, capacity={"cpu": 2.0, "memory": 1e9}) for name in "abc"
    )
    robot = Robot(
        name="small",
        folder="/robot",
        computers=computers,
        # over which messages are on their way while something moves
        links=(Link(between=("a", "c"), latency=0.01),),
        architectures=(
            Architecture(
                name="see",
                function="seeing",
                components=(_component("camera"), _component("filter")),
                connectors=(joined("camera.out", "filter.raw"),),
            ),
            Architecture(
                name="think", function="thinking", components=(_component("mind"),)
            ),
            Architecture(
                name="act", function="acting", components=(_component("arm"),)
            ),
        ),
        connectors=(joined("filter.out", "mind.seen"), joined("mind.out", "arm.to")),
        tasks=(
            Task(
                name="work",
                actions=(
                    Action(name="go", functions=("seeing", "thinking", "acting")),
                ),
            ),
        ),
    )
    placement = {"camera": "a", "filter": "b", "mind": "b", "arm": "c"}
    election = Election(votes=dict.fromkeys("abc", 1), managers=("a", "b", "c"))
    return Scenario(
        robot=robot,
        placement=placement,
        tasks=("work",),
        seconds=seconds,
        election=election if elects else None,
    )


def _component(name: str) -> ComponentEntry:
    return ComponentEntry(
        name=name, implementation=f"small:{name}", demand={"cpu": 0.2, "memory": 1e6}
    )


def joined(source: str, target: str) -> Connector:
    ends = (ConnectorEnd(*end.split(".")) for end in (source, target))
    return Connector(between=(next(ends), next(ends)))
