"""What is not as the manager wants it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.agent_connections.statuses import not_joined
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Incarnation
from poise.manage.observe.deviations import (
    Deviation,
    find_deviations,
    find_unjoined,
    find_unwanted,
    wanted_containers,
)
from poise.model.robot import Connector, ConnectorEnd, Robot
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerHealth,
    ContainerState,
    ContainerStatus,
    ErrorCount,
    Fault,
    State,
)

JOINED = Connector(between=(ConnectorEnd("eye", "x"), ConnectorEnd("mind", "x")))
FAULT = Fault(container="see", message="was killed by SIGKILL")


def find(
    robot: Robot,
    eye: State | None,
    state: ContainerState,
    restarts_lately: int = 0,
    fault: Fault | None = FAULT,
) -> list[Deviation]:
    """Return the deviations with `eye` in some state; None: it is not there."""
    health = ContainerHealth(
        name="see",
        state=state,
        since=0.0,
        last_fault=fault,
        restarts_lately=restarts_lately,
    )
    components = () if eye is None else (ComponentStatus(name="eye", state=eye),)
    container = ContainerStatus(name="see", pid=7, components=components)
    status = AgentStatus(
        computer="a",
        generation=1,
        uptime=9.0,
        cpu=0.0,
        containers=(container,),
        health=(health,),
    )
    placed = [Incarnation(component="eye", computer="a", goal="active")]
    layout = DeploymentLayout(robot, "")
    return list(
        find_deviations(
            placed, wanted_containers(placed, layout), layout, {"a": status}, 5.0
        )
    )


@pytest.mark.parametrize("eye", [None, "inactive", "unresponsive"])
def test_names_the_container_whose_fault_is_the_cause(
    robot: Robot, eye: State | None
) -> None:
    (found,) = find(robot, eye, "restarting")
    assert (found.component, found.container) == ("eye", "see")


def test_a_component_that_failed_is_told_though_its_container_had_a_fault(
    robot: Robot,
) -> None:
    (found,) = find(robot, "failed", "running")
    assert found.container == ""
    assert found.what == "component 'eye' on 'a' is failed"


def test_without_a_fault_there_is_no_other_cause(robot: Robot) -> None:
    (found,) = find(robot, None, "starting", fault=None)
    assert found.container == ""


def test_a_container_that_was_restarted_three_times_lately_is_in_a_crash_loop(
    robot: Robot,
) -> None:
    assert find(robot, "active", "running", restarts_lately=2) == []
    (found,) = find(robot, "active", "running", restarts_lately=3)
    assert found.what == (
        "container 'see' on 'a' is in a crash loop: restarted at least 3 times within "
        "a minute"
    )


def test_names_a_container_that_nobody_wants() -> None:
    """Such as one of another manager."""
    container = ContainerStatus(name="odd", pid=7, components=())
    status = AgentStatus(
        computer="a", generation=1, uptime=9.0, cpu=0.0, containers=(container,)
    )
    (found,) = find_unwanted({}, {"a": status}, 5.0).values()
    assert found.what == "container 'odd' runs on 'a' but should not"


@pytest.mark.parametrize(
    ("ready", "placed", "count"),
    [
        (False, ("eye", "mind"), 1),
        (True, ("eye", "mind"), 0),
        (False, ("eye",), 0),  # what is at the other end is not there: that is said
    ],
)
def test_names_a_connector_that_is_not_joined(
    robot: Robot, placed: tuple[str, ...], count: int, *, ready: bool
) -> None:
    joined = replace(robot, connectors=(JOINED,))
    end = ConnectorStatus(name="eye.x-mind.x", kind="local", end="source", ready=ready)
    container = ContainerStatus(name="see", pid=7, components=(), connectors=(end,))
    status = AgentStatus(
        computer="a", generation=1, uptime=9.0, cpu=0.0, containers=(container,)
    )
    settled = [Incarnation(component=n, computer="a", goal="active") for n in placed]
    layout = DeploymentLayout(joined, "")
    found = find_unjoined(settled, layout, {"a": status}, 5.0).values()
    assert len(found) == count
    for each in found:
        assert each.what == "connector 'eye.x-mind.x' from 'a' does not reach 'a'"


def test_where_another_computer_is_to_be_reached_is_said(robot: Robot) -> None:
    """A firewall lets the gateway's port through, or not."""
    joined = replace(robot, connectors=(JOINED,))
    end = ConnectorStatus(
        name="eye.x-mind.x", key="x/0.0", kind="remote", end="source", ready=False
    )
    container = ContainerStatus(name="see", pid=7, components=(), connectors=(end,))
    here = AgentStatus(
        computer="a", generation=1, uptime=9.0, cpu=0.0, containers=(container,)
    )
    there = AgentStatus(
        computer="b", generation=1, uptime=9.0, cpu=0.0, gateway="10.0.0.2:7448"
    )
    settled = [
        Incarnation(component=name, computer=at, goal="active")
        for name, at in (("eye", "a"), ("mind", "b"))
    ]
    statuses, layout = {"a": here, "b": there}, DeploymentLayout(joined, "")
    what = "connector 'eye.x-mind.x' from 'a' does not reach 'b' at 10.0.0.2:7448 (TCP)"
    (found,) = find_unjoined(settled, layout, statuses, 5.0).values()
    assert found.what == what
    assert not_joined(statuses, {"x/0.0": ("a", "b")}) == [what]
    refused = replace(end, refusal="no TLS session: certificate has expired")
    connectors = (replace(container, connectors=(refused,)),)
    statuses["a"] = replace(here, containers=connectors)
    (found,) = find_unjoined(settled, layout, statuses, 5.0).values()
    assert found.what == f"{what}: {refused.refusal}"


