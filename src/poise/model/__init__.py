"""What a robot is, and the file that describes it."""

from poise.model.load import load
from poise.model.robot import (
    Action,
    Architecture,
    Chain,
    Component,
    Computer,
    Connector,
    Device,
    End,
    Generated,
    Link,
    Objective,
    Port,
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
    "Device",
    "End",
    "Generated",
    "Link",
    "Objective",
    "Port",
    "Robot",
    "Simulator",
    "Task",
    "Workload",
    "load",
]
