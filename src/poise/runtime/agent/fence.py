"""Which manager an agent obeys, and until when its leased components may be active.

While an agent is cut off, its manager may start its components elsewhere. So it holds a
lease, which heartbeats extend: of its manager, or of an agent that hears the manager.
Without either it goes on only while all other agents hear it: then the manager reaches
none of them, and can have started nothing there; where managers are voted for, while a
majority does that obeys the same one (docs/design/leader.md). The lease counts from
when a heartbeat was *sent*, so an agent that was stalled extends nothing by old ones.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import inf

from poise.clock import wall_time
from poise.wire.heartbeats import ASK_AFTER, LEASE, Contacts
from poise.wire.records.heartbeat_records import MANAGER
from poise.wire.records.request_records import Claim, ManagerId, Refused, majority_at


class Fence:
    """The manager that claimed an agent last, while no later one succeeds it.

    A later one has a higher fencing token, and succeeds when the earlier one's
    liveliness token is gone, or to take over. What the earlier one still sends is
    refused.
    """

    def __init__(
        self,
        robot: str,
        computer: str,
        wake: Callable[[], None],
        say: Callable[[str], object],
        manager: ManagerId | None = None,
        token: int = 0,
        wall: Callable[[], float] = wall_time,
    ) -> None:
        self.wake = wake
        self._wall = wall
        self._say = say
        self.arrivals = 0
        self.is_cut_off = False
        self.cut_off = 0.0
        self.unmanaged = wall()
        self._robot = robot
        self._computer = computer
        self._gone: set[str] = set() if manager is None else {manager.key}
        self.manager = manager
        self.token = token
        self._present: ManagerId | None = None
        self._ended: set[str] = set()
        self._is_expired = False

    def update(self) -> None:
        """Take note of a manager that came or went, and of the end of the lease."""
        before, manager = self._present, self.manager
        is_gone = manager is None or manager.key in self._gone
        self._present = None if is_gone else manager
        if self._present != before:
            self.unmanaged = self._wall() if is_gone else 0.0
            if before is not None:
                self._say(f"{before} is gone; what still runs here goes on")
            if self._present is not None:
                self._say(f"managed by {self._present}")
        if self.is_cut_off and not self.cut_off:
            self.cut_off = self._wall()
            # the present manager is refused, too, until it claims the agent again
            self.token += 1
            self._is_expired = True
            self._say(
                "cut off from its manager, which may start movable components "
                "elsewhere: they are inactive here until it sends a deployment"
            )

    def cut(self) -> None:
        """Note that the lease has ended; for the thread of the heartbeats."""
        self.is_cut_off = True
        self.wake()

    def note_told(self) -> None:
        """Note that a deployment came: its manager knows the other computers."""
        if self.cut_off:
            self.cut_off, self.is_cut_off = 0.0, False
            self._say("reached by its manager again")

    def is_managed(self) -> bool:
        """Return whether a manager may be at work, for all that is known."""
        return self.manager is not None and self.manager.key not in self._ended

    def lapse(self) -> None:
        """Let nothing leased run until the manager that claims sends a deployment."""
        self.is_cut_off = True
        self.cut_off = self.cut_off or self._wall()

    def succeeds(self, key: str) -> bool:
        """Return whether no other manager than this one can be at work."""
        before = self.manager
        return before is None or before.key == key or before.key in self._ended

    def note_liveliness(self, key: str, *, is_there: bool, has_ended: bool) -> None:
        """Note that a manager's liveliness token came or went; from any thread."""
        if is_there:
            self._gone.discard(key)
            self._ended.discard(key)
            self.arrivals += 1
            self.wake()
        else:
            self._gone.add(key)
            if has_ended:
                self._ended.add(key)
                self.wake()

    def note_alive(self, key: str) -> None:
        """Note that a manager is at work though its liveliness token went."""
        self._ended.discard(key)

    def claim(
        self, claim: Claim, token: int, *, is_unheard: bool = False
    ) -> Refused | None:
        """Obey a manager from now on, and return None; else return why not.

        `is_unheard`: whether the manager before is not heard any more. Where managers
        are voted for that is enough, and the next one has a higher term.
        """
        before, manager = self.manager, claim.manager
        is_same = before is not None and before.key == manager.key
        is_later = token > self.token or (is_same and token == self.token)
        is_free = before is None or is_same or claim.take_over
        if claim.election is None:
            is_free = is_free or (before is not None and before.key in self._gone)
        elif before is not None and not is_same:
            is_free = is_free or is_unheard or before.key in self._ended
            is_later = is_later and manager.term > before.term
        if not is_free or not is_later:
            return Refused(self._manages(), obeys_another=True)
        if not claim.is_poll:
            self.manager, self.token, self._is_expired = manager, token, False
        return None

    def refusal(self, token: int) -> str:
        """Return why a request with this token is refused; empty when it is not."""
        if self.manager is None:
            return f"no manager has claimed '{self._computer}' since its agent started"
        if self._is_expired:
            return f"the lease of '{self._computer}' ended: claim its agent again"
        return "" if token == self.token else self._manages()

    def _manages(self) -> str:
        return f"robot '{self._robot}' is managed by {self.manager}"


