"""Topics: a published port goes to ROS 2, a subscribed one comes from there."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec
from msgspec import Struct

from poise.clock import ComponentClock
from poise.errors import RobotError
from poise.ros2.arrivals import Arrivals
from poise.ros2.bridge_node import BridgeLine, BridgeNode, annotated
from poise.ros2.conversion import Conversion, Conversions, Convert
from poise.ros2.interfaces import interface
from poise.runtime.component.ports import Port, Published, every, published, subscribed

_HAND_OVER = 1e-6
"""After each message it sleeps [s], so that subscribers in its process run at once: to
wait for ROS 2 again, its executor keeps Python's lock for 0.1 ms."""
_LOOK_EVERY = 2.0
"""So often it looks at what others publish, or want [s]."""
_ERROR = "ERROR: "


class Topics(BridgeNode):
    """What both ways of topics share."""

    @classmethod
    def conversions(cls, clock: ComponentClock) -> list[Conversion]:
        """Return how the messages of each entry are converted."""
        of = Conversions(clock).of
        return [of(cls.port.type, interface(entry.type)) for entry in cls.entries]

    def open(self) -> None:
        """Know nobody yet at the other end of a topic."""
        self._misfits: set[str] = set()

    def _look_at_others(self) -> None:
        """Raise once for each node that does not fit: nothing else says it."""
        for entry in self.entries:
            for text in self._misfitting(entry):
                if text not in self._misfits:
                    self._misfits.add(text)
                    raise RobotError(text)

    def _misfitting(self, entry: BridgeLine) -> Iterator[str]:
        """Yield which nodes at the other end of a topic do not fit, and why."""
        raise NotImplementedError


class ToTopics(Topics):
    """Subscribes to the port, and publishes in ROS 2.

    It has no state, so it gets the last message of a port again where it moves to, and
    its new publishers have one for late subscribers.
    """

    def open(self) -> None:
        """Make the publishers."""
        super().open()
        self._out: list[tuple[Convert, Convert]] = []
        for entry, pair in zip(self.entries, self.conversions(self.clock), strict=True):
            kind = interface(entry.type)
            publisher = self.node.create_publisher(kind, entry.ros2, entry.qos())
            self._out.append((publisher.publish, pair.to_ros))

    def listen(self) -> None:
        """Do not wait for ROS 2, from where nothing comes."""

    @every(_LOOK_EVERY)
    def look_at_subscribers(self) -> None:
        """Raise once for each that does not fit."""
        self._look_at_others()

    def _misfitting(self, entry: BridgeLine) -> Iterator[str]:
        """Yield what subscribers take that this does not give."""
        from rclpy import duration, qos  # noqa: PLC0415, only where a node runs

        offered = entry.qos()
        offered.deadline = offered.liveliness_lease_duration = duration.Infinite
        for other in self.node.get_subscriptions_info_by_topic(entry.ros2):
            if other.topic_type != entry.type:
                yield (
                    f"node '{other.node_name}' takes {other.topic_type} from "
                    f"'{entry.ros2}', where the bridge publishes {entry.type}: it gets "
                    "nothing"
                )
                continue
            fits, why = qos.qos_check_compatible(offered, other.qos_profile)
            if fits == qos.QoSCompatibility.ERROR:
                reasons = [r for r in why.split(";") if r.startswith(_ERROR)]
                yield (
                    f"node '{other.node_name}' gets nothing from '{entry.ros2}', to "
                    "which the bridge publishes: "
                    f"{'; '.join(r.removeprefix(_ERROR).lower() for r in reasons)}"
                )

    def _take(self, message: Any) -> None:  # noqa: ANN401, as the port says
        for publish, to_ros in self._out:
            publish(to_ros(message))


class Came(Struct, frozen=True):
    """The stamps of its `Arrivals`."""

    stamps: Mapping[str, int]


class FromTopics(Topics):
    """Subscribes in ROS 2, and publishes to the port."""

    def snapshot(self) -> Came:
        """Return until when it took messages: its successor gets some of them, too."""
        return Came(dict(self._arrivals.stamps))

    def restore(self, state: Came) -> None:
        """Take nothing that the bridge before has taken."""
        self._arrivals.go_on_from(state.stamps)

    def open(self) -> None:
        """Make the subscriptions."""
        super().open()
        self._arrivals = Arrivals()
        for entry, pair in zip(self.entries, self.conversions(self.clock), strict=True):
            self._subscribe(entry, pair.from_ros)
        self.node.create_timer(_LOOK_EVERY, self._look_at_others)

    def activate(self) -> None:
        """Begin to hear ROS 2, with what came since its predecessor heard the last."""
        self.listen()

    def _subscribe(
        self, entry: BridgeLine, from_ros: Convert, reliability: str = ""
    ) -> None:
        """Subscribe; with less reliability when a publisher offers no more."""
        from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: PLC0415, only where a node runs

        def take(message: Any, info: Mapping[str, Any]) -> None:  # noqa: ANN401, a message
            if not self._arrivals.is_new(info):
                return
            # the port is wired later, and again
            getattr(self, self.port.name).publish(from_ros(message))
            time.sleep(_HAND_OVER)

        def offered_less(event: Any) -> None:  # noqa: ANN401, an event
            policy = event.last_policy_kind.name.lower().rpartition("_")[2]
            if policy != "reliability" or reliability or entry.reliability:
                raise RobotError(
                    f"'{entry.ros2}' has a publisher that offers less {policy} than "
                    "the bridge asks for: nothing comes from it"
                )
            self.log.warning(
                "'%s' has a publisher without reliability: subscribed without it, too",
                entry.ros2,
            )
            self.node.destroy_subscription(subscription)
            self._subscribe(entry, from_ros, "best effort")

        subscription = self.node.create_subscription(
            interface(entry.type),
            entry.ros2,
            take,
            entry.qos(reliability),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=offered_less),
        )

    def _misfitting(self, entry: BridgeLine) -> Iterator[str]:
        """Yield what publishers give that this does not take; the two never meet."""
        for other in self.node.get_publishers_info_by_topic(entry.ros2):
            if other.topic_type != entry.type:
                yield (
                    f"node '{other.node_name}' publishes {other.topic_type} on "
                    f"'{entry.ros2}', where the bridge takes {entry.type}: nothing "
                    "comes from it"
                )


def taking(port: Port, entries: Sequence[BridgeLine]) -> dict[str, Any]:
    """Return what declares the port of `ToTopics`."""

    def take(self: Any, message: Any) -> None:  # noqa: ANN401, as the port says
        self._take(message)

    take.__annotations__["message"] = port.type
    keep = max(entry.depth for entry in entries)
    return {f"take_{port.name}": subscribed(port.name, keep=keep)(take)}


def publishing(port: Port, entries: Sequence[BridgeLine]) -> dict[str, Any]:
    """Return what declares the port of `FromTopics`."""
    latest = any(entry.durability == "transient local" for entry in entries)
    return {port.name: published(latest=latest), **annotated(Published)(port, entries)}


def keeping_last(port: Port, entry: BridgeLine) -> BridgeLine:
    """Return an entry as the port asks for it, where it says nothing of durability."""
    if not port.latest or entry.durability:
        return entry
    return msgspec.structs.replace(entry, durability="transient local", depth=1)
