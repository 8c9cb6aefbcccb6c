"""Diagrams as Mermaid and as PlantUML text."""

from __future__ import annotations

import re
from collections.abc import Iterator

from poise.session.diagrams.diagram_records import (
    ComponentDiagram,
    DeploymentDiagram,
    Diagram,
    SequenceDiagram,
)


def mermaid(diagram: Diagram) -> str:
    """Return the diagram as Mermaid text."""
    if isinstance(diagram, SequenceDiagram):
        head, body = "sequenceDiagram", _mermaid_sequence(diagram)
    elif isinstance(diagram, ComponentDiagram):
        head, body = "flowchart LR", _mermaid_components(diagram)
    else:
        head, body = "flowchart TB", _mermaid_deployment(diagram)
    title = ["---", f"title: {_quoted(diagram.title)}", "---"]
    return "\n".join([*title, head, *(f"  {line}" for line in body), ""])


def _mermaid_components(diagram: ComponentDiagram) -> Iterator[str]:
    for each in diagram.subsystems:
        label = _quoted(f"«subsystem»<br/>{each.name}")
        yield f"subgraph {_node_id('frame', each.name)}[{label}]"
        for name in each.components:
            yield f"  {_node_id(name)}[{_quoted(f'«component»<br/>{name}')}]"
        yield "end"
    for join in diagram.joins:
        what = {"call": f"«use» {join.type}", "flow": f"«flow» {join.type}"}
        label = _quoted(what.get(join.kind, "«use»").strip())
        yield f"{_node_id(join.source)} -.->|{label}| {_node_id(join.target)}"


def _mermaid_deployment(diagram: DeploymentDiagram) -> Iterator[str]:
    for place, view in enumerate(diagram.placements):
        prefix = f"v{place}"
        yield f"subgraph {prefix}[{_quoted(view.name)}]"
        for node in view.nodes:
            label = "<br/>".join((f"«device» {node.name}", *node.lines))
            yield f"  subgraph {_node_id(prefix, node.name)}[{_quoted(label)}]"
            for part in node.parts:
                text = "<br/>".join(filter(None, (part.name, part.remark)))
                yield f"    {_node_id(prefix, node.name, part.name)}[{_quoted(text)}]"
            yield "  end"
        yield "end"
        for path in view.paths:
            one, other = (_node_id(prefix, name) for name in path.between)
            label = f"|{_quoted('<br/>'.join(path.lines))}|" if path.lines else ""
            yield f"{one} ---{label} {other}"


def _mermaid_sequence(diagram: SequenceDiagram) -> Iterator[str]:
    for name in diagram.lifelines:
        yield f"participant {_node_id(name)} as {name}"
    for each in diagram.messages:
        text = each.text.replace(";", ",")
        yield f"{_node_id(each.source)}->>{_node_id(each.target)}: {text}"


def _node_id(*names: str) -> str:
    return "_".join(re.sub(r"\W", "_", name) for name in ("n", *names))


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "'") + '"'


def plantuml(diagram: Diagram) -> str:
    """Return the diagram as PlantUML text."""
    if isinstance(diagram, ComponentDiagram):
        body = _plantuml_components(diagram)
    elif isinstance(diagram, DeploymentDiagram):
        body = _plantuml_deployment(diagram)
    else:
        body = _plantuml_sequence(diagram)
    return "\n".join(["@startuml", f"title {diagram.title}", *body, "@enduml", ""])


def _plantuml_components(diagram: ComponentDiagram) -> Iterator[str]:
    yield "left to right direction"
    for each in diagram.subsystems:
        yield f'component "{each.name}" as {_name("frame", each.name)} <<subsystem>> {{'
        yield from (f'  component "{c}" as {_name(c)}' for c in each.components)
        yield "}"
    provided = set()
    for join in diagram.joins:
        source, target = _name(join.source), _name(join.target)
        if join.kind == "call":
            ball = _name("ball", join.target, join.port)
            if ball not in provided:
                provided.add(ball)
                yield f'interface "{join.type}" as {ball}'
                yield f"{ball} - {target}"
            yield f"{source} -( {ball}"
        else:
            label = f"<<{join.kind}>> {join.type}".strip()
            yield f"{source} ..> {target} : {label}"


def _plantuml_deployment(diagram: DeploymentDiagram) -> Iterator[str]:
    for place, view in enumerate(diagram.placements):
        prefix = f"v{place}"
        yield f'frame "{view.name}" {{'
        for node in view.nodes:
            title = r"\n".join((node.name, *node.lines))
            yield f'  node "{title}" as {_name(prefix, node.name)} <<device>> {{'
            for part in node.parts:
                text = r"\n".join(filter(None, (part.name, part.remark)))
                yield f'    component "{text}" as {_name(prefix, node.name, part.name)}'
            yield "  }"
        yield "}"
        for path in view.paths:
            one, other = (_name(prefix, name) for name in path.between)
            label = r"\n".join(path.lines)
            yield f"{one} -- {other} : {label}" if label else f"{one} -- {other}"


def _plantuml_sequence(diagram: SequenceDiagram) -> Iterator[str]:
    for name in diagram.lifelines:
        yield f'participant "{name}" as {_name(name)}'
    for each in diagram.messages:
        yield f"{_name(each.source)} -> {_name(each.target)} : {each.text}"


def _name(*names: str) -> str:
    return "_".join(re.sub(r"\W", "_", name) for name in ("n", *names))
