"""Which messages a bridge takes that was moved."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from poise.errors import RobotError
from poise.ros2.arrivals import Arrivals
from poise.ros2.bridge_node import BridgeLine
from poise.ros2.topic_bridges import FromTopics, ToTopics


class Taking:
    """A bridge whose subscription is called by hand."""

    def __init__(self) -> None:
        self.took: list[str] = []
        self.bridge: Any = object.__new__(FromTopics)
        self.bridge._arrivals = Arrivals()
        port = SimpleNamespace(publish=self.took.append)
        self.bridge.__dict__ |= {"port": SimpleNamespace(name="said"), "said": port}
        self.bridge.node = SimpleNamespace(create_subscription=self._created)
        line = BridgeLine(ros2="/said", type="std_msgs/msg/String")
        self.bridge._subscribe(line, lambda message: message)

    def _created(self, kind: Any, topic: str, take: Any, *_: Any, **__: Any) -> None:
        del kind, topic
        self.take = take

    def takes(self, text: str, publisher: int, stamp: int) -> None:
        """Let a message come."""
        gid = {"implementation_identifier": "any", "data": [publisher] * 16}
        self.take(text, {"publisher_gid": gid, "source_timestamp": stamp})


@pytest.mark.slow
def test_a_message_is_new_by_the_clock_of_its_publisher() -> None:
    before = Taking()
    before.takes("ahead", publisher=1, stamp=1000)
    before.takes("late", publisher=2, stamp=400)
    after = Taking()
    after.bridge.restore(before.bridge.snapshot())
    after.takes("ahead", publisher=1, stamp=1000)  # the last ones come again
    after.takes("late", publisher=2, stamp=400)
    after.takes("new", publisher=2, stamp=500)
    after.takes("set back", publisher=2, stamp=300)
    assert after.took == ["new", "set back"]


@pytest.mark.slow
def test_publishers_of_another_type_are_told_of_once() -> None:
    bridge: Any = object.__new__(FromTopics)
    bridge._misfits = set()
    bridge.__dict__["entries"] = [BridgeLine(ros2="/said", type="std_msgs/msg/String")]
    types = {"talker": "std_msgs/msg/Int32", "teller": "std_msgs/msg/String"}
    others = [
        SimpleNamespace(node_name=name, topic_type=type_)
        for name, type_ in types.items()
    ]
    topics = {"/said": others}
    bridge.node = SimpleNamespace(get_publishers_info_by_topic=topics.__getitem__)
    what = "node 'talker' publishes std_msgs/msg/Int32 on '/said', where the bridge "
    with pytest.raises(RobotError, match=f"{what}takes std_msgs/msg/String"):
        bridge._look_at_others()
    bridge._look_at_others()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("type_", "reliability", "why"),
    [
        ("std_msgs/msg/Int32", "BEST_EFFORT", "takes std_msgs/msg/Int32 from '/said'"),
        ("std_msgs/msg/String", "RELIABLE", "gets nothing from '/said', to which .*: "),
        ("std_msgs/msg/String", "BEST_EFFORT", ""),
    ],
)
def test_subscribers_that_get_nothing_are_told_of_once(
    type_: str, reliability: str, why: str
) -> None:
    from rclpy import duration, qos  # noqa: PLC0415, where it is there

    line = BridgeLine(
        ros2="/said", type="std_msgs/msg/String", reliability="best effort"
    )
    wants = qos.QoSProfile(  # with all policies, as discovery tells them
        depth=1,
        reliability=qos.ReliabilityPolicy[reliability],
        deadline=duration.Infinite,
        liveliness_lease_duration=duration.Infinite,
    )
    other = SimpleNamespace(node_name="ear", topic_type=type_, qos_profile=wants)
    bridge: Any = object.__new__(ToTopics)
    bridge._misfits = set()
    bridge.__dict__["entries"] = [line]
    bridge.node = SimpleNamespace(get_subscriptions_info_by_topic=lambda _: [other])
    if why:
        with pytest.raises(RobotError, match=f"^node 'ear' {why}"):
            bridge.look_at_subscribers()
    bridge.look_at_subscribers()
