"""The records of a robot, and the file that describes it."""

from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from poise.model.loading import load

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


def __getattr__(name: str) -> object:
    """Import what reads files, which takes long, when it is first asked for."""
    if name != "load":
        raise AttributeError(f"module 'poise.model' has no attribute '{name}'")
    from poise.model.loading import load  # noqa: PLC0415

    return load
