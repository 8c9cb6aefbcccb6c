"""A component on a computer, of which there are two while it moves."""

from __future__ import annotations

from msgspec import Struct, structs

from poise.wire.records.deployment_records import Goal


class Incarnation(Struct, frozen=True, kw_only=True):
    """A component on a computer. While it moves or is replaced there are two."""

    component: str
    computer: str
    # tells the incarnations of a component apart; the later one has the higher
    epoch: int = 0
    goal: Goal = "active"
    implementation: str = ""  # instead of the robot file's; empty: that one
    # ``package.module:function`` that turns the state of the implementation before into
    # one for this; empty: it is the same
    adapt: str = ""
    fresh: bool = False  # whether it begins without state
    gently: bool = False  # whether it is prepared with the CPU time that others leave
    unjoined: bool = False
    held: bool = False  # whether it is inactive only because `Desired.held` names it
    turn: int = 0
    action: str = ""

    def __str__(self) -> str:
        """Return what it is and where, for the journal."""
        return f"{self.component}/{self.epoch} on {self.computer} ({self.goal})"

    def with_goal(self, goal: Goal) -> Incarnation:
        """Return the same with another goal."""
        return structs.replace(self, goal=goal)
