"""Turns one Linux machine into the computers of a robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Self

from msgspec.structs import replace

from poise.clock import wall_time
from poise.emulate import cgroups as cgroup_files
from poise.emulate import emulated_network, processes
from poise.emulate.cgroups import Groups
from poise.emulate.computer import EmulatedComputer
from poise.emulate.emulated_network import NetworkPlan
from poise.emulate.layout import EmulationLayout, KeptSet, lay_out
from poise.emulate.limits import shortages
from poise.emulate.probe import Probe, probe_host
from poise.emulate.registry import addresses, register, remove, sweep
from poise.errors import RunError
from poise.model.robot import Robot

# One process may own several emulations, one after the other or at once.
_numbers = count()


class Emulation:
    """All computers of a robot on this machine, until it is closed.

    `without` lists what the machine does not allow. First it cleans up after earlier
    runs that were killed.
    """

    computers: Mapping[str, EmulatedComputer]  # by name
    # sentences for the user: the missing ones of quota, CPU set, memory limit,
    # namespaces and shaped links, and why; and where the machine is too small
    without: tuple[str, ...]
    address: str  # the owner's address in the emulated network, without limits

    def __init__(
        self,
        robot: Robot,
        folder: Path,
        *,
        probe: Probe | None = None,
        keep: bool = False,
    ) -> None:
        sweep()
        host, number = probe or probe_host(), next(_numbers)
        kept = KeptSet.of(robot) if keep else None
        self._layout = register(
            lambda taken: lay_out(robot, folder, host, number, kept, taken)
        )
        self.computers = {}
        try:
            groups, refused = _prepared(host.groups, self._layout.run)
            if refused:
                host, aside = replace(host, groups=groups), self._layout.aside
                taken = addresses(but=self._layout.run)
                again = lay_out(robot, folder, host, number, kept, taken)
                self._layout = replace(again, aside=aside)
            self._make(self._layout, groups, host, refused)
            if kept is not None:
                kept = replace(kept, since=wall_time(), without=self.without)
                self._layout = replace(self._layout, kept=kept)
            register(lambda _: self._layout)
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                message = f"this machine refuses an emulated computer: {error}"
                raise RunError(message) from error
            raise

    def close(self, ask: float = processes.ASK) -> None:
        """Ask processes to end, kill them after `ask` [s], and remove everything."""
        try:
            for computer in self._layout.computers:
                for group in computer.groups:  # to end takes CPU time
                    cgroup_files.lift(group)
            processes.stop(self._running, ask)
        finally:
            remove(self._layout)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _make(
        self, layout: EmulationLayout, groups: Groups, host: Probe, refused: list[str]
    ) -> None:
        computers = {}
        for computer in layout.computers:
            Path(computer.folder).mkdir(parents=True)
            groups.make(computer.mark, computer.limits)
            computers[computer.name] = EmulatedComputer(computer)
        self.computers = MappingProxyType(computers)
        unshaped = _wire(layout.network, host) if layout.network else []
        self.address = layout.network.owner_address if layout.network else "127.0.0.1"
        self.without = (
            *(refused or host.without_groups()),
            *([_PINNED] if layout.computers[0].pin else []),
            *shortages({each.name: each.limits for each in layout.computers}),
            *([_BLIND] if _is_blind(computers.values()) else []),
            *host.without_network(),
            *unshaped,
        )

    def _running(self) -> list[int]:
        """Return the processes of all computers."""
        return [pid for each in self.computers.values() for pid in each.running()]


_PINNED = "CPU set in a cgroup: taskset is used instead, which a program can undo"
_BLIND = (
    "invalid runs: the kernel does not report the CPU pressure of cgroups, so Poise "
    "cannot tell when the host is too busy for the emulation"
)


def _is_blind(computers: Iterable[EmulatedComputer]) -> bool:
    return any(computer.usage().starved is None for computer in computers)


def _prepared(groups: Groups, run: str) -> tuple[Groups, list[str]]:
    """Return groups that can be made, and why they differ from `groups`."""
    try:
        groups.prepare(run)
    except OSError as error:
        reason = f"quota, CPU set and memory limit: the kernel refuses cgroups: {error}"
        return Groups(), [reason]
    return groups, []


def _wire(plan: NetworkPlan, host: Probe) -> list[str]:
    """Make the network, shaped if possible; return what is missing."""
    emulated_network.build(plan)
    if "tc" not in host.tools:
        return []
    slow = any(shape.latency for _, _, shape in plan.links)
    delays = slow and emulated_network.can_delay(plan.switch)
    emulated_network.shape(plan, delays=delays)
    reason = "link latency: this kernel cannot delay packets (no sch_netem)"
    return [reason] if slow and not delays else []
