"""What a person writes for a component is a value, or is refused."""

from __future__ import annotations

import pytest

from poise.errors import UsageError
from poise.session.running_robots.running_component import value_of


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ('{"gain":\t1E2}', {"gain": 100.0}),
        ('"\\ud83e\\udd16"', "\N{ROBOT FACE}"),
        ("{gain: 0.5, note: two words}", {"gain": 0.5, "note": "two words"}),
        ("20 ms", "20 ms"),
        ("", None),
    ],
)
def test_what_is_json_or_yaml_is_a_value(text: str, value: object) -> None:
    assert value_of(text) == value


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("{gain: 1", id="YAML"),
        pytest.param("2026-02-30", id="date"),
        pytest.param("9" * 5000, id="digits"),
        pytest.param("[" * 1200, id="depth", marks=pytest.mark.slow),
        pytest.param("\udcff", id="not UTF-8"),
    ],
)
def test_what_is_neither_is_refused_by_a_short_message(text: str) -> None:
    with pytest.raises(UsageError, match="is neither JSON nor YAML") as refused:
        value_of(text)
    assert len(str(refused.value)) < 500
    assert "\n" not in str(refused.value)
