"""The JSON Schema of the problem file."""

from __future__ import annotations

import msgspec

from poise.plan.problem import Problem


def schema() -> str:
    """Return the JSON Schema of what `poise.plan.load` reads, as indented JSON."""
    found = msgspec.json.schema(Problem)
    whole = {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}
    return msgspec.json.format(msgspec.json.encode(whole), indent=2).decode() + "\n"
