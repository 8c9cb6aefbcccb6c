"""Version 1 of cgroups, on folders that stand for its hierarchies."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.emulate.cgroups import V1, Group
from poise.emulate.limits import Limits
from poise.kernel_counters import Mount


@pytest.fixture
def groups(tmp_path: Path) -> V1:
    """Make groups over three hierarchies, and a version 2 beside them."""
    kinds = [(1, "cpu,cpuacct"), (1, "cpuset"), (1, "memory"), (2, "hugetlb")]
    for _, kind in kinds:
        (tmp_path / kind).mkdir()
    (tmp_path / "cpuset" / "cpuset.mems").write_text("0-1\n")
    return V1(
        Mount(version, tmp_path / kind, tmp_path / kind, frozenset(kind.split(",")))
        for version, kind in kinds
    )


def made(groups: V1, memory: int | None = None) -> Group:
    """Make a group on one CPU."""
    groups.make("run-0", Limits(quota=0.5, cpus=(2,), memory=memory))
    return Group("run-0", groups.homes("run-0"), 1)


def test_limits_are_written_to_each_hierarchy(groups: V1, tmp_path: Path) -> None:
    group = made(groups, memory=1000)
    cpu = tmp_path / "cpu,cpuacct" / "run-0"
    # 0.5 of a 10 ms period.
    assert (cpu / "cpu.cfs_period_us").read_text() == "10000\n"
    assert (cpu / "cpu.cfs_quota_us").read_text() == "5000\n"
    assert (cpu / "cpu.shares").read_text() == "262144\n"
    assert (tmp_path / "cpuset/run-0/cpuset.cpus").read_text() == "2\n"
    assert (tmp_path / "cpuset/run-0/cpuset.mems").read_text() == "0-1\n"
    memory = tmp_path / "memory/run-0/memory.limit_in_bytes"
    assert memory.read_text() == "1000\n"
    # Joined once each, though two controllers share a hierarchy.
    assert len(group.joins) == len(set(group.joins)) == 4
    assert groups.controls == {"cpu", "cpuset", "memory"}


def test_quota_that_fills_its_cpus_is_no_quota(groups: V1, tmp_path: Path) -> None:
    groups.make("run-0", Limits(quota=1.0, cpus=(2,)))
    quota = tmp_path / "cpu,cpuacct/run-0/cpu.cfs_quota_us"
    assert quota.read_text() == "-1\n"


def test_usage_is_read_in_seconds_and_bytes(groups: V1, tmp_path: Path) -> None:
    group = made(groups)
    cpu = tmp_path / "cpu,cpuacct/run-0"
    (cpu / "cpu.stat").write_text("throttled_time 250000000\n")
    (cpu / "cpuacct.usage").write_text("1500000000\n")
    peak = tmp_path / "memory/run-0/memory.max_usage_in_bytes"
    peak.write_text("4096\n")
    pressure = "some avg10=0 total=500000\nfull avg10=0 total=350000\n"
    (tmp_path / "hugetlb/run-0/cpu.pressure").write_text(pressure)
    usage = group.usage()
    assert (usage.used, usage.throttled, usage.memory) == (1.5, 0.25, 4096)
    assert usage.starved == pytest.approx(0.1)


def test_what_waits_to_be_prepared_is_not_starved(groups: V1, tmp_path: Path) -> None:
    group = made(groups)
    pressure = tmp_path / "hugetlb/run-0/cpu.pressure"
    pressure.write_text("full avg10=0 total=350000\n")
    prepared = tmp_path / "hugetlb/run-0/prepared/cpu.pressure"
    prepared.parent.mkdir()
    prepared.write_text("full avg10=0 total=300000\n")
    assert group.usage().starved == pytest.approx(0.05)


def test_starvation_is_unknown_without_pressure(groups: V1) -> None:
    assert made(groups).usage().starved is None
