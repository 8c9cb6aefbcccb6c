"""Diagrams in Graphviz's language: it places and draws everything, also text."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from math import ceil, sqrt

from poise.manage.deploy.topological_order import levels
from poise.session.diagrams.diagram_records import (
    ComponentDiagram,
    DeployedComponent,
    DeploymentDiagram,
    DeploymentNode,
    Diagram,
    Join,
    Placed,
    SequenceDiagram,
)

_FONT = 'fontname="DejaVu Sans,Helvetica,Arial,sans-serif"'
_MARKED = "#fff2cc"
_BETWEEN = '"#8a8a8a"'
_MOST_BESIDE = 4
"""So many architectures that lead to each other are drawn beside each other."""
_WIDE = 1.6
"""A computer's components are in so many more columns than rows, about."""


def dot(diagram: Diagram) -> str:
    """Return the diagram in the DOT language."""
    if isinstance(diagram, ComponentDiagram):
        body = _components(diagram)
    elif isinstance(diagram, DeploymentDiagram):
        body = _deployment(diagram)
    else:
        body = _sequence(diagram)
    head = (
        f"graph [{_FONT} fontsize=13 labelloc=t label=<{_bold(diagram.title)}>]",
        f"node [{_FONT} fontsize=11 shape=component]",
        f"edge [{_FONT} fontsize=9]",
    )
    return "\n".join(["digraph {", *(f"  {line}" for line in (*head, *body)), "}\n"])


def _components(diagram: ComponentDiagram) -> Iterator[str]:
    yield "rankdir=LR ranksep=0.5 nodesep=0.3"
    ends = _ends(diagram)
    for each in diagram.subsystems:
        function = "" if each.function == each.name else f": {each.function}"
        lines = _small("«subsystem»"), f"{_bold(each.name + function)}<br/>"
        label = "".join(lines).replace("<br/>", '<br align="left"/>')
        frame = _id("cluster", each.name)
        yield f"subgraph {frame} {{ label=<{label}> labeljust=l style=rounded"
        for name in each.components:
            text = f"{_small('«component»')}{escape(name)}"
            yield f"  {_id(name)} [label=<{text}>]"
            yield from (f"  {line}" for line in ends.get(name, ()))
        yield "}"
    frames = {c: each.name for each in diagram.subsystems for c in each.components}
    leads = [(frames[join.source], frames[join.target]) for join in diagram.joins]
    # a chain through many frames would be too wide: they are below each other then
    is_deep = len(levels({*frames.values()}, leads)) > _MOST_BESIDE
    for join in diagram.joins:
        is_within = frames[join.source] == frames[join.target]
        # what crosses the titles of frames leaves them legible
        ranks = "" if is_within else f" color={_BETWEEN}"
        ranks += " constraint=false" if is_deep and not is_within else ""
        if join.kind == "call":
            look = f"arrowhead=icurve arrowsize=1.3{ranks}"
            yield f"{_id(join.source)} -> {_hub(join)} [{look}]"
        else:
            source = _hub(join) if join.type else _id(join.source)
            look = f"style=dashed arrowhead=vee{ranks}"
            yield f"{source} -> {_id(join.target)} [{look}]"


def _ends(diagram: ComponentDiagram) -> dict[str, list[str]]:
    """Return what stands beside components.

    A ball for each interface that one provides, and the name of what one publishes.
    """
    ends: dict[str, dict[str, None]] = {}
    for join in diagram.joins:
        hub = _hub(join)
        if join.kind == "call":
            look = f"dir=none label=<{escape(join.type)}>"
            lines = [
                f'{hub} [shape=circle width=0.15 label="" fixedsize=true]',
                f"{hub} -> {_id(join.target)} [{look}]",
            ]
        elif join.type:
            label = f"{_small(f'«{join.kind}»')}{escape(join.type)}"
            lines = [
                f"{hub} [shape=plain fontsize=9 label=<{label}>]",
                f"{_id(join.source)} -> {hub} [style=dashed dir=none]",
            ]
        else:
            continue
        at = join.target if join.kind == "call" else join.source
        ends.setdefault(at, {}).update(dict.fromkeys(lines))
    return {name: list(lines) for name, lines in ends.items()}


