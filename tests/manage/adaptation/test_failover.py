"""Where components of lost computers go on."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator, Mapping

import pytest
from msgspec.structs import replace

from poise.manage.adaptation.placement_responders import plan_failover
from poise.manage.adaptation.situation import Situation
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Device,
    Link,
    Robot,
    Task,
)
from tests.manage.adaptation.conftest import Make

APART = {"a": "left", "b": "right"}


def with_first(robot: Robot, **fields: object) -> Robot:
    (architecture,) = robot.architectures
    first, *others = architecture.components
    changed = replace(first, **fields)
    whole = replace(architecture, components=(changed, *others))
    return replace(robot, architectures=(whole,))


def test_what_may_run_elsewhere_begins_again_there(situation: Make, two: Robot) -> None:
    linked = replace(two, links=(Link(between=("left", "right")),))
    found = plan_failover(situation(APART, robot=linked), {"left"})
    assert found.placement == {"a": "right"}
    assert not found.missing


def test_nothing_begins_again_where_the_manager_reaches_nothing(
    situation: Make,
) -> None:
    seen = replace(situation(APART), away=frozenset({"left", "right"}))
    found = plan_failover(seen, {"left"})
    assert found.placement == {}
    assert found.missing.keys() == {"a"}


def test_nothing_moves_when_nothing_ran_there(situation: Make) -> None:
    found = plan_failover(situation({"a": "left", "b": "left"}), {"right"})
    assert found.placement == {}
    assert found.missing == {}


def test_what_its_device_holds_there_is_missing(situation: Make, two: Robot) -> None:
    robot = replace(
        with_first(two, devices=("laser",)),
        devices=(Device(name="laser", computer="left"),),
    )
    found = plan_failover(situation(APART, robot=robot), {"left"})
    assert found.placement == {}
    assert found.missing == {"a": "it may run on left only"}


def test_what_may_not_move_is_missing(situation: Make, two: Robot) -> None:
    robot = with_first(two, movable=False)
    found = plan_failover(situation(APART, robot=robot), {"left"})
    assert found.missing == {"a": "it is not movable (robot file)"}


def test_what_is_short_of_cpu_runs_with_what_there_is(situation: Make) -> None:
    found = plan_failover(situation(APART, background={"right": 0.2}), {"left"})
    assert found.placement == {"a": "right"}
    assert not found.missing


def test_what_does_not_fit_beside_the_others_is_missing(
    situation: Make, two: Robot
) -> None:
    robot = with_memory(two, {"left": 9, "right": 9}, {"a": 5, "b": 5})
    found = plan_failover(situation(APART, robot=robot), {"left"})
    assert found.placement == {}
    assert found.missing["a"].startswith(
        "it fits nowhere beside the running components: "
    )


def test_what_works_moves_when_only_that_makes_room(
    situation: Make, two: Robot
) -> None:
    """Only `right` has the memory for `a`, and `b` may run on `small`, too."""
    (left, right) = two.computers
    robot = replace(two, computers=(left, right, replace(right, name="small")))
    robot = with_memory(robot, {"left": 9, "right": 9, "small": 5}, {"a": 8, "b": 5})
    found = plan_failover(situation(APART, robot=robot), {"left"})
    assert found.placement == {"a": "right"}
    assert [(s.component, s.target) for s in found.steps] == [("b", "small")]
    assert not found.missing


def test_what_cannot_move_now_makes_no_room(situation: Make, two: Robot) -> None:
    """First `small` has room for `a`, and then nothing has while `b` stays."""
    (left, right) = two.computers
    robot = replace(two, computers=(left, right, replace(right, name="small")))
    robot = with_memory(robot, {"left": 9, "right": 9, "small": 8}, {"a": 8, "b": 5})
    now = situation(APART, robot=robot)
    found = plan_failover(now, {"left"}, stuck={"b"})
    assert found.placement == {"a": "small"}
    assert not found.steps
    robot = with_memory(robot, {"left": 9, "right": 9, "small": 5}, {"a": 8, "b": 5})
    found = plan_failover(situation(APART, robot=robot), {"left"}, stuck={"b"})
    assert not found.placement


def with_memory(
    robot: Robot, computers: Mapping[str, float], components: Mapping[str, float]
) -> Robot:
    """Return a robot whose computers have memory, and whose components need it."""
    robot = robot.with_components(
        lambda c: replace(c, demand={**c.demand, "memory": components[c.name]})
    )
    return replace(
        robot,
        computers=tuple(
            replace(c, capacity={**c.capacity, "memory": computers[c.name]})
            for c in robot.computers
        ),
    )


@pytest.mark.parametrize("seed", range(40))
def test_nothing_is_missing_where_memory_is_enough(seed: int) -> None:
    """By enumeration of all placements, of all that works and all that was lost."""
    chance = random.Random(seed)
    computers = tuple(
        Computer(name=name, capacity={"cpu": 1.0, "memory": chance.uniform(8, 14)})
        for name in ("x", "y", "z")
    )
    components = tuple(
        ComponentEntry(
            name=f"c{n}",
            demand={"cpu": chance.uniform(0.1, 0.5), "memory": chance.uniform(1, 7)},
        )
        for n in range(6)
    )
    robot = Robot(
        name="random",
        computers=computers,
        architectures=(
            Architecture(name="all", function="all", components=components),
        ),
        tasks=(Task(name="work", actions=(Action(name="w", functions=("all",)),)),),
    )

    def fits(placement: Mapping[str, str]) -> bool:
        return all(
            sum(c.demand["memory"] for c in components if placement[c.name] == at.name)
            <= at.capacity["memory"]
            for at in computers
        )

    def placements(names: tuple[str, ...]) -> Iterator[dict[str, str]]:
        for homes in itertools.product(names, repeat=len(components)):
            yield {c.name: at for c, at in zip(components, homes, strict=True)}

    before = next(filter(fits, placements(("x", "y", "z"))), None)
    if before is None:
        return
    now = Situation(robot=robot, placement=before, lost=frozenset("x"))
    found = plan_failover(now, {"x"})
    if not any(map(fits, placements(("y", "z")))):
        assert found.missing
        return
    assert not found.missing
    moved = {step.component: step.target for step in found.steps}
    assert fits({**before, **moved, **found.placement})


def test_what_runs_elsewhere_stays(situation: Make, two: Robot) -> None:
    """Also where it could not be placed now."""
    robot = with_first(two, only=("left",))
    found = plan_failover(situation(APART, robot=robot), {"right"})
    assert found.placement == {"b": "left"}


def test_of_what_does_not_fit_whole_architectures_are_dropped_by_priority(
    situation: Make, two: Robot
) -> None:
    """Each needs more than half of the memory that is left."""
    (work,) = two.architectures
    names = {c.name: c for c in work.components}
    parts = tuple(
        replace(
            work,
            name=f"work_{name}",
            function=f"work_{name}",
            priority=priority,
            components=(names[name],),
        )
        for name, priority in (("a", 2), ("b", 1))
    )
    robot = replace(two, architectures=parts, connectors=())
    robot = with_memory(robot, {"left": 9, "right": 7}, {"a": 4, "b": 4})
    found = plan_failover(situation({"a": "left", "b": "left"}, robot=robot), {"left"})
    assert found.placement == {"a": "right"}
    assert found.missing["b"].startswith(
        "it fits nowhere beside the running components: "
    )


def test_what_belongs_to_another_layer_is_missing(situation: Make, two: Robot) -> None:
    (work,) = two.architectures
    robot = replace(two, architectures=(replace(work, layer="reactive", home="left"),))
    found = plan_failover(situation({"a": "left", "b": "left"}, robot=robot), {"left"})
    assert found.placement == {}
    assert set(found.missing.values()) == {
        "it belongs to the reactive layer, which stays"
    }
