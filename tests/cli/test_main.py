"""How every command ends when it is interrupted, however early."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from poise.waker import wait_readable
from tests.command import run_poise
from tests.runtime.conftest import free_port
from tests.waiting import LONG

pytestmark = pytest.mark.slow

HELLO = Path(__file__).parents[2] / "examples" / "hello"


@pytest.mark.parametrize("imported", ["msgspec", "typer", "poise.runtime.agent.agent"])
def test_ctrl_c_ends_a_command_that_has_hardly_begun(imported: str) -> None:
    """It comes right after a module was imported, or later on a busy machine."""
    argv = [sys.executable, "-X", "importtime", "-m", "poise", "agent", "main"]
    argv += ["--robot", "begun", "--address", "127.0.0.1", "--port", str(free_port())]
    with subprocess.Popen(argv, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert any(line.endswith(f" {imported}\n") for line in process.stderr)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=LONG)
    assert process.returncode == 128 + signal.SIGINT
    assert "Traceback" not in said


@pytest.mark.parametrize("command", ["calibrate", "profile"])
def test_ctrl_c_ends_a_measurement(command: str, tmp_path: Path) -> None:
    for file in HELLO.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    argv = [sys.executable, "-m", "poise", command, "robot.yaml", "--for", "100s"]
    with subprocess.Popen(
        argv,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        said = iter(process.stdout)
        assert any(re.match("calibrating|measuring|printer has", line) for line in said)
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=LONG)[0]
    assert process.returncode == 128 + signal.SIGINT
    assert "Traceback" not in rest


HANGING = "import os, time\nprint('child', os.getpid(), flush=True)\ntime.sleep(600)\n"


@pytest.mark.parametrize(
    ("command", "sent"),
    [
        ("check", signal.SIGINT),
        ("run", signal.SIGTERM),
        ("profile", signal.SIGHUP),
    ],
)
def test_a_signal_ends_a_check_of_hanging_code(
    command: str, sent: signal.Signals, tmp_path: Path
) -> None:
    shutil.copy(HELLO / "robot.yaml", tmp_path)
    (tmp_path / "hello.py").write_text(HANGING)
    with subprocess.Popen(
        [sys.executable, "-m", "poise", command, "robot.yaml"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        child = next(line for line in process.stdout if line.startswith("child"))
        pidfd = os.pidfd_open(int(child.split()[1]))
        process.send_signal(sent)
        rest = process.communicate(timeout=LONG)[0]
    assert (process.returncode, rest) == (128 + sent, "")
    assert wait_readable([pidfd], LONG)
    os.close(pidfd)


AT_ONCE = """
import os, signal
from poise.cli.main import end_at_once
end_at_once()
try:
    os.kill(os.getpid(), signal.SIGTERM)
    print("went on")
except BaseException as error:
    print("raised", error)
"""
NOTED = """
import os, signal
from poise.cli.main import Interrupts
with Interrupts() as interrupts:
    for number in signal.SIGTERM, signal.SIGINT:
        try:
            os.kill(os.getpid(), number)
            print("went on")
        except BaseException as error:
            print("raised", error)
    print("cleaned up")
"""


@pytest.mark.parametrize(
    ("code", "said"),
    [(AT_ONCE, ""), (NOTED, "went on\nwent on\ncleaned up\n")],
)
def test_no_handler_raises(code: str, said: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (128 + 15, said, "")


NO_THREAD = """
import threading
from poise.cli.main import run_process

def start(_: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")

threading.Thread.start = start
run_process()
"""


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("run", "robot.yaml"), 1),
        (("agent", "left", "--robot", "full", "--address", "127.0.0.1"), 70),
    ],
)
def test_a_computer_without_a_free_thread_is_no_bug(
    words: tuple[str, ...], code: int
) -> None:
    port = ("--port", str(free_port())) if words[0] == "agent" else ()
    done = subprocess.run(
        [sys.executable, "-c", NO_THREAD, *words, *port],
        cwd=HELLO,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == code
    assert "no thread can be started: raise the limit of processes" in done.stderr
    assert "Traceback" not in done.stderr
    assert "bug" not in done.stderr


def test_nohup_lets_a_command_go_on() -> None:
    code = (
        "import os, signal\n"
        "from poise.cli.main import Interrupts, end_at_once\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "end_at_once()\n"
        "os.kill(os.getpid(), signal.SIGHUP)\n"
        "with Interrupts() as interrupts:\n"
        "    os.kill(os.getpid(), signal.SIGHUP)\n"
    )
    subprocess.run([sys.executable, "-c", code], timeout=LONG, check=True)


def test_top_without_a_terminal_names_what_to_use_instead() -> None:
    done = run_poise("top")
    assert done.returncode == 2
    assert "needs a terminal: `poise status`" in done.stderr