def _hub(join: Join) -> str:
    """Return the identifier of what all connectors at one port share."""
    return _id("at", join.target if join.kind == "call" else join.source, join.port)


def _deployment(diagram: DeploymentDiagram) -> Iterator[str]:
    yield "ranksep=0.4 nodesep=0.6"
    for place, view in enumerate(diagram.placements):
        yield f"subgraph cluster_{place} {{ style=rounded label=<{_bold(view.name)}>"
        yield from (f"  {line}" for line in _placed(view, str(place)))
        yield "}"


def _placed(view: Placed, prefix: str) -> Iterator[str]:
    for node in view.nodes:
        look = f'shape=box3d margin="0.2,0.12" label=<{_node_table(node)}>'
        yield f"{_id(prefix, node.name)} [{look}]"
    for path in view.paths:
        one, other = (_id(prefix, name) for name in path.between)
        if path.lines:  # a node of its own: nothing is drawn across it
            label, text = (
                _id(prefix, *path.between),
                "<br/>".join(map(escape, path.lines)),
            )
            yield f"{label} [shape=plain fontsize=9 label=<{text}>]"
            yield f"{one} -> {label} -> {other} [dir=none]"
        else:
            yield f"{one} -> {other} [dir=none]"


def _node_table(node: DeploymentNode) -> str:
    """Return a table as Graphviz has them: a head, then components in a grid."""
    columns = max(2, ceil(sqrt(_WIDE * len(node.parts))))
    head = _small("«device»") + _bold(node.name)
    lines = "".join(f'<br/><font point-size="9">{escape(t)}</font>' for t in node.lines)
    rows = [f'<tr><td colspan="{columns}">{head}{lines}</td></tr>']
    for first in range(0, len(node.parts), columns):
        cells = "".join(_cell(part) for part in node.parts[first : first + columns])
        rows.append(f"<tr>{cells}</tr>")
    return f'<table border="0" cellspacing="5">{"".join(rows)}</table>'


def _cell(part: DeployedComponent) -> str:
    colour = f' bgcolor="{_MARKED}"' if part.remark else ""
    remark = f"<br/>{_bold(part.remark)}" if part.remark else ""
    text = f"{_small('«component»')}{escape(part.name)}{remark}"
    return f'<td border="1" cellpadding="5"{colour}>{text}</td>'


def _sequence(diagram: SequenceDiagram) -> Iterator[str]:
    """Yield lifelines as columns of points, and messages as edges within a row."""
    yield "nodesep=0.9 ranksep=0.28 splines=line"
    count = len(diagram.lifelines)
    for place, name in enumerate(diagram.lifelines):
        yield f"p{place}_0 [shape=box group=g{place} label=<{_bold(name)}>]"
    rows = len(diagram.messages)
    for row in range(1, rows + 2):
        for place in range(count):
            dot_ = f"[shape=point width=0.01 group=g{place}]"
            yield f"p{place}_{row} {dot_}"
            line = "[style=dashed dir=none weight=1000]"
            yield f"p{place}_{row - 1} -> p{place}_{row} {line}"
    for row in range(rows + 2):
        names = " ".join(f"p{place}_{row}" for place in range(count))
        yield f"{{ rank=same {names} }}"
    yield f"{' -> '.join(f'p{place}_0' for place in range(count))} [style=invis]"
    for row, message in enumerate(diagram.messages, 1):
        source = diagram.lifelines.index(message.source)
        target = diagram.lifelines.index(message.target)
        yield from _arrow(row, source, target, message.text)


def _arrow(row: int, source: int, target: int, text: str) -> Iterator[str]:
    """Yield the edges of a message from point to point; its text is on the longest."""
    left, right = sorted((source, target))
    for place in range(left, right):
        is_tip = target in {place, place + 1}
        way = "forward" if target > source else "back"
        label = f" label=<{escape(text)}>" if source in {place, place + 1} else ""
        look = f"dir={way if is_tip else 'none'}{label}"
        yield f"p{place}_{row} -> p{place + 1}_{row} [{look}]"


def _id(*names: str) -> str:
    return '"' + "/".join(names).replace('"', "'") + '"'


def _small(text: str) -> str:
    return f'<font point-size="8">{escape(text)}</font><br/>'


def _bold(text: str) -> str:
    return f"<b>{escape(text)}</b>"
