"""How every command ends when it is interrupted, however early."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.runtime.conftest import free_port
from tests.waiting import LONG

pytestmark = pytest.mark.slow


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
