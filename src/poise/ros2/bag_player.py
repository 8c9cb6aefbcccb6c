"""Plays a bag into ROS 2, as raw as it was recorded, for bridges and nodes to hear."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

from poise.clock import wall_time
from poise.errors import RobotError
from poise.ros2 import ros_context
from poise.ros2.interfaces import interface
from poise.runtime.replay import PAUSE, Due, Replay
from poise.wire.bag_file import Bag, BagMessage

Publish = Callable[[BagMessage], None]
_NANO = 1_000_000_000


class BagPlayer(Replay):
    """Publishes the ``topics`` of a ``bag``, again and again, beside its ports."""

    def __init__(self) -> None:
        self._closing = ExitStack()

    def configure(self) -> None:
        """Make a publisher for each topic."""
        super().configure()
        bag = Bag(Path(self.parameters["bag"]))
        ros_context.join(self.parameters["environment"])
        self._closing.callback(ros_context.leave)
        node = ros_context.node_of("poise_bag_player")
        self._closing.callback(node.destroy_node)
        publishers = {
            topic: _publisher(node, bag, topic) for topic in self.parameters["topics"]
        }
        self._streams.append(self._played(bag, publishers))

    def cleanup(self) -> None:
        """Destroy the node."""
        self._closing.close()

    def _played(self, bag: Bag, publishers: dict[str, Publish]) -> Iterator[Due]:
        for turn in count():
            began = turn * (bag.seconds + PAUSE)
            first = None
            for message in bag.messages(publishers):
                first = message.at if first is None else first
                send = partial(publishers[message.topic], message)
                yield began + message.at - first, send
            if first is None:  # there is nothing to play
                return


def _publisher(node: Any, bag: Bag, topic: str) -> Publish:  # noqa: ANN401, of rclpy
    """Return what publishes messages of a topic, which are serialised already."""
    from rclpy import qos  # noqa: PLC0415, only where a node runs

    try:
        kind = interface(bag.types[topic])
    except RobotError as error:
        raise RobotError(f"bag {bag.path}, topic '{topic}': {error}") from None
    # offers what any subscriber may ask for
    transient = qos.DurabilityPolicy.TRANSIENT_LOCAL
    profile = qos.QoSProfile(depth=10, durability=transient)
    publisher = node.create_publisher(kind, topic, profile)
    first = next(iter(kind.get_fields_and_field_types().values()), "")
    has_header = first == "std_msgs/Header"

    def publish(message: BagMessage) -> None:
        """Publish a message, as old as it was when it was recorded."""
        later, data = wall_time() - message.at, message.data
        publisher.publish(stamped_later(data, later) if has_header else data)

    return publish


def stamped_later(data: bytes, by: float) -> bytes:
    """Return a serialised message with a later stamp [s] in the header it begins with.

    A stamp of zero, which says that there is none, stays.
    """
    layout = struct.Struct("<iI" if data[1] & 1 else ">iI")
    seconds, nano = layout.unpack_from(data, _AT)
    if not seconds and not nano:
        return data
    moved = divmod(seconds * _NANO + nano + round(by * _NANO), _NANO)
    return data[:_AT] + layout.pack(*moved) + data[_AT + layout.size :]


_AT = 4
"""Where a serialised message begins, behind what says how it is serialised."""
