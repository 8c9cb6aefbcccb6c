"""Turns one Linux machine into the computers of a robot: starts programs on each."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import IO, Self

from msgspec.structs import replace

from poise.clock import Clock, wall_time
from poise.emulate import cgroups as cgroup_files
from poise.emulate import emulated_network, processes
from poise.emulate.cgroups import Group, Groups, Probe, probe_host
from poise.emulate.emulated_network import NAMESPACES, NetworkPlan
from poise.emulate.limits import Usage, is_starved, shortages
from poise.emulate.processes import MARK, stop
from poise.emulate.registry import (
    ComputerLayout,
    KeptSet,
    lay_out,
    register,
    regrouped,
    remove,
    sweep,
)
from poise.errors import RunError
from poise.kernel_counters import CPU_GROUP, PRESSURE_GROUP, stolen_time
from poise.model.robot import Robot
from poise.threads import remedy_of

Stream = int | IO[bytes] | None

# A shell enters the cgroups and then becomes the program: it never runs outside, and
# nothing of Python happens between fork and exec. "--" ends the files.
_ENTER = (
    'while [ "$1" != -- ]; do echo $$ > "$1" || exit 126; shift; done; shift; exec "$@"'
)


SLOWDOWN = "POISE_SLOWDOWN"
"""Environment variable: how many times faster a computer is than the one it emulates.

More than 1 only where the machine allows no quota. Programs that do work of a declared
size can do that many times as much, and then take as long as they would there.
"""


CPU_FILE = "POISE_CPU_FILE"
"""Environment variable: the file that counts the computer's CPU time; empty: none."""


class EmulatedComputer:
    """A computer of the robot, emulated by a part of this one."""

    def __init__(self, layout: ComputerLayout) -> None:
        self.name = layout.name
        self.address = layout.address
        self.folder = Path(layout.folder)
        self.limits = layout.limits
        self.promised = layout.limits.quota  # cores: with less, it was starved
        homes = {which: Path(home) for which, home in layout.homes.items()}
        self._group = Group(layout.mark, homes, len(layout.limits.cpus))
        self._cpu_group = homes.get("cpu") if layout.has_quota else None
        pressure = homes.get("pressure")
        self._pressure_group = None if pressure == homes.get("cpu") else pressure
        self._mark = layout.mark
        self._prefix = _prefix(layout)
        too_fast = len(layout.limits.cpus) / layout.limits.quota
        self.slowdown = 1.0 if layout.has_quota else max(1.0, too_fast)
        self._stolen = stolen_time(layout.limits.cpus)
        self._children: list[subprocess.Popen[bytes]] = []

    def popen(
        self,
        argv: Sequence[str],
        *,
        env: Mapping[str, str] | None = None,
        cwd: str | Path | None = None,
        stdin: Stream = None,
        stdout: Stream = None,
        stderr: Stream = None,
        pass_fds: Sequence[int] = (),
    ) -> subprocess.Popen[bytes]:
        """Start a program on the computer, in a session of its own.

        It is within all limits before its first instruction. Its process is the one
        that is returned (no wrapper stays between). A program that cannot be found
        ends with code 127, one that cannot enter its cgroup with 126.
        """
        joins = [str(file) for file in self._group.joins]
        child = subprocess.Popen(  # noqa: S603 - the arguments are never parsed by the shell
            ["/bin/sh", "-c", _ENTER, "sh", *joins, "--", *self._prefix, *argv],
            env={**(os.environ if env is None else env), **self._environment()},
            cwd=cwd,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            pass_fds=pass_fds,
            start_new_session=True,
        )
        self._children.append(child)
        return child

    def end_started(self) -> None:
        """End what was started on it by this object, but nothing else there."""
        stop(lambda: [child.pid for child in self._children if child.poll() is None])

    def running(self) -> list[int]:
        """Return the numbers of all processes on it."""
        # poll() reaps ended children. A new one may not have entered its group yet.
        self._children = [child for child in self._children if child.poll() is None]
        started = {child.pid for child in self._children}
        return sorted(started.union(self._group.processes()))

    def usage(self) -> Usage:
        """Return its usage since it was made."""
        usage = self._group.usage()
        if usage.starved is None:
            return usage
        stolen = stolen_time(self.limits.cpus) - self._stolen
        return replace(usage, starved=usage.starved + stolen)

    def was_starved(self, before: Usage, after: Usage) -> bool:
        """Return whether the host starved it (`is_starved`)."""
        return is_starved(before, after, self.promised, len(self.limits.cpus))

    def _environment(self) -> dict[str, str]:
        return {
            MARK: self._mark,
            "TMPDIR": str(self.folder),
            SLOWDOWN: f"{self.slowdown:g}",
            CPU_FILE: str(self._group.cpu_file or ""),
            CPU_GROUP: str(self._cpu_group or ""),
            PRESSURE_GROUP: str(self._pressure_group or ""),
        }


