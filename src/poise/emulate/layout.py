"""The layout of an emulation, decided before anything is made."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from poise.emulate.cleanup import Cleanup
from poise.emulate.limits import Limits, share_out
from poise.emulate.network.plan import NetworkPlan, plan_network
from poise.emulate.owner import Owner
from poise.emulate.probe import Probe
from poise.errors import UsageError
from poise.model.robot import Robot


class ComputerLayout(Struct, frozen=True, kw_only=True):
    """The layout of one computer.

    Parameters
    ----------
    mark
        Names its group, and marks its processes.
    address
        The IP address at which its processes listen.
    folder
        Its private folder.
    namespace
        Its network namespace; None: the owner's.
    """

    name: str
    mark: str
    address: str
    folder: Path
    limits: Limits
    namespace: str | None = None


class EmulationLayout(Struct, frozen=True, kw_only=True):
    """The whole emulation; `network` is None where there are no namespaces."""

    run: str
    places: tuple[ComputerLayout, ...]
    network: NetworkPlan | None
    cleanup: Cleanup


def lay_out(robot: Robot, folder: Path, host: Probe, number: int) -> EmulationLayout:
    """Return the layout of the computers of `robot` on `host`.

    Parameters
    ----------
    folder
        The run's folder.
    number
        Distinguishes the emulations of one process.

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
    network = (
        plan_network(owner, number, names, robot.links) if host.has_namespaces else None
    )
    places = tuple(
        ComputerLayout(
            name=name,
            mark=f"{run}-{index}",
            address=network.cables[index].address
            if network
            else _loopback(owner.pid + number, index),
            folder=_private(folder, name),
            limits=limits[index],
            namespace=network.cables[index].namespace if network else None,
        )
        for index, name in enumerate(names)
    )
    return EmulationLayout(
        run=run,
        places=places,
        network=network,
        cleanup=_cleanup(owner, run, places, network, host),
    )


def _cleanup(
    owner: Owner,
    run: str,
    places: tuple[ComputerLayout, ...],
    network: NetworkPlan | None,
    host: Probe,
) -> Cleanup:
    groups = [path for place in places for path in host.groups.folders(place.mark)]
    return Cleanup(
        owner=owner,
        run=run,
        marks=tuple(place.mark for place in places),
        groups=tuple(map(str, groups)),
        aside=tuple(map(str, host.groups.aside(run))),
        interfaces=(network.owner,) if network else (),
        namespaces=network.namespaces if network else (),
        folders=tuple(str(place.folder) for place in places),
    )


def _private(folder: Path, name: str) -> Path:
    private = folder.absolute() / name
    if private.exists():
        message = f"{private} exists: give each run a folder of its own"
        raise UsageError(message)
    return private


def _loopback(run: int, index: int) -> str:
    """Return an address in 127.0.0.0/8; concurrent runs get different ones."""
    return f"127.{1 + run % 254}.{index}.1"
