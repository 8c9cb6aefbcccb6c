"""ROS 2 around a robot: where its nodes look for others, and bridges to ports."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Struct

from poise.model.file_keys import END, Name, note, says
from poise.model.ros2_node import RosName
from poise.model.software import ConnectorEnd

_WORD = r"[A-Za-z][A-Za-z0-9_]*"
RosType = Annotated[
    str,
    note(
        pattern=rf"^{_WORD}/(msg|srv|action)/{_WORD}$",
        expected="package/msg/Name, package/srv/Name or package/action/Name",
        examples=("sensor_msgs/msg/LaserScan", "std_srvs/srv/Trigger"),
    ),
]
Reliability = Literal["reliable", "best effort"]
Durability = Literal["volatile", "transient local"]
Discovery = Literal["subnet", "localhost", "computers"]


class Ros2Bridge(Struct, frozen=True, kw_only=True):
    """Joins a port of a component with a topic, a service or an action of ROS 2.

    The port says the direction: what is published goes to ROS 2, what is subscribed
    comes from there; provided methods are served to ROS 2, required ones are asked
    there.
    """

    ros2: Annotated[RosName, says("The topic, service or action: /scan.")]
    port: Annotated[ConnectorEnd, END, says("The component's port: scanner.scan.")]
    method: Annotated[
        Name, says("The method of an interface with several.", is_nullable=True)
    ] = ""
    type: Annotated[
        RosType,
        says(
            "Its type in ROS 2: sensor_msgs/msg/LaserScan. Default: the only one that "
            "is called as the port's message or interface.",
            is_nullable=True,
        ),
    ] = ""
    reliability: Annotated[
        Reliability | None, says("Default: as the other side's; if unknown, reliable.")
    ] = None
    durability: Annotated[
        Durability | None, says("Default: transient local for a port with `latest`.")
    ] = None
    depth: Annotated[int, says("How many messages wait at most.", ge=1, le=10000)] = 10


class Ros2Network(Struct, frozen=True, kw_only=True):
    """How the robot's ROS 2 nodes find each other."""

    domain: Annotated[
        int | None,
        says("ROS_DOMAIN_ID. Default: that of `poise agent`.", ge=0, le=232),
    ] = None
    discovery: Annotated[
        Discovery | None,
        says(
            "Where nodes look for others: in the subnet by multicast, on their own "
            "computer, or on the computers of the robot file, without multicast. "
            "Default: as the environment of `poise agent` says."
        ),
    ] = None
    bridges: Annotated[
        tuple[Ros2Bridge, ...],
        says("Ports of components that are joined with ROS 2."),
    ] = ()
