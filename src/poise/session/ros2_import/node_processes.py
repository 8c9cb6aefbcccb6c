"""Finds the processes of ROS 2 nodes in /proc, and measures what they use."""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from poise.kernel_counters import (
    ComputerCpu,
    ComputerMemory,
    process_cpu,
    proportional_memory,
    resident_memory,
)
from poise.session.ros2_import.graph_records import Hardware, NodeProcess

PREFIXES = ("ROS_", "RMW_", "FASTRTPS_", "FASTDDS_", "CYCLONEDDS_", "AMENT_")
"""Variables that change what ROS 2 does begin so."""
_ALSO = {"PYTHONPATH"}
_HARMLESS = {"ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION"}
_ANYBODYS = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")
_NO_DEVICES = ("/dev/pts/", "/dev/tty", "/dev/ptmx", "/dev/fuse")
"""Many have these open, or their like: /dev/tty1. /dev/ttyUSB0 is a device."""
_SERIAL = ("/dev/ttyUSB", "/dev/ttyACM", "/dev/ttyAMA", "/dev/ttyS", "/dev/ttyTHS")


def relevant(environment: Mapping[str, str]) -> dict[str, str]:
    """Return what of an environment matters to ROS 2 and to Python."""
    return {
        name: value
        for name, value in environment.items()
        if (name.startswith(PREFIXES) or name in _ALSO) and name not in _HARMLESS
    }


def find_pid(low: int, proc: Path = Path("/proc")) -> int | None:
    """Return the process whose id ends so and that has ROS 2 loaded; None: unclear.

    Parameters
    ----------
    low
        The last 16 bits of its id, in its own namespace of processes.
    """
    found = [
        int(folder.name)
        for folder in proc.iterdir()
        if folder.name.isdigit() and low in _low_ids(folder) and _has_ros(folder)
    ]
    return found[0] if len(found) == 1 else None


def _low_ids(folder: Path) -> set[int]:
    with contextlib.suppress(OSError):
        for line in (folder / "status").read_text().splitlines():
            if line.startswith("NSpid:"):
                return {int(line.split()[-1]) & 0xFFFF}
    return set()


def _has_ros(folder: Path) -> bool:
    try:
        return "librmw" in (folder / "maps").read_text()
    except OSError:  # another user's: its id has to do
        return True


class ProcessUsage:
    """What some processes use from now on, each with its child processes.

    A child that is one of them counts by itself.
    """

    def __init__(self) -> None:
        self.pids: set[int] = set()
        self._began = time.monotonic()
        self._computer = ComputerCpu()
        self._all_cpu = self._computer.read() or 0.0
        self._first: dict[int, tuple[float, float]] = {}

    def add(self, pid: int) -> None:
        """Measure one more from now on."""
        self.pids.add(pid)
        self._first.setdefault(pid, (time.monotonic(), self._used(pid)))

    def cpu(self, pid: int) -> float:
        """Return the mean use since it was added [cores]."""
        began, before = self._first[pid]
        elapsed = time.monotonic() - began
        return max(0.0, self._used(pid) - before) / elapsed if elapsed > 0 else 0.0

    def memory(self, pid: int) -> float:
        """Return its share of the memory that it holds [bytes]."""
        held = (proportional_memory(p) or resident_memory(p) for p in self._family(pid))
        return float(sum(held))

    def _used(self, pid: int) -> float:
        return sum(map(process_cpu, self._family(pid)))

    def _family(self, pid: int) -> list[int]:
        found = [pid]
        for parent in found:
            with contextlib.suppress(OSError, ValueError):
                text = Path(f"/proc/{parent}/task/{parent}/children").read_text()
                found += [int(word) for word in text.split()]
        return [each for each in found if each == pid or each not in self.pids]

    def hardware(self, processes: Iterable[NodeProcess], own_cpu: float) -> Hardware:
        """Return this computer, and what all but `processes` and this one take."""
        processes = tuple(processes)
        busy = (self._computer.read() or 0.0) - self._all_cpu
        busy /= time.monotonic() - self._began
        room = ComputerMemory().read()
        limit, free = (room.limit, room.free) if room else (0.0, 0.0)
        held = sum(each.memory for each in processes) + self.memory(os.getpid())
        return Hardware(
            name=os.uname().nodename,
            cores=float(len(os.sched_getaffinity(0))),
            memory=limit,
            other_cpu=max(0.0, busy - own_cpu - sum(each.cpu for each in processes)),
            other_memory=max(0.0, limit - free - held),
        )


def describe(pid: int, nodes: tuple[str, ...], usage: ProcessUsage) -> NodeProcess:
    """Return what `/proc` says of a process."""
    folder = Path(f"/proc/{pid}")
    environment = _pairs(_words(folder / "environ"))
    arguments = _words(folder / "cmdline")
    if arguments and "/" not in arguments[0]:
        path = shutil.which(arguments[0], path=environment.get("PATH"))
        arguments = (path or arguments[0], *arguments[1:])
    with contextlib.suppress(OSError):
        folder = (folder / "cwd").readlink()
    return NodeProcess(
        pid=pid,
        nodes=nodes,
        arguments=arguments,
        folder=str(folder),
        environment=relevant(environment),
        cpu=usage.cpu(pid),
        memory=usage.memory(pid),
        devices=devices_of(pid),
    )


def _words(file: Path) -> tuple[str, ...]:
    try:
        text = file.read_text(errors="replace")
    except OSError:
        return ()
    return tuple(text.rstrip("\0").split("\0")) if text else ()


def _pairs(words: Iterable[str]) -> dict[str, str]:
    return {name: value for name, _, value in (word.partition("=") for word in words)}


def devices_of(pid: int) -> tuple[str, ...]:
    """Return the device nodes that a process has open; drivers must stay with them."""
    found: set[str] = set()
    for entry in Path(f"/proc/{pid}/fd").glob("*"):
        with contextlib.suppress(OSError):
            path = str(entry.readlink())
            mode = entry.stat().st_mode
            if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
                found.add(path)
    return tuple(sorted(filter(_is_device, found)))


def _is_device(path: str) -> bool:
    is_known = path.startswith("/dev/") and path not in _ANYBODYS
    return is_known and (path.startswith(_SERIAL) or not path.startswith(_NO_DEVICES))
