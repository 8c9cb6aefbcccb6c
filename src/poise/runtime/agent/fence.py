"""Which manager an agent obeys: one at a time, by its fencing token."""

from __future__ import annotations

from collections.abc import Callable

from poise.clock import wall_time
from poise.wire.records.requests import Claim, ManagerId, Refused


class Fence:
    """The manager that claimed an agent last, while no later one succeeds it.

    A manager is succeeded only once its liveliness token is gone, or by one that is to
    take over; and only by one with a higher fencing token. What the earlier one still
    sends is refused from then on.

    Parameters
    ----------
    robot, computer
        The agent's, for messages.
    wake
        Called when there is something for `look`, on any thread; must not block.
    say
        Called by `look` with a sentence when a manager comes or goes.
    manager, token
        What an agent before it obeyed. That manager counts as gone until its
        liveliness token is seen.
    wall
        Returns the time [s since 1970].

    Attributes
    ----------
    arrivals
        How many managers have come.
    is_cut_off
        Whether the lease has ended, and no manager has said since what runs elsewhere.
    cut_off
        Since when `look` knows that [s since 1970]; 0: it is not so.
    unmanaged
        Since when `look` knows of no manager that is there [s since 1970]; 0: one is.
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
        self._wake = wake
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

    def look(self) -> None:
        """Take note of a manager that came or went, and of the end of the lease."""
        before, manager = self._present, self.manager
        is_gone = manager is None or manager.key in self._gone
        self._present = None if is_gone else manager
        if self._present != before:
            self.unmanaged = self._wall() if is_gone else 0.0
            if before is not None:
                self._say(f"{before} is gone; containers go on")
            if self._present is not None:
                self._say(f"managed by {self._present}")
        if self.is_cut_off and not self.cut_off:
            self.cut_off = self._wall()
            # the present manager is refused, too, until it claims the agent again
            self.token += 1
            self._is_expired = True
            self._say(
                "cut off from its manager, which may start movable components "
                "elsewhere: they are inactive here until it says what runs where"
            )

    def cut(self) -> None:
        """Note that the lease has ended; for the thread of the heartbeats."""
        self.is_cut_off = True
        self._wake()

    def note_told(self) -> None:
        """Note that the manager, which knows what runs elsewhere, says what runs."""
        if self.cut_off:
            self.cut_off, self.is_cut_off = 0.0, False
            self._say("reached by its manager again")

    def is_managed(self) -> bool:
        """Return whether a manager may be at work, for all that is known."""
        return self.manager is not None and self.manager.key not in self._ended

    def lapse(self) -> None:
        """Let nothing leased run until the manager that claims says what runs."""
        self.is_cut_off = True
        self.cut_off = self.cut_off or self._wall()

    def succeeds(self, key: str) -> bool:
        """Return whether no other manager than this one can be at work.

        One that may be only cut off may start elsewhere what runs here.
        """
        before = self.manager
        return before is None or before.key == key or before.key in self._ended

    def note_liveliness(self, key: str, *, is_there: bool, has_ended: bool) -> None:
        """Note that a manager's liveliness token came or went; from any thread.

        Parameters
        ----------
        has_ended
            Whether that manager has surely ended, when its token went; else it may
            only be cut off.
        """
        if is_there:
            self._gone.discard(key)
            self._ended.discard(key)
            self.arrivals += 1
            self._wake()
        else:
            self._gone.add(key)
            if has_ended:
                self._ended.add(key)

    def note_alive(self, key: str) -> None:
        """Note that a manager is at work though its liveliness token went."""
        self._ended.discard(key)

    def claim(self, claim: Claim, token: int) -> Refused | None:
        """Obey a manager from now on; return why not.

        It must take over from the manager that is obeyed, unless that one is gone.
        """
        before = self.manager
        is_same = before is not None and before.key == claim.manager.key
        is_free = before is None or is_same or before.key in self._gone
        is_free = is_free or claim.take_over
        is_later = token > self.token or (is_same and token == self.token)
        if not is_free or not is_later:
            return Refused(self._manages())
        self.manager, self.token, self._is_expired = claim.manager, token, False
        return None

    def refusal(self, token: int) -> str:
        """Return why a request with this token is refused; empty when it is not."""
        if self.manager is None:
            return f"no manager has claimed '{self._computer}' since its agent started"
        if self._is_expired:
            return f"the lease of '{self._computer}' ended: claim its agent again"
        return "" if token == self.token else self._manages()

    def _manages(self) -> str:
        return (
            f"robot '{self._robot}' is managed by {self.manager}, whose fencing token "
            f"is {self.token}"
        )
