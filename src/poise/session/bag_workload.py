"""A bag of ROS 2 as what comes into a robot, by its bridges and the topics of nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from msgspec import Struct

from poise.errors import UsageError, listed
from poise.estimate.profiles import ConnectorProfile
from poise.model.check.ros2_components import bridge_of, ros2_environment
from poise.model.robot import Robot
from poise.model.software import Ros2Bridge
from poise.runtime.replay import PAUSE
from poise.session.record_run import message_type
from poise.wire.bag_file import Bag


def topic_name(name: str) -> str:
    """Return a topic as bags have it, of nodes without a namespace."""
    return "/" + name.strip("/")


class PlayedBag(Struct, frozen=True):
    """What the component that plays a bag into ROS 2 is told, as its parameters."""

    bag: str
    topics: tuple[str, ...]
    environment: Mapping[str, str]


def played_bag(robot: Robot, path: Path) -> PlayedBag:
    """Return what of a bag the robot takes in; UsageError: it lacks something."""
    topics = _topics(robot, Bag(path))
    return PlayedBag(str(path), tuple(topics), ros2_environment(robot))


def bag_traffic(robot: Robot, path: Path) -> Mapping[str, ConnectorProfile]:
    """Return connector -> what a bag brings over it, on average."""
    bag = Bag(path)
    topics = _topics(robot, bag)
    counts, sizes = Counter[str](), Counter[str]()
    for message in bag.messages(topics):
        counts[message.topic] += 1
        sizes[message.topic] += len(message.data)
    return {
        connector: ConnectorProfile(
            messages=count / (bag.seconds + PAUSE), size=sizes[topic] / count
        )
        for topic, count in counts.items()
        for connector in topics[topic]
    }


def _topics(robot: Robot, bag: Bag) -> dict[str, list[str]]:
    """Return topic of a bag that the robot takes in -> the connectors that bring it."""
    sent = {topic_name(c.topic) for c in robot.all_connectors() if c.topic}
    topics: dict[str, list[str]] = {}
    for connector in robot.connectors:
        if connector.topic:
            topics.setdefault(topic_name(connector.topic), []).append(str(connector))
    lacking = []
    for bridge in _taking(robot):
        topic, found = topic_name(bridge.ros2), bag.types.get(topic_name(bridge.ros2))
        own = bridge_of(bridge.port)
        topics.setdefault(topic, []).extend(
            str(c) for c in robot.all_connectors() if c.between[0].component == own
        )
        if found is None and topic not in sent:
            lacking.append(f"no topic '{topic}', which {bridge.port} takes")
        elif found and not found.endswith(wanted := _type_of(robot, bridge)):
            lacking.append(f"{found} on '{topic}', and {bridge.port} takes {wanted}")
        elif topic in bag.silent:
            lacking.append(f"no message on '{topic}', which {bridge.port} takes")
    inner = {topic_name(c.topic) for a in robot.architectures for c in a.connectors}
    topics = {t: c for t, c in topics.items() if t in bag.types and t not in inner}
    if lacking or bag.silent.issuperset(topics):
        what = "; ".join(lacking) or "nothing that comes into the robot"
        has = listed(sorted(bag.types.keys() - bag.silent))
        raise UsageError(
            f"bag {bag.path} has {what}. It has {has}. Record it "
            "(`ros2 bag record`), or let `workload` generate messages for the port"
        )
    return topics


def _type_of(robot: Robot, bridge: Ros2Bridge) -> str:
    """Return the type that a bridge takes, or how its name ends if that is all."""
    return bridge.type or "/" + message_type(robot, bridge.port).rpartition(":")[2]


def _taking(robot: Robot) -> Iterator[Ros2Bridge]:
    """Yield the bridges whose ports take messages, which the workload makes not."""
    workload = robot.workload
    made = {str(each.port) for each in workload.generate} if workload else set()
    for bridge in robot.ros2.bridges:
        code = robot.code.get(bridge.port.component)
        kind = code and code.ports.get(bridge.port.port)
        if kind == "subscribes" and str(bridge.port) not in made:
            yield bridge
