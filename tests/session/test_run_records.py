"""What went wrong in a run is found in the last statuses, worked out by hand."""

from __future__ import annotations

from poise.model import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.session.run_records import (
    component_errors,
    hung_handlers,
    refused_messages,
    silent_ports,
)
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    ErrorCount,
)

TOPIC, CALL = "eye.images-brain.images", "brain.arm-arm.moves"


def statuses(
    *components: ComponentStatus, connectors: tuple[ConnectorStatus, ...] = ()
) -> dict[str, AgentStatus]:
    container = ContainerStatus(
        name="all", pid=1, components=components, connectors=connectors
    )
    status = AgentStatus(
        computer="left", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    return {"left": status}


def target(
    name: str, messages: int = 0, errors: int = 0, refused: int = 0
) -> ConnectorStatus:
    return ConnectorStatus(
        name=name,
        kind="local",
        end="target",
        ready=True,
        messages=messages,
        errors=errors,
        refused=refused,
    )


def source(name: str, messages: int) -> ConnectorStatus:
    return ConnectorStatus(
        name=name, kind="local", end="source", ready=True, messages=messages
    )


BRAIN = ComponentStatus(
    name="brain", state="inactive", subscribes=("images",), requires=("arm",)
)


def robot(*connectors: Connector) -> Robot:
    components = tuple(ComponentEntry(name=name) for name in ("eye", "brain"))
    return Robot(
        name="r",
        computers=(Computer(name="left"),),
        architectures=(Architecture(name="a", function="a", components=components),),
        connectors=connectors,
    )


IMAGES = Connector(
    between=(ConnectorEnd("eye", "images"), ConnectorEnd("brain", "images"))
)
EYE = ComponentStatus(name="eye", state="inactive")


def test_messages_that_were_refused_count_and_failed_calls_do_not() -> None:
    """A call that fails is an error of its caller, who may expect it."""
    found = statuses(BRAIN, connectors=(target(TOPIC, 5, 2, 2), target(CALL, 0, 3)))
    assert refused_messages(found) == {TOPIC: 2}


def test_errors_come_in_the_order_in_which_they_first_came() -> None:
    late = ErrorCount(where="tick", text="late", first=9.0, count=1)
    early = ErrorCount(where="tock", text="early", first=3.0, count=7)
    brain = ComponentStatus(name="brain", state="active", error_counts=(late, early))
    found = component_errors([("left", brain)])
    assert [(e.component, e.computer, e.text, e.count) for e in found] == [
        ("brain", "left", "early", 7),
        ("brain", "left", "late", 1),
    ]


def test_only_a_handler_that_kept_its_component_active_is_hung() -> None:
    hung = ComponentStatus(
        name="brain", state="active", handler="think", handler_seconds=3.0
    )
    (found,) = hung_handlers(statuses(hung))
    assert (found.component, found.handler, found.seconds) == ("brain", "think", 3.0)
    assert hung_handlers(statuses(EYE)) == ()


def test_a_port_that_got_nothing_says_why() -> None:
    silent = silent_ports(robot(), statuses(BRAIN))
    assert [str(port) for port in silent] == [
        "port brain.images got no message: no connector leads to it"
    ]
    (away,) = silent_ports(robot(IMAGES), statuses(BRAIN))
    assert away.reason == "component 'eye', which publishes to it, does not run"
    (quiet,) = silent_ports(robot(IMAGES), statuses(BRAIN, EYE))
    assert quiet.reason == "eye.images published nothing"
    ends = (source(TOPIC, 4), target(TOPIC))
    (lost,) = silent_ports(robot(IMAGES), statuses(BRAIN, EYE, connectors=ends))
    assert lost.reason == "eye.images published 4, and none arrived"


def test_a_port_that_got_a_message_is_not_silent() -> None:
    ends = (source(TOPIC, 4), target(TOPIC, 1))
    assert silent_ports(robot(IMAGES), statuses(BRAIN, EYE, connectors=ends)) == ()


def test_a_provided_port_without_calls_is_silent_where_that_is_asked() -> None:
    silent = silent_ports(robot(IMAGES), statuses(EYE), ["brain.advise"])
    assert [each.port for each in silent] == ["brain.advise"]
