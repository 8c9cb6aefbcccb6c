"""`poise ros2 import` as a function: watch, and return the text of a robot file."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from msgspec import Struct

from poise.errors import RunError
from poise.session.ros2_import.graph_records import Age, Flow, Graph, NodeProcess, Topic
from poise.session.ros2_import.node_processes import (
    WhereImported,
    component_name,
    name_of,
    relevant,
    start_of,
)
from poise.units import counted, format_bytes, format_seconds

HERE = "main"
"""What the computer is called on which the graph was observed."""


class ImportedRobot(Struct, frozen=True):
    """The text of a robot file, and the graph that it was made of."""

    text: str
    graph: Graph

    def summary(self) -> Iterator[str]:
        """Yield what was found, in sentences."""
        graph = self.graph
        nodes = sum(len(process.nodes) for process in graph.processes)
        yield (
            f"{counted(nodes, 'node')} in {counted(len(graph.processes), 'program')}, "
            f"{counted(len(graph.topics), 'topic')}; watching took "
            f"{graph.own_cpu:.1%} of a core"
        )
        for node, why in sorted(graph.elsewhere.items()):
            yield f"{node} is missing: {why}"
        yield from graph.remarks


def import_robot(
    seconds: float,
    *,
    name: str = "ros2",
    folder: Path = Path(),
    computers: Mapping[str, Mapping[str, Any]] | None = None,
) -> ImportedRobot:
    """Watch the ROS 2 graph of this environment, and return it as a robot.

    `folder`: that of the robot file. `computers`: name -> `cpu` and `memory` as there;
    that called ``main`` is this one instead of what it has, and others are added.
    RunError: there is no rclpy, or no node whose process is known.
    """
    try:
        from poise.session.ros2_import.observer import observe
    except ImportError as error:
        raise RunError(
            f"{error}: run this where ROS 2 is: after `source /opt/ros/*/setup.bash`, "
            "or, on x86-64, in an environment with `pip install 'poise[ros2]'`"
        ) from error
    graph = observe(seconds)
    if not graph.processes:
        nodes = [f"{name}: {why}" for name, why in sorted(graph.elsewhere.items())]
        text = "there is no node here that can be imported"
        raise RunError("\n".join([text, *nodes]))
    here = WhereImported(
        folder=str(folder.resolve()),
        environment=relevant(os.environ),
        python=sys.executable,
        read=lambda file: Path(file).read_text(encoding="utf-8"),
    )
    machines = {HERE: hardware_keys(graph), **(computers or {})}
    return ImportedRobot(RobotText(graph, name, machines, here).write(), graph)


_SHARE, _FEWEST = 0.8, 5
"""So many stamps of an output are those of an input, if it passes them on."""


def chains_of(topics: Sequence[Topic]) -> Iterator[tuple[str, list[str], Age | None]]:
    """Yield the longest chains: last topic, nodes to a subscriber of it, age there."""
    for topic in topics:
        for flow in topic.flows:
            if _next_of(flow, topic, topics):
                continue
            nodes = _back_from(flow, topics, ())
            for last in topic.subscribers:
                if len(nodes) > 1 and last not in nodes:
                    yield topic.name, [*nodes, last], flow.age


def _back_from(
    flow: Flow, topics: Sequence[Topic], after: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the nodes that a stamp went through until it was in `flow`."""
    nodes = (flow.node, *after)
    for topic in topics:
        if flow.node not in topic.subscribers:
            continue
        for source in topic.flows:
            if source.node not in nodes and _passes_on(source, flow):
                return _back_from(source, topics, nodes)
    return nodes


def _next_of(flow: Flow, topic: Topic, topics: Sequence[Topic]) -> bool:
    """Whether a subscriber passes the stamps on."""
    return any(
        after.node in topic.subscribers and _passes_on(flow, after)
        for other in topics
        if other.name != topic.name
        for after in other.flows
    )


def _passes_on(source: Flow, result: Flow) -> bool:
    """Whether nearly all stamps of `result` are stamps of `source`, and older then."""
    known = set(source.stamps)
    if not (known and source.age and result.age):
        return False
    comparable = [each for each in result.stamps if min(known) <= each <= max(known)]
    equal = sum(stamp in known for stamp in comparable)
    is_same = len(comparable) >= _FEWEST and equal >= _SHARE * len(comparable)
    return is_same and source.age.median < result.age.median


