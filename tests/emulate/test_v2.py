"""Version 2 of cgroups, with a fake kernel that keeps its two rules."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from poise.emulate.cgroups import V2, Group, bring_back
from poise.emulate.limits import Limits
from poise.kernel_counters import Mount


class Kernel(V2):
    """Keeps cgroups in plain files, as the kernel would."""

    def __init__(self, top: Path, available: str, processes: str) -> None:
        self._top = top
        self.make_folder(top)
        (top / "cgroup.controllers").write_text(available)
        (top / "cgroup.procs").write_text(processes)
        super().__init__(Mount(2, top, top, frozenset(available.split())))

    def make_folder(self, folder: Path) -> None:
        """Make a cgroup with the files that every one has."""
        folder.mkdir(exist_ok=True)
        for name in ("cgroup.procs", "cgroup.subtree_control"):
            (folder / name).touch()

    def write(self, file: Path, value: object) -> None:
        """Write; refuse controllers where processes are, or settings without them."""
        if file.name == "cgroup.subtree_control":
            if (file.parent / "cgroup.procs").read_text().split():
                raise OSError(errno.EBUSY, "Device or resource busy")
            file.write_text(str(value).replace("+", ""))
        elif file.name == "cgroup.procs":
            self._move(file, str(value))
        else:
            enabled = (self._top / "cgroup.subtree_control").read_text().split()
            if file.name.partition(".")[0] not in enabled:
                raise OSError(errno.ENOENT, "No such file", str(file))
            super().write(file, value)

    def _move(self, file: Path, pid: str) -> None:
        for other in self._top.rglob("cgroup.procs"):
            left = [each for each in other.read_text().split() if each != pid]
            other.write_text("\n".join(left))
        file.write_text(f"{file.read_text()}\n{pid}")


def groups(
    top: Path, available: str = "cpu cpuset memory io", processes: str = ""
) -> V2:
    return Kernel(top, available, processes)


def test_limits_are_written_once_the_controllers_are_handed_on(tmp_path: Path) -> None:
    made = groups(tmp_path)
    made.prepare("run")
    made.make("run-0", Limits(quota=0.5, cpus=(2, 3), memory=1000))
    folder = tmp_path / "run-0"
    assert (folder / "cpu.max").read_text() == "5000 10000\n"
    assert (folder / "cpu.weight").read_text() == "10000\n"
    assert (folder / "cpuset.cpus").read_text() == "2,3\n"
    assert (folder / "memory.max").read_text() == "1000\n"
    assert (folder / "memory.swap.max").read_text() == "0\n"
    # beside its programs an agent makes groups for containers
    group = Group("run-0", made.homes("run-0"), 2)
    assert group.joins == (folder / "programs/cgroup.procs",)
    assert (folder / "cgroup.subtree_control").read_text() == "cpu"


def test_processes_in_the_way_are_put_aside(tmp_path: Path) -> None:
    made = groups(tmp_path, processes="11\n12\n")
    made.prepare("run")
    made.make("run-0", Limits(quota=0.5, cpus=(0,)))
    (aside,) = made.aside("run")
    assert (aside / "cgroup.procs").read_text().split() == ["11", "12"]
    assert not (tmp_path / "cgroup.procs").read_text().split()


def test_only_delegated_controllers_are_used(tmp_path: Path) -> None:
    made = groups(tmp_path, available="cpu pids")
    made.prepare("run")
    made.make("run-0", Limits(quota=0.5, cpus=(0,), memory=1000))
    assert made.controls == {"cpu"}
    assert not (tmp_path / "run-0" / "memory.max").exists()


def test_quota_that_fills_its_cpus_is_no_quota(tmp_path: Path) -> None:
    made = groups(tmp_path)
    made.prepare("run")
    made.make("run-0", Limits(quota=3.0, cpus=(0, 1)))
    assert (tmp_path / "run-0" / "cpu.max").read_text() == "max 10000\n"


def test_usage_is_read_in_seconds_and_bytes(tmp_path: Path) -> None:
    made = groups(tmp_path)
    made.prepare("run")
    made.make("run-0", Limits(quota=0.5, cpus=(0,)))
    group = Group("run-0", made.homes("run-0"), 1)
    folder = tmp_path / "run-0"
    (folder / "cpu.stat").write_text("usage_usec 1500000\nthrottled_usec 250000\n")
    (folder / "cpu.pressure").write_text("full avg10=0 total=350000\n")
    (folder / "memory.current").write_text("4096\n")
    usage = group.usage()
    assert (usage.used, usage.throttled, usage.memory) == (1.5, 0.25, 4096)
    assert usage.starved == pytest.approx(0.1)


def test_what_was_put_aside_is_brought_back(tmp_path: Path) -> None:
    bring_back(str(tmp_path / "nothing"))
    aside = tmp_path / "aside"
    aside.mkdir()
    (tmp_path / "cgroup.subtree_control").write_text("cpu memory\n")
    # Without processes in it, even a plain folder can be removed like a cgroup.
    bring_back(str(aside))
    assert (tmp_path / "cgroup.subtree_control").read_text() == "-cpu -memory"
    assert not aside.exists()
