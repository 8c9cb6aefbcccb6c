"""Where components of lost computers go on."""

from __future__ import annotations

from msgspec.structs import replace

from poise.manage.adaptation.shortages.failover import fail_over
from poise.model.robot import Device, Link, Robot
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
    found = fail_over(situation(APART, robot=linked), {"left"})
    assert found.placement == {"a": "right"}
    assert not found.missing


def test_nothing_moves_when_nothing_ran_there(situation: Make) -> None:
    found = fail_over(situation({"a": "left", "b": "left"}), {"right"})
    assert found.placement == {}
    assert found.missing == {}


def test_what_its_device_holds_there_is_missing(situation: Make, two: Robot) -> None:
    robot = replace(
        with_first(two, devices=("laser",)),
        devices=(Device(name="laser", computer="left"),),
    )
    found = fail_over(situation(APART, robot=robot), {"left"})
    assert found.placement == {}
    assert found.missing == {"a": "it may run on left only"}


def test_what_may_not_move_is_missing(situation: Make, two: Robot) -> None:
    robot = with_first(two, movable=False)
    found = fail_over(situation(APART, robot=robot), {"left"})
    assert found.missing == {"a": "it is not movable (robot file)"}


def test_what_does_not_fit_beside_the_others_is_missing(situation: Make) -> None:
    found = fail_over(situation(APART, background={"right": 0.2}), {"left"})
    assert found.placement == {}
    assert found.missing["a"].startswith("it fits nowhere beside what runs: ")


def test_what_runs_elsewhere_stays(situation: Make, two: Robot) -> None:
    """Also where it could not be placed now."""
    robot = with_first(two, only=("left",))
    found = fail_over(situation(APART, robot=robot), {"right"})
    assert found.placement == {"b": "left"}


def test_of_what_does_not_fit_whole_architectures_are_dropped_by_priority(
    situation: Make, two: Robot
) -> None:
    """Each needs more than half of what is left beside the other."""
    (work,) = two.architectures
    names = {c.name: c for c in work.components}
    parts = tuple(
        replace(
            work,
            name=f"work_{name}",
            function=f"work_{name}",
            priority=priority,
            components=(replace(names[name], demand={"cpu": 0.3}),),
        )
        for name, priority in (("a", 2), ("b", 1))
    )
    robot = replace(two, architectures=parts, connectors=())
    found = fail_over(situation({"a": "left", "b": "left"}, robot=robot), {"left"})
    assert found.placement == {"a": "right"}
    assert found.missing["b"].startswith("it fits nowhere beside what runs: ")
    assert found.waits_for_room


def test_what_belongs_to_another_layer_is_missing(situation: Make, two: Robot) -> None:
    (work,) = two.architectures
    robot = replace(two, architectures=(replace(work, layer="reactive", home="left"),))
    found = fail_over(situation({"a": "left", "b": "left"}, robot=robot), {"left"})
    assert found.placement == {}
    assert set(found.missing.values()) == {
        "it belongs to the reactive layer, which stays"
    }
    assert not found.waits_for_room
