"""Says that connections cannot be accepted, and what to do.

It is logged now and then, and reported for as long as it lasts.
"""

from __future__ import annotations

import errno
import logging
import os
import resource
import time

log = logging.getLogger(__name__)

EVERY = 10.0
"""At most one warning in this time [s]."""
_LATELY = 2.0
"""A failure counts for this time [s]: status is asked for more often."""
_PASSING = {errno.EAGAIN, errno.ECONNABORTED, errno.EINTR}


class AcceptWarning:
    """The warnings of one listener.

    Parameters
    ----------
    who
        Who accepts, for people.
    """

    def __init__(self, who: str) -> None:
        self._who = who
        self._again_at = 0.0
        self._last = ""
        self._last_at = float("-inf")

    def note(self, error: OSError) -> None:
        """Warn of an error of `accept`, unless the connection has just gone."""
        if error.errno in _PASSING:
            return
        self._last_at, self._last = time.monotonic(), self._sentence(error)
        if self._last_at >= self._again_at:
            self._again_at = self._last_at + EVERY
            log.warning("%s", self._last)

    def trouble(self) -> str:
        """Return why no connection can be accepted now; empty: they can."""
        try:
            os.close(os.eventfd(0))
        except OSError as error:
            return self._sentence(error)
        return self._last if time.monotonic() < self._last_at + _LATELY else ""

    def _sentence(self, error: OSError) -> str:
        return f"{self._who} accepts no connection for now: {error}{_remedy(error)}"


def _remedy(error: OSError) -> str:
    if error.errno != errno.EMFILE:
        return ""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return (
        f". Process {os.getpid()} may open {limit} files: raise that where the agent "
        f"starts (`ulimit -n {2 * limit}`), or close what its components leave open"
    )
