"""Holds that quick tests are quick: no process, no socket, no sleep, no long work.

A test is quick unless it is marked `slow`; `make quick` runs the quick ones.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

LONG = 0.25
"""A quick test that takes more of a CPU [s] is named at the end of the run."""
TOO_LONG = 5.0
"""A quick test that takes more of a CPU [s] fails."""

_FORBIDDEN = {
    "os.exec": "replaces its process",
    "os.fork": "starts a process",
    "os.forkpty": "starts a process",
    "os.posix_spawn": "starts a process",
    "os.system": "starts a process",
    "socket.__new__": "opens a socket",
    "subprocess.Popen": "starts a process",
}
_WAY_OUT = "let it do without, or mark it `slow`"
_LASTED = "lasted"


class _Guard:
    """Refuses, while a quick test runs, what a quick test does not do."""

    def __init__(self) -> None:
        self.watches = False
        self.offence = ""

    def refuse(self, what: str) -> None:
        self.offence = self.offence or f"a quick test {what}: {_WAY_OUT}"
        raise AssertionError(self.offence)

    def audit(self, event: str, _: object) -> None:
        if self.watches and event in _FORBIDDEN:
            self.refuse(_FORBIDDEN[event])


_guard = _Guard()
sys.addaudithook(_guard.audit)  # stays for good, and costs next to nothing


def _sleep(seconds: float) -> None:
    _guard.refuse(f"sleeps for {seconds:g} s")


@contextmanager
def _watched(item: pytest.Item) -> Iterator[None]:
    if item.get_closest_marker("slow"):
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "sleep", _sleep)
        _guard.watches, _guard.offence = True, ""
        try:
            yield
        finally:
            _guard.watches = False
    if _guard.offence:  # although the test caught it
        pytest.fail(_guard.offence)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Watch the fixtures of a quick test."""
    with _watched(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Watch a quick test, and fail it if it takes too long."""
    began = time.thread_time()
    with _watched(item):
        yield
    lasted = time.thread_time() - began
    if item.get_closest_marker("slow"):
        return
    item.user_properties.append((_LASTED, lasted))
    if lasted > TOO_LONG:
        pytest.fail(f"takes {lasted:.2f} s of a CPU: make it quicker or `slow`")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the quick tests that take long."""
    for report in terminalreporter.stats.get("passed", ()):
        lasted = dict(report.user_properties).get(_LASTED, 0.0)
        if report.when == "call" and lasted > LONG:
            terminalreporter.write_line(
                f"takes {lasted:.2f} s and is not marked `slow`: {report.nodeid}"
            )
