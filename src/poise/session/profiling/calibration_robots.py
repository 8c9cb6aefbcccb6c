"""The robots that `poise calibrate` runs: yardsticks, and pairs that communicate."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
from msgspec import Struct

from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)

SIZES = (100, 65_536)
"""[bytes] Small and large; the cost of a byte is the slope between them."""
KINDS = ("direct", "local", "remote")
_MODULE = "poise.runtime.workload.calibration"


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