def _prefix(layout: ComputerLayout) -> list[str]:
    """Return the command that enters namespace and CPU set, and becomes the program."""
    namespace = layout.namespace
    return [
        *(["nsenter", f"--net={NAMESPACES / namespace}"] if namespace else []),
        *(["taskset", "--cpu-list", layout.limits.cpu_list] if layout.pin else []),
    ]


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
                host = replace(host, groups=groups)
                self._layout = regrouped(self._layout, host)
            self._make(host, refused)
            if kept is not None:
                why = "" if self._layout.network else "; ".join(host.without_network())
                kept = replace(
                    kept, since=wall_time(), without=self.without, no_network=why
                )
                self._layout = replace(self._layout, kept=kept)
            register(lambda _: self._layout)
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                why = f"{error}{remedy_of(error)}"
                message = f"this machine refuses an emulated computer: {why}"
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

    def _make(self, host: Probe, refused: list[str]) -> None:
        layout, computers = self._layout, {}
        for computer in layout.computers:
            Path(computer.folder).mkdir(parents=True)
            host.groups.make(computer.mark, computer.limits)
            computers[computer.name] = EmulatedComputer(computer)
        self.computers = MappingProxyType(computers)
        unshaped = _wire(layout.network, host) if layout.network else []
        self.address = layout.network.owner_address if layout.network else "127.0.0.1"
        self.without = (
            *(refused or host.without_groups()),
            *([_PINNED] if layout.computers[0].pin else []),
            *shortages(
                {computer.name: computer.limits for computer in layout.computers}
            ),
            *(
                [_BLIND]
                if any(c.usage().starved is None for c in computers.values())
                else []
            ),
            *host.without_network(),
            *unshaped,
        )

    def _running(self) -> list[int]:
        """Return the processes of all computers."""
        return [
            pid for computer in self.computers.values() for pid in computer.running()
        ]


_PINNED = "CPU set in a cgroup: taskset is used instead, which a program can undo"
_BLIND = (
    "invalid runs: the kernel does not report the CPU pressure of cgroups, so Poise "
    "cannot tell when the host is too busy for the emulation"
)


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


WINDOW = 1.0
"""The shortest window [s]: long against a quota's period, short against a run."""


class StarvationWatch:
    """Counts how long each computer was starved, window by window."""

    def __init__(self, computers: Mapping[str, EmulatedComputer], clock: Clock) -> None:
        self._computers = computers
        self._clock = clock
        self._starved: dict[str, float] = {}
        self._since = clock.now()
        self._before = self._usages()

    def poll(self) -> None:
        """Judge the window if it has ended; call it more often than every `WINDOW`."""
        if self._clock.now() - self._since >= WINDOW:
            self._judge()

    def end(self) -> Mapping[str, float]:
        """Judge the last window; return the starved computers, and how long [s].

        The run is invalid unless the result is empty.
        """
        self._judge()
        return dict(self._starved)

    def _judge(self) -> None:
        now, after = self._clock.now(), self._usages()
        for name, computer in self._computers.items():
            before = self._before[name]
            if computer.was_starved(before, after[name]):
                lasted = now - self._since
                self._starved[name] = self._starved.get(name, 0.0) + lasted
        self._since, self._before = now, after

    def _usages(self) -> dict[str, Usage]:
        return {name: computer.usage() for name, computer in self._computers.items()}
