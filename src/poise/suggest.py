"""Suggestions for unknown names: the most similar one, and the choices."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from itertools import islice

_MOST = 12
"""More choices than this are not listed in a message."""
_MOST_COMPARED = 500
"""More choices than this are not compared with a name: it takes 10 us for each."""


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the closest choice, or nothing."""
    compared = list(islice(choices, _MOST_COMPARED))
    close = difflib.get_close_matches(word, compared, n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def listed(choices: Iterable[str]) -> str:
    """Return the choices as a list for people, shortened if it is long."""
    names = [f"'{choice}'" for choice in choices]
    if len(names) > _MOST:
        names = [*names[:_MOST], f"and {len(names) - _MOST} more"]
    return ", ".join(names) or "none"


def unknown(kind: str, word: str, choices: Iterable[str]) -> str:
    """Return the message for a name that is not in `choices`."""
    choices = tuple(dict.fromkeys(choices))
    return (
        f"there is no {kind} '{word}'{did_you_mean(word, choices)}; "
        f"{kind}s: {listed(choices)}"
    )
