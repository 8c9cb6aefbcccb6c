"""What must hold after every step of a simulated robot, each with its id."""

from __future__ import annotations

from collections.abc import Mapping

from poise.simulation.schedule.scheduler import SimulationError

INVARIANTS: Mapping[str, str] = {
    "nothing-active-twice": "No two incarnations of a component work at one time.",
    "each-message-once-in-order": "No message is processed twice, or out of order.",
    "committed-stays": "A committed move is never undone.",
    "commands-end": "An accepted command ends within its limit.",
    "desired-is-reached": "What is desired runs soon after the last fault ended.",
    "failures-are-shown": "A failure is in `status` within a second.",
    "no-bug-stops-the-robot": "No error ends a manager, an agent or a thread of them.",
}
"""Id -> what it says; `docs/design/simulation.md` cites the ids."""


class Violation(SimulationError):
    """An invariant does not hold.

    Parameters
    ----------
    invariant
        Its id.
    """

    def __init__(self, invariant: str, what: str) -> None:
        assert invariant in INVARIANTS, invariant  # noqa: S101
        super().__init__(f"{invariant}: {what}")
        self.invariant = invariant
