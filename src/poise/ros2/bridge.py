"""Joins a port of a component with ROS 2: the component knows nothing of it.

A bridge is a component itself, connected to the port; so it is placed, measured and
restarted as others are. Which way messages go, the port says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from poise.clock import SystemClock
from poise.decoding import convert
from poise.errors import RobotError, did_you_mean, listed
from poise.ros2 import ros_context
from poise.ros2.bridge_node import BridgeLine, BridgeNode, annotated
from poise.ros2.interfaces import named
from poise.ros2.service_bridges import (
    AsksActions,
    AsksRos,
    ServesActions,
    ServesRos,
    answering,
)
from poise.ros2.topic_bridges import (
    FromTopics,
    ToTopics,
    keeping_last,
    publishing,
    taking,
)
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import find
from poise.runtime.component.ports import Port, Required, methods_of, ports_of


class Bridge(BridgeNode):
    """The other end of the port that its parameters name."""

    @classmethod
    def __poise_specialised__(
        cls, parameters: Mapping[str, Any], folder: str
    ) -> type[Component]:
        """Return a class whose port fits the port that it bridges."""
        ros_context.rclpy()
        component, name = find(parameters["of"], folder), parameters["port"]
        ports = ports_of(component)
        if name not in ports:
            raise RobotError(
                f"'{parameters['of']}' has no port '{name}'"
                f"{did_you_mean(name, ports)}; ports: {listed(ports)}"
            )
        port = ports[name]
        entries = convert(parameters["bridges"], list[BridgeLine])
        kind = _kind(port, entries)
        _check_used(kind, entries)
        base, declaring = _SIDES[port.kind, kind]
        entries = [_full(port, kind, entry) for entry in entries]
        own = {"port": port, **declaring(port, entries)}
        own["entries"] = [keeping_last(port, entry) for entry in entries]
        made: Any = type(cls.__name__, (base,), own)
        made.conversions(SystemClock())  # `poise check` says what misfits
        return made  # type: ignore[no-any-return]


_SIDES: Mapping[
    tuple[str, str], tuple[type[BridgeNode], Callable[..., dict[str, Any]]]
] = {
    ("publishes", "msg"): (ToTopics, taking),
    ("subscribes", "msg"): (FromTopics, publishing),
    ("provides", "srv"): (ServesRos, annotated(Required)),
    ("requires", "srv"): (AsksRos, answering),
    ("provides", "action"): (ServesActions, annotated(Required)),
    ("requires", "action"): (AsksActions, answering),
}
"""The kinds of a port and of ROS 2 -> what bridges them, and declares its own port."""


def _kind(port: Port, entries: Sequence[BridgeLine]) -> str:
    """Return whether a port is bridged by messages, services or actions."""
    fitting = [kind for of, kind in _SIDES if of == port.kind]
    said = {entry.type.split("/")[1]: entry.type for entry in entries if entry.type}
    for kind, type_ in said.items():
        if kind not in fitting:
            raise RobotError(
                f"'{port.name}' {port.kind}, so it takes no {type_}, but a "
                f"{' or '.join(fitting)}"
            )
    if len(said) > 1:
        raise RobotError(
            f"'{port.name}' is bridged by {listed(said.values())}: take either "
            "services or actions for all of its methods"
        )
    return next(iter(said), fitting[0])


def _check_used(kind: str, entries: Sequence[BridgeLine]) -> None:
    """Raise RobotError for a key that such bridges do not heed."""
    unused: tuple[str, ...]
    unused, others = ("reliability", "durability", "depth"), "topics"
    if kind == "msg":
        unused, others = ("method", "limit"), "services and actions"
    for entry in entries:
        plain = BridgeLine(ros2=entry.ros2)
        for key in unused:
            if getattr(entry, key) != getattr(plain, key):
                raise RobotError(f"'{entry.ros2}' has `{key}`, which is for {others}")


def _full(port: Port, kind: str, entry: BridgeLine) -> BridgeLine:
    full = entry.type or named(port.type.__qualname__, kind)
    method = entry.method
    if kind != "msg" and not method:
        known = methods_of(port.type)
        if len(known) != 1:
            raise RobotError(
                f"'{port.name}' has several methods, so write `method: ` one of "
                f"{listed(known)}"
            )
        method = known[0]
    return msgspec.structs.replace(entry, type=full, method=method)
