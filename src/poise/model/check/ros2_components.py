"""ROS 2 in a robot file: its checks, and the components that nodes and bridges become.

So whatever places, starts, measures and moves components knows nothing of ROS 2.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import to_builtins
from msgspec.structs import replace

from poise.endpoint import Endpoint
from poise.errors import listed
from poise.model.check.allowed_computers import allowed_computers
from poise.model.check.names import component_names, components, connectors
from poise.model.robot import ComponentEntry, Connector, ConnectorEnd, Robot
from poise.model.ros2_node import START, wrong_parameters
from poise.model.software import ComponentCode, Ros2Bridge
from poise.model.yaml_tree import Finding
from poise.units import quoted

NODE = "poise.ros2.node:RosNode"
BRIDGE = "poise.ros2.bridge:Bridge"
_NEAR = 1.0
"""The overhead of a connector to a bridge, so that it is placed beside the port."""


def check_ros2(robot: Robot) -> Iterator[Finding]:
    """Yield what is wrong with nodes, topics and bridges; before `with_ros2`."""
    for path, _, component in components(robot):
        for key, message in _wrong_node(component):
            yield Finding((*path, key), f"component '{component.name}' {message}")
        params = component.ros2.params if component.ros2 else {}
        for name, why in wrong_parameters(params):
            text = f"component '{component.name}': parameter {quoted(name)} {why}"
            yield Finding((*path, "ros2", "params", *name.split(".")), text)
    known = {c.name: c for c in robot.components()}
    bridged = {bridge.port.component for bridge in robot.ros2.bridges}
    is_local = robot.ros2.discovery == "localhost"
    allowed = allowed_computers(robot) if is_local else {}
    for path, _, connector in connectors(robot):
        for message in _wrong_topic(connector, known, bridged):
            yield Finding((*path, "between"), f"the connector {connector} {message}")
        ends = {end.component for end in connector.between}
        computers = {computer for end in ends for computer in allowed.get(end, ())}
        is_one = len(computers) < 2 or any(ends <= {*s} for s in robot.together)  # noqa: PLR2004
        if connector.topic and not is_one:
            text = f"{connector} may join {listed(sorted(computers))}"
            remedy = "write `discovery: computers`, or keep its ends `together`"
            text = f"{text}, but with `discovery: localhost` nodes find none elsewhere"
            yield Finding((*path, "topic"), f"the connector {text}: {remedy}")
    for index, bridge in enumerate(robot.ros2.bridges):
        for message in _wrong_bridge(robot, bridge):
            yield Finding(("ros2", "bridges", index, "port"), message)


def _wrong_node(component: ComponentEntry) -> Iterator[tuple[str, str]]:
    node = component.ros2
    if component.environment and not (component.command or (node and node.executable)):
        yield "environment", "has no process of its own, so it takes no `environment`"
    if node is None:
        return
    for key in ("implementation", "command", "ports"):
        if getattr(component, key):
            yield key, f"is a ROS 2 node: leave `{key}` out"
    if component.parameters:
        yield "parameters", "is a ROS 2 node: write `params` under `ros2`"
    if bool(node.executable) == bool(node.node):
        yield "ros2", "needs either an `executable` or a `node`"
    elif node.node and (node.package or node.arguments):
        key = "package" if node.package else "arguments"
        yield "ros2", f"has a `node`: `{key}` belongs to an `executable`"


def _wrong_topic(
    connector: Connector, known: Mapping[str, ComponentEntry], bridged: set[str]
) -> Iterator[str]:
    """Yield what does not fit an end that is a ROS 2 node."""
    for end in connector.between:
        entry = known.get(end.component)
        if entry is None:
            continue
        if entry.ros2 and not connector.topic:
            yield f"ends at the ROS 2 node '{entry.name}': add `topic: /its_topic`"
        if not connector.topic:
            continue
        if end.port:
            yield f"has a topic of ROS 2, so write '{entry.name}' without a port"
        elif entry.implementation and entry.name not in bridged:
            yield (
                f"has a topic, but '{entry.name}' is no ROS 2 node: add a bridge to "
                "`bridges` under `ros2`"
            )


def _wrong_bridge(robot: Robot, bridge: Ros2Bridge) -> Iterator[str]:
    end, names = bridge.port, component_names(robot)
    name = bridge_of(end)
    if end.component not in names:  # `check_names` says so
        return
    if not robot.component(end.component).implementation:
        yield f"component '{end.component}' has no Python class, so no port to bridge"
    if not end.port:
        yield f"name the port of component '{end.component}' too"
    if name in names:
        yield f"its bridge is called '{name}', as another component is: rename that"


def bridge_of(port: ConnectorEnd) -> str:
    """Return the name of the component that bridges a port."""
    return f"{port.component}-{port.port}-ros2"


def with_ros2(robot: Robot) -> Robot:
    """Return the robot with components for its ROS 2 nodes and bridges."""
    environment = ros2_environment(robot)
    bridges: dict[ConnectorEnd, list[Ros2Bridge]] = {}
    for bridge in robot.ros2.bridges:
        bridges.setdefault(bridge.port, []).append(bridge)
    architectures = []
    for architecture in robot.architectures:
        own = architecture.components
        nodes = [_with_node(entry, environment) for entry in own]
        added = [
            _bridge(entry, lines, environment)
            for entry in own
            for port, lines in bridges.items()
            if port.component == entry.name
        ]
        architectures.append(replace(architecture, components=(*nodes, *added)))
    return replace(robot, architectures=tuple(architectures))


def with_code(robot: Robot, code: Mapping[str, ComponentCode]) -> Robot:
    """Return the robot with what its classes declare, and its bridges connected."""
    limits: dict[ConnectorEnd, float] = {}
    for bridge in robot.ros2.bridges:
        limits[bridge.port] = max(bridge.limit, limits.get(bridge.port, 0.0))
    architectures = []
    for architecture in robot.architectures:
        names = {component.name for component in architecture.components}
        joined = tuple(
            _to_bridge(port, limit, code)
            for port, limit in limits.items()
            if port.component in names and port.component in code
        )
        connectors = (*architecture.connectors, *joined)
        architectures.append(replace(architecture, connectors=connectors))
    return replace(robot, architectures=tuple(architectures), code=code)


def _to_bridge(
    port: ConnectorEnd, limit: float, code: Mapping[str, ComponentCode]
) -> Connector:
    ends = port, ConnectorEnd(bridge_of(port), port.port)
    if code[port.component].ports[port.port] in {"subscribes", "provides"}:
        ends = ends[1], ends[0]
    return Connector(between=ends, overhead=_NEAR, limit=limit)


def _with_node(entry: ComponentEntry, environment: Mapping[str, str]) -> ComponentEntry:
    node = entry.ros2
    if node is None:
        return entry
    if node.executable:
        merged = {**environment, **entry.environment}
        return replace(entry, command=node.command(), environment=merged)
    start = {
        "node": node.node,
        "arguments": list(node.names()),
        "environment": dict(environment),
    }
    parameters = {START: start, **node.params}
    return replace(entry, implementation=NODE, parameters=parameters)


def _bridge(
    entry: ComponentEntry, bridges: list[Ros2Bridge], environment: Mapping[str, str]
) -> ComponentEntry:
    return ComponentEntry(
        name=bridge_of(bridges[0].port),
        implementation=BRIDGE,
        only=entry.only,
        movable=entry.movable,
        when_cut_off=entry.when_cut_off,
        parameters={
            "of": entry.implementation,
            "port": bridges[0].port.port,
            "bridges": [{**to_builtins(bridge), "port": ""} for bridge in bridges],
            "environment": dict(environment),
        },
    )


def ros2_environment(robot: Robot) -> dict[str, str]:
    """Return the environment variables with which its nodes find each other."""
    network, variables = robot.ros2, {}
    if network.domain is not None:
        variables["ROS_DOMAIN_ID"] = str(network.domain)
    discovery = network.discovery
    if discovery == "computers" and not robot.is_emulated:
        addresses = [c.address for c in robot.computers if c.address is not None]
        peers = (Endpoint.parse(address).host for address in addresses)
        variables["ROS_STATIC_PEERS"] = ";".join(peers)
    if discovery is not None:
        # an emulated network has no others in it, and no addresses yet
        is_wide = discovery == "subnet" or (
            discovery == "computers" and robot.is_emulated
        )
        reach = "SUBNET" if is_wide else "LOCALHOST"
        variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] = reach
    return variables
