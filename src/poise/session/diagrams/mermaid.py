"""Diagrams as Mermaid text, which GitHub, GitLab and Jupyter draw."""

from __future__ import annotations

import re
from collections.abc import Iterator

from poise.session.diagrams.records import (
    ComponentDiagram,
    DeploymentDiagram,
    Diagram,
    SequenceDiagram,
)


def mermaid(diagram: Diagram) -> str:
    """Return the diagram as Mermaid text."""
    if isinstance(diagram, SequenceDiagram):
        head, body = "sequenceDiagram", _sequence(diagram)
    elif isinstance(diagram, ComponentDiagram):
        head, body = "flowchart LR", _components(diagram)
    else:
        head, body = "flowchart TB", _deployment(diagram)
    title = ["---", f"title: {_quoted(diagram.title)}", "---"]
    return "\n".join([*title, head, *(f"  {line}" for line in body), ""])


def _components(diagram: ComponentDiagram) -> Iterator[str]:
    for each in diagram.subsystems:
        label = _quoted(f"«subsystem»<br/>{each.name}")
        yield f"subgraph {_id('frame', each.name)}[{label}]"
        for name in each.components:
            yield f"  {_id(name)}[{_quoted(f'«component»<br/>{name}')}]"
        yield "end"
    for join in diagram.joins:
        what = {"call": f"«use» {join.type}", "flow": f"«flow» {join.type}"}
        label = _quoted(what.get(join.kind, "«use»").strip())
        yield f"{_id(join.source)} -.->|{label}| {_id(join.target)}"


def _deployment(diagram: DeploymentDiagram) -> Iterator[str]:
    for place, view in enumerate(diagram.placements):
        prefix = f"v{place}"
        yield f"subgraph {prefix}[{_quoted(view.name)}]"
        for node in view.nodes:
            label = "<br/>".join((f"«device» {node.name}", *node.lines))
            yield f"  subgraph {_id(prefix, node.name)}[{_quoted(label)}]"
            for part in node.parts:
                text = "<br/>".join(filter(None, (part.name, part.remark)))
                yield f"    {_id(prefix, node.name, part.name)}[{_quoted(text)}]"
            yield "  end"
        yield "end"
        for path in view.paths:
            one, other = (_id(prefix, name) for name in path.between)
            label = f"|{_quoted('<br/>'.join(path.lines))}|" if path.lines else ""
            yield f"{one} ---{label} {other}"


def _sequence(diagram: SequenceDiagram) -> Iterator[str]:
    for name in diagram.lifelines:
        yield f"participant {_id(name)} as {name}"
    for each in diagram.messages:
        text = each.text.replace(";", ",")
        yield f"{_id(each.source)}->>{_id(each.target)}: {text}"


def _id(*names: str) -> str:
    return "_".join(re.sub(r"\W", "_", name) for name in ("n", *names))


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "'") + '"'
