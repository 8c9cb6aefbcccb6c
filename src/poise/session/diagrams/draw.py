"""Draws a robot: its software, where it runs, how that changes; and the files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Literal, get_args

from msgspec import Struct

from poise.errors import UsageError, listed
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.transition_plan import plan_transition
from poise.model.robot import Architecture, Computer, Connector, Link, Robot
from poise.plan.from_robot import check_task
from poise.session.arguments import check_path, check_robot, check_type
from poise.session.diagrams.diagram import (
    Arrow,
    Box,
    BoxDiagram,
    Diagram,
    Join,
    SequenceDiagram,
    mermaid,
    plantuml,
    svg,
)
from poise.session.folders import write_whole
from poise.session.record_run import coded_ports
from poise.units import (
    counted,
    format_amount,
    format_bandwidth,
    format_bytes,
    format_seconds,
)

What = Literal["components", "deployment", "transition"]
FORMATS: Mapping[str, Callable[[Diagram], str]] = {
    ".svg": svg,
    ".mmd": mermaid,
    ".puml": plantuml,
}
"""Ending of a file -> what writes the diagram."""


class Drawing(Struct, frozen=True):
    """A diagram, to be written to files; Jupyter shows it as a picture."""

    diagram: Diagram

    def save(self, path: Path | str) -> None:
        """Write it to a file that ends in ``.svg``, ``.mmd`` or ``.puml``.

        Raises
        ------
        UsageError
            It ends otherwise.
        RunError
            It cannot be written, and is what it was.
        """
        check_path("path", path)
        path = Path(path)
        if path.suffix not in FORMATS:
            raise UsageError(
                f"{path}: the name says the format, and ends in {', '.join(FORMATS)}"
            )
        write_whole(path, self.text(path.suffix))

    def text(self, ending: str = ".mmd") -> str:
        """Return it as SVG (``.svg``), Mermaid (``.mmd``) or PlantUML (``.puml``)."""
        return FORMATS[ending](self.diagram)

    def _repr_svg_(self) -> str:
        """Return it as SVG, for Jupyter."""
        return self.text(".svg")


def draw(
    robot: Robot,
    what: What | None = None,
    placements: Mapping[str, Mapping[str, str]] | None = None,
    *,
    task: str | None = None,
) -> Drawing:
    """Return a UML diagram of a robot.

    Parameters
    ----------
    what
        ``components``: the architectures and how their components are joined;
        ``deployment``: what runs where, several placements side by side;
        ``transition``: what happens on the way from one placement to another. None: a
        deployment when there are placements, else components.
    placements
        Name -> placement (component -> computer), such as `Placement.where` or that of
        a running robot's status. A transition has two, before and after.
    task
        Only what it needs is among the ``components``; None: all.

    Raises
    ------
    UsageError
        There is no such task, or placements are missing or name what the robot lacks.
    RobotError
        No transition leads to the second placement; the message says why.
    """
    check_robot(robot)
    named = placements or {}
    check_type("placements", named, Mapping, "a mapping of names to placements")
    what = what or ("deployment" if named else "components")
    if what not in get_args(What):
        raise UsageError(f"no diagram '{what}' (there are: {listed(get_args(What))})")
    if what == "components" and not named:
        if task is not None:
            check_task(robot, task)
        functions = None if task is None else robot.functions_of(task)
        return Drawing(component_diagram(robot, functions))
    for name, placement in named.items():
        _check(robot, name, placement)
    if what == "deployment" and named:
        return Drawing(deployment_diagram(robot, named))
    if what == "transition" and len(named) == 2:  # noqa: PLR2004
        now, then = named.values()
        steps = plan_transition(robot, now, then)
        return Drawing(sequence_diagram(robot, " → ".join(named), steps))
    raise UsageError(
        "a component diagram is of no placement, a deployment of one or more, a "
        f"transition of two: {what} got {len(named)}"
    )


def _check(robot: Robot, name: str, placement: Mapping[str, str]) -> None:
    """Raise UsageError for components and computers that the robot does not have."""
    is_what = "component -> computer, as in `Placement.where`"
    check_type(f"placements[{name!r}]", placement, Mapping, is_what)
    components = {each.name for each in robot.components()}
    computers = {each.name for each in robot.computers}
    if strange := [
        f"'{component}' on '{computer}'"
        for component, computer in placement.items()
        if component not in components or computer not in computers
    ]:
        raise UsageError(
            f"placement '{name}' has {', '.join(strange)}: the robot file has no such "
            "component or computer"
        )


Ports = dict[str, dict[str, tuple[str, str]]]
"""Component -> port -> its kind and the name of its type."""


def component_diagram(robot: Robot, functions: Collection[str] | None) -> BoxDiagram:
    """Return the diagram of what provides `functions`; None: of all architectures."""
    chosen = [
        architecture
        for architecture in robot.architectures
        if functions is None or architecture.function in functions
    ]
    drawn = {c.name for each in chosen for c in each.components}
    boxes = tuple(_subsystem(each) for each in chosen)
    ports = _ports(robot, drawn)
    joins = dict.fromkeys(
        _join(connector, ports)
        for connector in robot.all_connectors()
        if {end.component for end in connector.between} <= drawn
    )
    return BoxDiagram(robot.name, boxes, tuple(joins))


def _subsystem(each: Architecture) -> Box:
    inside = tuple(Box(c.name, c.name) for c in each.components)
    function = () if each.function == each.name else (f"provides {each.function}",)
    return Box(f"frame/{each.name}", each.name, "subsystem", function, inside)


def _join(connector: Connector, ports: Ports) -> Join:
    source, target = connector.between
    own = ports[source.component].get(source.port)
    kind, type_ = own or ports[target.component].get(target.port, ("", ""))
    names, says = (source.component, target.component), (type_,) if type_ else ()
    if kind in {"requires", "provides"}:
        return Join(*names, "call", target.port, says)
    return Join(*names, "flow" if kind else "use", source.port, says)


def _ports(robot: Robot, drawn: Collection[str]) -> Ports:
    ports: Ports = {}
    for component in robot.components():
        if component.name in drawn:
            kinds: dict[str, tuple[str, str]] = {
                port.name: (port.kind, port.type.rpartition(":")[2])
                for port in component.ports
            }
            for name, port in coded_ports(robot, component).items():
                type_ = getattr(port.type, "__qualname__", str(port.type))
                kinds[name] = port.kind, type_
            ports[component.name] = kinds
    return ports


_MOST_CROSSING = 4
"""Up to this number of connectors between two computers are named, else counted."""


def deployment_diagram(
    robot: Robot, placements: Mapping[str, Mapping[str, str]]
) -> BoxDiagram:
    """Return placements side by side; what is elsewhere than in the first is marked."""
    first: Mapping[str, str] = next(iter(placements.values()), {})
    boxes: list[Box] = []
    joins: list[Join] = []
    for number, (name, placement) in enumerate(placements.items()):
        nodes = tuple(
            _node(robot, computer, placement, first, f"{number}")
            for computer in robot.computers
        )
        boxes.append(Box(f"{number}", name, "placement", (), nodes))
        joins += _paths(robot, placement, f"{number}")
    return BoxDiagram(robot.name, tuple(boxes), tuple(joins))


def _node(
    robot: Robot,
    computer: Computer,
    placement: Mapping[str, str],
    first: Mapping[str, str],
    within: str,
) -> Box:
    here = [n for n, there in placement.items() if there == computer.name]
    demands = {each.name: each.demand for each in robot.components()}
    lines = []
    for resource in computer.capacity:
        usable = computer.usable(resource)
        used = sum(demands[name].get(resource, 0.0) for name in here)
        share = f"{used / usable:.0%} of " if usable and used else ""
        lines.append(f"{resource}: {share}{format_amount(resource, usable)}")
    devices = [d.name for d in robot.devices if d.computer == computer.name]
    lines += [f"devices: {', '.join(devices)}"] if devices else []
    key = f"{within}/{computer.name}"
    parts = tuple(
        Box(f"{key}/{name}", name, remark=_remark(name, computer.name, first))
        for name in sorted(here)
    )
    return Box(key, computer.name, "device", tuple(lines), parts)


def _remark(name: str, computer: str, first: Mapping[str, str]) -> str:
    before = first.get(name)
    if before == computer:
        return ""
    return "starts" if before is None else f"from {before}"


def _paths(robot: Robot, placement: Mapping[str, str], within: str) -> Iterator[Join]:
    """Yield a path for each two computers that are linked, or talk to each other."""
    links = {frozenset(link.between): link for link in robot.links}
    crossing: dict[frozenset[str], list[str]] = defaultdict(list)
    traffic: dict[frozenset[str], float] = defaultdict(float)
    for connector in robot.all_connectors():
        ends = [placement.get(end.component) for end in connector.between]
        if None not in ends and ends[0] != ends[1]:
            pair = frozenset(end for end in ends if end is not None)
            crossing[pair].append(" → ".join(e.component for e in connector.between))
            traffic[pair] += connector.traffic
    for pair in dict.fromkeys((*links, *crossing)):
        one, other = (f"{within}/{name}" for name in sorted(pair))
        lines = _path_lines(links.get(pair), crossing[pair], traffic[pair])
        yield Join(one, other, "path", lines=tuple(lines))


def _path_lines(
    link: Link | None, names: Iterable[str], traffic: float
) -> Iterator[str]:
    if link is not None and link.bandwidth < float("inf"):
        latency = f", {format_seconds(link.latency)}" if link.latency else ""
        yield f"{format_bandwidth(link.bandwidth)}{latency}"
    names = list(dict.fromkeys(names))
    if names:
        size = f", {format_bytes(traffic)}/s" if traffic else ""
        yield f"{counted(len(names), 'connector')}{size}"
    if len(names) <= _MOST_CROSSING:
        yield from names


MANAGER = "manager"


def sequence_diagram(
    robot: Robot, title: str, steps: Iterable[TransitionStep]
) -> SequenceDiagram:
    """Return the steps as messages between the manager and the agents of computers."""
    states = {each.name: each.state for each in robot.components()}
    messages = tuple(
        message
        for step in steps
        for message in _messages(step, states.get(step.component, 0.0))
    )
    used = {name for each in messages for name in (each.source, each.target)}
    computers = [c.name for c in robot.computers if c.name in used]
    return SequenceDiagram(f"{robot.name}: {title}", (MANAGER, *computers), messages)


def _messages(step: TransitionStep, state: float) -> Iterator[Arrow]:
    """Yield what a step takes; docs/design/moves.md has all of its parts."""
    name, source, target = step.component, step.source, step.target
    why = f" ({step.why})" if step.why else ""
    if not step.source:
        yield Arrow(MANAGER, target, f"start {name}{why}")
    elif not step.target:
        yield Arrow(MANAGER, source, f"stop {name}{why}")
    else:
        size = f", {format_bytes(state)}" if state else ""
        yield Arrow(MANAGER, target, f"prepare {name}{why}")
        yield Arrow(MANAGER, source, f"pause {name}")
        yield Arrow(source, target, f"state of {name}{size}")
        yield Arrow(MANAGER, target, f"resume {name}")
        yield Arrow(MANAGER, source, f"end {name}")
