"""Emulated computers that are kept up, used by several commands, and broken."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet, find_set, probe_host, sweep
from poise.emulate.registry import read
from tests.command import POISE, robot_up, run_poise
from tests.processes import words_of
from tests.waiting import LONG, wait_long, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

HELLO = Path(__file__).parents[3] / "examples" / "hello"
ECHO = """
import socket, sys
with socket.create_server((sys.argv[1], 0)) as server:
    print(server.getsockname()[1], flush=True)
    connection, _ = server.accept()
    for question in connection.makefile("rb"):
        connection.sendall(question)
"""
ASK = """
import socket, sys
connection = socket.create_connection((sys.argv[1], int(sys.argv[2])), 20)
heard = b""
for number, line in enumerate(sys.stdin):
    question = b"%d\\n" % number
    connection.settimeout(float(line))
    try:
        connection.sendall(question)
        while question not in heard.splitlines(keepends=True):  # of earlier ones
            heard += connection.recv(100)
        print("answer", flush=True)
    except TimeoutError:
        print("silence", flush=True)
"""


@pytest.fixture(scope="module", autouse=True)
def _needs_namespaces() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))


def hello(folder: Path, name: str) -> Path:
    """Return the file of a robot with the computers left and right.

    The sets of a user are found by name: other tests that run now have others.
    """
    shutil.copy(HELLO / "hello.py", folder)
    text = (HELLO / "robot.yaml").read_text().replace("robot: hello", f"robot: {name}")
    (folder / "robot.yaml").write_text(text)
    return folder / "robot.yaml"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hello(tmp_path_factory.mktemp("kept"), f"kept-{os.getpid()}")


@pytest.fixture(scope="module")
def kept(file: Path) -> Iterator[EmulatedSet]:
    with poise.emulated(poise.load(file), say=print) as emulated:
        yield emulated


@pytest.fixture(autouse=True)
def _healed(request: pytest.FixtureRequest) -> Iterator[None]:
    """End the faults that a test left: those that follow need the set whole."""
    yield
    if "kept" in request.fixturenames:
        kept: EmulatedSet = request.getfixturevalue("kept")
        while faults := kept.state().faults:
            # of a crashed computer nothing else is healed
            fault = min(faults, key=lambda each: each.kind != "crashed")
            if fault.kind == "load":
                kept.load(fault.on[0], 0.0)
            elif fault.kind in {"crashed", "frozen", "frozen agent"}:
                kept.boot(*fault.on)
            else:
                kept.heal(*fault.on)


def emulate(kept: EmulatedSet, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command on a set."""
    return run_poise("emulate", *words, "--robot", kept.robot)


def agent_of(kept: EmulatedSet, computer: str) -> int:
    """Return the process of a computer's agent, once there is one."""
    found: dict[int, int] = {}

    def look_for_it() -> bool:
        for pid in kept.computers[computer].running():
            words = words_of(pid)
            if b"agent" in words and computer.encode() in words:
                with contextlib.suppress(OSError):  # it has ended meanwhile
                    found[pid] = began(pid)
        return bool(found)

    wait_long(look_for_it)
    # what it forks has its command line for a moment
    return min(found, key=found.__getitem__)


