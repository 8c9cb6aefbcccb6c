"""A whole emulation: what it goes without, and that it leaves nothing behind."""

from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import pytest

from poise.emulate import Emulation, probe_host, set_for, sweep
from poise.emulate.cgroups import V2, Groups, Probe
from poise.emulate.limits import Limits
from poise.emulate.registry import FOLDER, EmulationLayout, registered
from poise.errors import RobotError, RunError, UsageError
from poise.kernel_counters import mounts
from poise.model.robot import Computer, Robot

LIMIT = 60.0
BURN = "import time\nend = time.monotonic() + 1.2\nwhile time.monotonic() < end: pass"
STUBBORN = (
    "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
    "print('ready', flush=True); signal.pause()"
)


def own_layout() -> EmulationLayout:
    """Return what is registered of this process's latest emulation."""
    own = [layout for layout in registered() if layout.owner.pid == os.getpid()]
    return max(own, key=lambda layout: int(layout.run.rpartition("-")[2]))


def left_of(layout: EmulationLayout) -> list[str]:
    """Return what is still there of an emulation."""
    network = layout.network
    paths = [
        *(path for c in layout.computers for path in (*c.groups, c.folder)),
        *layout.aside,
        *(f"/run/netns/{name}" for name in (network.namespaces if network else ())),
    ]
    cables = {name for _, name in socket.if_nameindex()}
    left = [network.owner] if network and network.owner in cables else []
    entries = [each.run for each in registered() if each.run == layout.run]
    return [*(path for path in paths if Path(path).exists()), *left, *entries]


