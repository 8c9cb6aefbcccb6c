"""What of an earlier manager's robot goes on, by what its agents were told."""

from __future__ import annotations

from collections.abc import Collection

import pytest
from msgspec.structs import replace

from poise.manage.deploy.adoption import Adoption, adopt, found_in, is_half_done
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Desired, Incarnation
from poise.model.robot import Architecture, Chain, ComponentEntry, Robot
from poise.wire.records.deployment_records import Deployment, Goal

GATEWAYS = {"left": "left:7000", "right": "right:7000"}
PLANNED = {"grabber": "left", "thinker": "right"}
GRABBER = Incarnation(component="grabber", computer="left")
THINKER = Incarnation(component="thinker", computer="right", epoch=2)


def told(robot: Robot, *incarnations: Incarnation) -> dict[str, Deployment]:
    return DeploymentLayout(robot, "/run").deployments(
        Desired(coming=incarnations, generation=7), GATEWAYS
    )


def adopted(
    robot: Robot,
    *incarnations: Incarnation,
    now: Robot | None = None,
    committed: Collection[tuple[str, int]] = (),
    version: str = "",
) -> Adoption:
    robot_now = now or robot
    return adopt(
        found_in(told(robot, *incarnations)),
        robot_now,
        DeploymentLayout(robot_now, "/run", code_version=lambda *_: version),
        PLANNED,
        committed=committed,
    )


def target(epoch: int, goal: Goal = "inactive") -> Incarnation:
    return Incarnation(component="thinker", computer="left", epoch=epoch, goal=goal)


def test_all_that_runs_as_the_file_says_goes_on_where_it_is(robot: Robot) -> None:
    moved = replace(THINKER, computer="left")
    adoption = adopted(robot, GRABBER, moved)
    assert adoption == Adoption(
        kept={"grabber": GRABBER, "thinker": moved}, restarts={}, ends=(), starts={}
    )


def test_a_component_that_was_to_be_activated_is(robot: Robot) -> None:
    adoption = adopted(robot, GRABBER, THINKER.with_goal("inactive"))
    assert adoption.kept["thinker"] == THINKER


def test_a_migration_that_was_not_committed_is_rolled_back(robot: Robot) -> None:
    found = (GRABBER, THINKER.with_goal("stay"), target(3))
    assert is_half_done(found_in(told(robot, *found)), robot)
    adoption = adopted(robot, *found)
    assert adoption.kept["thinker"] == THINKER
    (sentence,) = adoption.half_done
    assert "'thinker' from 'right' to 'left' was interrupted, and is rolled" in sentence


def test_a_migration_that_was_committed_is_finished(robot: Robot) -> None:
    found = (GRABBER, THINKER.with_goal("stay"), target(3))
    adoption = adopted(robot, *found, committed={("thinker", 3)})
    assert adoption.kept["thinker"] == target(3, "active")
    assert "is finished" in adoption.half_done[0]


def test_the_commit_of_another_migration_finishes_none(robot: Robot) -> None:
    """An agent that was cut off has not heard that the one before has ended."""
    found = (GRABBER, THINKER.with_goal("stay"), target(3))
    adoption = adopted(robot, *found, committed={("grabber", 0)})
    assert adoption.kept["thinker"] == THINKER


def test_a_target_that_was_to_be_active_counts_in_any_case(robot: Robot) -> None:
    """Its manager knew of the commit; the container that did may have ended."""
    adoption = adopted(robot, GRABBER, THINKER.with_goal("stay"), target(3, "active"))
    assert adoption.kept["thinker"] == target(3, "active")


def test_what_a_lost_computer_still_runs_does_not_count(robot: Robot) -> None:
    adoption = adopted(robot, GRABBER, THINKER, target(3, "active"))
    assert adoption.kept["thinker"] == target(3, "active")


def test_nothing_is_half_done_when_each_runs_once(robot: Robot) -> None:
    assert not is_half_done(found_in(told(robot, GRABBER, THINKER)), robot)


def with_thinker(robot: Robot, **changes: object) -> Robot:
    return replace(
        robot,
        architectures=tuple(
            replace(
                a,
                components=tuple(
                    replace(c, **changes) if c.name == "thinker" else c
                    for c in a.components
                ),
            )
            for a in robot.architectures
        ),
    )


