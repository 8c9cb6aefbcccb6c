"""Who looks at which connector that begins in this container."""

from __future__ import annotations

import time

from poise.errors import UsageError
from poise.runtime.connectors.sender import Sender
from poise.runtime.connectors.tap import Observer
from poise.runtime.hosting.wiring import Wiring
from poise.wire.records.migration_records import StepsFailed
from poise.wire.records.tap_records import Tap, TapReading

KEPT_FOR = 3.0
"""A viewer that has not asked for so long does not look any more [s]."""
MOST_VIEWERS = 16


class Taps:
    """The observers of a container's senders; used by its control thread alone."""

    def __init__(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self._observed: dict[tuple[Sender, str], Observer] = {}

    def read(self, asked: Tap) -> TapReading | StepsFailed:
        """Return what has gone out since a viewer asked last; from now on note it."""
        try:
            sender = self._wiring.sender(asked.connector)
        except UsageError as error:
            return StepsFailed(asked.number, str(error))
        key = sender, asked.viewer
        if key not in self._observed:
            if len(self._observed) >= MOST_VIEWERS:
                text = f"{MOST_VIEWERS} viewers look at this container already"
                return StepsFailed(asked.number, text)
            self._observed[key] = Observer(
                asked.connector, sender.port.type, asked.rate, asked.items
            )
            self._show(sender)
        return self._observed[key].take(asked.number)

    def end_unread(self) -> None:
        """Remove the observers of viewers that do not look any more."""
        if not self._observed:
            return
        until = time.monotonic() - KEPT_FOR
        gone = [key for key, each in self._observed.items() if each.read_at < until]
        for key in gone:
            del self._observed[key]
            self._show(key[0])

    def _show(self, sender: Sender) -> None:
        sender.observe(
            tuple(o for (each, _), o in self._observed.items() if each is sender)
        )
