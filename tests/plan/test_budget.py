"""A budget is CPU time: on a busy machine it takes longer, within a limit."""

from __future__ import annotations

import pytest

from poise.plan import planner
from poise.plan.planner import BUSY, Budget


def test_counts_cpu_time_and_a_share_of_what_it_waited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cpu = clock = 5.0
    monkeypatch.setattr(planner, "thread_time", lambda: cpu)
    monkeypatch.setattr(planner, "perf_counter", lambda: clock)
    left = Budget(1.0).left
    assert left() == 1.0
    cpu, clock = 5.4, 5.4
    assert left() == pytest.approx(0.6)
    clock = 6.0  # others had the CPU
    assert left() == pytest.approx(0.6)
    clock = 5.0 + 0.9 * BUSY
    assert left() == pytest.approx(0.1)
    cpu = 6.1
    assert left() < 0
