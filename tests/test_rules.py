"""The rules of all tests are enforced: for quick ones, and for a busy machine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests import busy
from tests.waiting import LONG

ROOT = Path(__file__).parents[1]
RULES = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from tests import busy, quick

def pytest_configure(config):
    config.addinivalue_line("markers", "slow: is not quick")
    for plugin in (busy, quick):
        config.pluginmanager.register(plugin)
"""


def run(folder: Path, tests: str) -> str:
    """Run tests under the rules; return what pytest says."""
    (folder / "conftest.py").write_text(RULES)
    (folder / "test_it.py").write_text(tests)
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    ).stdout


@pytest.mark.slow
def test_a_quick_test_starts_no_process_opens_no_socket_and_does_not_sleep(
    tmp_path: Path,
) -> None:
    said = run(
        tmp_path,
        """
import contextlib, os, pytest, socket, subprocess, time

def test_process():
    subprocess.run(["true"])

def test_fork():
    os.fork()

def test_socket():
    socket.socketpair()

def test_sleep():
    with contextlib.suppress(AssertionError):
        time.sleep(0.001)

def test_nothing():
    pass

@pytest.mark.slow
def test_slow():
    subprocess.run(["true"])
    time.sleep(0.001)
""",
    )
    assert "4 failed, 2 passed" in said
    for offence in ("starts a process", "opens a socket", "sleeps for 0.001 s"):
        assert f"a quick test {offence}: let it do without, or mark it `slow`" in said


@pytest.mark.slow
def test_a_run_fails_when_a_busy_machine_spoilt_more_than_two_percent(
    tmp_path: Path,
) -> None:
    tests = """
import pytest
from tests import busy

@pytest.mark.parametrize("number", range(200))
def test_it(number):
    if number < {}:
        others = busy.CpuOfOthers()
        others.cpus = lambda: 2.0
        busy.skip_as_starved("starved", others)
"""
    enough, too_many = run(tmp_path, tests.format(4)), run(tmp_path, tests.format(5))
    assert "5 tests were spoilt by a busy machine, more than 4" in too_many
    assert "more than" not in enough
    assert "test_it[3]: Skipped: the machine was too busy: others used 2.0" in enough


def test_no_failed_assertion_is_excused() -> None:
    """A test may be skipped as the machine was busy only where Poise says so."""
    callers = {
        file.relative_to(ROOT).as_posix()
        for file in (ROOT / "tests").rglob("*.py")
        if "skip_as_starved" in file.read_text()
    }
    assert callers == {"tests/busy.py", "tests/command.py", "tests/test_rules.py"}


@pytest.mark.parametrize(
    ("used", "expected"),
    [(0.4, pytest.fail.Exception), (0.6, pytest.skip.Exception)],
)
def test_starved_computers_are_an_excuse_only_while_others_use_the_machine(
    used: float, expected: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On two CPUs, half of one may be used by others."""
    monkeypatch.setattr(busy.CpuOfOthers, "cpus", lambda _: used)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    with pytest.raises(expected, match="starved"):
        busy.skip_as_starved("starved", busy.CpuOfOthers())
