"""A component on a computer, of which there are two while it moves."""

from __future__ import annotations

from msgspec import Struct, structs

from poise.wire.records.deployment_records import Goal


class Incarnation(Struct, frozen=True, kw_only=True):
    """A component on a computer. While it moves or is replaced there are two.

    Parameters
    ----------
    epoch
        Tells the incarnations of a component apart; the later one has the higher.
    implementation
        Instead of the robot file's; empty: that one.
    adapt
        ``package.module:function`` that turns the state of the implementation before
        into one for this; empty: it is the same.
    fresh
        Whether it begins without state.
    gently
        Whether it is prepared with the CPU time that others leave.
    unjoined
        Whether no connector ends at it: it waits, and others do not reach it.
    held
        Whether it is inactive only because `Desired.held` names it.
    turn, action
        The number of the action that it is to end, which grows, and its name.
    """

    component: str
    computer: str
    epoch: int = 0
    goal: Goal = "active"
    implementation: str = ""
    adapt: str = ""
    fresh: bool = False
    gently: bool = False
    unjoined: bool = False
    held: bool = False
    turn: int = 0
    action: str = ""

    def __str__(self) -> str:
        """Return what it is and where, for the journal."""
        return f"{self.component}/{self.epoch} on {self.computer} ({self.goal})"

    def with_goal(self, goal: Goal) -> Incarnation:
        """Return the same with another goal."""
        return structs.replace(self, goal=goal)
