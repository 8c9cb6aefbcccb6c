"""The computers of a robot, their devices and links; in SI units.

Resources have any names; ``cpu`` [cores of the reference computer] and ``memory``
[bytes] always exist.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from msgspec import Struct
from msgspec.structs import force_setattr

from poise.model.file_keys import (
    RESERVE,
    Address,
    Amount,
    Bandwidth,
    Bytes,
    Cores,
    Name,
    Resource,
    Seconds,
    entries,
    says,
)

SLACK = 1e-9
"""How far a limit may be passed, relative to it (at least to 1): rounding only."""


def fits(load: float, limit: float) -> bool:
    """Whether `load` keeps `limit`, but for rounding."""
    return load <= limit + SLACK * max(1.0, limit)


class CapacityKeys(Struct):
    """How the capacity of a computer is written."""

    cpu: Annotated[Cores, says("Its cores: 4, or 150%.", gt=0)]
    memory: Annotated[Bytes, says("Its memory for components: 1 GiB.", gt=0)]
    resources: Annotated[
        Mapping[Resource, Amount],
        says("Any other resource that components share, by name: {gpu: 1}."),
    ] = {}


class Computer(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A computer of the robot and its capacity.

    `capacity` [cores, bytes, or the resource's own unit] is before `speed`, which
    scales ``cpu`` only.
    """

    name: str
    capacity: Annotated[Mapping[str, float], entries(CapacityKeys)] = {}
    speed: Annotated[
        Amount,
        says(
            "How fast one core is; the reference computer's are 1. It scales cpu only.",
            gt=0,
        ),
    ] = 1.0
    reserve: Annotated[
        Mapping[str, float],
        RESERVE,
        says(
            "The share that placements leave free: 5% of cpu and memory, or by "
            "resource, as in {cpu: 5%, disk: 10%}. A countable resource such as a GPU "
            "is kept whole unless it is named."
        ),
    ] = {}
    price: Annotated[
        Amount,
        says("What it costs, in any unit; `poise plan --smallest` seeks the least."),
    ] = 1.0
    address: Annotated[
        Address | None,
        says(
            "Host of its agent: 10.0.0.1, robot.local:7500 or [fd00::2]:7500; port "
            "7447 unless given. Either all computers have one, or all are emulated."
        ),
    ] = None
    witness: Annotated[
        bool,
        says(
            "Whether it only votes for the manager, as a router may: nothing is placed "
            "there."
        ),
    ] = False

    def total(self, resource: str) -> float:
        """Return how much it has of `resource`: capacity x speed."""
        speed = self.speed if resource == "cpu" else 1.0
        return self.capacity.get(resource, 0.0) * speed

    @property
    def own_cores(self) -> float:
        """Its CPU in cores of the machine that it is, or that emulates it.

        A real core that is half as fast is a core; an emulated one is half a core.
        """
        return self.capacity.get("cpu", 0.0) if self.address else self.total("cpu")

    def usable(self, resource: str) -> float:
        """Return the usable amount of `resource`: capacity x speed - reserve."""
        return self.total(resource) * (1 - self.reserve.get(resource, 0.0))


class Device(Struct, frozen=True, kw_only=True):
    """A sensor or actuator, fixed to one computer."""

    name: str
    computer: Annotated[Name, says("The computer that it is plugged into.")]
    path: Annotated[
        str, says("A device node, or a socket of the simulator, for its components.")
    ] = ""
    exclusive: Annotated[
        bool, says("Whether only one action may use it at a time.")
    ] = False


class Link(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A network link between two computers."""

    between: Annotated[tuple[Name, Name], says("The two computers it joins.")]
    bandwidth: Annotated[
        Bandwidth,
        says(
            "Each way: 100 Mbit/s. Without it, or without a link, there is no limit.",
            gt=0,
            is_nullable=True,
        ),
    ] = math.inf
    latency: Annotated[Seconds, says("One way: 0.2 ms.")] = 0.0
    distance: Annotated[
        Amount, says("Cost of a unit of overhead over it in the objective.")
    ] = 1.0

    def __post_init__(self) -> None:
        """Take any infinity for the default, which is not written: JSON has none."""
        if self.bandwidth == math.inf:
            force_setattr(self, "bandwidth", math.inf)
