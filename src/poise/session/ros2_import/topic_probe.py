"""Measures a topic by a raw subscription, which big topics have only at times."""

from __future__ import annotations

import time
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from poise.session.ros2_import.publisher_count import PublisherCount, stamp_of

MOST_BYTES, MOST_MESSAGES = 2e6, 500
"""A look ends after so much, so that the observer does not load the robot."""
BETWEEN = 5.0
"""[s] from the end of a look to the next one."""
_STAMPED = {"std_msgs/Header", "builtin_interfaces/Time"}


class TopicProbe:
    """Looks at a topic until a look is long enough, and again after a pause."""

    def __init__(self, node: Node, topic: str, message: type) -> None:
        self._node, self._topic, self._message = node, topic, message
        self._is_stamped = starts_with_stamp(message)
        self._subscription: Any = None
        self._look_at = 0.0
        self._bytes = self._messages = 0
        self.publishers: dict[bytes, PublisherCount] = {}
        self.was_sampled = False

    def adjust(self) -> None:
        """Begin or end a look, if it is time to."""
        is_long = self._bytes > MOST_BYTES or self._messages > MOST_MESSAGES
        if self._subscription is None and time.monotonic() >= self._look_at:
            self._bytes = self._messages = 0
            self._subscription = self._node.create_subscription(
                self._message,
                self._topic,
                self._receive,
                QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
                raw=True,
            )
        elif self._subscription is not None and is_long:
            self.was_sampled = True
            self._look_at = time.monotonic() + BETWEEN
            self.close()

    def close(self) -> None:
        """End the look."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _receive(self, data: bytes, info: Mapping[str, Any]) -> None:
        publisher = bytes(info["publisher_gid"]["data"])
        counted = self.publishers.setdefault(publisher, PublisherCount())
        number = info["publication_sequence_number"] or counted.received
        counted.count(len(data), number, info["source_timestamp"])
        self._bytes += len(data)
        self._messages += 1
        if self._is_stamped:
            now = self._node.get_clock().now().nanoseconds
            counted.count_stamp(stamp_of(data), now)


def starts_with_stamp(message: type) -> bool:
    """Return whether the first field of a message type is a stamp or a header."""
    fields: Mapping[str, str] = message.get_fields_and_field_types()  # type: ignore[attr-defined]
    return next(iter(fields.values()), "") in _STAMPED


def message_type(name: str) -> type:
    """Return the class of ``package/msg/Type``; ImportError, AttributeError: none."""
    package, kind, class_name = name.split("/")
    found: type = getattr(import_module(f"{package}.{kind}"), class_name)
    return found
