"""Under overload the important architecture gets more of the CPU.

Each of the two wants more than the computer has, so weights alone decide who gets how
much of what the host leaves, little or much.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from benchmarks.priorities import run
from poise.emulate.emulation import EmulatedComputer
from poise.kernel_counters import CPU_GROUP

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.one_worker]

WORK = (0.03, 0.04)
"""CPU of a step [s]; 20 steps a second want 0.6 and 0.8 of 0.5 cores."""
AHEAD = 0.75
"""The least share of both that the important one gets: 10/11 by its weight."""


def test_with_equal_priorities_neither_is_ahead(tmp_path: Path) -> None:
    assert 1 - AHEAD < share_of_the_important(1, tmp_path) < AHEAD


def test_the_higher_priority_gets_more(tmp_path: Path) -> None:
    assert share_of_the_important(10, tmp_path) > AHEAD


def test_it_does_by_nice_values_where_there_are_no_cgroups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = EmulatedComputer._environment

    def without(self: EmulatedComputer) -> Mapping[str, str]:
        return {**whole(self), CPU_GROUP: ""}

    monkeypatch.setattr(EmulatedComputer, "_environment", without)
    assert share_of_the_important(10, tmp_path) > AHEAD


def share_of_the_important(priority: int, folder: Path) -> float:
    report = run(priority, 3.0, folder, WORK)
    cpu = {component.name: component.cpu for component in report.components}
    return cpu["important"] / sum(cpu.values())
