"""Skips a test that the machine spoilt, when Poise says so and the machine agrees.

Poise calls a run invalid when the host gave emulated computers too little CPU. The
test is skipped if other processes used more than `TOLERATED` of the machine's CPUs
meanwhile, and fails otherwise. No failed assertion is ever excused: what may be late on
a busy machine is waited for, or asserted as a count or a ratio. At most `MOST_SKIPPED`
of a run's tests may be skipped.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import pytest

TOLERATED = 0.25
"""The share of the machine's CPUs that others may use beside a test."""
MOST_SKIPPED = 0.02
"""The share of a run's tests that may be skipped because the machine was busy."""

_SAYS = "the machine was too busy: "
_TICK = 1 / os.sysconf("SC_CLK_TCK")


class CpuOfOthers:
    """Measures the CPU time of all processes but this one and its descendants."""

    def __init__(self) -> None:
        self._began, self._used = time.monotonic(), _cpu_of_others()

    def cpus(self) -> float:
        """Return how many CPUs the others used since the beginning, at the mean."""
        return (_cpu_of_others() - self._used) / (time.monotonic() - self._began)


def skip_as_starved(claim: str, others: CpuOfOthers) -> NoReturn:
    """Skip the running test, or fail it if others left the machine alone.

    Parameters
    ----------
    claim
        What Poise says of the machine.
    others
        Has measured since the test began to need it.
    """
    cpus = os.cpu_count() or 1
    used = others.cpus()
    if used > TOLERATED * cpus:
        pytest.skip(f"{_SAYS}others used {used:.1f} of its {cpus} CPUs; {claim}")
    pytest.fail(f"{claim}, but others used {used:.1f} of this machine's {cpus} CPUs")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests a busy machine spoiled."""
    if skipped := _spoilt(terminalreporter):
        terminalreporter.section("spoilt by a busy machine", red=True)
        for report in skipped:
            terminalreporter.write_line(f"{report.nodeid}: {_reason(report)}")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run of which a busy machine spoiled too much."""
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")
    if terminal is None or hasattr(session.config, "workerinput"):
        return
    most = max(1.0, MOST_SKIPPED * session.testscollected)
    if len(skipped := _spoilt(terminal)) > most and session.exitstatus == 0:
        terminal.write_line(
            f"{len(skipped)} tests were spoilt by a busy machine, more than {most:.0f}"
        )
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _spoilt(terminal: pytest.TerminalReporter) -> list[pytest.TestReport]:
    return [r for r in terminal.stats.get("skipped", ()) if _SAYS in _reason(r)]


def _reason(report: pytest.TestReport) -> str:
    return str(report.longrepr[2]) if isinstance(report.longrepr, tuple) else ""


def _cpu_of_others() -> float:
    """Return the CPU time of all but this process and its descendants [s].

    Of descendants that ended it knows what their parents waited for.
    """
    names = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
    user, nice, system, _, _, irq, softirq, steal = map(int, names[1:9])
    ours = sum(times for _, times in _family())
    return (user + nice + system + irq + softirq + steal - ours) * _TICK


def _family() -> Iterator[tuple[int, int]]:
    """Yield the number and CPU time [ticks] of this process and its descendants."""
    children: dict[int, list[int]] = {}
    used = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = file.read_text(encoding="utf-8").rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        number = int(file.parent.name)
        children.setdefault(int(fields[1]), []).append(number)
        used[number] = sum(map(int, fields[11:15]))  # with children it waited for
    family = [os.getpid()]
    for number in family:
        family.extend(children.get(number, ()))
        yield number, used.get(number, 0)