def test_what_the_file_says_differently_restarts_and_nothing_else(
    robot: Robot,
) -> None:
    now = with_thinker(robot, parameters={"depth": 3}, implementation="mind:Other")
    adoption = adopted(robot, GRABBER, THINKER, now=now)
    assert adoption.kept == {"grabber": GRABBER}
    assert adoption.starts == {"thinker": "right"}
    assert "to 'mind:Other'" in adoption.restarts["thinker"]
    assert (
        "its parameters changed from {} to {'depth': 3}"
        in (adoption.restarts["thinker"])
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"environment": {"A": "1"}}, "environment changed from {} to {'A': '1'}"),
        ({"checkpoint": 2.0}, "checkpoint changed from 0.0 to 2.0"),
        ({"restart_when_hung": 5.0}, "restart_when_hung changed from 0.0 to 5.0"),
        ({"only": ("right",)}, "it may no longer run elsewhere"),
    ],
)
def test_what_it_was_made_with_restarts_it(
    robot: Robot, changes: dict[str, object], said: str
) -> None:
    now = with_thinker(robot, **changes)
    assert said in adopted(robot, GRABBER, THINKER, now=now).restarts["thinker"]


def test_another_deadline_of_a_chain_restarts_its_components(robot: Robot) -> None:
    chain = Chain(name="see", through=("grabber", "thinker"), deadline=0.2)
    before = replace(robot, chains=(chain,))
    now = replace(robot, chains=(replace(chain, deadline=0.1),))
    restarts = adopted(before, GRABBER, THINKER, now=now).restarts
    assert restarts == {"thinker": "its chains or their deadlines changed"}


def test_another_limit_of_calls_restarts_the_caller(robot: Robot) -> None:
    (first, *rest) = robot.connectors
    now = replace(robot, connectors=(replace(first, limit=5.0), *rest))
    source = Incarnation(component="filter", computer="left")
    restarts = adopt(
        found_in(told(robot, source, THINKER)),
        now,
        DeploymentLayout(now, "/run", code_version=lambda *_: ""),
        {"filter": "left", "thinker": "right"},
    ).restarts
    assert restarts == {"filter": f"the limit of {first} changed from 0.3 s to 5 s"}


def test_a_class_that_replaced_the_one_of_the_file_goes_on(robot: Robot) -> None:
    replaced = replace(THINKER, implementation="mind:Better")
    adoption = adopted(robot, GRABBER, replaced)
    assert adoption.kept["thinker"] == replaced


def test_a_class_that_the_file_has_changed_meanwhile_takes_its_place(
    robot: Robot,
) -> None:
    now = with_thinker(robot, implementation="mind:Third")
    replaced = replace(THINKER, implementation="mind:Better")
    adoption = adopted(robot, GRABBER, replaced, now=now)
    assert "to 'mind:Third'" in adoption.restarts["thinker"]


def test_other_code_restarts_all_of_its_container(robot: Robot) -> None:
    adoption = adopted(robot, GRABBER, THINKER, version="new")
    assert set(adoption.restarts) == {"grabber", "thinker"}
    assert adoption.restarts["grabber"] == "its code has changed"


def test_what_the_task_does_not_need_any_more_ends(robot: Robot) -> None:
    adoption = adopt(
        found_in(told(robot, GRABBER, THINKER)),
        robot,
        DeploymentLayout(robot, "/run"),
        {"grabber": "left"},
    )
    assert adoption.ends == ("thinker",)
    assert adoption.kept == {"grabber": GRABBER}


def test_what_did_not_run_yet_starts_where_it_is_planned(robot: Robot) -> None:
    adoption = adopted(robot, GRABBER)
    assert adoption.starts == {"thinker": "right"}


def with_alternative(robot: Robot) -> Robot:
    other = Architecture(
        name="instinct",
        function="mind",
        components=(ComponentEntry(name="reflex", implementation="mind:Reflex"),),
    )
    mind = next(a for a in robot.architectures if a.name == "mind")
    rest = tuple(a for a in robot.architectures if a.name != "mind")
    return replace(robot, architectures=(*rest, replace(mind, function="mind"), other))


def test_an_architecture_is_replaced_as_a_whole_or_not(robot: Robot) -> None:
    both = with_alternative(robot)
    reflex = Incarnation(component="reflex", computer="right", goal="inactive")
    found = (GRABBER, THINKER.with_goal("stay"), reflex)
    assert is_half_done(found_in(told(both, *found)), both)
    before = adopted(both, *found)
    assert set(before.kept) == {"grabber", "thinker"}
    after = adopted(both, *found, committed={("reflex", 0)})
    assert set(after.kept) == {"grabber", "reflex"}
    assert after.ends == ("thinker",)


def test_an_architecture_that_replaced_the_planned_one_stays(robot: Robot) -> None:
    both = with_alternative(robot)
    reflex = Incarnation(component="reflex", computer="right")
    assert set(adopted(both, GRABBER, reflex).kept) == {"grabber", "reflex"}
