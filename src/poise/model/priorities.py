"""How much more a higher priority counts than a lower one when CPU is short. Pure."""

from __future__ import annotations

from collections.abc import Iterable

STEP = 10.0
"""How many times more CPU the next higher priority gets, when both want all."""
RANGE = 100.0
"""How many times more the highest gets than the lowest, at most."""


def importance(priorities: Iterable[int]) -> dict[int, float]:
    """Return priority -> how many times more it counts than the lowest, >= 1.

    Only the order of priorities counts.
    """
    ranked = sorted(set(priorities))
    steps = len(ranked) - 1
    step = min(STEP, RANGE ** (1 / steps)) if steps > 0 else 1.0
    return {priority: step**rank for rank, priority in enumerate(ranked)}
