"""What the simulated world judged, whatever else it says."""

from __future__ import annotations

from typing import Any

import pytest

from poise.session.render.run_tables import judgements

FUNCTION = {"name": "audition", "success": True, "values": {}}
TASK = {
    "name": "serve",
    "success": False,
    "values": {
        "gap": {"value": 1.5, "unit": "m"},
        "served_after": {"value": None, "unit": "s"},
        "cups": {"value": 0, "unit": ""},
    },
}


def test_tasks_that_ran_come_before_functions() -> None:
    world = {"tasks": [TASK], "criteria": [FUNCTION]}
    (of_task,) = judgements(world, ["serve"])
    assert {name: str(value) for name, value in of_task.values.items()} == {
        "gap": "1.5 m",
        "served_after": "not measured",
        "cups": "0",
    }
    assert [each.name for each in judgements(world, ["other"])] == ["audition"]


@pytest.mark.parametrize("criteria", ["good", [1], [{"name": "x"}], {"audition": True}])
def test_another_form_is_no_judgement(criteria: Any) -> None:
    assert judgements({"criteria": criteria}, []) == []
