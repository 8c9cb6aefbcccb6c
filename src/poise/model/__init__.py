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
from poise.model.steps import Prefetch

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
    "Prefetch",
    "Robot",
    "Simulator",
    "Task",
    "Workload",
    "load",
]
