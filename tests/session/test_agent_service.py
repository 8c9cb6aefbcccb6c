"""systemd runs agents: where it can be started, a real one in namespaces of its own."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest.mock import Mock

import pytest

from poise.errors import RunError
from poise.session.agent_service import AgentService
from tests.command import Poise
from tests.runtime.conftest import free_port
from tests.waiting import LONG, wait_until

UNIT = "poise-hello-left.service"
AS_NOBODY = "--run-as", "nobody"
SYSTEMD = Path("/lib/systemd/systemd")
BOOT = r"""
set -e
mount -t tmpfs none /run
mkdir -p /run/systemd/system
mount -t tmpfs none /sys/fs/cgroup
mount -t cgroup2 none /sys/fs/cgroup
for target in t sysinit basic shutdown network-online; do
  printf '[Unit]\nDefaultDependencies=no\n' >"$SYSTEMD_UNIT_PATH/$target.target"
done
exec env container=nspawn "$0" --system --unit=t.target --show-status=no
"""


def install(poise: Poise, folder: Path, port: int, *options: str) -> Path:
    """Write the unit of an agent on loopback."""
    done = poise(
        *("agent", "install", "left", "--robot", "hello", "--address", "127.0.0.1"),
        *("--system", "--port", port, "--unit-folder", folder, *options),
    )
    assert done.returncode == 0, done.stderr
    assert f"{folder / UNIT} is written" in done.stdout
    return folder / UNIT


def test_writes_and_removes_a_unit(poise: Poise, tmp_path: Path) -> None:
    unit = install(poise, tmp_path, 7447)
    text = unit.read_text()
    command = f"ExecStart={sys.executable} -m poise agent left --robot hello"
    assert f"{command} --address 127.0.0.1 --port 7447\n" in text
    words = ("agent", "uninstall", "left", "--robot", "hello")
    place = ("--system", "--unit-folder", tmp_path)
    assert poise(*words, *place).returncode == 0
    assert not unit.exists()
    again = poise(*words, *place)
    assert again.returncode == 2
    assert "nothing is installed" in again.stderr


def test_what_systemd_refuses_names_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The log of a user's unit was to be found in the machine's."""
    failed = Mock(returncode=1, stderr="Job failed")
    monkeypatch.setattr(subprocess, "run", Mock(return_value=failed))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "systemd/private").mkdir(parents=True)
    service = AgentService("hello", "left", is_users=True)
    why = f"Job failed; `journalctl --user -u {UNIT}` may say why"
    with pytest.raises(RunError, match=re.escape(why)):
        service.install("")


def test_the_unit_of_another_robot_is_left_alone(poise: Poise, tmp_path: Path) -> None:
    place = ("--address", "127.0.0.1", "--unit-folder", tmp_path)
    mine, other = ("c", "--robot", "a-b"), ("b-c", "--robot", "a")
    assert poise("agent", "install", *mine, *place).returncode == 0
    (unit,) = tmp_path.iterdir()
    text = unit.read_text()
    for done in (
        poise("agent", "install", *other, *place),
        poise("agent", "uninstall", *other, *place[2:]),
    ):
        assert done.returncode == 2
        assert f"{unit} is not of computer 'b-c' of robot 'a'" in done.stderr
    assert unit.read_text() == text
    assert poise("agent", "install", *mine, *place).returncode == 0


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("left.local", "give an IP address"),
        ("0.0.0.0", "no other computer reaches this one by it"),
        ("::", "no other computer reaches this one by it"),
    ],
)
def test_an_unknown_address_is_refused(
    poise: Poise, tmp_path: Path, address: str, says: str
) -> None:
    words = ("agent", "install", "left", "--robot", "hello", "--address", address)
    done = poise(*words, "--unit-folder", tmp_path)
    assert done.returncode == 2
    assert says in done.stderr
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("computer", "robot", "says"),
    [
        ("../left", "hello", "'../left' is not a computer's name: a letter"),
        ("left", "../hello", "'../hello' is not a robot's name: a letter"),
    ],
)
def test_a_name_that_no_robot_file_has_is_refused(
    poise: Poise, tmp_path: Path, computer: str, robot: str, says: str
) -> None:
    own = (computer, "--robot", robot)
    folder = tmp_path / "units"
    for words in (
        ("agent", *own, "--address", "127.0.0.1"),
        ("agent", "install", *own, "--address=127.0.0.1", "--unit-folder", folder),
        ("agent", "uninstall", *own, "--unit-folder", folder),
    ):
        done = poise(*words)
        assert (done.returncode, done.stdout) == (2, "")
        assert says in done.stderr
    assert not [*tmp_path.iterdir()]


