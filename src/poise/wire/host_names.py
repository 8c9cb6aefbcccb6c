"""Looks hosts up by name, on a thread: a name server may not answer for seconds."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Sequence

from poise import threads
from poise.endpoint import Endpoint

_AGAIN, _SOON = 5.0, 1.0
"""Names are looked up again after this time, for their addresses may change, and those
that are not known yet after this one [s]."""
_JOIN_LIMIT = 0.1
MAPPED = "::ffff:"
"""Stands before an IPv4 address that a socket of IPv6 sends to."""


class HostNames:
    """The IP addresses of hosts, for one thread that must not wait for them."""

    def __init__(self, family: socket.AddressFamily) -> None:
        self._family = family
        self._known: dict[str, tuple[str, ...]] = {}
        self._names: list[str] = []
        self._thread: threading.Thread | None = None
        self._has_news = threading.Event()
        self._is_closed = False

    def find(self, host: str) -> Sequence[str]:
        """Return a host's IP addresses at once; none while they are not known yet."""
        known = self._known.get(host, ())
        if not known and Endpoint(host, 0).is_ip:
            known = self._known[host] = (self._own(host),)
        elif not known and host not in self._names:
            if self._thread is None:
                thread = threads.daemon(self._main, "host names", again=True)
                thread.start()
                self._thread = thread
            self._names.append(host)
            self._has_news.set()
        return known

    def close(self) -> None:
        """Look nothing up any more."""
        self._is_closed = True
        self._has_news.set()
        if self._thread is not None:
            self._thread.join(_JOIN_LIMIT)
            if self._thread.is_alive():
                threads.abandon(self._thread)

    def _main(self) -> None:
        while not self._is_closed:
            for host in tuple(self._names):
                # the last address holds while no name server answers
                with contextlib.suppress(OSError, UnicodeError):
                    self._look_up(host)
            is_known = self._known.keys() >= {*self._names}
            self._has_news.wait(_AGAIN if is_known else _SOON)
            self._has_news.clear()

    def _look_up(self, host: str) -> None:
        mapped = socket.AI_V4MAPPED | socket.AI_ALL
        flags = mapped if self._family == socket.AF_INET6 else 0
        found = socket.getaddrinfo(
            host, None, self._family, socket.SOCK_DGRAM, flags=flags
        )
        self._known[host] = tuple(dict.fromkeys(str(to[0]) for *_, to in found))

    def _own(self, address: str) -> str:
        """Return an IP address as a socket of this family takes it."""
        is_mapped = self._family == socket.AF_INET6 and ":" not in address
        return f"{MAPPED}{address}" if is_mapped else address
