"""Derives the costs of connectors from the CPU of pairs that communicate. Pure.

The cost of a call is the CPU of its pair minus that of two containers that do not
communicate: one with the same timer, and an empty one. So timers and containers cancel
out. What remains is the call: encoding, waking the other end, and cold caches, as in a
component that calls once in each step.

The CPU of a container is the median over the samples' intervals, so that the rest of
its start does not count.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise

import msgspec
from msgspec import Struct

from poise.errors import RunError
from poise.estimate.profiles import Costs, KindCosts
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.wire.records.status_records import AgentSample, ContainerSample

SIZES = (100, 65_536)
"""[bytes] Small and large; the cost of a byte is the slope between them."""
KINDS = ("direct", "local", "remote")
_MODULE = "poise.runtime.calibration"


class Pair(Struct, frozen=True):
    """Two components that communicate, and how."""

    kind: str
    how: str
    size: int

    @property
    def name(self) -> str:
        """The name of their architecture."""
        return f"{self.kind}-{self.how}-{self.size}"

    @property
    def containers(self) -> tuple[str, ...]:
        """The names of their containers."""
        if self.kind == "direct":
            return (self.name,)
        return (f"{self.name}.{self.name}-source", f"{self.name}.{self.name}-target")


PAIRS = tuple(
    Pair(kind, how, size)
    for kind in KINDS
    for how in ("call", "message")
    for size in SIZES
)
EMPTY = "empty"
"""A container that does nothing, like a target without traffic."""
TICKING = "ticking"
"""A container whose component has an empty timer, like a silent source."""


def yardsticks(robot: Robot) -> tuple[Robot, dict[str, str]]:
    """Return a robot with a yardstick on each of `robot`'s computers; its placement."""
    components = {f"yardstick-{c.name}": c.name for c in robot.computers}
    architecture = Architecture(
        name="yardsticks",
        function="yardsticks",
        components=tuple(
            ComponentEntry(name=n, implementation=f"{_MODULE}:Yardstick", isolated=True)
            for n in components
        ),
    )
    return _bare(robot, (architecture,)), components


def pairs(robot: Robot, here: str, there: str) -> tuple[Robot, dict[str, str]]:
    """Return a robot with pairs on and between two of `robot`'s computers."""
    placement = {}
    architectures = list(_architectures())
    for pair in PAIRS:
        placement[f"{pair.name}-source"] = here
        placement[f"{pair.name}-target"] = there if pair.kind == "remote" else here
    for name, implementation in (
        (EMPTY, "poise.runtime.component.component:Component"),
        (TICKING, f"{_MODULE}:Ticker"),
    ):
        placement[name] = here
        silent = ComponentEntry(name=name, implementation=implementation)
        architectures.append(
            Architecture(name=name, function=name, components=(silent,))
        )
    return _bare(robot, tuple(architectures)), placement


def _architectures() -> Iterator[Architecture]:
    for pair in PAIRS:
        source, target = (
            ("Asker", "Echoer") if pair.how == "call" else ("Talker", "Listener")
        )
        ends = (f"{pair.name}-source", f"{pair.name}-target")
        yield Architecture(
            name=pair.name,
            function=pair.name,
            components=tuple(
                ComponentEntry(
                    name=name,
                    implementation=f"{_MODULE}:{class_}",
                    isolated=pair.kind != "direct",
                    parameters={"size": pair.size},
                )
                for name, class_ in zip(ends, (source, target), strict=True)
            ),
            connectors=(
                Connector(
                    between=(
                        ConnectorEnd(ends[0], "port"),
                        ConnectorEnd(ends[1], "port"),
                    )
                ),
            ),
        )


def _bare(robot: Robot, architectures: tuple[Architecture, ...]) -> Robot:
    """Return the robot's computers and links with other software."""
    return msgspec.structs.replace(
        robot,
        architectures=architectures,
        connectors=(),
        chains=(),
        tasks=(),
        together=(),
        apart=(),
        simulator=None,
        workload=None,
    )


class Use(Struct, frozen=True):
    """CPU time of one call or message at either end [s]."""

    source: float
    target: float


def costs_of(
    samples: Iterable[AgentSample], speeds: Mapping[str, float]
) -> dict[str, KindCosts]:
    """Return the costs of connectors by kind; remote only with two computers."""
    uses, computers = _uses(samples, speeds)
    kinds = KINDS if len(computers) > 1 else KINDS[:-1]
    costs = {kind: _fitted(uses, kind) for kind in kinds}
    for kind, both in costs.items():
        if kind != "direct" and not both.source.call * both.source.message:
            raise RunError(
                f"the cost of a {kind} connector cannot be separated from other load; "
                "try again on a less busy machine, or with a longer --for"
            )
    return costs


def _uses(
    samples: Iterable[AgentSample], speeds: Mapping[str, float]
) -> tuple[dict[Pair, Use], set[str]]:
    series: dict[str, list[ContainerSample]] = defaultdict(list)
    where: dict[str, str] = {}
    for sample in samples:
        for container in sample.containers:
            series[container.name].append(container)
            where[container.name] = sample.computer
    for name in (EMPTY, TICKING, *(name for pair in PAIRS for name in pair.containers)):
        if name not in series or series[name][-1].at <= series[name][0].at:
            raise RunError(f"container '{name}' sent no samples; try again")
    used = {name: _cores(each) for name, each in series.items()}
    found = {}
    for pair in PAIRS:
        source = series[pair.containers[0]]
        seconds = source[-1].at - source[0].at
        count = _count(source[-1]) - _count(source[0])
        if count <= 0:
            raise RunError(f"the pair '{pair.name}' did not communicate; try again")
        spent = [
            max(0.0, used[name] - used[silent]) * seconds / count * speeds[where[name]]
            for name, silent in zip(pair.containers, (TICKING, EMPTY), strict=False)
        ]
        found[pair] = Use(spent[0], sum(spent[1:]))
    return found, set(where.values())


def _cores(samples: Sequence[ContainerSample]) -> float:
    """Return the CPU of a container [cores]."""
    return statistics.median(
        (b.cpu - a.cpu) / (b.at - a.at) for a, b in pairwise(samples) if b.at > a.at
    )


def _count(sample: ContainerSample) -> int:
    return sum(each.calls + each.messages for each in sample.connectors)


def _fitted(uses: Mapping[Pair, Use], kind: str) -> KindCosts:
    return KindCosts(
        source=_end({p: use.source for p, use in uses.items()}, kind),
        target=_end({p: use.target for p, use in uses.items()}, kind),
    )


def _end(uses: Mapping[Pair, float], kind: str) -> Costs:
    """Fit a line through small and large sizes; calls and messages share its slope."""
    small, large = SIZES
    calls = [uses[Pair(kind, "call", size)] for size in SIZES]
    messages = [uses[Pair(kind, "message", size)] for size in SIZES]
    slopes = [(b - a) / (large - small) for a, b in (calls, messages)]
    byte = max(0.0, sum(slopes) / len(slopes))
    return Costs(
        call=max(0.0, calls[0] - small * byte),
        message=max(0.0, messages[0] - small * byte),
        byte=byte,
    )
