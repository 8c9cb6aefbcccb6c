"""Whether an agent's leased components may be active. Pure: moments are passed in.

While an agent is cut off, its manager may start its components elsewhere. So an agent
holds a lease, which heartbeats extend: of its manager, or of another agent that hears
the manager. Without either it goes on only if nothing can have been started elsewhere:
the manager has ended, or all other agents are heard, so that the manager reaches none.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from poise.wire.failure_detector import LEASE, Contacts
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
        self._began: float | None = None

    def begin(self, others: Collection[str], now: float | None = None) -> None:
        """Be claimed by a manager that knows these other agents of the robot.

        Parameters
        ----------
        now
            When an agent goes on with what one before it was told [s]; None: as soon as
            the manager is heard.
        """
        self._others = others
        self._began = now

    def managed(self, now: float) -> float | None:
        """Return how long ago it sent what its manager has heard [s]; None: unknown."""
        manager = self._contacts.get(MANAGER)
        if manager is None:
            return None if self._began is None else now - self._began
        return now - (manager.began if manager.acked is None else manager.acked)

    def age(self, now: float) -> float:
        """Return how long ago the lease was extended [s]; 0 before it begins."""
        direct = self.managed(now)
        if direct is None:
            return 0.0
        others = [c for name in self._others if (c := self._contacts.get(name))]
        ages = [
            now - other.acked + other.last.managed
            for other in others
            if other.acked is not None and other.last.managed is not None
        ]
        return min([direct, *ages])

    def revoked(self) -> Mapping[str, int]:
        """Return whose fencing tokens the manager has revoked, to repeat it."""
        manager = self._contacts.get(MANAGER)
        return manager.last.revoked if manager is not None else {}

    def is_revoked(self, computer: str, token: int) -> bool:
        """Return whether the manager or another agent says so of a token.

        A token grows by one when its lease ends.
        """
        sides = (self._contacts.get(name) for name in (MANAGER, *self._others))
        return any(
            side is not None and token <= side.last.revoked.get(computer, -2) + 1
            for side in sides
        )

    def is_held(self, now: float) -> bool:
        """Return whether it is in force, or not needed, while there is a manager."""
        return self.age(now) < LEASE or all(
            self._is_heard_by(other, now) for other in self._others
        )

    def _is_heard_by(self, other: str, now: float) -> bool:
        contact = self._contacts.get(other)
        if contact is None or contact.acked is None:
            return False
        return now - contact.acked < LEASE
