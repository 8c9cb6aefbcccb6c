"""What one end of a connector counts, always."""

from __future__ import annotations

from poise.runtime import _calls
from poise.wire.codec import WireError
from poise.wire.records.deployment_records import ConnectorKind
from poise.wire.records.status_records import ConnectorStatus, Side


class Counts(_calls.Counts):
    """Plain numbers, added to by the threads that use the connector."""

    def refuse(self, _: WireError) -> None:
        """Count something that came and is no frame."""
        self.errors += 1

    def status(
        self, name: str, key: str, kind: ConnectorKind, end: Side, *, ready: bool
    ) -> ConnectorStatus:
        """Return the numbers as a record."""
        return ConnectorStatus(
            name=name,
            key=key,
            kind=kind,
            end=end,
            ready=ready,
            calls=self.calls,
            messages=self.messages,
            bytes_out=self.bytes_out,
            bytes_in=self.bytes_in,
            errors=self.errors,
            drops=self.drops,
            delay=self.delay.summary(),
            wait=self.wait.summary(),
            size=self.size.summary(),
            latency=self.latency.summary(),
            latency_error=self.latency_error,
        )
