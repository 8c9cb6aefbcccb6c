"""A diagram, and how it is written as Mermaid, as PlantUML and as SVG.

SVG has boxes in columns, and lines in lanes beside them, behind no box.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from math import ceil, sqrt
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


_SIZE, _SMALL = 13, 10
_LETTER = 0.6
"""How wide a letter is, about, as a share of its height."""
_PAD, _GAP, _ROW = 10.0, 14.0, 15.0
_LANE = 10.0
_MARKED, _PLAIN = "#fff2cc", "#ffffff"
_COLOURS = ("#3465a4", "#8f5902", "#4e9a06", "#75507b", "#a40000", "#555753")


def svg(diagram: Diagram) -> str:
    """Return the diagram as SVG."""
    if isinstance(diagram, SequenceDiagram):
        parts, width, height = _sequence(diagram)
    else:
        parts, width, height = _columns(diagram)
    width = max(width, _width(diagram.title, _SIZE) + 2 * _PAD)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" '
        f'height="{height:.0f}" font-family="DejaVu Sans,Helvetica,Arial,sans-serif">'
        f'<rect width="100%" height="100%" fill="white"/>'
        f"{_text(_PAD, 20, diagram.title, bold=True)}{''.join(parts)}</svg>\n"
    )


def _columns(diagram: BoxDiagram) -> tuple[list[str], float, float]:
    """Return all boxes: a column for each placement, else one for all."""
    are_placements = any(box.kind == "placement" for box in diagram.boxes)
    columns = [(box,) for box in diagram.boxes] if are_placements else [diagram.boxes]
    parts: list[str] = []
    left, bottom = _PAD, 0.0
    for boxes in columns:
        keys = {inner.key for box in boxes for inner in box.walk()}
        joins = [join for join in diagram.joins if join.source in keys]
        column = _Column(left, joins, boxes)
        parts += column.parts
        left, bottom = column.right + 2 * _GAP, max(bottom, column.bottom)
    return parts, left, bottom + _GAP


class _End(Struct, frozen=True):
    """Where a line leaves a box."""

    x: float
    y: float


class _Column:
    """Boxes below each other; each line has a lane of its own to their right."""

    def __init__(
        self, left: float, joins: Sequence[Join], boxes: Sequence[Box]
    ) -> None:
        self.parts: list[str] = []
        self._joins = joins
        self._ends: dict[tuple[int, str], _End] = {}
        joined = [box for top in boxes for box in top.walk() if self._at(box.key)]
        leaves = [box for top in boxes for box in top.walk() if not _is_frame(box)]
        self._inner = max(map(_content_width, (*joined, *leaves)), default=80.0)
        self.bottom = 34.0
        for box in boxes:
            self._draw(box, left)
            self.bottom += _GAP
        self.right = self._draw_lanes(left + self._inner + 2 * _PAD + _GAP)

    def _at(self, key: str) -> list[tuple[int, Join]]:
        """Return the lines that end at a box, with their numbers."""
        joins = enumerate(self._joins)
        return [(n, j) for n, j in joins if key in {j.source, j.target}]

    def _draw(self, box: Box, left: float) -> None:
        if not _is_frame(box):
            self._draw_leaf(box, left)
            return
        top, place = self.bottom, len(self.parts)
        self.bottom += _ROW * (1 + len(box.lines)) + _PAD
        for inner in box.boxes:
            self._draw(inner, left + _PAD)
            self.bottom += _PAD
        width = self._inner + 2 * _PAD
        frame = _rect(left, top, width, self.bottom - top, "#f6f6f6", "#999", 8)
        self.parts[place:place] = [frame, *_head(box, left + _PAD, top + 4)]

    def _draw_leaf(self, box: Box, left: float) -> None:
        """Draw a box with its cells; its lines leave it on the right."""
        top, right = self.bottom, left + self._inner
        head = list(_head(box, left + _PAD, top))
        below = top + _ROW * (len(head) + 0.5)
        cells, height = _cells(box, left + _PAD, below)
        ends = self._at(box.key)
        rows = [max(1, len(j.lines) if box.key == j.source else 1) for _, j in ends]
        y = top
        for (number, join), count in zip(ends, rows, strict=True):
            y += _ROW * count
            self._ends[number, box.key] = _End(right, y)
            if box.key == join.source:
                for row, line in enumerate(reversed(join.lines)):
                    at = y - 3 - 12 * row
                    self.parts.append(_text(right + _PAD, at, line, _SMALL))
        self.bottom = max(below + height, y + _PAD / 2)
        fill = _MARKED if box.remark else _PLAIN
        rect = _rect(left, top, self._inner, self.bottom - top, fill, "#444", 3)
        self.parts += [rect, *head, *cells]

    def _draw_lanes(self, right: float) -> float:
        """Draw all lines, the shortest next to the boxes; return where they end."""
        names = [line for join in self._joins for line in join.lines]
        first = right + max((_width(name, _SMALL) for name in names), default=0.0)
        lanes: list[list[tuple[float, float]]] = []
        pairs = []
        for number, join in enumerate(self._joins):
            source = self._ends.get((number, join.source))
            target = self._ends.get((number, join.target))
            if source and target:
                pairs.append((abs(source.y - target.y), number, join, source, target))
        for _, number, join, source, target in sorted(pairs, key=lambda p: p[:2]):
            low, high = sorted((source.y, target.y))
            free = (n for n, taken in enumerate(lanes) if _is_free(taken, low, high))
            if (lane := next(free, len(lanes))) == len(lanes):
                lanes.append([])
            lanes[lane].append((low, high))
            x = first + lane * _LANE
            self.parts += _line(join, source, target, x, _COLOURS[number % 6])
        return first + len(lanes) * _LANE


def _is_frame(box: Box) -> bool:
    return box.kind in {"subsystem", "placement"}


def _is_free(taken: Iterable[tuple[float, float]], low: float, high: float) -> bool:
    return all(high < one - 2 or low > other + 2 for one, other in taken)


def _line(
    join: Join, source: _End, target: _End, lane: float, colour: str
) -> Iterator[str]:
    """Yield a line with its end: a ball at what is provided, a tip at what flows."""
    tip = 10.0 if join.kind == "call" else 0.0
    path = f"M{source.x:.1f} {source.y:.1f}H{lane:.1f}V{target.y:.1f}"
    dashes = ' stroke-dasharray="5 3"' if join.kind in {"call", "use"} else ""
    yield (
        f'<path d="{path}H{target.x + tip:.1f}" fill="none" stroke="{colour}"{dashes}/>'
    )
    x, y, white = target.x, target.y, 'fill="white" stroke="#444"'
    if join.kind == "call":
        yield f'<circle cx="{x + 5:.1f}" cy="{y:.1f}" r="5" {white}/>'
    elif join.kind != "path":
        yield f'<path d="M{x:.1f} {y:.1f}l9 -4v8z" fill="{colour}"/>'


def _head(box: Box, left: float, top: float) -> Iterator[str]:
    """Yield the words of a box: its kind and name, what is known, its remark."""
    kind = "" if box.kind == "placement" else f"«{box.kind}» "
    y = top + _ROW
    yield _text(left, y, f"{kind}{box.name}", bold=box.kind != "component")
    for line in filter(None, (*box.lines, box.remark)):
        y += _ROW
        yield _text(left, y, line, _SMALL, bold=line == box.remark)


def _columns_of(box: Box) -> int:
    return min(4, max(1, ceil(sqrt(len(box.boxes)))))


def _cell_width(box: Box) -> float:
    words = [word for inner in box.boxes for word in (inner.name, inner.remark)]
    return max((_width(word, 12) for word in words), default=0.0) + _PAD


def _content_width(box: Box) -> float:
    if _is_frame(box):
        return 0.0
    cells = _columns_of(box) * (_cell_width(box) + 6)
    kind = _width(f"«{box.kind}» {box.name}", _SIZE)
    return max(cells, kind, *(_width(line, _SMALL) for line in box.lines), 0.0) + 20


def _cells(box: Box, left: float, top: float) -> tuple[list[str], float]:
    """Return the boxes inside a box as a grid, and how high that is."""
    if not box.boxes:
        return [], 0.0
    parts, columns, width = [], _columns_of(box), _cell_width(box)
    high = 40.0 if any(inner.remark for inner in box.boxes) else 26.0
    for number, inner in enumerate(box.boxes):
        x = left + number % columns * (width + 6)
        y = top + number // columns * (high + 6)
        fill = _MARKED if inner.remark else _PLAIN
        parts.append(_rect(x, y, width, high, fill, "#888", 2))
        parts.append(_text(x + 5, y + 17, inner.name, 12))
        if inner.remark:
            parts.append(_text(x + 5, y + 32, inner.remark, _SMALL, bold=True))
    return parts, ceil(len(box.boxes) / columns) * (high + 6) + 4


def _sequence(diagram: SequenceDiagram) -> tuple[list[str], float, float]:
    """Return lifelines as columns, and messages as arrows below each other."""
    place = {name: number for number, name in enumerate(diagram.lifelines)}
    apart = max((_width(name, _SIZE) + 3 * _PAD for name in place), default=0.0)
    for each in diagram.messages:
        steps = abs(place[each.source] - place[each.target]) or 1
        apart = max(apart, (_width(each.text, 11) + 3 * _PAD) / steps)
    xs = [_PAD + apart / 2 + apart * number for number in place.values()]
    high, step = 76.0, 26.0
    bottom = high + step * (len(diagram.messages) + 1)
    parts = []
    for name, number in place.items():
        x = xs[number]
        parts.append(
            f'<path d="M{x:.1f} 58V{bottom:.1f}" stroke="#999" stroke-dasharray="4 3"/>'
        )
        half = _width(name, _SIZE) / 2 + _PAD
        parts.append(_rect(x - half, 34, 2 * half, 24, _PLAIN, "#444", 3))
        parts.append(_text(x, 51, name, bold=True, anchor="middle"))
    for row, arrow in enumerate(diagram.messages, 1):
        one, other = xs[place[arrow.source]], xs[place[arrow.target]]
        y = high + step * row
        back = -9 if other > one else 9
        parts.append(f'<path d="M{one:.1f} {y:.1f}H{other:.1f}" stroke="#444"/>')
        parts.append(f'<path d="M{other:.1f} {y:.1f}l{back} -4v8z" fill="#444"/>')
        parts.append(_text((one + other) / 2, y - 5, arrow.text, 11, anchor="middle"))
    return parts, xs[-1] + apart / 2 + _PAD if xs else 0.0, bottom + _GAP


def _rect(
    x: float, y: float, width: float, height: float, fill: str, line: str, round_: int
) -> str:
    return (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" '
        f'rx="{round_}" fill="{fill}" stroke="{line}"/>'
    )


def _text(
    x: float,
    y: float,
    words: str,
    size: float = _SIZE,
    *,
    bold: bool = False,
    anchor: str = "start",
) -> str:
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}"'
        f"{weight}>{escape(words)}</text>"
    )


def _width(words: str, size: float) -> float:
    return _LETTER * size * len(words)
