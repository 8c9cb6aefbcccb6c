"""What diagrams show. How it is written, in each notation, stands beside this file."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct


class Subsystem(Struct, frozen=True):
    """An architecture: components within a frame."""

    name: str
    function: str
    components: tuple[str, ...]


class Join(Struct, frozen=True):
    """A connector between two components.

    Parameters
    ----------
    kind
        ``call``: `source` requires an interface that `target` provides at `port`;
        ``flow``: messages; ``use``: the robot file does not say.
    type
        Name of the interface or the message; empty: not known.
    """

    source: str
    target: str
    kind: Literal["call", "flow", "use"]
    port: str = ""
    type: str = ""


class ComponentDiagram(Struct, frozen=True):
    """The architectures of a robot, and how their components are joined."""

    title: str
    subsystems: tuple[Subsystem, ...]
    joins: tuple[Join, ...]


class DeployedComponent(Struct, frozen=True):
    """A component on a computer; `remark` says what is special there."""

    name: str
    remark: str = ""


class DeploymentNode(Struct, frozen=True):
    """A computer with what it has, what of that is used, and what runs there."""

    name: str
    lines: tuple[str, ...]
    parts: tuple[DeployedComponent, ...]


class Path(Struct, frozen=True):
    """What goes between two computers, and over which link."""

    between: tuple[str, str]
    lines: tuple[str, ...]


class Placed(Struct, frozen=True):
    """One placement: its name, computers, and what goes between them."""

    name: str
    nodes: tuple[DeploymentNode, ...]
    paths: tuple[Path, ...]


class DeploymentDiagram(Struct, frozen=True):
    """One placement, or several side by side."""

    title: str
    placements: tuple[Placed, ...]


class Arrow(Struct, frozen=True):
    """What one lifeline sends another; to itself: what it does."""

    source: str
    target: str
    text: str


class SequenceDiagram(Struct, frozen=True):
    """Who tells whom what, in order."""

    title: str
    lifelines: tuple[str, ...]
    messages: tuple[Arrow, ...]


Diagram = ComponentDiagram | DeploymentDiagram | SequenceDiagram
