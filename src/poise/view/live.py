"""Reads how a running robot is, again and again, also after its manager was killed."""

from __future__ import annotations

from collections import deque

from msgspec import Struct
from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import PoiseError
from poise.session.running_robots.running import JournalEntry, Running, Status

MOST_ENTRIES = 500
"""So many decisions are kept."""


class Look(Struct, frozen=True, kw_only=True):
    """How a robot was when it was last looked at.

    Parameters
    ----------
    status
        What was known last, of agents if no manager answers; None: nothing yet.
    entries
        The last entries of its journal, oldest first.
    trouble
        Why no manager answers now; empty: one does.
    since
        Since when there is none [s since 1970].
    """

    status: Status | None = None
    entries: tuple[JournalEntry, ...] = ()
    trouble: str = ""
    since: float = 0.0


class LiveReader:
    """Reads one robot. It looks only when it is asked to, and never raises.

    Parameters
    ----------
    robot
        Its name; None: the only one that runs here. It stays with the one it found.
    """

    def __init__(self, robot: str | None = None) -> None:
        self.running = Running(robot)
        self._entries: deque[JournalEntry] = deque(maxlen=MOST_ENTRIES)
        self._look = Look()

    def look(self) -> Look:
        """Return how the robot is; without an answer, how it was, and why."""
        before = self._look
        try:
            status = self.running.status()
            self.running.name = status.robot
            if before.status is None or before.status.manager != status.manager:
                # its journal may be another file, with numbers of its own
                self._entries.clear()
            if status.by_agents:  # the journal is the manager's
                first = status.deviations[0]
                trouble, since = first.what, first.since
                return self._note(Look(status=status, trouble=trouble, since=since))
            after = self._entries[-1].number if self._entries else 0
            self._entries.extend(self.running.journal(after))
        except PoiseError as error:
            since = before.since if before.trouble else wall_time()
            return self._note(replace(before, trouble=str(error), since=since))
        return self._note(Look(status=status))

    def _note(self, look: Look) -> Look:
        self._look = replace(look, entries=tuple(self._entries))
        return self._look
