"""Where components fit beside the running ones."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise import plan
from poise.manage.shortages.free_room import room_for_components
from poise.model.robot import Robot
from tests.manage.adaptation.conftest import Make


def test_nobody_waits_for_the_reason_why_there_is_no_room(
    situation: Make, two: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def looked_for(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(plan.Result, "find_conflict", looked_for)
    big = two.with_components(
        lambda c: replace(c, demand={"cpu": 0.7 if c.name == "b" else 0.2})
    )
    seen = situation({"a": "left"})
    assert room_for_components(replace(seen, robot=big), ["b"]) == {}
    assert room_for_components(seen, ["b"]).keys() == {"b"}
