"""The control socket and the stats page of a container process, at the agent's end."""

from __future__ import annotations

import contextlib
import os
import signal
import socket

from poise.runtime._calls import LeaseEnd, PageSampler
from poise.wire import record_channel
from poise.wire.records.container import FromContainer, ToContainer


class ControlLink:
    """A `ContainerControl` of a real process.

    Parameters
    ----------
    stats_page
        The descriptor of its stats page; closed when it is not needed any more.

    Attributes
    ----------
    page
        Reads the container's stats page; None before its birth.
    """

    def __init__(self, name: str, connection: socket.socket, stats_page: int) -> None:
        self.name = name
        self.pid = 0
        self.page: PageSampler | None = None
        self._connection = connection
        self._reader = record_channel.RecordReader(connection)
        self._stats_page = stats_page
        self._lease: LeaseEnd | None = None

    def fileno(self) -> int:
        """Return the descriptor to wait for; negative: it is closed."""
        return self._connection.fileno()

    def next(self) -> FromContainer | None:
        """Return what the container says next, as `RecordReader.next` does."""
        said: FromContainer | None = self._reader.next(FromContainer)
        return said

    def note_born(self, pid: int) -> None:
        """Take note of its process; OSError or RuntimeError: no memory is free."""
        self.pid = pid
        self.page = PageSampler(self._stats_page, pid)
        self._lease = LeaseEnd(self._stats_page)

    def send(self, record: ToContainer) -> None:
        """Tell it something; raises as `record_channel.send`."""
        record_channel.send(self._connection, record)

    def signal(self, number: signal.Signals) -> None:
        """Send its process a signal; harmless when that has ended."""
        if self.pid:
            with contextlib.suppress(ProcessLookupError):  # its end is reported
                os.kill(self.pid, number)

    def extend_lease(self, until: float) -> None:
        """Let its leased components act until then [s, CLOCK_BOOTTIME].

        Called from any thread; without effect before it is born.
        """
        if self._lease is not None:
            self._lease.at = until

    def is_lease_past(self) -> bool:
        """Return whether its leased components may not act; raises as `note_born`."""
        return LeaseEnd(self._stats_page).is_past()

    def heartbeat(self) -> int | None:
        """Return how often its control thread has run; None before it is born."""
        return None if self.page is None else self.page.heartbeat()

    def close(self) -> None:
        """Let go of socket and page."""
        if self._connection.fileno() >= 0:
            self._connection.close()
            os.close(self._stats_page)
