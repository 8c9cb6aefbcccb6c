"""Says that connections cannot be accepted, and what to do; not at every attempt."""

from __future__ import annotations

import errno
import logging
import os
import resource
import time

log = logging.getLogger(__name__)

EVERY = 10.0
"""At most one warning in this time [s]."""
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

    def note(self, error: OSError) -> None:
        """Warn of an error of `accept`, unless the connection has just gone."""
        now = time.monotonic()
        if error.errno in _PASSING or now < self._again_at:
            return
        self._again_at = now + EVERY
        log.warning(
            "%s accepts no connection for now: %s%s", self._who, error, _remedy(error)
        )


def _remedy(error: OSError) -> str:
    if error.errno != errno.EMFILE:
        return ""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return (
        f". Process {os.getpid()} may open {limit} files: raise that where the agent "
        f"starts (`ulimit -n {2 * limit}`), or close what its components leave open"
    )
