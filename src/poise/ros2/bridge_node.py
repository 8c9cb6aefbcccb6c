"""What all bridges share: a node of their own, whose callbacks a component runs."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any, ClassVar

from msgspec import Struct

from poise.clock import ComponentClock
from poise.ros2 import ros_context
from poise.ros2.executor_source import ExecutorSource
from poise.runtime.component.component import Component
from poise.runtime.component.ports import Port

_FOUND_WITHIN = 3.5
"""Fast DDS announces itself again after 3 s when its first datagrams are lost [s]."""
_SETTLED = 0.5
"""All other nodes and their ends are known when no more came for so long [s]."""
_LOOK_EVERY = 0.02


class BridgeLine(Struct, frozen=True, kw_only=True):
    """One line of `bridges` in the robot file."""

    ros2: str
    method: str = ""
    type: str = ""
    reliability: str | None = None
    durability: str | None = None
    depth: int = 10
    limit: float = 1.0
    port: str = ""

    def qos(self, reliability: str = "") -> Any:  # noqa: ANN401, a profile of rclpy
        """Return the quality of service that it asks for, or with less reliability."""
        from rclpy import qos  # noqa: PLC0415, only where a node runs

        reliability = reliability or self.reliability or "reliable"
        durability = self.durability or "volatile"
        return qos.QoSProfile(
            depth=self.depth,
            reliability=qos.ReliabilityPolicy[reliability.replace(" ", "_").upper()],
            durability=qos.DurabilityPolicy[durability.replace(" ", "_").upper()],
        )


class BridgeNode(Component):
    """The other end of a port."""

    _start_parameters = frozenset({"of", "port", "bridges", "environment"})
    port: ClassVar[Port]
    entries: ClassVar[Sequence[BridgeLine]]

    @classmethod
    def conversions(cls, clock: ComponentClock) -> Any:  # noqa: ANN401, for each entry
        """Return what converts the values of each entry; RobotError: they misfit."""
        raise NotImplementedError

    def __init__(self) -> None:
        self.closing = ExitStack()

    def configure(self) -> None:
        """Make a node of its own."""
        ros_context.join(self.parameters["environment"])
        self.closing.callback(ros_context.leave)
        self.node = ros_context.node_of(re.sub(r"\W", "_", f"poise_{self.name}"))
        self.closing.callback(self.node.destroy_node)
        self.source = ExecutorSource(self.node, self._context.give_up)
        self.closing.callback(self.source.close)
        self.open()
        if self._context.follows:
            self._find_others()

    def _find_others(self) -> None:
        """Wait until ROS 2 has found other nodes: what they send before is lost."""
        began = changed = now = time.monotonic()
        own, known = self.node.get_name(), list[Any]()
        while now < (changed + _SETTLED if known else began + _FOUND_WITHIN):
            before, names = known, sorted(self.node.get_node_names())
            known = [*names, *self._ends_there()] if {*names} - {own} else []
            changed = now if known != before else changed
            time.sleep(_LOOK_EVERY)
            now = time.monotonic()

    def _ends_there(self) -> Sequence[int]:
        """Return how many ends there are at the topics and services of its own."""
        node, services = self.node, ("/_action/send_goal", "/_action/get_result", "")
        names = [entry.ros2 for entry in self.entries]
        return [
            *(node.count_clients(name + each) for name in names for each in services),
            *(node.count_publishers(name) for name in names),
        ]

    def open(self) -> None:
        """Make the node's ends."""
        raise NotImplementedError

    def activate(self) -> None:
        """Begin to hear ROS 2."""
        if self._context.takes_over():
            ros_context.drop_requests(self.node)
        self.listen()

    def listen(self) -> None:
        """Let callbacks run on the component's thread."""
        self._context.listen(self.source)

    def deactivate(self) -> None:
        """Hear nothing any more."""
        self._context.listen(None)

    def cleanup(self) -> None:
        """Destroy the node, and before it what it does not know."""
        self.closing.close()


def annotated(form: Any) -> Callable[..., dict[str, Any]]:  # noqa: ANN401, of a port
    """Return what declares a port of a form, such as `Published`."""
    return lambda port, _: {"__annotations__": {port.name: form[port.type]}}
