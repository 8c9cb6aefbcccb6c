"""Observes a running ROS 2 graph; changes nothing in it."""

from __future__ import annotations

import os
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any

import rclpy
from rclpy.action import (
    get_action_client_names_and_types_by_node,
    get_action_server_names_and_types_by_node,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from poise.errors import RunError
from poise.kernel_counters import process_cpu
from poise.session.ros2_import.graph_records import (
    Call,
    CallKind,
    Flow,
    Graph,
    PublisherCount,
    Topic,
    stamp_of,
)
from poise.session.ros2_import.node_processes import ProcessUsage, describe, find_pid

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


_NAME = "poise_import"
_SETTLED = 1.0
"""[s] No node was found for so long: discovery is over."""
_DISCOVERY = 6.0
_POLL = 1.0
"""[s] New topics are looked for so often."""
_EVERY_NODES = {"/rosout", "/parameter_events"}
_PARAMETER_SERVICES = {
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
}
_TOOLS = ("launch_ros_", "rviz", "rqt", "transform_listener_impl_")


def observe(seconds: float) -> Graph:
    """Return what is seen of this environment's graph; RunError: no node was found."""
    try:
        rclpy.init(args=[])
    except RuntimeError as error:  # such as a domain that is no number
        raise RunError(f"ROS 2 does not start: {error}") from None
    try:
        node = Node(_NAME, enable_rosout=False, start_parameter_services=False)
        try:
            return _Observer(node).observe(seconds)
        finally:
            node.destroy_node()
    finally:
        rclpy.shutdown()


def remarks_on(before: set[str], now: Sequence[str]) -> Iterator[str]:
    """Yield which nodes ended, and which names several nodes have."""
    for name in sorted(before - {*now}):
        yield f"{name} ended meanwhile"
    for name, count in sorted(Counter(now).items()):
        if count > 1:
            yield (
                f"{count} nodes are called {name}, of which at most one is seen: "
                "give each a name of its own"
            )


class _Observer:
    def __init__(self, node: Node) -> None:
        self._node = node
        self._probes: dict[str, TopicProbe] = {}
        self._unmeasured: dict[str, str] = {}
        self._nodes: set[str] = set()
        self._pids: dict[str, int] = {}
        self._elsewhere: dict[str, str] = {}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def observe(self, seconds: float) -> Graph:
        self._discover()
        usage = self._usage = ProcessUsage()
        began, own = time.monotonic(), process_cpu(os.getpid())
        self._measure(began + seconds)
        elapsed = time.monotonic() - began
        own_cpu = (process_cpu(os.getpid()) - own) / elapsed
        for name in self._names() - self._nodes:
            self._elsewhere[name] = "it has no publisher that tells its process"
        nodes: dict[int, list[str]] = defaultdict(list)
        for name, pid in self._pids.items():
            nodes[pid].append(name)
        processes = [describe(p, tuple(n), usage) for p, n in nodes.items()]
        topics = tuple(self._topics(elapsed))
        for probe in self._probes.values():
            probe.close()
        return Graph(
            computer=usage.hardware(processes, own_cpu),
            seconds=elapsed,
            processes=tuple(sorted(processes, key=lambda each: each.nodes)),
            topics=topics,
            calls=tuple(self._calls(sorted(self._nodes & self._names()))),
            elsewhere=self._elsewhere,
            remarks=tuple(remarks_on(self._nodes, self._all_names())),
            own_cpu=own_cpu,
        )

    def _discover(self) -> None:
        """Wait until no more nodes are found; later ones are found while measuring."""
        end = time.monotonic() + _DISCOVERY
        found: set[str] = set()
        changed = time.monotonic()
        while time.monotonic() < min(end, changed + _SETTLED) or not found:
            self._executor.spin_once(timeout_sec=0.05)
            if (names := self._names()) != found:
                found, changed = names, time.monotonic()
            if time.monotonic() > end and not found:
                domain = os.environ.get("ROS_DOMAIN_ID", "0")
                raise RunError(
                    f"no ROS 2 node was found within {_DISCOVERY:g} s in domain "
                    f"{domain}: set ROS_DOMAIN_ID and the other variables of ROS 2 as "
                    "where the nodes were started"
                )

    def _names(self) -> set[str]:
        return set(self._all_names())

    def _all_names(self) -> list[str]:
        return [
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
            if name != _NAME and not name.startswith(("_", *_TOOLS))
        ]

    def _measure(self, end: float) -> None:
        """Look at all topics until `end`."""
        looked = -_POLL
        while (now := time.monotonic()) < end:
            if now >= looked + _POLL:
                looked = now
                self._find_nodes()
                self._find_topics()
            for probe in self._probes.values():
                probe.adjust()
            self._executor.spin_once(timeout_sec=min(0.1, end - now))

    def _find_topics(self) -> None:
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._probes or topic in self._unmeasured or _is_hidden(topic):
                continue
            try:
                message = message_type(types[0])
            except (ImportError, AttributeError):
                self._unmeasured[topic] = f"{types[0]} is not installed here"
                continue
            self._probes[topic] = TopicProbe(self._node, topic, message)

    def _topics(self, seconds: float) -> Iterator[Topic]:
        for name, types in sorted(self._node.get_topic_names_and_types()):
            if _is_hidden(name):
                continue
            publishers = self._node.get_publishers_info_by_topic(name)
            subscribers = dict.fromkeys(
                _full_name(info)
                for info in self._node.get_subscriptions_info_by_topic(name)
                if info.node_name != _NAME
            )
            if not (publishers or subscribers):
                continue
            probe = self._probes.get(name)
            counts = probe.publishers if probe else {}
            flows = []
            for info in publishers:
                count = counts.get(bytes(info.endpoint_gid))
                node = _full_name(info)
                flows.append(count.flow(node, seconds) if count else Flow(node=node))
            yield Topic(
                name=name,
                type=types[0],
                flows=tuple(flows),
                subscribers=tuple(subscribers),
                quality=_quality(publishers),
                unmeasured=self._unmeasured.get(name, ""),
            )

    def _find_nodes(self) -> None:
        """Note the processes of nodes that are new, or why they are not known."""
        new = self._names() - self._pids.keys() - self._elsewhere.keys()
        endpoints = self._endpoints() if new else {}
        own = endpoints.get(f"/{_NAME}")
        for name in sorted(new):
            info = endpoints.get(name)
            if info is None or own is None:
                continue  # it is not known whole yet
            self._nodes.add(name)
            if not _is_fast_dds(info) or not _is_fast_dds(own):
                self._elsewhere[name] = _OTHER_DDS
            elif _host(info) != _host(own):
                self._elsewhere[name] = _other_host(find_pid(_low_id(info)))
            elif (pid := find_pid(_low_id(info))) is None:
                self._elsewhere[name] = "its process is not visible here"
            else:
                self._pids[name] = pid
                self._usage.add(pid)

    def _endpoints(self) -> dict[str, TopicEndpointInfo]:
        """Return node -> one of its publishers; nearly every node has one of these."""
        found: dict[str, TopicEndpointInfo] = {}
        names = (topic for topic, _ in self._node.get_topic_names_and_types())
        for topic in (*_EVERY_NODES, *names):
            for info in self._node.get_publishers_info_by_topic(topic):
                found.setdefault(_full_name(info), info)
        return found

    def _calls(self, names: list[str]) -> Iterator[Call]:
        node = self._node
        servers: dict[tuple[CallKind, str, str], set[str]] = defaultdict(set)
        clients: dict[tuple[CallKind, str, str], set[str]] = defaultdict(set)
        for full in names:
            space, _, name = full.rpartition("/")
            space = space or "/"
            for found, services, actions in (
                (
                    servers,
                    node.get_service_names_and_types_by_node(name, space),
                    get_action_server_names_and_types_by_node(node, name, space),
                ),
                (
                    clients,
                    node.get_client_names_and_types_by_node(name, space),
                    get_action_client_names_and_types_by_node(node, name, space),
                ),
            ):
                for service, types in services:
                    if not _is_every_nodes(service):
                        found["service", service, types[0]].add(full)
                for action, types in actions:
                    found["action", action, types[0]].add(full)
        for key in sorted({*servers, *clients}):
            kind, name, type_ = key
            yield Call(
                name=name,
                type=type_,
                kind=kind,
                clients=tuple(sorted(clients[key])),
                servers=tuple(sorted(servers[key])),
            )


def _is_hidden(topic: str) -> bool:
    return topic in _EVERY_NODES or "/_" in topic


def _full_name(info: TopicEndpointInfo) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


_OTHER_DDS = (
    "only Fast DDS tells the process of a node: start the nodes and the import with "
    "RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
)


def _is_fast_dds(info: TopicEndpointInfo) -> bool:
    """Return whether an endpoint's id begins with the vendor of Fast DDS."""
    return bytes(info.endpoint_gid)[:2] == b"\x01\x0f"


def _host(info: TopicEndpointInfo) -> bytes:
    """Return what Fast DDS writes of the computer into the id of an endpoint."""
    return bytes(info.endpoint_gid)[2:4]


def _other_host(pid: int | None) -> str:
    """Return why a node is not here whose host is another; `pid`: who may be it."""
    if pid is None:
        return "it runs on another computer"
    return (
        "it runs on another computer, or it is process "
        f"{pid} here, in a container or started before this computer's network "
        "addresses changed: then restart it"
    )


def _low_id(info: TopicEndpointInfo) -> int:
    """Return the last 16 bits of the process's id, as Fast DDS writes them."""
    return int.from_bytes(bytes(info.endpoint_gid)[4:6], "little")


def _is_every_nodes(service: str) -> bool:
    return "/_action/" in service or service.rpartition("/")[2] in _PARAMETER_SERVICES


def _quality(publishers: list[TopicEndpointInfo]) -> str:
    """Return how reliably publishers send, and whether late subscribers get it."""
    words = dict.fromkeys(
        word
        for info in publishers
        for word in (
            info.qos_profile.reliability.name.lower().replace("_", " "),
            info.qos_profile.durability.name.lower().replace("_", " "),
        )
        if word != "volatile"
    )
    return ", ".join(words)
