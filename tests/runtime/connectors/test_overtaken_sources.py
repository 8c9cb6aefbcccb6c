"""What a lost component sent is not taken after what its next incarnation sends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from poise import Component, subscribed
from poise.runtime.component.ports import ports_of
from poise.runtime.connectors.channel_route import ReceivingEnd
from poise.runtime.connectors.endpoints import OvertakenSources
from poise.runtime.connectors.interface import message_tag
from poise.runtime.connectors.latest import Numbered
from poise.runtime.connectors.route import DirectRoute, NumberedRoute
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.data_age import RemoteClock
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.frame import FrameKind
from poise.wire.records.deployment_records import ConnectorSpec


class Arm(Component):
    @subscribed(keep=5)
    def to(self, message: str) -> None:
        pass


def connector(source_epoch: int) -> ConnectorSpec:
    return ConnectorSpec(
        name="mind.out-arm.to",
        kind="remote",
        source="mind",
        source_epoch=source_epoch,
        source_port="out",
        target="arm",
        target_port="to",
    )


class Receiver:
    """A component that hears one source, of which two incarnations are joined."""

    def __init__(self) -> None:
        self.overtaken = OvertakenSources()
        self.counts = Counts()
        self.came: list[Any] = []
        self.heard = {"to": dict[str, Any]()}

    def hear(self, epoch: int, text: str) -> None:
        spec = connector(epoch)
        feed: Any = SimpleNamespace(
            counts=self.counts, put=lambda entry: self.came.append(entry[1])
        )
        issuer: Any = SimpleNamespace(came=lambda _: None)
        target: Any = self
        port = ports_of(Arm)["to"]
        handle = ReceivingEnd(
            spec=spec,
            target=target,
            port=port,
            feed=feed,
            issuer=issuer,
            remote_clock=RemoteClock(),
        ).handler()
        tag = message_tag(port.type)
        pieces = frame.segments(codec(str), text, FrameKind.MESSAGE, tag=tag)
        handle(frame.parse(b"".join(bytes(each) for each in pieces)))


def test_what_a_lost_source_sent_is_refused_after_what_the_next_one_sent() -> None:
    """It was under way over a link that was cut."""
    arm = Receiver()
    arm.hear(0, "first")
    arm.hear(1, "second")
    arm.hear(0, "late")
    assert arm.came == ["first", "second"]
    assert (arm.counts.errors, arm.counts.drops) == (0, 1)


@pytest.mark.parametrize("route", [DirectRoute, NumberedRoute])
def test_a_message_from_where_its_component_moved_away_is_dropped(
    route: type[DirectRoute],
) -> None:
    """A thread of the component's own may still publish there."""
    arm, taken = Receiver(), list[Any]()
    feed = SimpleNamespace(counts=arm.counts, put=taken.append)
    mailbox = SimpleNamespace(feed=lambda *_: feed)
    target: Any = SimpleNamespace(
        mailbox=mailbox, overtaken=arm.overtaken, heard=arm.heard
    )
    sender: Any = SimpleNamespace(counts=arm.counts, note_room=None)
    here = route(connector(0), target, ports_of(Arm)["to"], sender)
    here.push(None, Numbered((0, 1), False, "first"))
    arm.hear(1, "second")
    here.push(None, Numbered((0, 2), False, "late"))
    assert (len(taken), arm.came) == (1, ["second"])
    assert (arm.counts.errors, arm.counts.drops) == (0, 1)


def test_an_earlier_incarnation_is_heard_when_the_later_one_is_not_joined() -> None:
    arm = Receiver()
    arm.hear(1, "first")
    arm.overtaken.forget("mind.out-arm.to", 1)
    arm.hear(0, "second")
    assert arm.came == ["first", "second"]
