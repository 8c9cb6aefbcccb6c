"""The records of a robot, and the file that describes it."""

from poise.model.load import load
from poise.model.robot import (
    Action,
    Architecture,
    Chain,
    Component,
    Computer,
    Connector,
    DeclaredPort,
    Device,
    End,
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
    "Component",
    "Computer",
    "Connector",
    "DeclaredPort",
    "Device",
    "End",
    "Generated",
    "Link",
    "Objective",
    "Robot",
    "Simulator",
    "Task",
    "Workload",
    "load",
]
