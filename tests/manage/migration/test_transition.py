"""Plans of transitions: ordered, never overfull, and they end where they should."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from poise.errors import RobotError
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.transition_plan import plan_transition
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot


def robot_of(demands: dict[str, float], capacities: dict[str, float]) -> Robot:
    """Return a robot whose components and computers only know ``cpu``."""
    return Robot(
        name="tiny",
        computers=tuple(
            Computer(name=name, capacity={"cpu": cpu, "memory": 1.0})
            for name, cpu in capacities.items()
        ),
        architectures=(
            Architecture(
                name="all",
                function="all",
                components=tuple(
                    ComponentEntry(name=name, demand={"cpu": cpu})
                    for name, cpu in demands.items()
                ),
            ),
        ),
    )


def loads_on_the_way(
    robot: Robot, now: dict[str, str], steps: tuple[TransitionStep, ...]
) -> list[dict[str, float]]:
    """Return the cpu load per computer after each step, both ends of a move counted."""
    demand = {c.name: c.demand["cpu"] for c in robot.components()}
    placement = dict(now)
    loads = []
    for step in steps:
        load = dict.fromkeys((c.name for c in robot.computers), 0.0)
        for name, computer in placement.items():
            load[computer] += demand[name]
        if step.target:
            load[step.target] += demand[step.component]
        loads.append(load)
        if not step.target:
            del placement[step.component]
        else:
            placement[step.component] = step.target
    return loads


def result_of(now: dict[str, str], steps: tuple[TransitionStep, ...]) -> dict[str, str]:
    """Return the placement after all steps."""
    placement = dict(now)
    for step in steps:
        if not step.target:
            del placement[step.component]
        else:
            placement[step.component] = step.target
    return placement


def test_nothing_to_do_takes_no_step() -> None:
    robot = robot_of({"a": 1}, {"x": 1})
    assert plan_transition(robot, {"a": "x"}, {"a": "x"}) == ()


def test_makes_room_before_it_is_needed() -> None:
    """X holds a (3 of 4); b (2) can only come once a has gone to y."""
    robot = robot_of({"a": 3, "b": 2}, {"x": 4, "y": 5})
    now, then = {"a": "x", "b": "y"}, {"a": "y", "b": "x"}
    steps = plan_transition(robot, now, then)
    assert [str(step) for step in steps] == [
        "move a from x to y",
        "move b from y to x",
    ]


def test_two_that_wait_for_each_other_use_a_third_computer() -> None:
    """Neither of two full computers has room for the other's component."""
    robot = robot_of({"a": 3, "b": 3}, {"x": 4, "y": 4, "z": 3})
    now, then = {"a": "x", "b": "y"}, {"a": "y", "b": "x"}
    steps = plan_transition(robot, now, then)
    assert [str(step).split()[0] for step in steps] == ["move", "move", "move"]
    assert (steps[0].target, bool(steps[0].why)) == ("z", True)
    assert result_of(now, steps) == then


def test_without_a_third_computer_one_is_stopped_and_the_plan_says_so() -> None:
    robot = robot_of({"a": 3, "b": 3}, {"x": 4, "y": 4})
    now, then = {"a": "x", "b": "y"}, {"a": "y", "b": "x"}
    steps = plan_transition(robot, now, then)
    assert [str(step).split()[0] for step in steps] == ["stop", "move", "start"]
    assert "cold move" in steps[0].why
    assert "cold move" in steps[2].why
    assert result_of(now, steps) == then


def test_a_target_that_is_too_much_for_a_computer_is_refused_by_name() -> None:
    robot = robot_of({"a": 3, "b": 3}, {"x": 4, "y": 4})
    with pytest.raises(RobotError, match="'x' would be overfull"):
        plan_transition(robot, {"a": "x", "b": "y"}, {"a": "x", "b": "x"})


@st.composite
def transitions(
    draw: st.DrawFn,
) -> tuple[Robot, dict[str, str], dict[str, str]]:
    """Return a robot and two placements of parts of it that both fit."""
    hosts = ["x", "y", "z"]
    names = [f"c{i}" for i in range(draw(st.integers(1, 8)))]
    demands = {name: float(draw(st.integers(1, 5))) for name in names}
    placements = [
        {n: draw(st.sampled_from(hosts)) for n in names if draw(st.booleans())}
        for _ in range(2)
    ]
    capacities = {
        host: max(
            1.0,
            *(
                sum(demands[n] for n, h in placement.items() if h == host)
                for placement in placements
            ),
        )
        for host in hosts
    }
    return robot_of(demands, capacities), placements[0], placements[1]


@given(transitions())
def test_any_transition_arrives_and_is_never_overfull(
    case: tuple[Robot, dict[str, str], dict[str, str]],
) -> None:
    robot, now, then = case
    steps = plan_transition(robot, now, then)
    assert result_of(now, steps) == then
    for load in loads_on_the_way(robot, now, steps):
        for computer in robot.computers:
            assert load[computer.name] <= computer.capacity["cpu"] + 1e-9


SWAP = {"a": "left", "b": "right"}, {"a": "right", "b": "left"}


def moves(robot: Robot, *, shares_cpu: bool = False) -> list[tuple[str, str, str]]:
    """Return the steps of a swap: component, from where, and where to."""
    steps = plan_transition(robot, *SWAP, shares_cpu=shares_cpu)
    return [(each.component, each.source, each.target) for each in steps]


def test_what_takes_all_memory_makes_way_though_cpu_is_left() -> None:
    robot = robot_of({"a": 0.1, "b": 0.1}, {"left": 1.0, "right": 1.0, "third": 1.0})
    robot = robot.with_components(
        lambda c: replace(c, demand={**c.demand, "memory": 0.6})
    )
    around = [("a", "left", "third"), ("b", "right", "left"), ("a", "third", "right")]
    assert moves(robot) == around


def test_what_shares_cpu_swaps_where_it_is_short_on_the_way() -> None:
    robot = robot_of({"a": 0.8, "b": 0.8}, {"left": 1.0, "right": 1.0})
    assert moves(robot) == [
        ("a", "left", ""),
        ("b", "right", "left"),
        ("a", "", "right"),
    ]
    swapped = [("a", "left", "right"), ("b", "right", "left")]
    assert moves(robot, shares_cpu=True) == swapped


def test_what_may_not_move_stops_only_what_would_move_it() -> None:
    robot = robot_of({"a": 0.1, "b": 0.1}, {"left": 1.0, "right": 1.0})
    robot = robot.with_components(lambda c: replace(c, movable=c.name != "a"))
    now, then = SWAP
    steps = plan_transition(robot, now, {**then, "a": "left"})
    assert steps == (TransitionStep("b", "right", "left"),)
    with pytest.raises(RobotError, match="'a' is not movable, but would go from 'left"):
        plan_transition(robot, now, then)
