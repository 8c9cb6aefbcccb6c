"""`poise up` whose output nobody reads goes on looking after its robot."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from poise.errors import PoiseError
from poise.manage.control_socket.commands import RobotStatus, StatusCommand
from poise.manage.control_socket.control_client import send_command
from tests.command import POISE, run_poise
from tests.processes import children_of, words_of
from tests.waiting import LIMIT, LONG, wait_long

pytestmark = pytest.mark.slow

NAME = f"chatty{os.getpid()}"
CODE = """
from poise import Component, every

class Chatty(Component):
    count = 0

    @every(0.01)
    def chat(self):
        self.count += 1
        print("chat " * 200, self.count, flush=True)
"""
FILE = f"""
robot: {NAME}
computers:
  left: {{cpu: 0.5, memory: 1 GiB}}
  right: {{cpu: 0.5, memory: 1 GiB}}
architectures:
  work:
    function: work
    components:
      chatty: {{implementation: "chatty:Chatty", only: [left], cpu: 5%, memory: 50 MiB}}
      other: {{implementation: "chatty:Chatty", only: [right], cpu: 5%, memory: 50 MiB}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
"""
PIPE = 4096
"""The smallest that Linux gives [bytes]."""


def status() -> RobotStatus:
    answer = send_command(NAME, StatusCommand())
    assert isinstance(answer, RobotStatus)
    return answer


def is_up() -> bool:
    try:
        return bool(status().computers)
    except PoiseError:
        return False


def releases(computer: str) -> int:
    (container,) = status().computers[computer].containers
    return sum(t.releases for c in container.components for t in c.timers)


def adopted(computer: str) -> int:
    agent = status().computers.get(computer)
    return len(agent.took_over or ()) if agent else 0


def agent_of(up: int, computer: str) -> int:
    for pid in children_of(up):
        words = words_of(pid)
        if b"agent" in words and computer.encode() in words:
            return pid
    pytest.fail(f"no agent of {computer}")


def test_a_killed_agent_is_noticed_though_nobody_reads(tmp_path: Path) -> None:
    (tmp_path / "chatty.py").write_text(CODE)
    (tmp_path / "robot.yaml").write_text(FILE)
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, PIPE)
    argv = [*POISE, "up", str(tmp_path / "robot.yaml")]
    up = subprocess.Popen(argv, stdout=writing, stderr=writing)
    try:
        wait_long(is_up)
        # not one more byte of the chat goes out
        wait_long(lambda: not select.select([], [writing], [], 0)[1])
        before = releases("left")
        wait_long(lambda: releases("left") > before + 200)

        os.kill(agent_of(up.pid, "right"), signal.SIGKILL)
        wait_long(lambda: adopted("right") == 1)
        before = releases("left")
        wait_long(lambda: releases("left") > before + 50)

        stopped = run_poise("stop", "--robot", NAME)
        assert stopped.returncode == 0, stopped.stderr
        up.wait(LONG)
    finally:
        up.kill()
        up.wait(LONG)
        os.close(reading)
        os.close(writing)


FAILING = """
import poise.cli.command_table
from poise.cli.main import main

def build(*_, **__):
    raise KeyError("a bug of Poise")

poise.cli.command_table.build = build
main()
"""


@pytest.mark.parametrize(
    ("argv", "code"),
    [
        pytest.param([*POISE, "status", "--robot", "no"], 2, id="an error"),
        pytest.param([sys.executable, "-c", FAILING], 1, id="a bug"),
    ],
)
def test_a_command_that_fails_ends_though_nobody_reads_why(
    argv: list[str], code: int
) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(PIPE))
    os.set_blocking(writing, True)
    with subprocess.Popen(argv, stderr=writing) as failing:
        try:
            assert failing.wait(LIMIT) == code
        finally:
            failing.kill()
            os.close(reading)
            os.close(writing)


def test_a_bug_is_said_with_its_traceback() -> None:
    argv = [sys.executable, "-c", FAILING]
    failed = subprocess.run(
        argv, capture_output=True, text=True, timeout=LONG, check=False
    )
    assert failed.returncode == 1
    assert failed.stderr.startswith("Traceback (most recent call last):\n")
    assert failed.stderr.endswith("\nKeyError: 'a bug of Poise'\n")


def ended(
    words: str, redirected: str = "", stdout: int = subprocess.PIPE
) -> tuple[int, str]:
    """Return how a command ends, and what it says."""
    done = subprocess.run(
        ["bash", "-c", f"exec $0 -m poise {words} {redirected}", sys.executable],
        stdout=stdout,
        stderr=subprocess.PIPE,
        env={k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"},
        timeout=LONG,
        check=False,
    )
    return done.returncode, ((done.stdout or b"") + done.stderr).decode()


FULL = "a result: No space left on device\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("keys list --json", FULL),
        ("--version", FULL),
        ("status --robot no --json", FULL),
        ("status --help", FULL),
    ],
)
def test_a_full_disk_is_said_in_a_line(words: str, said: str) -> None:
    code, text = ended(words, "> /dev/full")
    assert code == 1
    assert text.endswith(said)
    assert "Traceback" not in text
    assert "Exception ignored" not in text


@pytest.mark.parametrize("words", ["--version", "keys list --json"])
def test_a_reader_that_has_left_is_no_failure_to_tell_of(words: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    assert ended(words, stdout=writing) == (1, "")
    os.close(writing)


def test_closed_streams_take_nothing_and_change_no_exit_code() -> None:
    assert ended("keys list --json", ">&-") == (0, "")
    assert ended("status --robot no", "2>&-") == (2, "")


def test_what_an_encoding_lacks_is_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    code, text = ended("plan examples/hello/robot.yaml")
    assert code == 0
    assert "\\u2588" in text  # a bar
