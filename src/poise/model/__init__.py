"""The records of a robot, and the file that describes it."""

from poise.model.load import load
from poise.model.robot import (
    Action,
    Architecture,
    Chain,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    DeclaredPort,
    Device,
    Generated,
    Link,
    Objective,
    Robot,
    Simulator,
    Task,
    Workload,
)

__all__ = [
    "Action",
    "Architecture",
    "Chain",
    "ComponentEntry",
    "Computer",
    "Connector",
    "ConnectorEnd",
    "DeclaredPort",
    "Device",
    "Generated",
    "Link",
    "Objective",
    "Robot",
    "Simulator",
    "Task",
    "Workload",
    "load",
]
