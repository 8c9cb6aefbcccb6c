"""Containers and connectors of a placement, by hand."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.deploy.adoption import found_in
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Desired, Incarnation
from poise.model.robot import Architecture, Chain, ComponentEntry, Computer, Robot
from poise.wire.records.deployment_records import ChainPart, ComponentSpec, Deployment
from tests.manage.conftest import connector_names

GATEWAYS = {"left": "10.0.0.1:4001", "right": "10.0.0.2:4002"}
ALL = ("grabber", "filter", "heavy", "alone", "driver", "thinker")


def deployments(robot: Robot, **where: str) -> dict[str, Deployment]:
    placed = [Incarnation(component=n, computer=c) for n, c in where.items()]
    return DeploymentLayout(robot, "/run").deployments(
        Desired(coming=tuple(placed), generation=3), GATEWAYS
    )


def everything_on(computer: str) -> dict[str, str]:
    return dict.fromkeys(ALL, computer)


def test_an_architecture_shares_a_container_but_for_those_that_need_their_own(
    robot: Robot,
) -> None:
    left = deployments(robot, **everything_on("left"))["left"]
    assert {
        c.name: [component.name for component in c.components] for c in left.containers
    } == {
        "eye": ["grabber", "filter"],
        "eye.heavy": ["heavy"],  # it would fill an interpreter
        "eye.alone": ["alone"],  # it asked for that
        "eye.driver": ["driver"],  # it is a process of its own
        "mind": ["thinker"],
    }
    assert left.generation == 3


def test_every_computer_is_told_even_to_run_nothing(robot: Robot) -> None:
    assert deployments(robot, grabber="left")["right"].containers == ()


def test_connectors_are_as_near_as_their_ends(robot: Robot) -> None:
    where = {**everything_on("left"), "thinker": "right"}
    told = deployments(robot, **where)
    assert connector_names(told["left"]) == {
        "eye": {
            "grabber.raw-filter.raw": "direct",
            "filter.clean-heavy.clean": "local",
            "filter.clean-thinker.seen": "remote",
        },
        "eye.heavy": {"filter.clean-heavy.clean": "local"},
        "eye.alone": {},
        "eye.driver": {},  # nothing can be joined to a command
    }
    assert connector_names(told["right"]) == {
        "mind": {"filter.clean-thinker.seen": "remote"}
    }


def test_both_ends_are_told_the_same(robot: Robot) -> None:
    where = {**everything_on("left"), "thinker": "right"}
    told = deployments(robot, **where)
    ends = [
        connector
        for deployment in told.values()
        for container in deployment.containers
        for connector in container.connectors
        if connector.target == "thinker"
    ]
    assert len(ends) == 2
    assert ends[0] == ends[1]
    assert ends[0].limit == 0.3


def test_a_connector_to_a_component_that_does_not_run_is_left_out(
    robot: Robot,
) -> None:
    told = deployments(robot, filter="left")
    assert connector_names(told["left"]) == {"eye": {}}


def test_a_component_is_told_all_it_needs(robot: Robot) -> None:
    (container,) = deployments(robot, grabber="left")["left"].containers
    assert container.folder == "/robot"
    assert container.components == (
        ComponentSpec(
            name="grabber",
            goal="active",
            implementation="eye:Grabber",
            parameters={"rate": 5},
            devices={"camera": "/run/camera.sock"},
        ),
    )


def test_a_command_is_told_its_command_line(robot: Robot) -> None:
    (container,) = deployments(robot, driver="left")["left"].containers
    assert container.components[0].command == ("./driver", "-v")
    assert container.components[0].implementation == ""


def test_a_connector_says_where_its_target_is_reached(robot: Robot) -> None:
    where = {**everything_on("left"), "thinker": "right"}
    told = deployments(robot, **where)
    found = {
        connector.name: connector.address
        for container in told["left"].containers
        for connector in container.connectors
    }
    assert found == {
        "grabber.raw-filter.raw": "",
        "filter.clean-heavy.clean": "eye.heavy",
        "filter.clean-thinker.seen": "10.0.0.2:4002/mind",
    }


def test_while_a_component_moves_both_incarnations_are_joined(robot: Robot) -> None:
    placed = [
        Incarnation(component="grabber", computer="left"),
        Incarnation(component="filter", computer="left"),
        Incarnation(component="filter", computer="right", epoch=1, goal="inactive"),
    ]
    told = DeploymentLayout(robot, "/run").deployments(
        Desired(coming=tuple(placed), generation=1), GATEWAYS
    )
    keys = {
        connector.key: connector.kind
        for connector in told["left"].containers[0].connectors
    }
    assert keys == {
        "grabber.raw-filter.raw/0.0": "direct",
        "grabber.raw-filter.raw/0.1": "remote",
    }


@pytest.mark.parametrize("names", [("a-b", "c"), ("a", "b-c")])
def test_no_two_containers_have_one_name(names: tuple[str, str]) -> None:
    architecture = Architecture(
        name=names[0],
        function="f",
        components=(ComponentEntry(name=names[1], isolated=True),),
    )
    robot = Robot(
        name="r",
        computers=(Computer(name="c", capacity={"cpu": 1}),),
        architectures=(architecture,),
    )
    placed = Incarnation(component=names[1], computer="left")
    assert DeploymentLayout(robot, "/").container_of(placed) == ".".join(names)


def test_a_chain_goes_with_messages_and_with_answers(robot: Robot) -> None:
    """One way from `grabber` by `filter` to `heavy`, and one back."""
    chain = Chain(name="c", through=("grabber", "filter", "heavy"), deadline=0.5)
    turned = Chain(name="t", through=("heavy", "filter"), deadline=0.5)
    chained = replace(robot, chains=(chain, turned))
    eye, heavy, *_ = deployments(chained, **everything_on("left"))["left"].containers
    parts = {c.name: c.chains for c in (*eye.components, *heavy.components)}
    assert parts["grabber"] == (ChainPart(name="c", is_first=True),)
    assert parts["filter"] == (ChainPart(name="c"), ChainPart(name="t", deadline=0.5))
    over = {c.name: (c.carries, c.answers) for c in eye.connectors}
    assert over["grabber.raw-filter.raw"] == (("c",), ())
    assert over["filter.clean-heavy.clean"] == (("c",), ("t",))
    assert over["filter.clean-thinker.seen"] == ((), ())


def test_deployed_code_is_imported_instead_of_folders(robot: Robot) -> None:
    told = deployments(replace(robot, deployed="a" * 64), **everything_on("left"))
    assert {(c.folder, c.code) for c in told["left"].containers} == {("", "a" * 64)}
    assert told["right"].code == ("a" * 64,)  # kept: components may move there


def test_other_code_of_a_component_has_a_container_of_its_own(robot: Robot) -> None:
    robot = replace(robot, deployed="a" * 64)
    placed = [
        Incarnation(component="grabber", computer="left", code="b" * 64),
        Incarnation(component="filter", computer="left"),
    ]
    left = DeploymentLayout(robot, "/run").deployments(
        Desired(coming=tuple(placed), generation=3), GATEWAYS
    )["left"]
    assert {c.name: c.code for c in left.containers} == {
        "eye..bbbbbbbb": "b" * 64,
        "eye": "a" * 64,
    }
    (joined,) = left.containers[0].connectors
    assert (joined.kind, joined.address) == ("local", "eye")
    # the next manager finds it so
    found = {each.name: each.incarnation.code for each in found_in({"left": left})}
    assert found == {"grabber": "b" * 64, "filter": ""}