def test_an_error_of_an_agents_own_code_is_shown_with_its_part(robot: Robot) -> None:
    error = ErrorCount(
        where="container 'see'",
        text="Traceback ...\nKeyError: 'a bug'\n",
        first=1.0,
        count=3,
    )
    status = AgentStatus(
        computer="a", generation=1, uptime=9.0, cpu=0.0, errors=(error,)
    )
    layout = DeploymentLayout(robot, "")
    (found,) = find_deviations([], {}, layout, {"a": status}, 5.0)
    assert found.computer == "a"
    assert found.what == (
        "agent of 'a': an internal error in part \"container 'see'\": KeyError: "
        "'a bug' (traceback in its log); the rest goes on"
    )


@pytest.mark.parametrize(
    ("cores", "memory", "said"),
    [
        (0.0, 0, []),  # not known
        (1.0, 10**9, []),
        (1.0, 950_000_000, []),  # the firmware keeps some
        (
            0.5,
            512 << 20,
            [
                (
                    "computer 'a' has 0.5 cores, not the 1 core of the robot file: "
                    "correct its `cpu` there, or too much is placed on it"
                ),
                (
                    "computer 'a' has 512 MiB, not the 954 MiB of the robot file: "
                    "correct its `memory` there, or too much is placed on it"
                ),
            ],
        ),
    ],
)
def test_a_computer_with_less_than_the_robot_file_says_is_named(
    robot: Robot, *, cores: float, memory: int, said: list[str]
) -> None:
    status = AgentStatus(
        computer="a",
        generation=1,
        uptime=9.0,
        cpu=0.0,
        cores=cores,
        computer_memory=memory,
    )
    (computer,) = robot.computers
    real = replace(robot, computers=(replace(computer, address="10.0.0.1"),))
    layout = DeploymentLayout(real, "")
    found = find_deviations([], {}, layout, {"a": status}, 5.0)
    assert [each.what for each in found] == said
    emulated = find_deviations([], {}, DeploymentLayout(robot, ""), {"a": status}, 5.0)
    assert list(emulated) == []
