"""Until when an agent's leased components may be active. Pure: moments are passed in.

While an agent is cut off, its manager may start its components elsewhere. So an agent
holds a lease, which heartbeats extend: of its manager, or of another agent that hears
the manager. Without either it goes on only while all other agents hear it: then the
manager reaches none of them, and can have started nothing there.

What counts is when that was *sent* which the others have heard. An agent that was
stalled finds old heartbeats when it goes on, and extends nothing by them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import inf

from poise.wire.failure_detector import ASK_AFTER, LEASE, Contacts
from poise.wire.records.heartbeats import MANAGER


class Lease:
    """The lease of one agent.

    Parameters
    ----------
    contacts
        Whom the agent hears.
    """

    def __init__(self, contacts: Contacts) -> None:
        self._contacts = contacts
        self._others: Collection[str] = ()
        self._manager = ""
        self._began: float | None = None

    def begin(
        self, others: Collection[str], manager: str, began: float | None = None
    ) -> None:
        """Be claimed by a manager that knows these other agents of the robot.

        Parameters
        ----------
        manager
            Its key. Agents that obey another one say nothing of this one's lease.
        began
            When it was extended, while the manager has heard nothing [s]; None: when
            the manager is heard first.
        """
        self._others, self._manager = others, manager
        self._began = began

    def managed(self, now: float) -> float | None:
        """Return how long ago it sent what its manager has heard [s]; None: unknown."""
        manager = self._contacts.get(MANAGER)
        if manager is not None and manager.acked is not None:
            return now - manager.acked
        if self._began is not None:
            return now - self._began
        return None if manager is None else now - manager.began

    def age(self, now: float) -> float:
        """Return how long ago the lease was extended [s]; 0 before it begins."""
        direct = self.managed(now)
        if direct is None:
            return 0.0
        if direct <= ASK_AFTER:  # no other agent is needed
            return direct
        others = [c for name in self._others if (c := self._contacts.get(name))]
        ages = [
            now - other.acked + other.last.managed
            for other in others
            if other.acked is not None
            and other.last.managed is not None
            and other.last.manager == self._manager
        ]
        return min([direct, *ages, self._unheard(now)])

    def until(self, now: float, age: float | None = None) -> float:
        """Return when it ends, for all that is known at `now` [s].

        Parameters
        ----------
        age
            What `age` says of that moment [s]; None: it is worked out.
        """
        return now - (self.age(now) if age is None else age) + LEASE

    def revoked(self) -> Mapping[str, int]:
        """Return whose fencing tokens the manager has revoked, to repeat it."""
        manager = self._contacts.get(MANAGER)
        return manager.last.revoked if manager is not None else {}

    def is_revoked(self, computer: str, token: int) -> bool:
        """Return whether the manager or another agent says so of a token.

        A token grows by one when its lease ends.
        """
        for name in (MANAGER, *self._others):
            side = self._contacts.get(name)
            revoked = side.last.revoked if side is not None else {}
            if revoked and token <= revoked.get(computer, -2) + 1:
                return True
        return False

    def _unheard(self, now: float) -> float:
        """Return how long ago it sent what all other agents have heard [s]."""
        contacts = map(self._contacts.get, self._others)
        mine = {"", self._manager}
        heard = [
            c.acked if c is not None and c.last.manager in mine else None
            for c in contacts
        ]
        return max((now - at if at is not None else inf for at in heard), default=0.0)
