"""Kills for lack of memory, by the kernel's counters."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.runtime.supervision.process_host import OomKills

V1 = "31 1 0:28 / {0}/memory rw - cgroup cgroup rw,memory"
V2 = "31 1 0:28 / {0}/memory rw - cgroup2 cgroup2 rw"


def kernel(folder: Path, version: int, kills: int) -> Path:
    """Write the kernel's files; return ``/proc``."""
    proc, group = folder / "proc", folder / "memory" / "robot"
    for made in (proc / "self", group):
        made.mkdir(parents=True, exist_ok=True)
    (proc / "vmstat").write_text("oom_kill 100\n")
    mount = {1: V1, 2: V2}.get(version, "30 1 0:27 / / rw - ext4 disk rw").format(
        folder
    )
    (proc / "self" / "mountinfo").write_text(mount + "\n")
    line = {1: "4:memory:/robot", 2: "0::/robot"}.get(version, "4:cpu:/robot")
    (proc / "self" / "cgroup").write_text(line + "\n")
    name = {1: "memory.oom_control", 2: "memory.events"}.get(version)
    if name:
        (group / name).write_text(f"under_oom 0\noom_kill {kills}\n")
    else:
        (proc / "vmstat").write_text(f"pgfault 1\noom_kill {kills}\n")
    limit = {1: "memory.limit_in_bytes", 2: "memory.max"}.get(version, "unused")
    use = {1: "memory.usage_in_bytes", 2: "memory.current"}.get(version, "unused")
    (group / limit).write_text(f"{256 << 20}\n")
    (group / use).write_text("4096\n")
    (group / "memory.stat").write_text("inactive_file 0\n")
    return proc


@pytest.mark.parametrize("version", [0, 1, 2])
def test_each_kill_explains_one_end(tmp_path: Path, version: int) -> None:
    """Version 0: no cgroup counts memory, but the whole machine does."""
    kills = OomKills(kernel(tmp_path, version, 5))
    assert not kills.claim(1.0)
    kernel(tmp_path, version, 7)
    assert [kills.claim(2.0) for _ in range(3)] == [True, True, False]
    assert ("256 MiB" in kills.limit()) == bool(version)


def test_a_count_that_cannot_be_read_for_a_while_explains_no_end(
    tmp_path: Path,
) -> None:
    kills = OomKills(kernel(tmp_path, 2, 5))
    (tmp_path / "memory/robot/memory.events").unlink()
    kills.update(1.0)
    kernel(tmp_path, 2, 5)
    assert not kills.claim(2.0)


def test_a_kill_explains_no_end_long_after_it(tmp_path: Path) -> None:
    kills = OomKills(kernel(tmp_path, 2, 0))
    kernel(tmp_path, 2, 1)
    kills.update(1.0)
    assert not kills.claim(60.0)


def test_a_kernel_that_counts_no_kills_explains_no_end(tmp_path: Path) -> None:
    assert not OomKills(tmp_path).claim(1.0)
