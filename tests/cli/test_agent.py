"""`poise agent` on real addresses."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

import pytest

from poise.cli.agent_command import agent_command
from poise.errors import UsageError
from tests.command import POISE, Poise
from tests.runtime.conftest import free_port
from tests.waiting import LONG

HELLO = Path(__file__).parents[2] / "examples" / "hello"


@contextlib.contextmanager
def agents(ports: Mapping[str, int]) -> Iterator[None]:
    """Run an agent for each computer on IPv6's loopback."""
    processes = []
    try:
        for name, port in ports.items():
            argv = [*POISE, "agent", name, "--robot", "hello", "--address", "::1"]
            processes.append(subprocess.Popen([*argv, f"--port={port}"]))
        yield
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait(LONG)


@pytest.mark.slow
def test_agents_and_connectors_use_ipv6(poise: Poise, tmp_path: Path) -> None:
    text = (HELLO / "robot.yaml").read_text()
    ports = {"left": free_port(), "right": free_port()}
    for name, port in ports.items():
        text = text.replace(f"{name}: {{", f"{name}: {{address: '[::1]:{port}', ")
    for name, computer in (("Counter", "left"), ("Printer", "right")):
        text = text.replace(f'hello:{name}"', f'hello:{name}", only: [{computer}]')
    (tmp_path / "robot.yaml").write_text(text)
    (tmp_path / "hello.py").write_bytes((HELLO / "hello.py").read_bytes())
    words = ["run", tmp_path / "robot.yaml", "--task", "greet", "--for", "3s"]
    with agents(ports):
        done = poise(*words, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert {each["kind"] for each in report["connectors"]} == {"remote"}
    assert report["clocks"]


def robot_at(folder: Path, **ports: int) -> Path:
    """Write the hello robot with real computers on this one."""
    text = (HELLO / "robot.yaml").read_text()
    for name, port in ports.items():
        text = text.replace(f"{name}: {{", f"{name}: {{address: '127.0.0.1:{port}', ")
    (folder / "hello.py").write_bytes((HELLO / "hello.py").read_bytes())
    (folder / "robot.yaml").write_text(text)
    return folder / "robot.yaml"


@contextlib.contextmanager
def agent(computer: str, robot: str, port: int, *options: str) -> Iterator[IO[str]]:
    """Run an agent; give what it prints."""
    argv = [*POISE, "agent", computer, "--robot", robot, "--address", "127.0.0.1"]
    process = subprocess.Popen(
        [*argv, f"--port={port}", *options], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        yield process.stdout
    finally:
        process.terminate()
        process.communicate(timeout=LONG)


@pytest.mark.slow
def test_a_witness_without_keys_says_what_others_can_do() -> None:
    argv = [*POISE, "witness", "third", "--robot", "hello", "--address", "127.0.0.1"]
    with subprocess.Popen(
        [*argv, f"--port={free_port()}"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        said = process.stdout.readline() + process.stdout.readline()
        process.terminate()
    assert "can have its vote" in said


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_an_agent_that_is_told_to_end_exits_with_0(number: signal.Signals) -> None:
    argv = [*POISE, "agent", "left", "--robot", "ended", "--address", "127.0.0.1"]
    with subprocess.Popen(
        [*argv, f"--port={free_port()}"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.send_signal(number)
        assert process.wait(LONG) == 0


@pytest.mark.slow
def test_agents_say_who_they_are_and_who_manages_them(
    poise: Poise, tmp_path: Path
) -> None:
    ports = {"left": free_port(), "right": free_port()}
    robot = robot_at(tmp_path, **ports)
    with (
        agent("left", "hello", ports["left"]) as said,
        agent("right", "hello", ports["right"]),
    ):
        first = said.readline()
        assert "agent of computer 'left' of robot 'hello'" in first
        assert f"at 127.0.0.1:{ports['left']}, gateway 127.0.0.1:" in first
        assert "Poise " in first
        assert "without keys: whoever reaches 127.0.0.1" in said.readline()
        done = poise("run", robot, "--task", "greet", "--for", "1s")
        assert done.returncode == 0, done.stderr
        assert "managed by user" in said.readline()
        assert "is gone; what still runs here goes on" in said.readline()


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [("left", "other"), ("third", "hello")])
def test_the_agent_of_another_computer_or_robot_is_named(
    poise: Poise, tmp_path: Path, wrong: tuple[str, str]
) -> None:
    ports = {"left": free_port(), "right": free_port()}
    robot = robot_at(tmp_path, **ports)
    with (
        agent(*wrong, ports["left"]) as said,
        agent("right", "hello", ports["right"]),
    ):
        said.readline()
        done = poise("run", robot, "--task", "greet", "--for", "1s")
    assert done.returncode == 1
    text = " ".join(done.stderr.split())
    assert (
        f"at 127.0.0.1:{ports['left']} there is the agent of computer '{wrong[0]}' of "
        f"robot '{wrong[1]}', not of computer 'left' of robot 'hello'"
    ) in text


@pytest.mark.slow
@pytest.mark.parametrize("address", ["[::1]", "::1:7447:x", "10.0.0.1:7500", "myhost"])
def test_an_address_to_listen_on_is_an_ip_address(poise: Poise, address: str) -> None:
    done = poise("agent", "left", "--robot", "hello", "--address", address)
    assert done.returncode == 2
    assert f"{address}" in done.stderr
    assert "fd00::" in done.stderr


@pytest.mark.parametrize("error", [UsageError("no keys"), OSError("no space left")])
def test_a_service_that_cannot_begin_is_not_begun_again_at_once(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def refuse(*_: object, **__: object) -> str:
        raise error

    waits: list[float] = []
    monkeypatch.setattr("time.sleep", waits.append)
    monkeypatch.setattr("poise.cli.agent_command.keys_for", refuse)
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    for _ in range(2):
        with pytest.raises(type(error), match=str(error)):
            agent_command("left", "hello", "192.0.2.1")
        monkeypatch.setenv("NOTIFY_SOCKET", "/run/nobody")
    (wait,) = waits
    assert 3.0 < wait <= 5.0


@pytest.mark.slow
def test_an_agent_runs_only_code_that_it_allows(poise: Poise, tmp_path: Path) -> None:
    ports = {"left": free_port(), "right": free_port()}
    robot = robot_at(tmp_path, **ports)
    words = ("run", robot, "--task", "greet", "--for", "0.5s")
    with agent("left", "hello", ports["left"]):
        with agent("right", "hello", ports["right"], "--allow", "/opt/robot"):
            refused = poise(*words)
        with agent("right", "hello", ports["right"], "--allow", str(tmp_path)):
            assert poise(*words).returncode == 0
    assert refused.returncode == 1
    said = " ".join(refused.stderr.split())
    assert f"code of container 'greeting' is at {tmp_path}" in said
    assert "only runs what is in /opt/robot (`poise agent --allow`)" in said
