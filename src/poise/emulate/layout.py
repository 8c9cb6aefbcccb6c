"""The layout of an emulation: all that it makes on the host, decided before."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Literal

from msgspec import Struct

from poise.emulate.cgroups import Probe
from poise.emulate.emulated_network import NetworkPlan, Shape, plan_network
from poise.emulate.limits import Limits, share_out
from poise.emulate.processes import Owner
from poise.errors import UsageError
from poise.model.robot import Robot

FaultKind = Literal["cut", "slow", "crashed", "frozen", "frozen agent", "load"]


class InjectedFault(Struct, frozen=True, kw_only=True):
    """A fault that any process injected, in force until it is healed.

    Parameters
    ----------
    on
        The computer, or the two computers of a link.
    since
        [s since 1970].
    shape
        Of a slow link.
    cpu
        Of a load [host cores].
    processes
        Of a load: their numbers.
    """

    kind: FaultKind
    on: tuple[str, ...]
    since: float
    shape: Shape | None = None
    cpu: float | None = None
    processes: tuple[int, ...] = ()

    def __str__(self) -> str:
        since = time.strftime("%H:%M:%S", time.localtime(self.since))
        what = f"{self.kind} {' '.join(self.on)}"
        if self.cpu is not None:
            what += f" of {self.cpu:g} cores"
        if self.shape is not None and self.shape.bandwidth is not None:
            what += f" to {self.shape.bandwidth * 8e-6:g} Mbit/s"
        if self.shape is not None and self.shape.latency:
            what += f" with {self.shape.latency * 1e3:g} ms"
        return f"{what} since {since}"

    @property
    def way_out(self) -> str:
        """What ends it, for people."""
        on = " ".join(self.on)
        if self.kind == "load":
            return f"`poise emulate load {on} --cpu 0` ends it"
        verb = "heal" if self.kind in {"cut", "slow"} else "boot"
        return f"`poise emulate {verb} {on}` ends it"


class ComputerLayout(Struct, frozen=True, kw_only=True):
    """The layout of one computer."""

    name: str
    mark: str  # names its group; its processes inherit it
    address: str  # the IP address at which its processes listen
    folder: str  # its private folder
    limits: Limits
    homes: Mapping[str, str] = {}  # cgroup controller -> its folder there
    namespace: str | None = None  # its network namespace; None: the owner's
    pin: bool = False  # whether ``taskset`` gives its processes their CPUs
    has_quota: bool = False  # whether its quota is enforced

    @property
    def groups(self) -> tuple[str, ...]:
        """Its cgroup folders."""
        return tuple(dict.fromkeys(self.homes.values()))


class KeptSet(Struct, frozen=True, kw_only=True):
    """What others must know of an emulation that is kept for them."""

    robot: str  # its name
    # the robot's computers and links, to compare with those of a robot file
    hardware: str
    since: float | None = None  # when it was up [s since 1970]; None: it is not yet
    without: tuple[str, ...] = ()  # `Emulation.without`
    faults: tuple[InjectedFault, ...] = ()  # the injected ones that are in force

    @classmethod
    def of(cls, robot: Robot) -> KeptSet:
        """Return what is known of a robot's emulation before it is up."""
        return cls(robot=robot.name, hardware=repr((robot.computers, robot.links)))


class EmulationLayout(Struct, frozen=True, kw_only=True):
    """The whole emulation."""

    owner: Owner
    run: str  # its name; unique on this machine
    computers: tuple[ComputerLayout, ...] = ()
    network: NetworkPlan | None = None  # none where there are no namespaces
    # cgroup folders with processes that were in the way; they go back at the end
    aside: tuple[str, ...] = ()
    kept: KeptSet | None = None  # none: only the owner uses it


def lay_out(
    robot: Robot,
    folder: Path,
    host: Probe,
    number: int,
    kept: KeptSet | None = None,
    taken: Collection[str] = (),
) -> EmulationLayout:
    """Return the layout of the computers of `robot` on `host`."""
    owner = Owner.this()
    run = f"{owner}-{number}"
    names = [computer.name for computer in robot.computers]
    limits = share_out(robot.computers, host.cpus)
    network = None
    if host.has_namespaces:
        network = plan_network(owner, number, names, robot.links, taken)
    loopback = _loopback(owner.pid + number, taken)
    computers = []
    for index, name in enumerate(names):
        mark = f"{run}-{index}"
        cable = network.cables[index] if network else None
        homes = host.groups.homes(mark)
        computers.append(
            ComputerLayout(
                name=name,
                mark=mark,
                address=cable.address if cable else f"{loopback}{index}.1",
                folder=_private(folder, name),
                limits=limits[index],
                homes={which: str(home) for which, home in homes.items()},
                namespace=cable.namespace if cable else None,
                pin="cpuset" not in host.groups.controls and "taskset" in host.tools,
                has_quota="cpu" in host.groups.controls,
            )
        )
    return EmulationLayout(
        owner=owner,
        run=run,
        computers=tuple(computers),
        network=network,
        aside=tuple(map(str, host.groups.aside(run))),
        kept=kept,
    )


def _private(folder: Path, name: str) -> str:
    private = folder.absolute() / name
    if private.exists():
        message = f"{private} exists: give each run a folder of its own"
        raise UsageError(message)
    return str(private)


def _loopback(start: int, taken: Collection[str]) -> str:
    """Return how free addresses in 127.0.0.0/8 begin, such as ``127.7.``."""
    begins = [f"127.{1 + (start + step) % 254}." for step in range(254)]
    free = (begin for begin in begins if not any(t.startswith(begin) for t in taken))
    return next(free, begins[0])
