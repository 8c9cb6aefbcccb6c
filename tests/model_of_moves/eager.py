"""Steps that may be taken at once, and no other: what else may happen waits for them.

Most states of the model differ only in the order of steps that do not touch each other.
When such a step is *eager*, all orders but one need not be looked at. A step ``a`` from
``s`` to ``s1`` may be eager when for each other step ``b`` from ``s`` to ``t``

- either ``b`` leads from ``s1`` to a state to which ``a`` leads from ``t``,
- or ``t`` is reached from ``s1``;

and ``a`` changes nothing of what `tests.model_of_moves.world.visible` shows, which is
all that may be wrong for a while only. Then all the states after which nothing can
happen that are reached from ``s`` are reached from ``s1``, too: by induction over the
longest way from ``s``, which has an end because no state comes back. So nothing is left
out that is stuck, at whose end something is lost, or that is wrong on the way.
`tests.model_of_moves.checker.crossings` looks for steps that break the rule, and
``test_eager.py`` holds that there are none.
"""

from __future__ import annotations

import re

from tests.model_of_moves.world import Bounds, State

_ALWAYS = re.compile(
    r"caller \d (goes out|goes on|is told that it moved)|transfer \d is done|removed"
)
_LATE = re.compile(r"(.*) at (.*) \(late\)")
_AT = re.compile(r"arrives at (.*)|(.*) is told|(.*) is removed|mark at (sink)")


class Eager:
    """Says of steps whether they are; there are none before the last kill."""

    def __init__(self, bounds: Bounds) -> None:
        self._kills = bounds.kills

    def __call__(self, s: State, name: str) -> bool:
        """Whether the step of this name may be taken alone in this state."""
        if s.kills < self._kills:
            return False
        if _ALWAYS.fullmatch(name):
            return True
        if late := _LATE.fullmatch(name):
            return _is_in_vain(s, *late.groups())
        at = _AT.fullmatch(name)
        if at is None:
            return False
        container = at[at.lastindex or 0]
        return _is_alone(s, container) and not _is_seen(s, name, container)


def _is_seen(s: State, name: str, container: str) -> bool:
    """Whether a deployment lets a component begin or end to work."""
    side, _, which = container.partition(" ")
    if not which or name.startswith("arrives"):
        return False
    works = s.one("old" if side == "old" else "new", int(which)).phase == "work"
    return works == name.endswith("removed")


def _is_alone(s: State, container: str) -> bool:
    """Whether no order is on its way that could meet what happens in a container."""
    pending = {o.container for o in s.orders if o.outcome == "sent"}
    pending |= {o.container for o in s.late}
    if pending & {container, container.replace("old", "new")}:
        return False
    # it is the same before and after for all who call or publish
    return container != "source" or (s.path == s.spec and s.held is None)


def _is_in_vain(s: State, step: str, container: str) -> bool:
    """Whether a late order changes nothing, now or at any later time."""
    if container == "source":
        return s.applied != "both" and not s.is_source_dead
    side, _, which = container.partition(" ")
    one = s.one("old" if side == "old" else "new", int(which))
    if one.phase in {"gone", "dead"}:
        return one.phase == "gone"
    gives = s.olds[int(which)].gives or any(
        (o.container, o.steps[-1]) == (f"old {which}", "send state") for o in s.late
    )
    works = one.phase == "work" and not one.stays and one.party == step
    in_vain = {
        "resume": works,
        "roll back": works,
        "restore state": not (gives or s.round.startswith("transfer")),
    }
    return in_vain.get(step, False)