_ROOM = 1.25
"""How much more memory a component is given than it was seen to hold."""


class RobotText:
    """Writes the robot file; the computer where it was observed comes first."""

    def __init__(
        self,
        graph: Graph,
        robot: str,
        computers: Mapping[str, Mapping[str, Any]],
        here: WhereImported,
    ) -> None:
        self._graph, self._robot = graph, robot
        self._computers, self._here = computers, here
        self._names = _unique_names(graph.processes)
        self._component = {
            node: self._names[process.pid]
            for process in graph.processes
            for node in process.nodes
        }
        self._starts = {p.pid: start_of(p, here) for p in graph.processes}
        self._planned = {
            self._names[pid] for pid, start in self._starts.items() if not start.keys
        }

    def write(self) -> str:
        """Return the text."""
        return "\n".join((*self._head(), *self._body(), ""))

    def _head(self) -> Iterator[str]:
        graph = self._graph
        took = f"{graph.own_cpu:.1%} of a core itself"
        nodes = f"{len(self._component)} nodes in {len(graph.processes)} processes"
        yield f"# Written by `poise ros2 import`, which watched {nodes}"
        yield f"# for {graph.seconds:.0f} s and took {took}. It does not see how"
        yield "# deep queues are, how often services are called, or peaks of CPU."
        yield "# Each node is an architecture: so it can have a `priority` of its own,"
        yield "# and the least important are suspended first when not all fit."
        for node, why in sorted(graph.elsewhere.items()):
            yield f"# {node} is missing: {why}."
        if folders := sorted(set(self._folders_left())):
            yield f"# Programs of packages that were started in {', '.join(folders)}"
            yield "# start in the folder of this file, and find no files there whose"
            yield "# paths are relative."
        for remark in graph.remarks:
            yield f"# {remark}."

    def _folders_left(self) -> Iterator[str]:
        """Yield the folders of programs that are found by their package instead."""
        for process in self._graph.processes:
            is_package = "package" in self._starts[process.pid].keys.get("ros2", {})
            if is_package and Path(process.folder) != Path(self._here.folder):
                yield process.folder

    def _body(self) -> Iterator[str]:
        yield f"robot: {self._robot}"
        yield "computers:"
        yield from self._hardware()
        yield from self._devices()
        yield "architectures:"
        for process in self._graph.processes:
            yield from self._architecture(process)
        yield from self._connectors()
        yield from self._chains()
        yield from self._tasks()

    def _hardware(self) -> Iterator[str]:
        for name, keys in self._computers.items():
            yield f"  {name}: {_flow(keys)}"
        if len(self._computers) == 1:
            yield "  # second: {cpu: 4, memory: 4 GiB} # is it worth it? `poise plan`"

    def _devices(self) -> Iterator[str]:
        first = next(iter(self._computers))
        paths = sorted({path for p in self._graph.processes for path in p.devices})
        if paths:
            yield "devices:"
        for path in paths:
            yield f"  {_device(path)}: {_flow({'computer': first, 'path': path})}"

    def _architecture(self, process: NodeProcess) -> Iterator[str]:
        name, start = self._names[process.pid], self._starts[process.pid]
        if len(process.nodes) > 1:
            both = ", ".join(process.nodes)
            yield f"  # {both}: one process, measured and placed as one"
        for remark in start.remarks:
            yield f"  # {name}: {remark}"
        if not start.keys:
            yield f"  # {name} is for planning only: say under `ros2` how it starts"
        yield f"  {name}:"
        yield f"    function: {name}"
        yield "    components:"
        demand = {
            "cpu": f"{max(process.cpu, 0.001):.1%}",
            "memory": f"{_ROOM * process.memory / 2**20:.0f} MiB",
        }
        devices = [_device(path) for path in process.devices]
        keys = {**start.keys, **demand, **({"devices": devices} if devices else {})}
        yield f"      {name}:"
        for key, value in keys.items():
            yield f"        {key}: {_flow(value)}"

    def _connectors(self) -> Iterator[str]:
        lines = [*self._topics(), *self._calls()]
        if any(not line.startswith("#") for line in lines):
            yield "connectors:"
        for line in lines:
            yield f"  {line}"

    def _topics(self) -> Iterator[str]:
        for topic in self._graph.topics:
            about = f"{topic.type}{', ' if topic.quality else ''}{topic.quality}"
            seen: set[tuple[str, str]] = set()
            for flow in topic.flows:
                for subscriber in topic.subscribers:
                    ends = self._ends(flow.node, subscriber)
                    if ends and ends not in seen:
                        seen.add(ends)
                        keys = {"between": [*ends], "topic": topic.name}
                        keys |= _traffic(flow)
                        yield f"- {_flow(keys)} # {about}{_note(topic, flow)}"
            if not seen and any(flow.rate for flow in topic.flows):
                yield f"# {topic.name} goes to no other process"

    def _calls(self) -> Iterator[str]:
        for call in self._graph.calls:
            for client in call.clients:
                for server in call.servers:
                    if ends := self._ends(client, server):
                        keys = {"between": [*ends], "topic": call.name}
                        yield f"- {_flow(keys)} # {call.kind}, {call.type}"

    def _ends(self, source: str, target: str) -> tuple[str, str] | None:
        """Return the components of two nodes; None: they are not two of this file."""
        one, other = self._component.get(source), self._component.get(target)
        return (one, other) if one and other and one != other else None

    def _chains(self) -> Iterator[str]:
        lines = []
        for topic, nodes, age in chains_of(self._graph.topics):
            components = dict.fromkeys(map(self._component.get, nodes))
            through = [component for component in components if component]
            if len(through) > 1 and age:
                keys = {"through": through, "deadline": "?"}
                ages = f"median {format_seconds(age.median)}, "
                ages += f"99 % within {format_seconds(age.p99)}"
                line = f"{name_of(topic)}: {_flow(keys)}"
                lines.append(f"#   {line} # age at arrival: {ages}")
        if lines:
            yield "# Stamps are passed on along these chains; set their deadlines:"
            yield "# chains:"
            yield from lines

    def _tasks(self) -> Iterator[str]:
        all_names = list(self._names.values())
        runnable = [name for name in all_names if name not in self._planned]
        yield "tasks:"
        if runnable:
            yield from _task("work", runnable)
        if runnable != all_names:
            yield "  # for `poise plan` only"
            yield from _task("plan_all", all_names)


