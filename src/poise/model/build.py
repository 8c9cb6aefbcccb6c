"""Turns the sections of a robot file into the records of a robot."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

from poise.model import robot, sections


def build(source: sections.RobotSection, folder: str) -> robot.Robot:
    """Return the robot of a valid file in `folder`."""
    return robot.Robot(
        name=source.robot,
        computers=tuple(_computer(n, c) for n, c in source.computers.items()),
        devices=tuple(
            robot.Device(name=n, computer=d.computer, path=d.path)
            for n, d in source.devices.items()
        ),
        links=tuple(_link(link) for link in source.links),
        architectures=tuple(
            _architecture(n, a) for n, a in source.architectures.items()
        ),
        connectors=_connectors(source.connectors),
        chains=tuple(
            robot.Chain(name=n, through=tuple(c.through), deadline=c.deadline)
            for n, c in source.chains.items()
        ),
        tasks=tuple(_task(n, t) for n, t in source.tasks.items()),
        objective=_objective(source.objective),
        quality_weight=source.objective.quality,
        together=tuple(map(tuple, source.together)),
        apart=tuple(map(tuple, source.apart)),
        simulator=_simulator(source.simulator),
        workload=_workload(source.workload),
        profile=source.profile or "",
        folder=folder,
    )


def _computer(name: str, source: sections.ComputerSection) -> robot.Computer:
    capacity = _amounts(source)
    reserve = source.reserve
    if not isinstance(reserve, Mapping):
        # Of a countable resource, a share would leave a part that nothing can use.
        reserve = dict.fromkeys(("cpu", "memory"), reserve) if reserve else {}
    return robot.Computer(
        name=name,
        capacity=capacity,
        speed=source.speed,
        reserve=reserve,
        price=source.price,
        address=source.address,
    )


def _link(source: sections.LinkSection) -> robot.Link:
    return robot.Link(
        between=source.between,
        bandwidth=float("inf") if source.bandwidth is None else source.bandwidth,
        latency=source.latency,
        distance=source.distance,
    )


def _architecture(
    name: str, source: sections.ArchitectureSection
) -> robot.Architecture:
    return robot.Architecture(
        name=name,
        function=source.function,
        layer=source.layer,
        priority=source.priority,
        quality=source.quality,
        home=source.home,
        components=tuple(_component(n, c) for n, c in source.components.items()),
        connectors=_connectors(source.connectors),
    )


def _component(name: str, source: sections.ComponentSection) -> robot.Component:
    return robot.Component(
        name=name,
        implementation=source.implementation or "",
        command=_command(source.command),
        demand=_amounts(source),
        devices=tuple(source.devices),
        only=tuple(source.only),
        movable=source.movable,
        isolated=source.isolated,
        state=source.state,
        ports=tuple(
            robot.DeclaredPort(name=n, kind=kind, type=reference)
            for n, port in source.ports.items()
            for kind, reference in port.items()
        ),
        parameters=source.parameters,
    )


def _connectors(
    source: Sequence[sections.ConnectorSection],
) -> tuple[robot.Connector, ...]:
    return tuple(
        robot.Connector(
            between=(_end(c.between[0]), _end(c.between[1])),
            overhead=c.overhead,
            message=c.message,
            rate=c.rate,
            limit=c.limit,
        )
        for c in source
    )


def _end(text: str) -> robot.End:
    component, _, port = text.partition(".")
    return robot.End(component, port)


def _task(name: str, source: sections.TaskSection) -> robot.Task:
    return robot.Task(
        name=name,
        actions=tuple(
            robot.Action(name=a.name, functions=tuple(a.functions))
            for a in source.actions
        ),
    )


def _objective(source: sections.ObjectiveSection) -> robot.Objective:
    return robot.Objective(
        communication=source.communication,
        balance=source.balance,
        scale=source.scale,
        spread=source.spread,
        weights=source.weights,
        sizes=source.sizes,
    )


def _simulator(source: sections.SimulatorSection | None) -> robot.Simulator | None:
    if source is None:
        return None
    return robot.Simulator(command=_command(source.command))


def _workload(source: sections.WorkloadSection | None) -> robot.Workload | None:
    if source is None:
        return None
    return robot.Workload(
        command=_command(source.command),
        recording=source.recording or "",
        generate=tuple(
            robot.Generated(
                port=_end(port),
                rate=each.rate,
                arrivals=each.arrivals,
                size=each.size,
                variation=each.variation,
                message=each.message or "",
                seed=each.seed,
            )
            for port, each in source.generate.items()
        ),
    )


def _command(source: str | Sequence[str] | None) -> tuple[str, ...]:
    return tuple(shlex.split(source) if isinstance(source, str) else source or ())


def _amounts(
    source: sections.ComputerSection | sections.ComponentSection,
) -> dict[str, float]:
    own = {"cpu": source.cpu, "memory": source.memory}
    given = {name: amount for name, amount in own.items() if amount is not None}
    return {**given, **source.resources}
