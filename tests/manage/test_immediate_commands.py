"""Which connector somebody means who wants to look at it, and what was written."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.control_socket.commands import LogCommand, TapCommand
from poise.manage.control_socket.immediate_commands import (
    _read_log,
    _read_tap,
    begin_of,
)
from poise.model.robot import Connector, ConnectorEnd
from poise.wire.records.request_records import OutputLine, OutputLines
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Side,
)

NAMES = ("eye.image-mind.image", "eye.image-screen.image", "ear.sound-mind.sound")


def end(name: str, side: Side) -> ConnectorStatus:
    return ConnectorStatus(name=name, kind="remote", end=side, ready=True)


def computer(name: str, container: str, *ends: ConnectorStatus) -> AgentStatus:
    inside = ContainerStatus(name=container, pid=1, connectors=ends)
    return AgentStatus(
        computer=name, generation=1, uptime=1.0, cpu=0.0, containers=(inside,)
    )


STATUSES = {
    "left": computer("left", "senses", *(end(name, "source") for name in NAMES)),
    "right": computer("right", "mind", *(end(name, "target") for name in NAMES)),
}


@pytest.mark.parametrize(
    ("asked", "meant"),
    [
        (NAMES[2], NAMES[2]),
        ("ear.sound", NAMES[2]),
        ("mind.sound", NAMES[2]),
        ("eye.image", NAMES[0]),  # the same messages go to both
    ],
)
def test_a_connector_is_meant_by_its_name_or_an_end(asked: str, meant: str) -> None:
    assert begin_of(STATUSES, asked) == (meant, "left", "senses")


def test_of_several_connectors_of_a_port_always_the_same_is_looked_at() -> None:
    """A container opens one again when its target moves; then it is the last."""
    ends = [end(name, "source") for name in reversed(NAMES)]
    moved = {"left": computer("left", "senses", *ends)}
    assert begin_of(moved, "eye.image") == (NAMES[0], "left", "senses")


def test_a_source_that_moves_is_looked_at_where_it_works() -> None:
    target = computer("right", "senses", end(NAMES[0], "source"))
    eye = ComponentStatus(name="eye", state="active")
    at = STATUSES["left"]
    senses = replace(at.containers[0], components=(eye,))
    statuses = {"left": replace(at, containers=(senses,)), "right": target}
    assert begin_of(statuses, "eye.image") == (NAMES[0], "left", "senses")


def test_an_end_where_different_messages_come_is_ambiguous() -> None:
    both = {
        "left": computer("left", "c", end("a.x-m.in", "both"), end("b-m.in", "both"))
    }
    with pytest.raises(UsageError, match=r"several .* 'm\.in': a\.x-m\.in; b-m\.in"):
        begin_of(both, "m.in")


def test_a_port_without_a_connector_is_looked_at_where_its_component_works() -> None:
    at = STATUSES["left"]
    nose = ComponentStatus(name="nose", state="active")
    senses = replace(at.containers[0], components=(nose,))
    statuses = {"left": replace(at, containers=(senses,))}
    assert begin_of(statuses, "nose.smell") == ("nose.smell", "left", "senses")


def test_one_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(UsageError, match=r"no connector 'nose' \(there are: ear"):
        begin_of(STATUSES, "nose")


@pytest.mark.parametrize("asked", ["eye-mind /scan", "/scan", "mind"])
def test_a_topic_of_ros2_is_known_and_left_to_it(asked: str) -> None:
    ends = (ConnectorEnd("eye", ""), ConnectorEnd("mind", ""))
    robot = SimpleNamespace(
        all_connectors=lambda: (Connector(between=ends, topic="/scan"),)
    )
    live: Any = SimpleNamespace(
        robot=robot,
        placement=lambda: {"eye": "left", "mind": "left"},
        agents=SimpleNamespace(statuses=dict),
    )
    with pytest.raises(UsageError) as said:
        _read_tap(live, TapCommand(connector=asked, viewer="v"))
    if asked == "mind":
        assert str(said.value) == "no connector 'mind' (there are: eye-mind /scan)"
    else:
        assert str(said.value) == (
            f"'{asked}' is made by ROS 2 alone: `ros2 topic echo /scan` shows it"
        )


def test_lines_are_in_order_though_a_clock_is_wrong() -> None:
    """The right computer's clock has just begun, at 1970."""
    now = int(wall_time() * 1e9)

    def told(now: int, *ages: int) -> OutputLines:
        texts = tuple(
            OutputLine(at=now - age, component="eye", text=str(age)) for age in ages
        )
        return OutputLines(lines=texts, now=now)

    agents = SimpleNamespace(
        statuses=lambda: STATUSES,
        request_all=lambda *_: {
            "left": told(now, 4 * 10**9, 2 * 10**9),
            "right": told(60 * 10**9, 3 * 10**9, 10**9),
        },
    )
    reading = _read_log(cast("Agents", agents), LogCommand(most=2))
    assert [int(line.text) // 10**9 for line in reading.lines] == [2, 1]
    assert reading.after["right"] == 59 * 10**9


@pytest.mark.parametrize(("most", "texts"), [(0, []), (1, ["b"]), (9, ["a", "b"])])
def test_no_more_lines_are_told_than_were_asked_for(
    most: int, texts: list[str]
) -> None:
    """An agent tells two, by the clocks of both the later one last."""
    lines = tuple(
        OutputLine(at=at, component="eye", text=text)
        for at, text in ((1, "a"), (2, "b"))
    )
    agents = SimpleNamespace(
        statuses=lambda: STATUSES,
        request_all=lambda *_: {
            "left": OutputLines(lines=lines),
            "right": OutputLines(),
        },
    )
    reading = _read_log(cast("Agents", agents), LogCommand(most=most))
    assert [line.text for line in reading.lines] == texts
    assert reading.omitted == 2 - len(texts)
