"""Which of the robot's functions worked, as a foreman in the hall would say."""

from __future__ import annotations

from typing import Any

from sorter import cell
from sorter.world.scene import Scene

SORTED, HELD, RIGHT, SHOWN = 0.5, 0.6, 0.8, 0.8
"""Shares, at least: of all objects that end in the right bin; of grips that hold
something; of objects in bins whose colour, or whose scratch, was seen rightly; of the
time in which the screen shows what was there less than a second before."""

FEWEST = 3
"""Of fewer objects no share is told."""


def result(scene: Scene, shown: float | None) -> dict[str, Any]:
    """Return how it went; `shown` is the share of the time the screen was fresh."""
    over = [thing for thing in scene.things if thing.fate]
    in_bins = [thing for thing in over if thing.fate in cell.BINS]

    def share(good: int, of: int) -> float | None:
        return round(good / of, 3) if of >= FEWEST else None

    right_bins = {
        id(thing): cell.REJECT if thing.scratch is not None else thing.colour
        for thing in over
    }
    measured = {
        "sorted_right": share(
            sum(thing.fate == right_bins[id(thing)] for thing in over), len(over)
        ),
        "grips_held": share(scene.grips_held, scene.grips),
        "colours_right": share(
            sum(each.fate in {each.colour, cell.REJECT} for each in in_bins),
            len(in_bins),
        ),
        "scratches_right": share(
            sum(
                (each.fate == cell.REJECT) == (each.scratch is not None)
                for each in in_bins
            ),
            len(in_bins),
        ),
        "collisions": scene.collisions,
        "screen_fresh": None if shown is None else round(shown, 3),
    }
    functions = {
        "sorting": (measured["sorted_right"] or 0.0) >= SORTED,
        "tracking": (measured["grips_held"] or 0.0) >= HELD,
        "detection": (measured["colours_right"] or 0.0) >= RIGHT,
        "inspection": (measured["scratches_right"] or 0.0) >= RIGHT,
        "safety": scene.runs and scene.collisions == 0,
        "operation": (shown or 0.0) >= SHOWN,
    }
    criteria = [
        {
            "name": name,
            "success": functions[name],
            "values": {key: {"value": value, "unit": ""}},
        }
        for name, (key, value) in zip(functions, measured.items(), strict=True)
    ]
    return {
        **measured,
        "objects": len(over),
        "wrong_bins": sum(each.fate != right_bins[id(each)] for each in in_bins),
        "passed": sum(each.fate == "passed" for each in over),
        "dropped": sum(each.fate == "dropped" for each in over),
        "seconds": round(scene.now, 2),
        "functions": functions,
        "criteria": criteria,
    }