@pytest.mark.skipif(os.getuid() != 0, reason="only root may be another")
def test_a_unit_that_runs_containers_as_another_user_has_few_rights(
    poise: Poise, tmp_path: Path
) -> None:
    text = install(poise, tmp_path, 7447, *AS_NOBODY).read_text()
    assert "--port 7447 --run-as nobody\n" in text
    assert "CapabilityBoundingSet=CAP_CHOWN" in text
    assert "CAP_SYS_ADMIN" not in text


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), AS_NOBODY] if os.getuid() == 0 else [()])
def test_systemd_finds_no_fault_in_the_unit(
    poise: Poise, tmp_path: Path, options: Sequence[str]
) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd-analyze")
    unit = install(poise, tmp_path, 7447, *options)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", unit],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    # systemd before 254 does not know it, and ignores it
    said = [x for x in done.stderr.splitlines() if "DelegateSubgroup" not in x]
    assert (done.returncode, [x for x in said if unit.name in x]) == (0, [])


class Booted:
    """A systemd that runs in namespaces of its own."""

    def __init__(self, pid: int) -> None:
        self._pid = pid

    def systemctl(self, *words: str) -> str:
        """Ask it something; return what it says, errors too."""
        enter = ["nsenter", "-t", str(self._pid), "-a", "systemctl"]
        done = subprocess.run(
            [*enter, *words], capture_output=True, text=True, timeout=LONG, check=False
        )
        return done.stdout.strip() + done.stderr.strip()

    def main_pid(self) -> int:
        """Return the agent's process, in this systemd's namespace; 0: there is none."""
        is_active = self.systemctl("is-active", UNIT) == "active"
        shown = self.systemctl("show", "-P", "MainPID", UNIT)
        return int(shown) if is_active and shown.isdigit() else 0

    def wait_for_agent(self, before: int = 0) -> int:
        """Return the process of an agent that is ready, and is not the one before."""
        wait_until(lambda: self.main_pid() not in {0, before}, LONG, every=0.1)
        return self.main_pid()

    def signal(self, pid: int, number: signal.Signals) -> None:
        """Send a signal to a process of its namespace."""
        enter = ["nsenter", "-t", str(self._pid), "-p", "-m"]
        subprocess.run([*enter, "kill", f"-{number}", str(pid)], check=True)


@contextlib.contextmanager
def booted(units: Path) -> Iterator[Booted]:
    """Start systemd, or skip the test."""
    if os.getuid() or not SYSTEMD.exists():
        pytest.skip("systemd is not installed, or this user is not root")
    spaces = ["unshare", "-p", "-m", "-n", "-C", "-i", "-u", "-f"]
    with subprocess.Popen(
        [*spaces, "--kill-child", "--mount-proc", "sh", "-c", BOOT, SYSTEMD],
        env={**os.environ, "SYSTEMD_UNIT_PATH": str(units)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    ) as process:
        try:
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
            wait_until(lambda: process.poll() is not None or children.read_text(), LONG)
            if process.poll() is not None:
                assert process.stderr is not None
                pytest.skip(f"systemd does not start: {process.stderr.read()!r}")
            machine = Booted(int(children.read_text()))
            wait_until(
                lambda: (
                    machine.systemctl("is-system-running")
                    in {"running", "degraded", "starting"}
                ),
                LONG,
                every=0.1,
            )
            yield machine
        finally:
            process.kill()


@pytest.mark.slow
def test_systemd_restarts_an_agent_that_dies_or_hangs(
    poise: Poise, tmp_path: Path
) -> None:
    unit = install(poise, tmp_path, free_port())
    # the test need not wait for all of the limit
    unit.write_text(unit.read_text().replace("WatchdogSec=10", "WatchdogSec=2"))
    with booted(tmp_path) as machine:
        assert not machine.systemctl("start", UNIT)
        first = machine.wait_for_agent()
        machine.signal(first, signal.SIGKILL)
        second = machine.wait_for_agent(first)
        machine.signal(second, signal.SIGSTOP)
        third = machine.wait_for_agent(second)
        assert machine.systemctl("show", "-P", "NRestarts", UNIT) == "2"
        assert not machine.systemctl("restart", UNIT)
        machine.wait_for_agent(third)
        machine.systemctl("stop", UNIT)
        assert machine.systemctl("show", "-P", "Result", UNIT) == "success"