class Lease:
    """The lease of one agent."""

    def __init__(self, contacts: Contacts) -> None:
        self._contacts = contacts
        self._others: Collection[str] = ()
        self._manager = ""
        self._began: float | None = None
        self._stalled = -inf
        self._votes: Mapping[str, int] = {}
        self._not_before = -inf

    def begin(
        self,
        others: Collection[str],
        manager: str,
        began: float | None = None,
        votes: Mapping[str, int] = {},
    ) -> None:
        """Be claimed by a manager that knows these other agents, at a moment [s].

        Where managers are voted for, a claim extends nothing.
        """
        self._others, self._manager, self._votes = others, manager, votes
        self._began = began

    def note_stall(self, now: float) -> None:
        """Note that its agent stood still until now [s], and that it ended meanwhile.

        The manager may have begun to start elsewhere what runs here, before the other
        agents know: from now on they extend nothing until it has heard this one.
        """
        self._stalled = now

    def end(self, now: float) -> None:
        """Note that it has ended: what was heard of earlier moments counts no more.

        While its computer was suspended no time went by on its clock.
        """
        self._not_before = now

    def managed(self, now: float) -> float | None:
        """Return how long ago it sent what its manager has heard [s]; None: unknown."""
        manager = self._contacts.get(MANAGER)
        if manager is not None and manager.granted is not None:
            return now - manager.granted
        if self._votes:
            return None
        if self._began is not None:
            return now - self._began
        return None if manager is None else now - manager.began

    def age(self, now: float) -> float:
        """Return how long ago the lease was extended [s]; 0 before it begins."""
        age = self._age(now)
        return inf if self._votes and now - age < self._not_before else age

    def _age(self, now: float) -> float:
        direct = self.managed(now)
        if self._votes:
            began = -inf if self._began is None else self._began
            direct = now - began if direct is None else min(direct, now - began)
        elif direct is None:
            return 0.0
        # no other agent is needed, or may extend it
        if direct <= ASK_AFTER or now - direct < self._stalled:
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
        """Return when it ends, for all that is known at `now` [s]."""
        return now - (self.age(now) if age is None else age) + LEASE

    def revoked(self) -> Mapping[str, int]:
        """Return whose fencing tokens the manager has revoked, to repeat it."""
        manager = self._contacts.get(MANAGER)
        return manager.last.revoked if manager is not None else {}

    def is_revoked(self, computer: str, token: int) -> bool:
        """Return whether the manager or another agent revoked a token."""
        if not self._contacts.was_revoked:
            return False
        for name in (MANAGER, *self._others):
            side = self._contacts.get(name)
            revoked = side.last.revoked if side is not None else {}
            if revoked and token <= revoked.get(computer, -2) + 1:
                return True
        return False

    def _unheard(self, now: float) -> float:
        """Return how long ago it sent what all other agents have heard [s].

        Where managers are voted for, a majority is enough that obeys the same one.
        """
        if self._votes:
            acked = {
                name: contact.acked
                for name in self._others
                if (contact := self._contacts.get(name)) is not None
                and contact.acked is not None
                and contact.last.manager == self._manager
            }
            return now - majority_at(self._votes, {**acked, self._contacts.name: now})
        contacts = map(self._contacts.get, self._others)
        mine = {"", self._manager}
        heard = [
            c.acked if c is not None and c.last.manager in mine else None
            for c in contacts
        ]
        return max((now - at if at is not None else inf for at in heard), default=0.0)
