"""Tests that run at the same time share nothing of the machine."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from poise.emulate import probe_host
from poise.emulate.registry import FOLDER, registry
from poise.wire import robots_here as location
from tests.waiting import LONG

pytestmark = pytest.mark.slow

ANOTHER = """
import socket, sys
from poise.emulate.registry import registry
from tests.machine import enter_own_network, leave
enter_own_network()
with socket.create_server(("127.0.0.1", int(sys.argv[1]))):
    print(registry())
leave()
"""


def another(port: int) -> Path:
    """Return the registry of another process that listens at a port of its network."""
    done = subprocess.run(
        [sys.executable, "-c", ANOTHER, str(port)],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return Path(done.stdout.strip())


@pytest.fixture
def _needs_networks() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))


@pytest.mark.usefixtures("_needs_networks")
def test_each_process_has_its_ports_and_its_registry() -> None:
    with socket.create_server(("127.0.0.1", 0)) as ours:
        theirs = another(ours.getsockname()[1])
    assert theirs != registry()
    assert not theirs.exists()


@pytest.mark.usefixtures("_needs_networks")
def test_the_registry_of_killed_tests_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with subprocess.Popen(["true"]) as ended:
        ended.wait(LONG)
    killed = tmp_path / f"poise-{ended.pid}-1.tests"
    killed.mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with socket.create_server(("127.0.0.1", 0)) as ours:
        another(ours.getsockname()[1])
    assert not killed.exists()


def test_robots_of_tests_are_not_among_the_users() -> None:
    assert "XDG_RUNTIME_DIR" not in os.environ
    assert str(location.folder()).startswith(os.environ["TMPDIR"])
    assert FOLDER in os.environ or probe_host().without_network()