def began(pid: int) -> int:
    """Return when a process began [clock ticks]."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19])


def test_a_run_uses_them_and_leaves_them_up(kept: EmulatedSet, file: Path) -> None:
    agents = [agent_of(kept, name) for name in kept.computers]
    done = run_poise("run", file, "--task", "greet", "--for", "1s", "--json")
    report = json.loads(done.stdout)
    # a busy host makes a run invalid
    assert done.returncode == (1 if report["invalid"] else 0), done.stdout
    assert f"process {os.getpid()} keeps" in done.stderr
    assert report["placement"].keys() == {"counter", "printer"}
    assert [agent_of(kept, name) for name in kept.computers] == agents


def test_what_a_manager_started_on_them_ends_with_it(
    kept: EmulatedSet, file: Path
) -> None:
    with poise.up(poise.load(file)) as running:
        child = running.emulated["left"].popen(["sleep", "600"])
        wait_until(lambda: child.pid in kept.computers["left"].running())
    assert child.returncode is not None
    assert agent_of(kept, "left")


def test_a_robot_with_other_computers_is_refused(
    kept: EmulatedSet, tmp_path: Path
) -> None:
    other = hello(tmp_path, kept.robot)
    other.write_text(other.read_text().replace("right: {cpu: 0.5", "right: {cpu: 0.4"))
    done = run_poise("run", other, "--for", "1s")
    assert done.returncode == 2
    assert f"`poise emulate stop --robot {kept.robot}` ends them" in done.stderr
    done = run_poise("emulate", other)
    assert done.returncode == 2
    assert "has emulated computers already" in done.stderr


def test_a_cut_is_silent_and_heals(kept: EmulatedSet) -> None:
    left, right = kept.computers.values()
    argv = [sys.executable, "-c", ECHO, left.address]
    server = left.popen(argv, stdout=subprocess.PIPE)
    assert server.stdout
    port = server.stdout.readline().decode().strip()
    argv = [sys.executable, "-c", ASK, left.address, port]
    client = right.popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def ask(limit: float) -> str:
        assert client.stdin
        assert client.stdout
        client.stdin.write(f"{limit}\n".encode())
        client.stdin.flush()
        return client.stdout.readline().decode().strip()

    assert ask(20) == "answer"
    for on in (("left", "right"), ("right",)):
        assert emulate(kept, "cut", *on).returncode == 0
        assert ask(0.5) == "silence"
        again = emulate(kept, "cut", *on)
        assert again.returncode == 2
        assert f"`poise emulate heal {' '.join(on)}` ends it" in again.stderr
        assert emulate(kept, "heal", *on).returncode == 0
        assert ask(20) == "answer"
    assert kept.state().faults == ()
    for process in (client, server):
        process.communicate(timeout=LONG)


@pytest.mark.parametrize("break_", ["crash", "freeze"])
def test_a_manager_loses_a_broken_computer_until_it_is_booted(
    kept: EmulatedSet, file: Path, break_: str
) -> None:
    with robot_up(file):
        robot = poise.connect(kept.robot)
        assert emulate(kept, break_, "right").returncode == 0
        wait_long(lambda: "right" in robot.status().out_of_reach)
        listed = json.loads(run_poise("emulate", "list", "--json").stdout)
        (faults,) = (each["faults"] for each in listed if each["robot"] == kept.robot)
        (fault,) = faults
        assert fault["on"] == ["right"]
        assert emulate(kept, break_, "right").returncode == 2
        assert emulate(kept, "boot", "right").returncode == 0
        wait_long(lambda: not robot.status().out_of_reach)
    assert emulate(kept, "boot", "right").returncode == 2


def test_an_agent_alone_is_stopped_until_it_is_booted(
    kept: EmulatedSet, file: Path
) -> None:
    with robot_up(file):
        robot = poise.connect(kept.robot)
        (container,) = robot.status().computers["left"].containers
        agent = agent_of(kept, "left")
        assert emulate(kept, "freeze", "left", "--agent").returncode == 0
        wait_until(lambda: state_of(agent) == "T")
        assert state_of(container.pid) != "T"
        (fault,) = kept.state().faults
        assert str(fault).startswith("frozen agent left since")
        again = emulate(kept, "freeze", "left", "--agent")
        assert again.returncode == 2
        assert "`poise emulate boot left` ends it" in again.stderr
        wait_long(lambda: "left" in robot.status().out_of_reach)
        assert emulate(kept, "boot", "left").returncode == 0
        wait_long(lambda: not robot.status().out_of_reach)
    assert kept.state().faults == ()


def state_of(pid: int) -> str:
    """Return a process's state; T: it is stopped."""
    stat = Path(f"/proc/{pid}/stat").read_text()
    return stat.rpartition(")")[2].split()[0]


def test_a_killed_agent_is_started_again(kept: EmulatedSet, file: Path) -> None:
    with robot_up(file):
        first = agent_of(kept, "right")
        os.kill(first, signal.SIGKILL)
        wait_long(lambda: agent_of(kept, "right") != first)
        robot = poise.connect(kept.robot)
        wait_long(lambda: not robot.status().out_of_reach)


