"""Nobody waits for ever for code of a component that hangs."""

from __future__ import annotations

import threading
from typing import cast
from unittest.mock import Mock

import pytest

from poise.errors import Timeout
from poise.runtime.component.started_calls import StartedCalls
from poise.runtime.connectors.endpoints import ComponentEndpoints
from poise.runtime.execution.exclusion import Exclusion
from poise.runtime.hosting import life_cycle
from poise.runtime.hosting.life_cycle import ExecutionGate


def test_what_hangs_is_not_waited_for_without_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(life_cycle, "BORROW_LIMIT", 0.01)
    gate = ExecutionGate(
        "map",
        Exclusion("map"),
        cast("ComponentEndpoints", None),
        StartedCalls("map", lambda do: do()),
        lambda: False,
    )
    hangs, goes_on = threading.Event(), threading.Event()

    def snapshot() -> None:
        with gate.borrowed():
            hangs.set()
            goes_on.wait()

    thread = threading.Thread(target=snapshot)
    thread.start()
    hangs.wait()
    try:
        with (
            pytest.raises(Timeout, match=r"'map'.*still runs"),
            gate.borrowed(by_hook=True),
        ):
            pass
    finally:
        goes_on.set()
        thread.join()
    with gate.borrowed(by_hook=True):  # it is free again
        pass


def test_what_could_not_resume_resumes_the_next_time() -> None:
    exclusion, endpoints = Exclusion("map"), Mock()
    calls = StartedCalls("map", lambda do: do())
    gate = ExecutionGate("map", exclusion, endpoints, calls, lambda: True)
    endpoints.send_buffered.side_effect = [RuntimeError("can't start new thread"), None]
    with pytest.raises(RuntimeError, match="new thread"):
        gate.resume()
    gate.resume()
    assert not gate.is_paused
    exclusion.enter(7, 0.0)
    exclusion.leave()
