"""Containers get CPU weights, by groups or by nice values."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from msgspec import structs

from poise.kernel_counters import CPU_GROUP, PRESSURE_GROUP
from poise.priority import REAL_TIME
from poise.runtime.supervision.process_host import CpuWeights, own_group
from poise.wire.records.deployment_records import ContainerSpec

HIGH = ContainerSpec(
    name="nav", folder="", components=(), connectors=(), weight=1000, nice=0
)
LOW = ContainerSpec(
    name="log", folder="", components=(), connectors=(), weight=100, nice=10
)
ALIKE = ContainerSpec(name="x", folder="", components=(), connectors=())


@pytest.fixture
def first(tmp_path: Path) -> Path:
    """Return a group of version 1 whose children have the files that they need."""
    for name in ("agent", "container-nav"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "cpu.shares").touch()
    return tmp_path


def test_nothing_is_done_while_all_are_alike(tmp_path: Path) -> None:
    weights = CpuWeights(tmp_path)
    assert weights.nice_of(ALIKE) == 0
    weights.settle(ALIKE, 1)
    assert not weights.means
    assert not list(tmp_path.iterdir())


def test_a_container_and_the_agent_get_groups_of_version_1(first: Path) -> None:
    weights = CpuWeights(first)
    assert weights.nice_of(HIGH) == 0
    weights.settle(HIGH, 12)
    assert weights.means == "cgroup v1"
    assert (first / "agent/cgroup.procs").read_text() == str(os.getpid())
    assert (first / "agent/cpu.shares").read_text() == "102400"
    assert (first / "container-nav/cgroup.procs").read_text() == "12"
    assert (first / "container-nav/cpu.shares").read_text() == "10240"


def test_version_2_hands_the_controller_on_and_has_no_processes(tmp_path: Path) -> None:
    (tmp_path / "cgroup.subtree_control").touch()
    (tmp_path / "cgroup.procs").write_text("3\n4\n")
    weights = CpuWeights(tmp_path)
    weights.nice_of(LOW)
    weights.settle(LOW, 12)
    assert weights.means == "cgroup v2"
    assert (tmp_path / "cgroup.subtree_control").read_text() == "+cpu"
    assert (tmp_path / "agent/cgroup.procs").read_text() == "4"  # entered last
    assert (tmp_path / "container-log/cpu.weight").read_text() == "100"


def test_an_ended_container_leaves_no_group(first: Path) -> None:
    weights = CpuWeights(first)
    weights.nice_of(HIGH)
    for file in (first / "container-nav").iterdir():
        file.unlink()
    weights.forget("nav")
    assert not (first / "container-nav").exists()


@pytest.mark.parametrize("folder", [None, Path("/proc/nothing")])
def test_without_groups_the_less_important_are_nicer(folder: Path | None) -> None:
    weights = CpuWeights(folder)
    assert weights.nice_of(HIGH) == 0
    assert weights.nice_of(LOW) == 10
    assert weights.means == "nice"
    weights.settle(LOW, 12)


def test_real_time_threads_stay_out_of_groups_of_version_1(
    first: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(REAL_TIME, "1")
    (first / "cpu.rt_runtime_us").touch()
    weights = CpuWeights(first)
    assert weights.nice_of(LOW) == 10


def test_an_emulated_computer_says_which_group_is_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CPU_GROUP, str(tmp_path))
    assert own_group() == tmp_path
    monkeypatch.setenv(CPU_GROUP, "")
    assert own_group() is None


def test_what_is_prepared_gets_only_what_nobody_else_wants(first: Path) -> None:
    (first / "prepared").mkdir()
    for name in ("cpu.shares", "cpu.idle"):
        (first / "prepared" / name).touch()
    weights = CpuWeights(first)
    prepared = structs.replace(HIGH, preparation_cpu=0.1)
    weights.nice_of(prepared)
    weights.settle(prepared, 12)
    # a tenth of 20 ms
    assert (first / "prepared/cpu.cfs_period_us").read_text() == "20000"
    assert (first / "prepared/cpu.cfs_quota_us").read_text() == "2000"
    assert (first / "prepared/cpu.idle").read_text() == "1"
    assert (first / "prepared/cgroup.procs").read_text() == "12"
    weights.settle(HIGH, 12)
    assert (first / "container-nav/cgroup.procs").read_text() == "12"


def test_what_is_prepared_is_apart_where_pressure_is_counted(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pressure = tmp_path / "pressure"
    pressure.mkdir()
    monkeypatch.setenv(PRESSURE_GROUP, str(pressure))
    (first / "prepared").mkdir()
    (first / "prepared/cpu.shares").touch()
    weights = CpuWeights(first)
    prepared = structs.replace(HIGH, preparation_cpu=0.1)
    weights.nice_of(prepared)
    weights.settle(prepared, 12)
    assert (pressure / "prepared/cgroup.procs").read_text() == "12"
    weights.settle(HIGH, 12)
    assert (pressure / "cgroup.procs").read_text() == "12"


def test_little_cpu_is_counted_over_a_longer_time(tmp_path: Path) -> None:
    (tmp_path / "cgroup.subtree_control").touch()
    (tmp_path / "cgroup.procs").touch()
    weights = CpuWeights(tmp_path)
    prepared = structs.replace(LOW, preparation_cpu=0.01)
    weights.nice_of(prepared)
    weights.settle(prepared, 12)
    # the kernel counts 1 ms at least
    assert (tmp_path / "prepared/cpu.max").read_text() == "1000 100000"
    assert (tmp_path / "prepared/cpu.weight").read_text() == "1"
