"""A diagram, and how it is written as Mermaid and as PlantUML."""

from __future__ import annotations

import re
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


def mermaid(diagram: Diagram) -> str:
    """Return the diagram as Mermaid text."""
    head = ["---", f"title: {_quoted(diagram.title)}", "---"]
    if isinstance(diagram, SequenceDiagram):
        body = ["sequenceDiagram"]
        body += [f"  participant {_id(name)} as {name}" for name in diagram.lifelines]
        for each in diagram.messages:
            text = each.text.replace(";", ",")
            body.append(f"  {_id(each.source)}->>{_id(each.target)}: {text}")
    else:
        is_flat = all(box.kind == "subsystem" for box in diagram.boxes)
        body = ["flowchart LR" if is_flat else "flowchart TB"]
        body += [line for box in diagram.boxes for line in _mermaid_box(box, "  ")]
        body += [f"  {_mermaid_join(join)}" for join in diagram.joins]
    return "\n".join([*head, *body, ""])


def _mermaid_box(box: Box, indent: str) -> Iterator[str]:
    name = box.name if box.kind == "placement" else f"«{box.kind}»<br/>{box.name}"
    label = _quoted("<br/>".join(filter(None, (name, *box.lines, box.remark))))
    if box.kind == "component":
        yield f"{indent}{_id(box.key)}[{label}]"
        return
    yield f"{indent}subgraph {_id(box.key)}[{label}]"
    for inner in box.boxes:
        yield from _mermaid_box(inner, indent + "  ")
    yield f"{indent}end"


def _mermaid_join(join: Join) -> str:
    arrow = "---" if join.kind == "path" else "-.->"
    text = _quoted(_label(join, "<br/>").replace("<<", "«").replace(">>", "»"))
    label = f"|{text}|" if text != '""' else ""
    return f"{_id(join.source)} {arrow}{label} {_id(join.target)}"


def plantuml(diagram: Diagram) -> str:
    """Return the diagram as PlantUML text."""
    if isinstance(diagram, SequenceDiagram):
        body = [f'participant "{name}" as {_id(name)}' for name in diagram.lifelines]
        body += [
            f"{_id(arrow.source)} -> {_id(arrow.target)} : {arrow.text}"
            for arrow in diagram.messages
        ]
    else:
        is_flat = all(box.kind == "subsystem" for box in diagram.boxes)
        body = ["left to right direction"] if is_flat else []
        body += [line for box in diagram.boxes for line in _plantuml_box(box, "")]
        joins = (line for join in diagram.joins for line in _plantuml_join(join))
        body += dict.fromkeys(joins)  # a ball is drawn once
    return "\n".join(["@startuml", f"title {diagram.title}", *body, "@enduml", ""])


_ELEMENTS = {"placement": "frame", "device": "node"}


def _plantuml_box(box: Box, indent: str) -> Iterator[str]:
    title = r"\n".join(filter(None, (box.name, *box.lines, box.remark)))
    head = f'{indent}{_ELEMENTS.get(box.kind, "component")} "{title}" as {_id(box.key)}'
    if box.kind == "component":
        yield head
        return
    yield f"{head} {{" if box.kind == "placement" else f"{head} <<{box.kind}>> {{"
    for inner in box.boxes:
        yield from _plantuml_box(inner, indent + "  ")
    yield f"{indent}}}"


def _plantuml_join(join: Join) -> Iterator[str]:
    source, target = _id(join.source), _id(join.target)
    if join.kind == "call":
        ball = _id(f"ball/{join.target}/{join.port}")
        yield f'interface "{" ".join(join.lines)}" as {ball}'
        yield f"{ball} - {target}"
        yield f"{source} -( {ball}"
        return
    label = _label(join, r"\n")
    arrow = "--" if join.kind == "path" else "..>"
    yield f"{source} {arrow} {target}{label and f' : {label}'}"


def _label(join: Join, newline: str) -> str:
    text = newline.join(join.lines)
    if join.kind == "path":
        return text
    return f"<<{'flow' if join.kind == 'flow' else 'use'}>> {text}".strip()


def _id(key: str) -> str:
    return "n_" + re.sub(r"\W", "_", key)


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "'") + '"'
