"""Which runs are made, in which order, of which robot."""

from __future__ import annotations

from collections import Counter
from itertools import groupby

import pytest

from benchmarks.experiment.results import (
    ARMS,
    BASE,
    Extent,
    TrialCondition,
    as_it_runs,
    extents,
    named,
    schedule,
    under,
)
from benchmarks.experiment.robots import ROBOTS, ExperimentRobot
from poise.model import load
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Link,
    Robot,
    Simulator,
)

CONDITIONS = ROBOTS["trot"].conditions
EXTENTS = extents(CONDITIONS)
ROBOT = Robot(
    name="tried",
    computers=(Computer(name="left", capacity={"cpu": 1.0}, speed=0.5),),
    links=(Link(between=("left", "right"), bandwidth=1e7),),
    architectures=(
        Architecture(
            name="all",
            function="all",
            home="left",
            priority=7,
            components=(ComponentEntry(name="localiser", parameters={"kept": 1}),),
        ),
    ),
    simulator=Simulator(command=("world",)),
)


@pytest.mark.parametrize(
    "extent", [EXTENTS[name] for name in ("usual", "full", "quick")]
)
def test_random_and_no_adaptation_are_always_tried(extent: Extent) -> None:
    names = {arm.name for arm in extent.arms}
    assert names >= {"random", "greedy", "Poise"}
    assert not named(extent.arms, "Poise").adapts
    assert extent.conditions[0].name == BASE


def test_each_arm_runs_as_often_as_the_extent_says() -> None:
    counts = Counter((each.arm, each.condition) for each in schedule(EXTENTS["full"]))
    assert {c for (_, cond), c in counts.items() if cond == BASE} == {79}
    assert {c for (_, cond), c in counts.items() if cond != BASE} == {20}
    assert len(counts) == len(ARMS) * len(CONDITIONS)
    assert len(schedule(EXTENTS["quick"])) == 8


def test_arms_take_turns_in_an_order_of_their_own() -> None:
    """Of each seed and condition all arms run before the next; orders differ."""
    trials = schedule(EXTENTS["full"])
    assert trials == schedule(EXTENTS["full"])
    orders = [
        tuple(each.arm for each in group)
        for _, group in groupby(trials, lambda t: (t.seed, t.condition))
    ]
    assert {frozenset(order) for order in orders} == {frozenset(a.name for a in ARMS)}
    assert all(len(order) == len(ARMS) for order in orders)
    assert len(set(orders)) > len(orders) / 2
    seeds = [each.seed for each in trials]
    assert seeds == sorted(seeds)


def test_a_load_makes_computers_slower_and_a_link_narrower() -> None:
    known = under(ROBOT, TrialCondition(name="both", load=2.0, bandwidth=5.0), "all")
    assert [each.speed for each in known.computers] == [0.25]
    assert [each.bandwidth for each in known.links] == [5.0]
    assert under(ROBOT, CONDITIONS[0], "all") == ROBOT


def test_what_overruns_is_known_to_no_planner() -> None:
    overrun = TrialCondition(name="over", parameters={"localiser": {"particles": 9}})
    assert under(ROBOT, overrun, "all") == ROBOT
    runs = as_it_runs(ROBOT, named(ARMS, "Poise"), overrun, 3)
    (localiser,) = runs.components()
    assert localiser.parameters == {"kept": 1, "particles": 9}
    assert runs.simulator is not None
    assert runs.simulator.command == ("world", "--endless", "--seed", "3")
    assert runs.architectures[0].priority == 7


def test_static_has_no_priorities_and_nice_has() -> None:
    plain, nice = (
        as_it_runs(ROBOT, named(ARMS, name), CONDITIONS[0], 0).architectures[0]
        for name in ("static", "static, nice")
    )
    assert (plain.priority, nice.priority) == (0, 7)


@pytest.mark.parametrize("tried", ROBOTS.values(), ids=ROBOTS)
def test_conditions_are_about_what_the_robot_has(tried: ExperimentRobot) -> None:
    """A name that the robot does not have would change nothing, and say nothing."""
    robot = load(tried.file)
    components = {each.name: each for each in robot.components()}
    computers = {each.name for each in robot.computers}
    assert tried.task in {task.name for task in robot.tasks}
    assert tried.conditions[0] == TrialCondition(name=BASE)
    for condition in tried.conditions:
        assert {computer for _, computer, _ in condition.programs} <= computers
        for name, parameters in condition.parameters.items():
            component = components[name]
            changed = {**component.parameters, **parameters}
            assert changed != component.parameters
