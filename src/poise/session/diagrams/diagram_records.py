"""What diagrams show; how it is written, in each notation, stands beside this file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from msgspec import Struct


class Box(Struct, frozen=True):
    """Something with a name, and what is inside it; a remark marks it."""

    key: str
    name: str
    kind: Literal["subsystem", "device", "component", "placement"] = "component"
    lines: tuple[str, ...] = ()
    boxes: tuple[Box, ...] = ()
    remark: str = ""

    def walk(self) -> Iterator[Box]:
        """Yield this box and all inside it."""
        yield self
        for box in self.boxes:
            yield from box.walk()


class Join(Struct, frozen=True):
    """A line between two boxes, by their keys; `port` is where a call arrives.

    ``call``: the source requires what the target provides; ``flow``: messages; ``use``:
    the robot file does not say; ``path``: what goes between two computers.
    """

    source: str
    target: str
    kind: Literal["call", "flow", "use", "path"]
    port: str = ""
    lines: tuple[str, ...] = ()


class BoxDiagram(Struct, frozen=True):
    """Architectures with their components, or placements with their computers."""

    title: str
    boxes: tuple[Box, ...]
    joins: tuple[Join, ...]


class Arrow(Struct, frozen=True):
    """What one lifeline sends another."""

    source: str
    target: str
    text: str


class SequenceDiagram(Struct, frozen=True):
    """Who tells whom what, in order."""

    title: str
    lifelines: tuple[str, ...]
    messages: tuple[Arrow, ...]


Diagram = BoxDiagram | SequenceDiagram
