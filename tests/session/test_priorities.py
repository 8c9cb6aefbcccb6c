"""Under overload the important architecture keeps its rate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from benchmarks.priorities import deadlines_met
from poise.emulate.computer import CPU_GROUP, EmulatedComputer
from tests.busy import needs_quiet_machine

pytestmark = [pytest.mark.slow, pytest.mark.one_worker]


_AHEAD = 0.25
"""This much larger at least is the important one's share of deadlines met.

Its weight is ten times that of the other: on a quiet machine it meets all, the other
none. With equal weights neither meets any.
"""


def test_without_priorities_both_miss_their_deadlines(tmp_path: Path) -> None:
    assert deadlines_met(1, 3.0, tmp_path)["important"] < 0.5


def test_the_higher_priority_keeps_its_rate(tmp_path: Path) -> None:
    with needs_quiet_machine():
        assert is_ahead(deadlines_met(10, 3.0, tmp_path))


def test_it_does_by_nice_values_where_there_are_no_cgroups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = EmulatedComputer._environment

    def without(self: EmulatedComputer) -> Mapping[str, str]:
        return {**whole(self), CPU_GROUP: ""}

    monkeypatch.setattr(EmulatedComputer, "_environment", without)
    with needs_quiet_machine():
        assert is_ahead(deadlines_met(10, 3.0, tmp_path))


def is_ahead(met: Mapping[str, float]) -> bool:
    return met["important"] > met["other"] + _AHEAD