def bare() -> Probe:
    """Return a host that allows nothing."""
    return Probe(
        cpus=probe_host().cpus,
        groups=Groups(),
        tools=frozenset(),
        may_make_namespaces=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("host", [None, bare()], ids=["this host", "bare host"])
def test_nothing_is_left_after_close(
    two_computers: Robot, tmp_path: Path, host: Probe | None
) -> None:
    emulation = Emulation(two_computers, tmp_path, probe=host)
    listed = own_layout()
    made = {path for c in listed.computers for path in (*c.groups, c.folder)}
    assert made <= set(left_of(listed))
    argv = [sys.executable, "-c", STUBBORN]
    child = emulation.computers["brain"].popen(argv, stdout=subprocess.PIPE)
    assert child.stdout
    assert child.stdout.readline() == b"ready\n"
    emulation.close(ask=0.05)
    assert child.wait(timeout=LIMIT) == -9
    assert left_of(listed) == []
    emulation.close()
    child.stdout.close()


@pytest.mark.slow
@pytest.mark.usefixtures("needs_limits")
def test_processes_end_that_their_quota_would_not_let_end(tmp_path: Path) -> None:
    robot = Robot(
        name="slow", computers=(Computer(name="snail", capacity={"cpu": 1e-3}),)
    )
    emulation = Emulation(robot, tmp_path / "run")
    argv = ["sh", "-c", "while :; do :; done"]
    children = [emulation.computers["snail"].popen(argv) for _ in range(30)]
    emulation.close(ask=0.0)  # they would have 1 ms of CPU time in a second
    assert all(child.wait(timeout=LIMIT) for child in children)


@pytest.mark.slow
def test_nothing_is_left_after_an_exception(
    two_computers: Robot, tmp_path: Path
) -> None:
    listed = []

    def fail() -> None:
        with Emulation(two_computers, tmp_path) as emulation:
            listed.append(own_layout())
            emulation.computers["legs"].popen(["sleep", "60"])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert left_of(listed[0]) == []


@pytest.mark.slow
def test_process_that_is_just_starting_is_ended_too(
    two_computers: Robot, tmp_path: Path
) -> None:
    emulation = Emulation(two_computers, tmp_path)
    children = [c.popen(["sleep", "60"]) for c in emulation.computers.values()]
    emulation.close()
    assert all(child.returncode is not None for child in children)


@pytest.mark.slow  # a cgroup may take a moment to go
def test_nothing_is_left_when_it_cannot_be_made(
    two_computers: Robot, tmp_path: Path
) -> None:
    class Refusing(Groups):
        listed: EmulationLayout

        def make(self, name: str, limits: Limits) -> None:
            """Refuse, as a kernel may."""
            Refusing.listed = own_layout()
            raise OSError(errno.EMFILE, f"Too many open files for {limits}", name)

    host = msgspec.structs.replace(probe_host(), groups=Refusing())
    says = "refuses an emulated computer: .*Too many open files.*: raise the limit of o"
    with pytest.raises(RunError, match=says):
        Emulation(two_computers, tmp_path, probe=host)
    assert left_of(Refusing.listed) == []


OWNER = """
import sys, time
from pathlib import Path
import msgspec
from poise.emulate import Emulation
from poise.model.robot import Robot
robot = msgspec.json.decode(sys.stdin.buffer.readline(), type=Robot)
emulation = Emulation(robot, Path(sys.argv[1]))
child = emulation.computers["brain"].popen(["sleep", "60"])
print(emulation._layout.run, child.pid, flush=True)
time.sleep(60)
"""


@pytest.mark.slow
def test_sweep_removes_what_a_killed_owner_left(
    two_computers: Robot, tmp_path: Path
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", OWNER, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as owner:
        assert owner.stdin
        assert owner.stdout
        owner.stdin.write(msgspec.json.encode(two_computers) + b"\n")
        owner.stdin.flush()
        run, pid = owner.stdout.readline().decode().split()
        (listed,) = [layout for layout in registered() if layout.run == run]
        assert listed.owner not in sweep()  # it still lives
        assert run in left_of(listed)
        owner.kill()
    assert Path("/proc", pid).exists()
    deadline = time.monotonic() + LIMIT
    # Another emulation that starts at this moment may be sweeping it already. And a
    # process that was killed stays until the machine's first process reaps it.
    while left_of(listed) or Path("/proc", pid).exists():
        sweep()
        assert time.monotonic() < deadline


@pytest.mark.usefixtures("own_registry")
def test_used_folder_is_refused_and_kept(two_computers: Robot, tmp_path: Path) -> None:
    (tmp_path / "legs").mkdir()
    with pytest.raises(UsageError, match="legs exists"):
        Emulation(two_computers, tmp_path)
    assert (tmp_path / "legs").exists()


@pytest.mark.usefixtures("own_registry")
def test_robot_with_an_impossible_computer_starts_nothing(tmp_path: Path) -> None:
    robot = Robot(name="r", computers=(Computer(name="dead", capacity={"cpu": 0}),))
    with pytest.raises(RobotError, match="'dead'"):
        Emulation(robot, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("own_registry")
def test_bare_host_says_what_it_goes_without(
    two_computers: Robot, tmp_path: Path
) -> None:
    with Emulation(two_computers, tmp_path, probe=bare(), keep=True) as emulation:
        kept = set_for(two_computers)
        assert kept is not None
        with pytest.raises(UsageError, match="without namespaces and shaped"):
            kept.cut("legs")
        said = "\n".join(emulation.without)
        for what in ("quota", "CPU set", "memory limit", "namespaces", "shaped links"):
            assert what in said
        addresses = {computer.address for computer in emulation.computers.values()}
        assert len(addresses) == 2
        assert all(address.startswith("127.") for address in addresses)


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["ip", "tc", "nsenter"])
@pytest.mark.usefixtures("needs_namespaces")
def test_missing_tool_is_said_and_done_without(
    two_computers: Robot, tmp_path: Path, missing: str
) -> None:
    host = probe_host()
    host = msgspec.structs.replace(host, tools=host.tools - {missing})
    with Emulation(two_computers, tmp_path, probe=host) as emulation:
        assert any(missing in sentence for sentence in emulation.without)
        child = emulation.computers["legs"].popen(["true"])
        assert child.wait(timeout=LIMIT) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("needs_namespaces")
def test_tools_in_folders_for_root_are_found(
    two_computers: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others who may make namespaces need not have these in PATH."""
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    with Emulation(two_computers, tmp_path) as emulation:
        assert not any("not installed" in sentence for sentence in emulation.without)


@pytest.mark.slow
@pytest.mark.usefixtures("needs_limits")
def test_computers_that_share_a_cpu_and_ask_for_too_much_are_starved(
    tmp_path: Path,
) -> None:
    names = ("a", "b", "c")
    robot = Robot(
        name="crowd",
        computers=tuple(Computer(name=n, capacity={"cpu": 0.9}) for n in names),
    )
    host = msgspec.structs.replace(probe_host(), cpus=probe_host().cpus[-1:])
    with Emulation(robot, tmp_path, probe=host) as emulation:
        computers = emulation.computers.values()
        if any(computer.usage().starved is None for computer in computers):
            pytest.skip("the kernel does not tell a cgroup's CPU pressure")
        before = [computer.usage() for computer in computers]
        argv = [sys.executable, "-c", BURN]
        children = [computer.popen(argv) for computer in computers]
        assert [child.wait(timeout=LIMIT) for child in children] == [0, 0, 0]
        after = [computer.usage() for computer in computers]
        assert any("which is more than it has" in each for each in emulation.without)
        # Each has a third of the CPU and was promised nine tenths.
        for computer, first, last in zip(computers, before, after, strict=True):
            assert computer.was_starved(first, last)


@pytest.mark.slow
def test_user_without_rights_runs_it_all_the_same() -> None:
    if os.geteuid():
        pytest.skip("the other tests run without rights already")
    # another run of tests closes the folders that pytest makes to others
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o777)
        done = subprocess.run(
            [sys.executable, "-c", WITHOUT_RIGHTS, str(Path(folder, "run"))],
            env={**os.environ, FOLDER: str(Path(folder, "emulations"))},
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        assert not Path(folder, "run", "only").exists()
    assert done.returncode == 0, done.stderr
    cpus, *without = done.stdout.splitlines()
    assert int(cpus) == 1
    assert any("quota" in each for each in without)
    assert any("namespaces" in each for each in without)


WITHOUT_RIGHTS = """
import os, subprocess, sys
from pathlib import Path
from poise.emulate import Emulation
from poise.model.robot import Computer, Robot
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
os.environ.pop("XDG_RUNTIME_DIR", None)
robot = Robot(name="r", computers=(Computer(name="only", capacity={"cpu": 1}),))
with Emulation(robot, Path(sys.argv[1])) as emulation:
    child = emulation.computers["only"].popen(["nproc"], stdout=subprocess.PIPE)
    print(child.communicate(timeout=20)[0].decode(), end="")
    print(*emulation.without, sep="\\n")
"""


@pytest.mark.slow
@pytest.mark.usefixtures("needs_namespaces")
def test_user_namespace_is_enough_for_the_network(
    two_computers: Robot, tmp_path: Path
) -> None:
    enter = ["unshare", "-Urnm"]
    if subprocess.run([*enter, "true"], check=False, capture_output=True).returncode:
        pytest.skip("no user namespaces here")
    script = 'mount -t tmpfs tmpfs /run && exec "$@"'
    done = subprocess.run(
        [*enter, "sh", "-c", script, "sh", sys.executable, "-c", NETWORK, tmp_path],
        input=msgspec.json.encode(two_computers),
        capture_output=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    assert b"namespaces" not in done.stdout
    assert done.stdout.count(b"rate 100Mbit") == 2


NETWORK = """
import subprocess, sys
from pathlib import Path
import msgspec
from poise.emulate import Emulation
from poise.model.robot import Robot
robot = msgspec.json.decode(sys.stdin.buffer.read(), type=Robot)
with Emulation(robot, Path(sys.argv[1]) / "run") as emulation:
    for computer in emulation.computers.values():
        argv = ["tc", "class", "show", "dev", "eth0"]
        child = computer.popen(argv, stdout=subprocess.PIPE)
        print(child.communicate(timeout=20)[0].decode())
    print(*emulation.without, sep="\\n")
"""


@pytest.mark.slow
def test_version_2_groups_hold_real_processes(
    two_computers: Robot, tmp_path: Path
) -> None:
    found = [m for m in mounts() if m.version > 1 and os.access(m.own, os.W_OK)]
    if not found:
        pytest.skip("no version 2 cgroup to write to")
    host = msgspec.structs.replace(probe_host(), groups=V2(found[0]))
    with Emulation(two_computers, tmp_path, probe=host) as emulation:
        brain = emulation.computers["brain"]
        child = brain.popen(["cat"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert child.stdin
        assert child.stdout
        child.stdin.write(b"up\n")
        child.stdin.flush()
        assert child.stdout.readline() == b"up\n"
        assert brain.running() == [child.pid]
        assert brain.usage().used > 0
        child.communicate(timeout=LIMIT)
        assert brain.running() == []
