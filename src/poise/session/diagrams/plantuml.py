"""Diagrams as PlantUML text."""

from __future__ import annotations

import re
from collections.abc import Iterator

from poise.session.diagrams.records import (
    ComponentDiagram,
    DeploymentDiagram,
    Diagram,
    SequenceDiagram,
)


def plantuml(diagram: Diagram) -> str:
    """Return the diagram as PlantUML text."""
    if isinstance(diagram, ComponentDiagram):
        body = _components(diagram)
    elif isinstance(diagram, DeploymentDiagram):
        body = _deployment(diagram)
    else:
        body = _sequence(diagram)
    return "\n".join(["@startuml", f"title {diagram.title}", *body, "@enduml", ""])


def _components(diagram: ComponentDiagram) -> Iterator[str]:
    yield "left to right direction"
    for each in diagram.subsystems:
        yield f'component "{each.name}" as {_id("frame", each.name)} <<subsystem>> {{'
        yield from (f'  component "{c}" as {_id(c)}' for c in each.components)
        yield "}"
    provided = set()
    for join in diagram.joins:
        source, target = _id(join.source), _id(join.target)
        if join.kind == "call":
            ball = _id("ball", join.target, join.port)
            if ball not in provided:
                provided.add(ball)
                yield f'interface "{join.type}" as {ball}'
                yield f"{ball} - {target}"
            yield f"{source} -( {ball}"
        else:
            label = f"<<{join.kind}>> {join.type}".strip()
            yield f"{source} ..> {target} : {label}"


def _deployment(diagram: DeploymentDiagram) -> Iterator[str]:
    for place, view in enumerate(diagram.placements):
        prefix = f"v{place}"
        yield f'frame "{view.name}" {{'
        for node in view.nodes:
            title = r"\n".join((node.name, *node.lines))
            yield f'  node "{title}" as {_id(prefix, node.name)} <<device>> {{'
            for part in node.parts:
                text = r"\n".join(filter(None, (part.name, part.remark)))
                yield f'    component "{text}" as {_id(prefix, node.name, part.name)}'
            yield "  }"
        yield "}"
        for path in view.paths:
            one, other = (_id(prefix, name) for name in path.between)
            label = r"\n".join(path.lines)
            yield f"{one} -- {other} : {label}" if label else f"{one} -- {other}"


def _sequence(diagram: SequenceDiagram) -> Iterator[str]:
    for name in diagram.lifelines:
        yield f'participant "{name}" as {_id(name)}'
    for each in diagram.messages:
        yield f"{_id(each.source)} -> {_id(each.target)} : {each.text}"


def _id(*names: str) -> str:
    return "_".join(re.sub(r"\W", "_", name) for name in ("n", *names))
