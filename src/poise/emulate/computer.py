"""One emulated computer: starts processes on it, reads its usage."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

import msgspec

from poise.emulate.cgroups import Files, Group
from poise.emulate.emulated_network import NAMESPACES
from poise.emulate.layout import ComputerLayout
from poise.emulate.processes import MARK, stop
from poise.emulate.usage import Usage, is_starved
from poise.kernel_counters import stolen_time

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


CPU_GROUP = "POISE_CPU_GROUP"
"""Environment variable: the computer's CPU cgroup, for groups in it; empty: none."""


class EmulatedComputer:
    """A computer of the robot, emulated by a part of this one."""

    def __init__(self, layout: ComputerLayout) -> None:
        self.name = layout.name
        self.address = layout.address
        self.folder = Path(layout.folder)
        self.limits = layout.limits
        homes = {which: Path(home) for which, home in layout.homes.items()}
        self._group = Group(layout.mark, homes, len(layout.limits.cpus), Files())
        self._cpu_group = homes.get("cpu") if layout.has_quota else None
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
        return msgspec.structs.replace(usage, starved=usage.starved + stolen)

    def was_starved(self, before: Usage, after: Usage) -> bool:
        """Return whether the host starved it (`is_starved`)."""
        return is_starved(before, after, self.limits.quota, len(self.limits.cpus))

    def _environment(self) -> dict[str, str]:
        return {
            MARK: self._mark,
            "TMPDIR": str(self.folder),
            SLOWDOWN: f"{self.slowdown:g}",
            CPU_FILE: str(self._group.cpu_file or ""),
            CPU_GROUP: str(self._cpu_group or ""),
        }


def _prefix(layout: ComputerLayout) -> list[str]:
    """Return the command that enters namespace and CPU set, and becomes the program."""
    namespace = layout.namespace
    return [
        *(["nsenter", f"--net={NAMESPACES / namespace}"] if namespace else []),
        *(["taskset", "--cpu-list", layout.limits.cpu_list] if layout.pin else []),
    ]
