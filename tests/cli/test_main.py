"""How every command ends when it is interrupted, however early."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

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
