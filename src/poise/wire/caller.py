"""Who waits for what a thread does: the other end of the link that brought a call."""

from __future__ import annotations

import threading

from poise.wire.link import Link


class _Served(threading.local):
    link: Link | None = None


_served = _Served()


def serve(link: Link) -> None:
    """Know over which link the calls come that this thread runs from now on."""
    _served.link = link


def is_gone() -> bool:
    """Return at once whether the caller gave up, or ended; False when there is none."""
    link = _served.link
    return link is not None and not link.is_idle()
