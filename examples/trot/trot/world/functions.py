"""Which of the robot's functions worked, as a person in the flat would say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

ANSWERED = 0.6
"""The share of sentences that want a right answer in time."""

LOST = 0.3
"""[m] The largest distance from the best path of a robot that knows where it is."""

MOVED = 1.0
"""[m] It drove so far at least."""

HEAD = 15.0
"""[degrees] The head may be this far off, median."""

GOOD = 0.6
"""The share of recommendations that are to be good; by chance a fifth is."""

SHOWN = 1.5
"""[s] from the question what is on to the recommendation, median."""

NAMED = 0.6
"""The share of the time in which the screen names who is in view, rightly."""

MEASURED: Mapping[str, Mapping[str, str]] = {
    "navigation": {
        "seconds": "s",
        "path_error": "m",
        "path_error_most": "m",
        "distance_to_goal": "m",
        "collisions": "",
    },
    "localisation": {"path_length": "m", "path_error_most": "m"},
    "manipulation": {"cups_placed": "", "cups_dropped": ""},
    "interaction": {
        "sentences": "",
        "answered": "",
        "word_error_rate": "",
        "answer_seconds": "s",
    },
    "audition": {"head_error_degrees": "degrees"},
    "recommendation": {
        "recommended": "",
        "good_recommendations": "",
        "recommendation_seconds": "s",
    },
    "recognition": {"named": ""},
}
"""What each function is judged by: keys of the world's result, and their units."""


def criteria(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return name, success and values of each function.

    Values are mappings of a key to ``{"value": 1.5, "unit": "s"}``; what was not
    measured is None, what has no unit has "".
    """
    worked = working(result)
    return [
        {
            "name": name,
            "success": worked[name],
            "values": {
                key: {"value": result[key], "unit": unit}
                for key, unit in MEASURED[name].items()
            },
        }
        for name in MEASURED
    ]


def working(result: Mapping[str, Any]) -> dict[str, bool]:
    """Return function -> whether it worked, by the world's other results."""
    said, seen = result["sentences"], result["recommendation_seconds"]
    head, good = result["head_error_degrees"], result["good_recommendations"]
    return {
        "navigation": result["goal_reached"] and result["collisions"] == 0,
        "localisation": result["path_length"] >= MOVED
        and result["path_error_most"] <= LOST,
        "manipulation": result["cups_placed"] > 0 and result["cups_dropped"] == 0,
        "interaction": said > 0 and result["answered"] >= ANSWERED * said,
        "audition": head is not None and head <= HEAD,
        "recommendation": (good or 0.0) >= GOOD and (seen or math.inf) <= SHOWN,
        "recognition": (result["named"] or 0.0) >= NAMED,
    }
