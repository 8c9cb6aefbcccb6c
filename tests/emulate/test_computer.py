"""Processes on emulated computers."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.emulate import EmulatedComputer, Emulation
from poise.model.robot import Robot

pytestmark = pytest.mark.slow

LIMIT = 60.0
BURN = "import time\nend = time.monotonic() + {}\nwhile time.monotonic() < end: pass"


@pytest.fixture
def emulation(two_computers: Robot, tmp_path: Path) -> Iterator[Emulation]:
    """Emulate the tiny robot."""
    with Emulation(two_computers, tmp_path) as emulation:
        yield emulation


def say(computer: EmulatedComputer, *argv: str) -> str:
    child = computer.popen(argv, stdout=subprocess.PIPE)
    output, _ = child.communicate(timeout=LIMIT)
    assert child.returncode == 0
    return output.decode()


def test_process_runs_on_the_cpus_of_its_computer(emulation: Emulation) -> None:
    code = "import os; print(*sorted(os.sched_getaffinity(0)))"
    for computer in emulation.computers.values():
        found = say(computer, sys.executable, "-c", code).split()
        assert found == [str(cpu) for cpu in computer.limits.cpus]


@pytest.mark.usefixtures("needs_limits")
def test_process_is_in_its_cgroups_before_it_begins(emulation: Emulation) -> None:
    cgroups = [
        say(computer, "cat", "/proc/self/cgroup")
        for computer in emulation.computers.values()
    ]
    for index, lines in enumerate(cgroups):
        mine = f"/poise-{os.getpid()}-"
        homes = [line for line in lines.splitlines() if mine in line]
        assert homes
        assert all(line.endswith(f"-{index}") for line in homes)


@pytest.mark.usefixtures("needs_namespaces")
def test_process_is_in_the_network_of_its_computer(emulation: Emulation) -> None:
    namespaces = {say(c, "readlink", "/proc/self/ns/net") for c in computers(emulation)}
    assert len(namespaces | {str(Path("/proc/self/ns/net").readlink())}) == 3
    for computer in computers(emulation):
        addresses = say(computer, "ip", "-o", "-4", "addr")
        assert f" {computer.address}/24 " in addresses


def computers(emulation: Emulation) -> list[EmulatedComputer]:
    return list(emulation.computers.values())


def test_process_has_the_files_and_folder_it_was_given(emulation: Emulation) -> None:
    brain = emulation.computers["brain"]
    read, write = os.pipe()
    code = (
        "import os, sys, tempfile;"
        "os.write(int(sys.argv[1]), tempfile.gettempdir().encode())"
    )
    argv = [sys.executable, "-c", code, str(write)]
    child = brain.popen(argv, pass_fds=[write], env={"PATH": os.environ["PATH"]})
    os.close(write)
    with os.fdopen(read) as pipe:
        assert pipe.read() == str(brain.folder)
    assert child.wait(timeout=LIMIT) == 0


def test_the_process_itself_is_returned(emulation: Emulation) -> None:
    child = emulation.computers["brain"].popen(["cat"], stdin=subprocess.PIPE)
    assert child.stdin
    comm = Path(f"/proc/{child.pid}/comm")
    deadline = time.monotonic() + LIMIT
    while comm.read_text() != "cat\n":
        assert time.monotonic() < deadline
    assert child.pid in emulation.computers["brain"].running()
    child.stdin.close()
    assert child.wait(timeout=LIMIT) == 0


def test_program_that_is_not_there_ends_with_127(emulation: Emulation) -> None:
    brain = emulation.computers["brain"]
    child = brain.popen(["/no/such/program"], stderr=subprocess.DEVNULL)
    assert child.wait(timeout=LIMIT) == 127


@pytest.mark.usefixtures("needs_limits")
def test_quota_holds_and_throttling_is_not_starving(emulation: Emulation) -> None:
    brain = emulation.computers["brain"]
    before, start = brain.usage(), time.monotonic()
    say(brain, sys.executable, "-c", BURN.format(1.0))
    after, wall = brain.usage(), time.monotonic() - start
    share = (after.used - before.used) / wall
    assert share < 0.3 * 1.2
    assert after.throttled > before.throttled
    assert after.memory is not None
    assert 1e6 < after.memory < 512e6
    assert not brain.was_starved(before, after)


@pytest.mark.usefixtures("needs_limits")
def test_memory_limit_holds(emulation: Emulation) -> None:
    code = "import sys; held = bytearray(b'x') * int(sys.argv[1])"
    legs = emulation.computers["legs"]
    for size, expected in ((50_000_000, 0), (300_000_000, -9)):
        child = legs.popen([sys.executable, "-c", code, str(size)])
        assert child.wait(timeout=LIMIT) == expected
