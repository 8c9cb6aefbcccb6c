"""Why agents let nobody in is asked of all at once."""

from __future__ import annotations

from threading import Barrier

import pytest

from poise.endpoint import Endpoint
from poise.wire import refusal
from tests.waiting import LONG


def test_all_are_asked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """While no name server answered, each took as long as all do now."""
    agents = {name: Endpoint(f"{name}.local", 1) for name in ("left", "right")}
    asked = Barrier(len(agents), timeout=LONG)

    def ask(agent: Endpoint, _keys: object) -> str:
        asked.wait()
        if agent.host == "left.local":
            return "it refuses"
        raise OSError("no name server")

    monkeypatch.setattr(refusal, "_of_listener", ask)
    assert refusal.why_all_refused(agents, None) == {
        "left": "it refuses",
        "right": "right.local:1: no name server",
    }
    assert not refusal.why_all_refused({}, None)
