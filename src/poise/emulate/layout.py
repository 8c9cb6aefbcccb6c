"""The layout of an emulation: all that it makes on the host, decided before.

The registry keeps it on disk, so that another process can find or remove it.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Literal

from msgspec import Struct

from poise.emulate.emulated_network import NetworkPlan, Shape, plan_network
from poise.emulate.limits import Limits, share_out
from poise.emulate.owner import Owner
from poise.emulate.probe import Probe
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


class ComputerLayout(Struct, frozen=True, kw_only=True):
    """The layout of one computer.

    Parameters
    ----------
    mark
        Names its group; its processes inherit it.
    address
        The IP address at which its processes listen.
    folder
        Its private folder.
    homes
        Cgroup controller -> its folder there.
    namespace
        Its network namespace; None: the owner's.
    pin
        Whether ``taskset`` gives its processes their CPUs.
    has_quota
        Whether its quota is enforced.
    """

    name: str
    mark: str
    address: str
    folder: str
    limits: Limits
    homes: Mapping[str, str] = {}
    namespace: str | None = None
    pin: bool = False
    has_quota: bool = False

    @property
    def groups(self) -> tuple[str, ...]:
        """Its cgroup folders."""
        return tuple(dict.fromkeys(self.homes.values()))


class KeptSet(Struct, frozen=True, kw_only=True):
    """What others must know of an emulation that is kept for them.

    Parameters
    ----------
    robot
        Its name.
    hardware
        The robot's computers and links, to compare with those of a robot file.
    since
        When it was up [s since 1970]; None: it is not yet.
    without
        `Emulation.without`.
    faults
        The injected ones that are in force.
    """

    robot: str
    hardware: str
    since: float | None = None
    without: tuple[str, ...] = ()
    faults: tuple[InjectedFault, ...] = ()

    @classmethod
    def of(cls, robot: Robot) -> KeptSet:
        """Return what is known of a robot's emulation before it is up."""
        return cls(robot=robot.name, hardware=repr((robot.computers, robot.links)))


class EmulationLayout(Struct, frozen=True, kw_only=True):
    """The whole emulation.

    Parameters
    ----------
    run
        Its name; unique on this machine.
    network
        None where there are no namespaces.
    aside
        Cgroup folders with processes that were in the way; they go back at the end.
    kept
        None: only the owner uses it.
    """

    owner: Owner
    run: str
    computers: tuple[ComputerLayout, ...] = ()
    network: NetworkPlan | None = None
    aside: tuple[str, ...] = ()
    kept: KeptSet | None = None


def lay_out(
    robot: Robot,
    folder: Path,
    host: Probe,
    number: int,
    kept: KeptSet | None = None,
    taken: Collection[str] = (),
) -> EmulationLayout:
    """Return the layout of the computers of `robot` on `host`.

    Parameters
    ----------
    folder
        The run's folder.
    number
        Distinguishes the emulations of one process.
    taken
        IP addresses of other emulations.

    Raises
    ------
    RobotError
        When a computer cannot be emulated.
    UsageError
        `folder` belongs to another run.
    """
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
    free = (each for each in begins if not any(t.startswith(each) for t in taken))
    return next(free, begins[0])