def _task(name: str, functions: Sequence[str]) -> Iterator[str]:
    yield f"  {name}:"
    yield f"    actions: [{{name: {name}, functions: {_flow(functions)}}}]"


def _unique_names(processes: Sequence[NodeProcess]) -> dict[int, str]:
    names: dict[int, str] = {}
    for process in processes:
        name = base = component_name(process)
        count = 1
        while name in names.values():
            count += 1
            name = f"{base[:58]}_{count}"
        names[process.pid] = name
    return names


def _device(path: str) -> str:
    return name_of(path.removeprefix("/dev/"))


def _traffic(flow: Flow) -> dict[str, str]:
    if not flow.rate:
        return {}
    size = f"{flow.size:.0f} B" if flow.size < 1e4 else f"{flow.size / 1e3:.4g} kB"  # noqa: PLR2004
    return {"message": size, "rate": f"{flow.rate:.3g} Hz"}


def _note(topic: Topic, flow: Flow) -> str:
    if topic.unmeasured:
        return f", not measured: {topic.unmeasured}"
    return "" if flow.rate else ", no message came"


def hardware_keys(graph: Graph) -> dict[str, Any]:
    """Return the computer on which a graph was observed, as keys of a robot file."""
    computer = graph.computer
    shares = {
        "cpu": computer.other_cpu / computer.cores,
        "memory": computer.other_memory / computer.memory if computer.memory else 0.0,
    }
    return {
        "cpu": computer.cores,
        "memory": format_bytes(computer.memory),
        "reserve": {key: f"{min(share, 0.95):.0%}" for key, share in shares.items()},
    }


class _Dumper(yaml.SafeDumper):
    """Quotes text that a robot file takes for a number, such as 1e3."""


_REFERENCE = re.compile(r"(?=\$\(\w+\))")
"""Where text begins that a robot file takes for an argument: a `$` makes it text."""


def _represent(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    style, text = None, _REFERENCE.sub("$", text)
    with contextlib.suppress(ValueError):
        float(text)
        style = "'"
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent)


def _flow(value: object) -> str:
    """Return a value as YAML on one line."""
    text = yaml.dump(
        value,
        Dumper=_Dumper,
        default_flow_style=True,
        sort_keys=False,
        allow_unicode=True,
        width=float("inf"),
    )
    return text.removesuffix("\n").removesuffix("\n...")
