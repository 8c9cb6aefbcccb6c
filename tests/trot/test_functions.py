from __future__ import annotations

from typing import Any

import pytest

from trot.world.functions import MEASURED, criteria, working

GOOD: dict[str, Any] = {
    "goal_reached": True,
    "collisions": 0,
    "path_length": 7.2,
    "path_error_most": 0.14,
    "cups_placed": 4,
    "cups_dropped": 0,
    "sentences": 5,
    "answered": 4,
    "head_error_degrees": 4.0,
    "good_recommendations": 0.8,
    "recommendation_seconds": 0.9,
    "named": 0.9,
}


def test_a_good_run_works() -> None:
    assert all(working(GOOD).values())


@pytest.mark.parametrize(
    ("change", "fails"),
    [
        ({"collisions": 1}, "navigation"),
        ({"path_error_most": 0.5}, "localisation"),
        ({"path_length": 0.2}, "localisation"),
        ({"cups_placed": 0}, "manipulation"),
        ({"answered": 2}, "interaction"),
        ({"head_error_degrees": None}, "audition"),
        ({"good_recommendations": 0.5}, "recommendation"),
        ({"recommendation_seconds": None}, "recommendation"),
        ({"named": None}, "recognition"),
    ],
)
def test_says_what_failed(change: dict[str, Any], fails: str) -> None:
    found = working(GOOD | change)
    assert [name for name, works in found.items() if not works] == [fails]


def test_every_function_has_its_values_with_units() -> None:
    others = {key: None for keys in MEASURED.values() for key in keys}
    found = {each["name"]: each for each in criteria(others | GOOD | {"answered": 0})}
    assert found.keys() == working(GOOD).keys()
    assert found["interaction"]["success"] is False
    assert found["interaction"]["values"]["answered"] == {"value": 0, "unit": ""}
    assert found["audition"] == {
        "name": "audition",
        "success": True,
        "values": {"head_error_degrees": {"value": 4.0, "unit": "degrees"}},
    }
