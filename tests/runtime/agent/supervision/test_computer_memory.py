"""How far the memory limits of a computer are away."""

from __future__ import annotations

import os
from pathlib import Path

from poise.kernel_counters import ComputerMemory, MemoryRoom, cores_of_computer

MIB = 1 << 20


def write(folder: Path, **files: object) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(f"{text}\n")


def kernel(folder: Path, mount: str, cgroup: str) -> Path:
    """Write the kernel's files of a machine with 400 of 1,000 MiB free."""
    proc = folder / "proc"
    meminfo = f"MemTotal: {1000 * 1024} kB\nMemAvailable: {400 * 1024} kB"
    write(proc, meminfo=meminfo)
    write(proc / "self", mountinfo=mount.format(folder / "memory"), cgroup=cgroup)
    return proc


def test_without_a_cgroup_the_whole_machine_counts(tmp_path: Path) -> None:
    proc = kernel(tmp_path, "30 1 0:27 / / rw - ext4 disk rw", "0::/robot")
    assert ComputerMemory(proc).read() == MemoryRoom(1000 * MIB, 400 * MIB)


def test_the_caches_of_a_group_are_free(tmp_path: Path) -> None:
    """Of 256 MiB 200 are in use, 30 of them for files that may be dropped."""
    mount = "31 1 0:28 / {0} rw - cgroup2 cgroup2 rw"
    proc = kernel(tmp_path, mount, "0::/robot")
    write(
        tmp_path / "memory" / "robot",
        memory__events="oom_kill 0",
        memory__max=256 * MIB,
        memory__current=200 * MIB,
        memory__stat=f"anon 5\ninactive_file {30 * MIB}",
    )
    assert ComputerMemory(proc).read() == MemoryRoom(256 * MIB, 86 * MIB)


def test_the_limit_of_a_group_above_counts(tmp_path: Path) -> None:
    mount = "31 1 0:28 / {0} rw - cgroup2 cgroup2 rw"
    proc = kernel(tmp_path, mount, "0::/robot/agent")
    group = tmp_path / "memory" / "robot"
    write(
        group / "agent",
        memory__events="oom_kill 0",
        memory__max="max",
        memory__current=9,
        memory__stat="inactive_file 0",
    )
    write(
        group,
        memory__max=256 * MIB,
        memory__current=200 * MIB,
        memory__stat="inactive_file 0",
    )
    assert ComputerMemory(proc).read() == MemoryRoom(256 * MIB, 56 * MIB)


def test_a_group_of_version_1_counts(tmp_path: Path) -> None:
    mount = "31 1 0:28 / {0} rw - cgroup cgroup rw,memory"
    proc = kernel(tmp_path, mount, "4:memory:/robot")
    write(
        tmp_path / "memory" / "robot",
        memory__oom_control="oom_kill 0",
        memory__limit_in_bytes=256 * MIB,
        memory__usage_in_bytes=200 * MIB,
        memory__stat=f"inactive_file 7\ntotal_inactive_file {10 * MIB}",
    )
    assert ComputerMemory(proc).read() == MemoryRoom(256 * MIB, 66 * MIB)


def test_a_kernel_that_says_nothing_has_no_known_limit(tmp_path: Path) -> None:
    assert ComputerMemory(tmp_path).read() is None


def test_the_size_is_that_of_the_least_limit(tmp_path: Path) -> None:
    mount = "31 1 0:28 / {0} rw - cgroup2 cgroup2 rw"
    proc = kernel(tmp_path, mount, "0::/robot")
    assert ComputerMemory(proc).size() == 1000 * MIB
    write(
        tmp_path / "memory" / "robot",
        memory__events="oom_kill 0",
        memory__max=700 * MIB,
        memory__current=100 * MIB,
        memory__stat="inactive_file 0",
    )
    assert ComputerMemory(proc).size() == 700 * MIB
    assert ComputerMemory(tmp_path).size() == 0


def test_the_quota_of_a_group_above_limits_the_cores(tmp_path: Path) -> None:
    mount = "31 1 0:28 / {0} rw - cgroup2 cgroup2 rw"
    proc = kernel(tmp_path, mount, "0::/robot/agent")
    group = tmp_path / "memory" / "robot"
    write(group / "agent", cpu__max="max 100000")
    assert cores_of_computer(proc) == len(os.sched_getaffinity(0))
    write(group, cpu__max="50000 100000")
    assert cores_of_computer(proc) == 0.5


def test_a_quota_of_version_1_limits_the_cores(tmp_path: Path) -> None:
    mount = "31 1 0:28 / {0} rw - cgroup cgroup rw,cpu"
    proc = kernel(tmp_path, mount, "4:cpu:/robot")
    group = tmp_path / "memory" / "robot"
    write(group, cpu__cfs_quota_us=-1, cpu__cfs_period_us=100_000)
    assert cores_of_computer(proc) == len(os.sched_getaffinity(0))
    write(group, cpu__cfs_quota_us=25_000, cpu__cfs_period_us=100_000)
    assert cores_of_computer(proc) == 0.25