def test_nothing_starts_on_a_frozen_computer(kept: EmulatedSet) -> None:
    before = agent_of(kept, "left")
    assert emulate(kept, "freeze", "left").returncode == 0
    os.kill(before, signal.SIGKILL)
    time.sleep(1.5)  # it would be started again within a second
    running = kept.computers["left"].running()
    assert not [pid for pid in running if state_of(pid) not in "TZ"]
    assert emulate(kept, "boot", "left").returncode == 0
    wait_long(lambda: agent_of(kept, "left") != before)


def test_a_load_takes_what_it_is_to_take(kept: EmulatedSet) -> None:
    left = kept.computers["left"]
    before = left.usage().used
    kept.load("left", 0.25)
    (load,) = kept.state().faults
    wait_until(lambda: left.usage().used - before > 0.25)
    assert load.cpu == 0.25
    (pid,) = load.processes
    wait_until(lambda: pid in left.running())
    # else who reads what a command says would wait until the load ends
    files = {Path(f"/proc/{pid}/fd/{number}").readlink() for number in range(3)}
    assert files == {Path(os.devnull)}
    kept.load("left", 0.0)
    assert pid not in left.running()
    with pytest.raises(poise.UsageError, match="'left' has no load"):
        kept.load("left", 0.0)
    with pytest.raises(poise.UsageError, match=r"load of 9: 'left' has 0\.5 cores"):
        kept.load("left", 9)


def test_a_slow_link_carries_less(kept: EmulatedSet) -> None:
    def rates() -> list[str]:
        argv = ["tc", "class", "show", "dev", "eth0"]
        shown = [
            computer.popen(argv, stdout=subprocess.PIPE).communicate(timeout=LONG)[0]
            for computer in kept.computers.values()
        ]
        return [
            rate for each in shown for rate in re.findall(r" rate (\S+)", str(each))
        ]

    assert rates() == ["100Mbit", "100Mbit"]
    done = emulate(kept, "slow", "left", "right", "--bandwidth", "1Mbit/s")
    assert done.returncode == 0, done.stderr
    assert rates() == ["1Mbit", "1Mbit"]
    kept.heal("right", "left")
    assert rates() == ["100Mbit", "100Mbit"]


def test_wrong_names_are_refused(kept: EmulatedSet) -> None:
    for words in (["cut", "left", "lift"], ["cut", "left", "left"], ["boot", "lift"]):
        done = emulate(kept, *words)
        assert done.returncode == 2
        assert f"'{words[-1]}'" in done.stderr
    done = run_poise("emulate", "crash", "left", "--robot", "nobody")
    assert done.returncode == 2
    assert "`poise emulate FILE` brings them up" in done.stderr
    with pytest.raises(poise.UsageError, match="give a bandwidth or a latency"):
        kept.slow("left", "right")


def test_what_a_killed_keeper_left_is_swept(kept: EmulatedSet, tmp_path: Path) -> None:
    name = f"second-{os.getpid()}"
    file = hello(tmp_path, name)
    argv = [*POISE, "emulate", str(file)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as keeper:
        assert keeper.stdout
        assert any("are up" in line for line in keeper.stdout)
        second = find_set(name)
        done = run_poise("emulate", "freeze", "left")
        assert done.returncode == 2  # which robot's?
        assert kept.robot in done.stderr
        assert name in done.stderr
        agent_of(second, "left")
        done = emulate(second, "freeze", "left")
        assert done.returncode == 0, done.stderr
        keeper.kill()
    assert second.layout.owner in sweep()
    assert read(second.layout.run) is None
    assert not any(
        Path(each).exists()
        for c in second.layout.computers
        for each in (*c.groups, c.folder, f"/run/netns/{c.namespace}")
    )
    assert kept.state().since


def test_stop_ends_them(tmp_path: Path) -> None:
    name = f"ending-{os.getpid()}"
    file = hello(tmp_path, name)
    argv = [*POISE, "emulate", str(file)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as keeper:
        assert keeper.stdout
        assert any("are up" in line for line in keeper.stdout)
        ending = find_set(name)
        assert run_poise("emulate", "stop", file).returncode == 0
        assert keeper.wait(timeout=LONG) == 128 + signal.SIGTERM
    assert read(ending.layout.run) is None
    with pytest.raises(poise.UsageError, match="have ended"):
        ending.cut("left", "right")
