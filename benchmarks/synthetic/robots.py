"""Robots of synthetic components."""

from __future__ import annotations

from pathlib import Path

from poise.model import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Robot,
)

FOLDER = str(Path(__file__).parents[1])
TOGETHER = 24
LIGHT_RATE = 5.0
"""How often a light component does next to nothing [1/s]."""
_MIB = 2.0**20
_MODULE = "synthetic.workers"


def alone(cpu: float, dearer_at: float = float("inf")) -> Robot:
    """Return a robot with one component that uses `cpu` [cores]."""
    parameters = {"cpu": cpu, "memory": 32 * _MIB}
    if dearer_at < float("inf"):
        parameters["dearer_at"] = dearer_at
    return _robot(
        (
            Architecture(
                name="alone",
                function="alone",
                components=(_component("worker", "Worker", parameters),),
            ),
        )
    )


def together(share: float = 1.0) -> Robot:
    """Return a robot with 24 components in four containers.

    In each six: three workers, and a caller that calls a server and feeds a sink. They
    use 70 % of a core, times `share`.
    """
    groups = range(TOGETHER // 6)
    return _robot(tuple(_group(number, share) for number in groups))


def truths(robot: Robot) -> dict[str, float]:
    """Return component -> what it uses [cores]."""
    return {c.name: float(c.parameters["cpu"]) for c in robot.components()}


def held(robot: Robot) -> dict[str, float]:
    """Return component -> memory that it holds [bytes], of those that hold any."""
    return {
        c.name: float(c.parameters["memory"])
        for c in robot.components()
        if "memory" in c.parameters
    }


def sizes(robot: Robot) -> dict[str, float]:
    """Return connector -> what its messages hold [bytes], of those with messages."""
    parameters = {c.name: c.parameters for c in robot.components()}
    return {
        str(connector): float(parameters[connector.between[0].component]["size"])
        for connector in robot.all_connectors()
        if connector.between[0].port == "blocks"
    }


def light(num: int) -> Robot:
    """Return a robot with `num` nearly idle components, ten in each container."""
    return _many("Light", num // 10, 10)


def silent(containers: int) -> Robot:
    """Return a robot with so many containers of six components that do nothing."""
    return _many("Silent", containers, 6)


def _many(class_: str, containers: int, in_each: int) -> Robot:
    return _robot(
        tuple(
            Architecture(
                name=f"group{k}",
                function=f"group{k}",
                components=tuple(
                    _component(f"part{k}_{i}", class_, {"cpu": 0.0})
                    for i in range(in_each)
                ),
            )
            for k in range(containers)
        )
    )


def _group(k: int, share: float) -> Architecture:
    parts = (
        _component(f"small{k}", "Worker", {"cpu": 0.01 * share, "memory": 4 * _MIB}),
        _component(f"large{k}", "Worker", {"cpu": 0.06 * share, "memory": 16 * _MIB}),
        _component(f"caller{k}", "Caller", {"cpu": 0.02 * share, "size": 8192}),
        _component(f"server{k}", "Server", {"cpu": 0.05 * share}),
        _component(f"sink{k}", "Sink", {"cpu": 0.03 * share}),
        _component(f"tiny{k}", "Worker", {"cpu": 0.005 * share, "memory": _MIB}),
    )
    return Architecture(
        name=f"group{k}",
        function=f"group{k}",
        components=parts,
        connectors=(
            _connector(f"caller{k}.server", f"server{k}.work_port"),
            _connector(f"caller{k}.blocks", f"sink{k}.blocks"),
        ),
    )


def _component(name: str, class_: str, parameters: dict[str, float]) -> ComponentEntry:
    return ComponentEntry(
        name=name, implementation=f"{_MODULE}:{class_}", parameters=parameters
    )


def _connector(source: str, target: str) -> Connector:
    ends = (ConnectorEnd(*source.split(".")), ConnectorEnd(*target.split(".")))
    return Connector(between=ends)


def _robot(architectures: tuple[Architecture, ...]) -> Robot:
    computer = Computer(name="bench", capacity={"cpu": 1.0, "memory": 1024 * _MIB})
    return Robot(
        name="synthetic",
        computers=(computer,),
        architectures=architectures,
        folder=FOLDER,
    )
