"""The lease of a container's components, which fence themselves when it ends.

The agent writes its end into the stats page. A leased component reads that before each
handler, and before what leaves or enters its container.
"""

from __future__ import annotations

from poise.errors import Unavailable
from poise.runtime._calls import LeaseEnd

__all__ = ["LeaseEnd", "LeaseEnded", "check_lease"]


class LeaseEnded(Unavailable):
    """A leased component may neither send, call, be called nor keep its state."""

    def __init__(self, component: str) -> None:
        super().__init__(
            f"component '{component}' is inactive: the lease of its computer has "
            "ended, so it may be active elsewhere"
        )


def check_lease(lease: LeaseEnd | None, component: str) -> None:
    """Raise LeaseEnded when a component's lease has ended; None: it is not leased."""
    if lease is not None and lease.is_past():
        raise LeaseEnded(component)
