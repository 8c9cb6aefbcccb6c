"""The JSON Schema (draft 2020-12) of robot files, from the types of `sections`."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from poise.model import sections
from poise.units import DIMENSIONS, NUMBER

_NUMBER = r"\s*\+?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*"


def schema() -> dict[str, Any]:
    """Return the schema as plain data.

    It requires no key at the top, because each may be in another included file.
    """
    text = json.dumps(msgspec.json.schema(sections.RobotSection))
    made = json.loads(text.replace('Section"', '"'))  # names for people
    made["$defs"]["Robot"]["required"] = []
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Poise robot file",
        **_quantities({key: value for key, value in made.items() if key != "title"}),
    }


def schema_text() -> str:
    """Return the schema as it is published, one key a line."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def _quantities(value: Any) -> Any:  # noqa: ANN401, any part of a schema
    """Allow every number with a unit to be a number or a text with its unit."""
    if isinstance(value, list):
        return [_quantities(item) for item in value]
    if not isinstance(value, dict):
        return value
    made = {key: _quantities(item) for key, item in value.items()}
    dimension = made.pop("x-dimension", None)
    if dimension is None:
        return made
    if "exclusiveMinimum" not in made:
        made["minimum"] = 0
    if dimension == NUMBER.name:
        return {**made, "type": "number"}
    units = "|".join(sorted(u for u in DIMENSIONS[dimension].units if u))
    pattern = f"^{_NUMBER}({units})?\\s*$"
    return {**made, "type": ["number", "string"], "pattern": pattern}
